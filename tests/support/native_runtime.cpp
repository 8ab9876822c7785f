// Instantiates the headers of kernels/runtime, layout and query; see native_headers.cpp.
#include "compact_nodes.h"
#include "part_queries.h"
#include "pool.h"

struct Bounds {
    unsigned shape[1];
    unsigned long size;
};

struct Node {
    int c[2];
    Node(int a, int b)
        : c {a, b}
    {
    }
};
template <class T> struct Array {
    T* data;
};
struct Vec3 {
    float c[3];
};
struct Face {
    int c[3];
};
struct RayBatch {
    Array<Vec3> origins, directions;
    Array<float> t_max;
    int origin_stride, direction_stride, t_max_stride;
};
struct HitBatch {
    Array<float> t;
    Array<int> primitive;
    Array<Node> uv;
};
struct Mesh {
    Array<Face> faces;
    Array<Vec3> vertices;
};

using namespace wrt;

void pools(pool::JobQueue& job_queue, const pool::Job* job)
{
    pool::run_as_helper<Bounds>(job_queue, 3);
    pool::run_as_caller<Bounds>(job_queue, job_queue.slots[2], job);
    pool::stop(job_queue.slots[2]);
    pool::close(job_queue);
}

int calls(Alternative* stages, const Call* steps, const int* counts, int* totals)
{
    run_stages<Bounds, 3, 8192, 32>(stages, 0, 2, counts, 4096, 5);
    return collapse_steps<Bounds>(steps, totals, totals + 2);
}

void parts(const RayBatch& rays, const HitBatch& hits, const Mesh& mesh, const int* ids, const Vec3* corners)
{
    fetch_ray(rays, hits, 3);
    fetch_merged<16>(ids, 40, mesh, ids, hits.primitive.data, hits, corners, 20);
}

Node loaded(const Node* nodes, int& index) { return load_compact<3, 63>(nodes, index); }
