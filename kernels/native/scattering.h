// What W rays do at surfaces: wrt.kernels.shading.bsdf.fresnel, and which rays go on.
#pragma once
#include "surfaces.h"

#if WRT_VECTORS
namespace wrt {
namespace {

/// `fresnel_exact`: the share that is reflected. cosine: at least 0.
template <int W> inline Floats<W> fresnel(Floats<W> cosine, Floats<W> ratio)
{
    using F = Floats<W>;
    const F beyond = 1.0f - ratio * ratio * (1.0f - cosine * cosine), other = root(beyond);
    const F parallel = (cosine - ratio * other) / (cosine + ratio * other);
    const F perpendicular = (ratio * cosine - other) / (ratio * cosine + other);
    return pick(beyond > 0.0f, 0.5f * (parallel * parallel + perpendicular * perpendicular), all<W>(1.0f));
}

/// Reflection and refraction at smooth boundaries.
template <int W> struct Boundaries {
    Floats<W> ratio, reflected;
    V3<W> back, bent;
};

/// `mirrored`, `refracted` and `fresnel_exact` for rays that arrive from `out`. bent: 0 at total internal reflection.
template <int W>
inline Boundaries<W> meet_boundaries(const V3<W>& direction, const V3<W>& normal, Ints<W> is_front, Floats<W> index)
{
    using F = Floats<W>;
    Boundaries<W> b;
    const V3<W> out = direction * -1.0f;
    const F cosine = dot(out, normal);
    b.ratio = pick(is_front, 1.0f / index, index);
    b.reflected = fresnel<W>(absolute(cosine), b.ratio);
    b.back = normal * (2.0f * cosine) - out;
    const F under = 1.0f - b.ratio * b.ratio * larger(all<W>(0.0f), 1.0f - cosine * cosine);
    b.bent = pick3<W>(under > 0.0f, normal * (b.ratio * cosine - root(under)) - out * b.ratio, zero3<W>());
    return b;
}

/// `kept_above`: directions that a smooth normal sent through the triangle, or back from it, are mirrored at its plane.
template <int W> inline V3<W> kept_above(const V3<W>& toward, const V3<W>& face_normal, Ints<W> is_transmitted)
{
    const Floats<W> rise = dot(toward, face_normal);
    return pick3<W>((rise < 0.0f) ^ is_transmitted, toward - face_normal * (2.0f * rise), toward);
}

template <int W> inline Floats<W> largest(const V3<W>& v) { return larger(v.x, larger(v.y, v.z)); }

/// Whether weights are finite and not 0.
template <int W> inline Ints<W> is_weight(const V3<W>& share)
{
    const V3<W> rest = share - share;
    return (largest<W>(share) > 0.0f) & (rest.x == 0.0f) & (rest.y == 0.0f) & (rest.z == 0.0f);
}

}  // namespace
}  // namespace wrt
#endif
