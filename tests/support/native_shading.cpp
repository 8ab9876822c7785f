// Instantiates the headers of shading and influence areas, as native_headers.cpp does the others.
#include "area_lanes.h"
#include "camera_rays.h"
#include "clipped_areas.h"
#include "last_rays.h"
#include "path_step.h"
#include "tree_step.h"

struct Vec3 {
    float c[3];
};
struct Vec3d {
    double c[3];
};
template <class T> struct Array {
    T* data;
    int shape[4];
};

using namespace wrt;

struct Vec2 {
    float c[2];
};
struct Vec4 {
    float c[4];
};
struct Hits {
    Array<float> t;
    Array<int> primitive;
    Array<Vec2> uv;
};

#if WRT_VECTORS
struct FaceRecord {
    float c[16];
};
struct ShadedMesh {
    struct {
        Vec3 low, high;
    } mesh;
    Array<FaceRecord> records;
    bool is_smooth;
    Array<Vec3> corner_normals;
};
struct Materials {
    Array<int> of_face, kind, two_sided, color_texture, surface_texture;
    int of_face_stride;
    bool has_uv, has_color;
    Array<Vec3> color, emission, absorption;
    Array<Vec4> shape;
};
struct Sky {
    int width, height, rows, columns;
    Vec3 east, north, up;
    Array<float> row_sums, cell_sums;
    Array<Vec3> texels;
};
struct Lights {
    int count, areas, triangle_entry, sky_entry;
    Array<int> kind, triangle;
    Array<Vec3> position, axis, edge1, edge2, radiance;
    Array<Vec4> shape;
    Array<float> sums, triangle_sums;
    float far, triangle_power;
    Vec3 triangle_low, triangle_high;
    Sky sky;
};
struct Scene {
    ShadedMesh shaded;
    Materials materials;
    Lights lights;
    bool schlick;
};
struct Source {
    int sampler;
    unsigned seed;
};
struct Wave {
    Array<int> order;
    int first_pixel, first_sample, samples;
};
struct Queue {
    Array<Vec3> origin, direction, weight;
    Array<float> density;
    Array<int> slot;
    Array<unsigned long long> media;
};
struct Gathered {
    Array<Vec3> emitted, lit, shadow_origin, shadow_direction, radiance;
};
struct Step {
    int generation;
    bool is_last, samples_lights;
    int roulette;
    float threshold;
};
struct View {
    int width, height;
    Vec3d position, right, up, forward;
};
struct Camera {
    View view;
    Vec3d center, lens_right;
    bool is_perspective, at_center;
    int filter;
};
struct Listed {
    Array<int> ray, light;
};

unsigned shading(const Scene& scene, const Source& source, const Wave& wave, const Queue& queue, const Hits& hits,
    const Gathered& rays, const Step& step, const Array<int>& flags, int& to)
{
    const StepArrays a {scene, source, wave, queue, hits, rays};
    return shade_paths<WIDTH>(a, step, 1, InPlace {queue, flags, rays})
        + shade_paths<WIDTH>(a, step, 1, Appended {queue, flags, rays, to, to})
        + shade_trees<WIDTH>(a, step, 1, 0, 2, queue, flags);
}

int queues(const Scene& scene, const Queue& queue, const Hits& hits, const Gathered& rays, const Array<int>& flags,
    const Listed& listed, Vec3& total)
{
    float squares = 0.0f;
    fetch_hits(scene, hits, 0, 3);
    order_rays(0, 3, queue, queue);
    gather_paths(0, 3, flags, rays, flags);
    gather_trees(0, 3, 3, 0, 1, flags, flags, rays, listed);
    add_samples(rays.lit.data, 3, 1.0f, total, squares);
    return append_rays(0, 3, queue, flags, queue, 0)
        + part_last_rays<WIDTH>(0, 3, true, scene.lights, queue, flags.data, queue);
}

int cameras(const Camera& camera, const Source& source, const Wave& wave, const Queue& queue, const Array<Vec3>& sums)
{
    return start_rays<WIDTH>(0, camera, source, wave, queue, sums);
}
#endif

struct AreaView {
    Vec3 eye, right, up, forward;
    float near;
    struct {
        float c[2];
    } half;
    bool radial;
};

float projections(const AreaView& view, const Vec3& low, const Vec3& high, const float* boxes, float* areas)
{
    whole_areas(view, boxes, 3, areas);
    clipped_areas(view, boxes, 3, true, areas);
    return whole_area(view, low, high) + clipped_area(view, low, high, false);
}

struct Batch {
    Array<Vec3> origins, directions;
    Array<float> t_min, t_max;
    int origin_stride, direction_stride, t_min_stride, t_max_stride;
    Vec3d center;
};
struct Faces3 {
    int c[3];
};
struct Mesh {
    Array<Faces3> faces;
    Array<Vec3> vertices;
};

struct Region {
    Vec3d origin, right, up, forward;
    double near, far, width, height, widening, heightening;
};

int areas(const Batch& batch, const Region& region, const AreaView& view, const Vec3& low, const Vec3& high,
    AreaLanes<16>& lanes, AreaMarks<16>& marks, unsigned short* area, float* cut)
{
    int sums[4] = {};
    const int count = load_area_rays(batch, 0, 3, lanes, marks);
    try_area(1, region, view, 0.1f, 0.1f, 0, lanes, marks);
    store_area_rays(0, count, 2, low, high, lanes, marks, area, cut, cut);
    sum_areas(marks, sums);
    return sums[0];
}
