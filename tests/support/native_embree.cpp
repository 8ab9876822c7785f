// Instantiates embree_packets.h, see native_headers.cpp.
#include "embree_packets.h"

struct Call {
    unsigned long long function, scene;
    int version, flags, width;
    bool closest;
    float t_max;
};
struct Packets {
    unsigned long long address;
    int fields;
};
struct Rays {
    unsigned long long origins;
    int origin_step;
    unsigned long long directions;
    int count;
};
struct Answers {
    unsigned long long t, primitive, u, v, occluded;
};

void embree_traces(const Call& call, const Packets& packets, const Rays& rays, const Answers& answers)
{
    wrt::embree::trace_filled(call, packets, 3);
    wrt::embree::trace_flat(call, rays, answers, 3);
}
