"""The rays of a packet against the triangles of a block, each ray against those that it may meet.

**Problem.** On a fine mesh, the W rays of a vector meet several triangles of a block, each of which only a few of them meet. If
all W rays are tested against one triangle after the other, most lanes are idle.

**Idea.** Two steps.

1. *List.* All rays are tested against all triangles by signs alone, which is cheap: those through one point by linear functions
   of their slopes (`edge_functions`), others by the test's own areas (`PairForm.may_meet`). Each ray gets a word with a bit for
   each triangle that its line may meet. There are no branches: what the CPU does for one triangle overlaps with the next.
2. *Test.* Each ray takes the next triangle of its word, W rays at a time. A block has W triangles, and the W floats of a
   component are one register, so the triangles of W rays are a permutation of its lanes. As triangles of a surface cover a ray
   once, one or two rounds are enough for most vectors.

What does not depend on the ray is computed before, for the W triangles of the block at once: vertices less a shared origin,
boxes, and planes of the boxes less the origin. Bits are those of `packet_block`, because each pair has the same operations.

Figures: notebooks/records/2026-11-25-packet-pairs.md.

References:
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001 (packets of
        rays against one triangle, which this departs from).
"""

from wrt.kernels.simd.lane_vectors import vector_words
from wrt.kernels.traversal.packet.leaves.edge_functions import COEFFICIENTS, CONVERGING, EDGES, MEETS
from wrt.kernels.triangle.support.lane_form import PairForm
from wrt.kernels.triangle.support.record_blocks import vertex_box

LEAST_LISTED = {16: 1}
"""Triangles of a block from which they are listed for each ray, by width; 2 for other widths. A single one that is left of a
block is mostly hit, but with 16 lanes a round of the test costs more than all else."""

_PASSES = """
            for (int pass = 0; pass < PASSES; ++pass) {
                if (PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
"""

_ADD = """
                WRT_UNROLLED for (int f = 0; f < P; f += W) {
                    WRT_MEETS
                    met[f / W] = met[f / W] | (may_meet & (1 << lane));
                }
"""

_LIST = f"""
    alignas(4 * W) int pairs[P];  // of each ray: a bit for each triangle of the block that it may meet
    {{
        vi met[P / W];
        const bool listed = wrt::count_bits(mask) >= LEAST_LISTED;
        WRT_UNROLLED for (int f = 0; f < P; f += W) met[f / W] = listed ? 0 : (int)mask;
        if (listed) {{{CONVERGING}
            if (converging) {{{EDGES}
                for (unsigned left = mask; left; left &= left - 1u) {{
                    const int lane = wrt::lowest_bit(left);{COEFFICIENTS}{_ADD.replace("WRT_MEETS", MEETS)}
                }}
            }} else {{{_PASSES}WRT_AXES
                for (unsigned left = mask; left; left &= left - 1u) {{
                    const int lane = wrt::lowest_bit(left);
                    const float* corner = &records.data[(size_t)block * (RECORD * W) + lane];{_ADD}
                }}
            }}}}
        }}
        WRT_UNROLLED for (int f = 0; f < P; f += W) save(pairs + f, met[f / W] & (load(t + f) >= load(t_min + f)));
    }}
"""

_ROWS = f"""
    const float* const first = &records.data[(size_t)block * (RECORD * W)];
    alignas(4 * W) float corners[9][W], planes[6][W];
    const bool planar = SHARED && bounds.mixed_axes == 0;  // near and far planes are the same for all rays
    WRT_FOR_LANES(i) {{
        float low[3], high[3];{vertex_box("first", "i")}
        for (int a = 0; a < 3; ++a) {{
            const bool back = bounds.inverse_large.c[a] < 0.0f;
            const float step = back ? -slack0 : slack0;
            const float near = (back ? high[a] : low[a]) - (origin0[a] + step);
            const float far = (back ? low[a] : high[a]) - (origin0[a] - step);
            planes[a][i] = planar ? near : low[a];
            planes[3 + a][i] = planar ? far : high[a];
            for (int vertex = 0; vertex < 9; vertex += 3) {{
                const float at = first[(vertex + a) * W + i];
                corners[vertex + a][i] = SHARED ? at - origin0[a] : at;
            }}
        }}
    }}
"""

