"""Phase "reinsertion" of the build by clusters: nodes of a merged tree move to where they cost least, all at the same time.

**Problem.** Merging decides by what is near. It does not see what a node will cost the nodes above it.

**Idea.** A move takes a node away, so that its sibling replaces their parent, and makes that parent the one of the node and of
a new sibling. The areas of all inner nodes together are what a tree costs by the surface area heuristic, but for a constant. A
move changes those of the nodes between both places.

**Upper levels.** Merging pairs is at its worst near the root, where rays of a view pay for every overlap, and moves of one node
do not mend that. So the upper levels are made anew first: the larger half of the nodes is opened until there are 128 subtrees,
which are divided from the root down by the best of all planes. The new levels are taken if they cost less. That is one launch
of one block (`rebuild_tops`).

**Steps** (Meister and Bittner 2018), each a launch. A round takes them `TURNS` times, for one of `TURNS` neighbouring nodes:

1. `find_moves`: a node looks for the place with the greatest gain. From its parent up, it looks into the subtree beside each
   node on its way, except where even a place that costs no more than the node's own area would gain less than the best so far.
   It claims the four links to parents that the move replaces or moves.
2. `choose_moves`: of moves that share a link, the one that gains most stays. Then moves can be made in any order. A move below
   a node that moves too could close a circle; of these, too, the one that gains most stays.
3. `move_nodes`.
4. `refit_nodes`: boxes and sizes, from the triangles up.

**What we changed.** A claim is the maximum of numbers that hold a gain and a node, so the tree does not depend on the order of
threads: it is the same for any number of them, and on CUDA and the CPU. Links are claimed, not nodes, so that both children of
a node may change at the same time. Nodes can also move up, beside a node that they are below. A search looks at a limited
number of nodes below each one that it passes.

**Why not the other reinsertion.** `wrt.builders.classics.bvh.reinsertion` moves nodes one after the other. There, every move
gains, and the depth is known before each. That is quick on a CPU, and cannot be done by many threads.

**Limits.** The gain of a move presumes that no other one changes the same areas, so not every turn gains: where moves meet, the
tree can become dearer by a little. Triangles move one by one; that two of them in one leaf cost less is not seen.

References: meister-bittner-2018; bittner-2013.
"""

import warp as wp

from wrt.builders.bvh.phases.cluster_merging import CHUNK, MergedTree
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import CUDA_BLOCK, exact_kernel
from wrt.kernels.runtime.workspace import Workspace

SEARCH_CHUNK = 256
"""Nodes whose search is worth a chunk of their own."""

TURNS = 2
"""Turns of a round: in each, one of TURNS neighbouring nodes looks for a place."""


@wp.struct
class Moves:
    """The moves of the nodes of a merged tree of n triangles, by node."""

    place: wp.array(dtype=wp.vec2i)
    """(2 n,) the new sibling, -1 for no move; the lowest node above both places, -1 if that is none."""
    key: wp.array(dtype=wp.uint64)
    """(2 n,) number of the move: the bits of its gain, and the node."""
    owner: wp.array(dtype=wp.uint64)
    """(2 n,) number of the move that may change where a node is linked; 0 for none."""
    arrived: wp.array(dtype=int)
    """(n,) children of an inner node that have come to it, of all rounds."""


@native.func_native("reinsertion.h", "wrt::find_move(tree, moves, node, count);")
def find_move(tree: MergedTree, moves: Moves, node: int, count: int):
    """Finds where a node is to move, and claims the links of the move."""


@native.func_native("reinsertion.h", "wrt::choose_move(tree, moves, node, count);")
def choose_move(tree: MergedTree, moves: Moves, node: int, count: int):
    """Takes back a move that others forbid."""


@native.func_native("reinsertion.h", "wrt::move_node(tree, moves, node, count);")
def move_node(tree: MergedTree, moves: Moves, node: int, count: int):
    """Moves a node."""


@native.func_native("reinsertion.h", "wrt::refit_from(tree, moves, triangle, count);")
def refit_from(tree: MergedTree, moves: Moves, triangle: int, count: int):
    """Computes the boxes and sizes of nodes above a triangle that no other one computes."""


@native.func_native("top_levels.h", "wrt::rebuild_top(tree, moves, count);")
def rebuild_top(tree: MergedTree, moves: Moves, count: int):
    """Makes the upper levels anew, by all threads of a block."""


@exact_kernel
def rebuild_tops(first: int, count: int, tree: MergedTree, moves: Moves):
    """Item: a thread of the one block; on the CPU, one."""
    rebuild_top(tree, moves, count)


@exact_kernel
def find_moves(first: int, count: int, turn: int, step: int, tree: MergedTree, moves: Moves):
    """Item: a node of every `step`."""
    find_move(tree, moves, turn + step * (first + wp.tid()), count)


@exact_kernel
def choose_moves(first: int, count: int, turn: int, step: int, tree: MergedTree, moves: Moves):
    """Item: likewise."""
    choose_move(tree, moves, turn + step * (first + wp.tid()), count)


@exact_kernel
def move_nodes(first: int, count: int, turn: int, step: int, tree: MergedTree, moves: Moves):
    """Item: likewise."""
    move_node(tree, moves, turn + step * (first + wp.tid()), count)


@exact_kernel
def refit_nodes(first: int, count: int, tree: MergedTree, moves: Moves):
    """Item: a triangle."""
    refit_from(tree, moves, first + wp.tid(), count)


def empty_moves(count: int, device: wp.Device) -> Moves:
    """Allocates the moves of the nodes of a number of triangles."""
    moves = Moves()
    moves.place = wp.empty(2 * count, dtype=wp.vec2i, device=device)
    moves.key, moves.owner = (wp.empty(2 * count, dtype=wp.uint64, device=device) for _ in range(2))
    moves.arrived = wp.empty(count, dtype=int, device=device)
    return moves


def reinsert(work: Workspace, tree: MergedTree, count: int, rounds: int) -> Moves:
    """Makes the upper levels of the tree of `count` triangles, at least two, anew, then moves nodes. On CUDA, the host does not
    wait."""
    moves = work.make("moves", count, lambda size: empty_moves(size, work.device))
    moves.owner.zero_()
    moves.arrived.zero_()
    work.launch(rebuild_tops, 1 if work.device.is_cpu else CUDA_BLOCK, [count, tree, moves])
    work.launch(refit_nodes, count, [count, tree, moves], chunk=CHUNK)
    for turn in range(rounds * TURNS):
        first = turn % TURNS
        items = -(-(2 * count - first) // TURNS)
        for kernel in (find_moves, choose_moves, move_nodes):
            work.launch(kernel, items, [count, first, TURNS, tree, moves], chunk=SEARCH_CHUNK)
        work.launch(refit_nodes, count, [count, tree, moves], chunk=CHUNK)
    return moves
