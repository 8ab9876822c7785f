"""The kernels with which a level of the nested build clips triangles (`nested`)."""

import warp as wp

from wrt.builders.classics.kdtree.nested.event_chunks import LevelLists
from wrt.builders.core.clip import ClippedMesh
from wrt.builders.core.levels import Chunk, LiveNode
from wrt.builders.kdtree.events.clipped_events import precedes
from wrt.builders.kdtree.phases.clipped_levels import clip_to_children
from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.layout.unchecked import load_byte, load_int, load_pair, store_byte, store_int, store_pair
from wrt.kernels.runtime.options import exact_kernel

STRADDLES = wp.constant(15)
"""`LevelLists.side` of a straddler before it is clipped: it and its events go to both sides."""


@exact_kernel
def list_straddlers(
    first: int,
    lists: LevelLists,
    chunks: wp.array(dtype=Chunk),
    places: wp.array(dtype=int),
    straddlers: wp.array(dtype=wp.vec2i),
):
    """Item: a chunk of references. Lists its straddlers, (place in the level's list, node), from places[chunk] on, and notes
    that the others have the same id on both sides."""
    index = first + wp.tid()
    chunk = chunks[index]
    to = places[index]
    for i in range(chunk.begin, chunk.end):
        store_int(lists.right, i, load_int(lists.triangle, i))
        if int(load_byte(lists.side, i)) == STRADDLES:
            straddlers[to] = wp.vec2i(i, chunk.node)
            to += 1


@exact_kernel
def clip_listed(
    first: int,
    mesh: ClippedMesh,
    references: int,
    lists: LevelLists,
    nodes: wp.array(dtype=LiveNode),
    straddlers: wp.array(dtype=wp.vec2i),
    boxes: Boxes,
    triangle: wp.array(dtype=int),
):
    """Item: a straddler. Clips it to both children's cells; its right part is the reference `references` + item."""
    item = first + wp.tid()
    place = straddlers[item][0]
    node = nodes[straddlers[item][1]]
    reference = lists.triangle[place]
    added = references + item
    triangle[added] = triangle[reference]
    lists.right[place] = added
    side = clip_to_children(mesh, boxes, node, triangle[reference], reference, added)
    store_byte(lists.side, place, wp.uint8(side << 2))


@exact_kernel
def count_parts(first: int, lists: LevelLists, chunks: wp.array(dtype=Chunk)):
    """Item: a chunk of references. Counts what goes to both sides, after clipping."""
    index = first + wp.tid()
    chunk = chunks[index]
    left = int(0)
    right = int(0)
    for i in range(chunk.begin, chunk.end):
        side = int(load_byte(lists.side, i)) >> 2
        left += side & 1
        right += side >> 1
    chunk.left = left
    chunk.right = right
    chunks[index] = chunk


@exact_kernel
def merge_lists(
    first: int, ends: wp.array(dtype=wp.vec3i), begin: wp.array(dtype=int), parts: wp.array(dtype=wp.vec2i), target: LevelLists
):
    """Item: a list, which ends with room for the events of parts. Merges these from the back.

    ends: (lists,) where the kept events end; the first event of its parts, and their end. begin: (lists,) start of the list."""
    item = first + wp.tid()
    old = ends[item][0]
    part = ends[item][2]
    while part > ends[item][1]:
        to = old + (part - ends[item][1]) - 1
        event = load_pair(parts, part - 1)
        if old > begin[item] and not precedes(load_pair(target.event, wp.max(old - 1, 0)), event):
            old -= 1
            event = load_pair(target.event, old)
        else:
            part -= 1
        store_pair(target.event, to, event)