_TEST = """
    const float* const inverses[3] = {inverse_x, inverse_y, inverse_z};
    const float* const starts[3] = {origin_x, origin_y, origin_z};
    for (int f = 0; f < P; f += W) for (vi left = load_ints(pairs + f); bits_of(left);) {
        const vi lowest = left & -left, paired = left != 0;
        const vi which = (((vi)__builtin_convertvector(lowest, vf) >> 23) - 127) & (W - 1);  // the exponent of a power of 2
        left = left ^ lowest;WRT_PASSES
                WRT_AXES
                WRT_PAIRS
                // the consistency rule: t is that of a meeting with the triangle's own widened box
                vf enter = -INF, leave = INF;
                WRT_UNROLLED for (int a = 0; a < 3; ++a) {
                    const vf low = chosen(planes[a], which), high = chosen(planes[3 + a], which);
                    const vf inverse = load(inverses[a] + f);
                    vf to_near = low, to_far = high;
                    if (!planar) {
                        const vf from = SHARED ? (vf)origin0[a] : load(starts[a] + f);
                        const vf wide = SHARED ? (vf)slack0 : load(slack + f);
                        const vi back = inverse < 0.0f;
                        const vf step = back ? -wide : wide;
                        to_near = (back ? high : low) - (from + step);
                        to_far = (back ? low : high) - (from - step);
                    }
                    const vf near = to_near * inverse, far = to_far * inverse;
                    enter = near > enter ? near : enter;
                    leave = far < leave ? far : leave;
                }
                at = at > enter ? at : enter;
                at = at < leave ? at : leave;
                const vf last = load(t + f);
                vi hit = inside & (enter <= leave) & (at >= load(t_min + f));
                const vi number = (vi)chosen(ids.data + block * W, which), before = load_ints(found + f);
                if (ANY_HIT) {  // the first will do, and nobody asks for its weights
                    hit = hit & (at <= last);WRT_FACES
                    replace(t + f, hit, (vf)(-INF));
                    left = hit ? 0 : left;
                } else {  // no hit so far is -1, the greatest number without a sign
                    hit = hit & ((at < last) | ((at == last) & ((number ^ SIGN) < (before ^ SIGN))));WRT_FACES
                    replace(t + f, hit, at);
                    replace(u + f, hit, hit_u);
                    replace(v + f, hit, hit_v);
                }
                replace(found + f, hit, number);
            }
    }
"""

_FACES = """
                    for (unsigned bits = bits_of(hit); bits; bits &= bits - 1u) {
                        const int i = wrt::lowest_bit(bits), k = f + i;
                        double normal[3];
                        wrt_normal(first + which[i], W, normal);
                        if (!wrt_front(normal, inverse_x[k], inverse_y[k], inverse_z[k])) hit[i] = 0;
                    }"""


def pairs_code(form: PairForm, width: int, cull_backfaces: bool) -> str:
    """C++ that tests the triangles `mask` of a block, up to the packet's new `t_max`; names as in `packet_block.block_code`."""
    pieces = {"WRT_PASSES": _PASSES, "WRT_AXES": form.axes, "WRT_MEETS": form.may_meet, "WRT_PAIRS": form.test}
    pieces["WRT_FACES"] = _FACES if cull_backfaces else ""
    constants = f"    constexpr int SIGN = (int)0x80000000, LEAST_LISTED = {LEAST_LISTED.get(width, 2)};\n"
    body = f"{constants}{_LIST}{_ROWS}{_TEST}"
    for name, piece in pieces.items():
        body = body.replace(name, piece)
    return vector_words(width) + form.rays + body
