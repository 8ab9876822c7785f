"""The rays of a packet against the triangles of a block, each ray against those that it may meet.

**Problem.** On a fine mesh, the W rays of a vector meet several triangles of a block, each of which only a few of them meet. If
all W rays are tested against one triangle after the other, most lanes are idle.

**Idea.** Two steps.

1. *List.* All rays are tested against all triangles by signs alone, which is cheap: those through one point by linear functions
   of their slopes (`edge_functions`), others by the test's own areas (`WoopPairs.may_meet`). Each ray gets a word with a bit
   for each triangle that its line may meet. There are no branches: what the CPU does for one triangle overlaps with the next.
2. *Test.* Each ray takes the next triangle of its word, W rays at a time. A block has W triangles, and the W floats of a
   component are one register, so the triangles of W rays are a permutation of its lanes. As triangles of a surface cover a ray
   once, one or two rounds are enough for most vectors.

What does not depend on the ray is computed before, for the W triangles of the block at once: vertices less a shared origin,
boxes, and planes of the boxes less the origin. Bits are those of `packet_block`, because each pair has the same operations.

Figures: notebooks/records/2026-11-25-packet-pairs.md.

References: wald-2001 (packets of rays against one triangle, which this departs from).
"""

from wrt.kernels.traversal.packet.leaves.edge_functions import GUARDS

LEAST_LISTED = {16: 1}
"""Triangles of a block from which they are listed for each ray, by width; 2 for other widths. A single one that is left of a
block is mostly hit, but with 16 lanes a round of the test costs more than all else."""


def pairs_code(pairs: str, width: int, what: str, arguments: str) -> str:
    """C++ that tests the triangles `mask` of a block. pairs: `PacketForm.pairs`; what, arguments: those of `test_triangles`
    but the test."""
    return f"{GUARDS}wrt::test_pairs<{what}, {LEAST_LISTED.get(width, 2)}>({arguments}, {pairs});"
