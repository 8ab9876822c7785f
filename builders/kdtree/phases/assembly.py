"""Assembly of the top levels and the finished subtrees into one tree in depth-first order
(`wrt.kernels.layout.kdtree_nodes`)."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import Parts, Reservation, Result, Task
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel


@exact_kernel
def copy_subtrees(
    first: int,
    parts: Parts,
    tasks: wp.array(dtype=Task),
    results: wp.array(dtype=Result),
    node_base: wp.array(dtype=int),
    block_base: wp.array(dtype=int),
    width: int,
    nodes: wp.array(dtype=wp.vec2i),
    primitive: wp.array(dtype=int),
):
    """Item: a task. Copies its nodes and leaf lists to their final position and makes its indices global."""
    number = first + wp.tid()
    task = tasks[number]
    for i in range(results[number].nodes):
        node = parts.nodes[task.nodes_first + i]
        axis = kdtree.split_axis(node)
        if axis == kdtree.LEAF:
            node = kdtree.leaf_node(kdtree.first_block(node) + block_base[number], kdtree.leaf_triangles(node))
        else:
            node = kdtree.inner_node(axis, kdtree.split_position(node), kdtree.right_child(node) + node_base[number])
        nodes[node_base[number] + i] = node
    for i in range(results[number].blocks * width):
        primitive[block_base[number] * width + i] = parts.primitive[task.blocks_first * width + i]


@exact_kernel
def write_top(
    first: int,
    axis: wp.array(dtype=int),
    position: wp.array(dtype=float),
    index: wp.array(dtype=int),
    right: wp.array(dtype=int),
    nodes: wp.array(dtype=wp.vec2i),
):
    """Item: an inner node of the top levels. Writes it to the tree."""
    i = first + wp.tid()
    nodes[index[i]] = kdtree.inner_node(axis[i], position[i], right[i])


@dataclass
class TopNumbering:
    """Depth-first numbers of the top levels' inner nodes and of the subtrees' roots."""

    axis: list[int]
    position: list[float]
    index: list[int]
    right: list[int]
    node_base: np.ndarray
    block_base: np.ndarray
    nodes: int
    blocks: int


def number_top(levels: list[np.ndarray], node_counts: np.ndarray, block_counts: np.ndarray) -> TopNumbering:
    """Numbers the nodes depth first.

    Args:
        levels: live nodes of each level except the last, as structured arrays; those of the last level are the subtrees' roots.
        node_counts, block_counts: (tasks,) size of each subtree.
    """
    top = TopNumbering([], [], [], [], np.zeros(len(node_counts), np.int32), np.zeros(len(node_counts), np.int32), 0, 0)
    stack = [(0, 0, -1)]  # level, live index, index in the lists of the top of the node whose right child it is
    while stack:
        level, live, parent = stack.pop()
        while level < len(levels) and levels[level][live]["finished"]:
            level, live = level + 1, int(levels[level][live]["left"])
        if parent >= 0:
            top.right[parent] = top.nodes
        if level == len(levels):
            top.node_base[live], top.block_base[live] = top.nodes, top.blocks
            top.nodes += int(node_counts[live])
            top.blocks += int(block_counts[live])
            continue
        node = levels[level][live]
        left = int(node["left"])
        stack += [(level + 1, left + 1, len(top.index)), (level + 1, left, -1)]
        top.axis.append(int(node["split"]["axis"]))
        top.position.append(float(node["split"]["position"]))
        top.index.append(top.nodes)
        top.right.append(0)
        top.nodes += 1
    return top


def join_parts(levels: list[np.ndarray], reservation: Reservation, results: wp.array, width: int) -> tuple[wp.array, wp.array]:
    """The finished tree's nodes and leaf lists; `levels` as in `number_top`."""
    device = results.device
    made = results.numpy()
    top = number_top(levels, made["nodes"], made["blocks"])
    nodes = wp.empty(top.nodes, dtype=wp.vec2i, device=device)
    primitive = wp.empty(top.blocks * width, dtype=int, device=device)

    def array(values: list | np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device=device)

    launch(
        copy_subtrees,
        len(results),
        [
            reservation.parts,
            reservation.tasks,
            results,
            array(top.node_base, int),
            array(top.block_base, int),
            width,
            nodes,
            primitive,
        ],
        device=device,
        chunk=1,
    )
    if top.index:
        columns = [array(top.axis, int), array(top.position, float), array(top.index, int), array(top.right, int)]
        launch(write_top, len(top.index), [*columns, nodes], device=device)
    return nodes, primitive


def assemble(
    triangles: TriangleBoxes,
    config: KdTreeConfig,
    phase: Phases,
    levels: list[np.ndarray],
    tasks: tuple[Reservation, wp.array],
    work: list[wp.array],
) -> KdTree:
    """Phase "assemble": the finished tree.

    Args:
        triangles, config: what it was built from.
        phase: the phases of the build.
        levels: as in `number_top`.
        tasks: the tasks' memory, and the result of each task.
        work: other arrays that are held at this time.
    """
    reservation, results = tasks
    with phase("assemble"):
        nodes, primitive = join_parts(levels, reservation, results, config.cost.width)
    held = [triangles.boxes.low, triangles.boxes.high, *work, reservation.parts.nodes, reservation.parts.primitive]
    phase.stats.reserve(*held, nodes, primitive)
    return KdTree(nodes, primitive, wp.vec3(*triangles.low), wp.vec3(*triangles.high), config.cost.width, phase.stats)
