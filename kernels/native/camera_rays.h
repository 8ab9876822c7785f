// Camera rays of W samples: wrt.kernels.shading.wavefront.camera_rays, in lanes.
#pragma once
#include "random_numbers.h"

#if WRT_VECTORS
namespace wrt {
namespace {

/// The number of the filter "box".
constexpr int BOX = 0;

/// Unit directions from a pinhole through places in pixels.
template <int W, class View> inline V3<W> camera_directions(const View& view, Ints<W> pixel, Floats<W> x, Floats<W> y)
{
    using D = Vector<double, W>;
    const auto wide = [](auto v) { return __builtin_convertvector(v, D); };
    const Ints<W> row = quotient<W>(pixel, view.width);
    const D across = wide(pixel - row * view.width) + 0.5 + wide(x), below = wide(row) + 0.5 + wide(y);
    const D to_right = 2.0 * across / (double)view.width - 1.0, up = 1.0 - 2.0 * below / (double)view.height;
    D d[3];
    WRT_UNROLLED
    for (int k = 0; k < 3; ++k) d[k] = view.forward.c[k] + (to_right * view.right.c[k] + up * view.up.c[k]);
    const D length = __builtin_elementwise_sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    const auto narrow = [&](D v) { return __builtin_convertvector(v / length, Floats<W>); };
    return {narrow(d[0]), narrow(d[1]), narrow(d[2])};
}

/// The rays of the samples first .. first + W - 1, if the camera is a pinhole with a box filter; returns how many are done.
template <int W, class Camera, class Source, class Wave, class Queue, class Sums>
inline int start_rays(
    int first, const Camera& camera, const Source& source, const Wave& wave, const Queue& queue, const Sums& radiance)
{
    using F = Floats<W>;
    const double* const lens = camera.lens_right.c;
    if (!camera.is_perspective || lens[0] != 0.0 || lens[1] != 0.0 || lens[2] != 0.0) return 0;
    if (!camera.at_center && (camera.filter != BOX || (source.sampler != SOBOL && source.sampler != RANDOM))) return 0;
    Ints<W> slot, pixel;
    for (int i = 0; i < W; ++i) slot[i] = first + i;
    const SampleKeys<W> keys = sample_keys<W>(source, wave, slot, pixel);
    F x = all<W>(0.0f), y = x;
    if (!camera.at_center) {
        keys.point(FILTER, x, y);
        x = x - 0.5f, y = y - 0.5f;
    }
    const auto origin = [&](int k) { return all<W>((float)(camera.view.position.c[k] - camera.center.c[k])); };
    save3<W>(queue.origin.data + first, {origin(0), origin(1), origin(2)});
    save3<W>(queue.direction.data + first, camera_directions<W>(camera.view, pixel, x, y));
    save3<W>(queue.weight.data + first, {all<W>(1.0f), all<W>(1.0f), all<W>(1.0f)});
    save(queue.density.data + first, all<W>(0.0f));
    save(queue.slot.data + first, slot);
    __builtin_memset(queue.media.data + first, 0, 8 * W);
    save3<W>(radiance.data + first, zero3<W>());
    return W;
}

}  // namespace
}  // namespace wrt
#endif
