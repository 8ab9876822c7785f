"""What finding a node's plane costs, apart from all else in a build: the search by projected or by surface areas, and the order
in which axes are tried.

A mesh's triangles, in the order of the leaves of a finished tree, are cut into ranges: nodes of one size. Their bins are filled
as in the build; then only the search runs, on all nodes, through the heuristic that the build has (`Searches`). Axes are
ordered for the boxes of a finished tree (`AxisOrders`).
"""

from functools import cache

import numpy as np
import warp as wp

from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders.bvh.binned_bvh import BinnedBuilder
from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.known_rays_config import known_rays
from wrt.builders.bvh.phases import bvh_levels as levels
from wrt.builders.bvh.phases.bin_heuristic import Heuristic
from wrt.builders.bvh.phases.binary_tree import BinaryTree
from wrt.builders.bvh.phases.bvh_bins import Plane, Scratch, make_scratch
from wrt.builders.bvh.phases.bvh_levels import BinnedNode
from wrt.builders.bvh.phases.split_axes import AXIS_CHOICES, AxisOrder, AxisRules, axis_order
from wrt.builders.bvh.projected_binned import ProjectedBuilder
from wrt.builders.core.levels import Chunk
from wrt.builders.influence.influence_area import InfluenceArea
from wrt.builders.influence.projected_cost import Mixture, facing
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.kernels.runtime.launch import launch
from wrt.known_rays.tree_analysis import analyse
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

NODES = 1024
"""Nodes of an item that orders axes."""


@cache
def make_search(heuristic: Heuristic) -> wp.Kernel:
    """The kernel in which a heuristic finds the planes of nodes whose bins are filled."""
    rays_type, search = heuristic.rays, heuristic.search

    def search_nodes(
        first: int,
        rules: BuildRules,
        rays: rays_type,
        nodes: wp.array(dtype=BinnedNode),
        scratch: Scratch,
        slot: int,
        tree: BinaryTree,
        planes: wp.array(dtype=Plane),
    ):
        """Item: a node. slot: of the bins of the first node."""
        i = first + wp.tid()
        planes[i] = search(rules, rays, nodes[i].binning, scratch, slot + i, tree, nodes[i].frame)

    return wp.kernel(search_nodes, module="unique", enable_backward=False, module_options={"fuse_fp": False})


class Searches:
    """Nodes whose planes are to be found.

    Args:
        mesh: whose triangles they have.
        size: triangles a node; what is left over is in none.
        accelerator: what builds the tree; its heuristic searches.
    """

    def __init__(self, mesh: TriangleMesh, size: int, accelerator: Bvh | ProjectedBvh) -> None:
        scene = Scene(mesh, device="cpu")
        order = scene.tree.primitive.numpy()
        faces = wp.array(mesh.faces[order[order >= 0]], dtype=wp.vec3i, device="cpu")
        triangles = triangle_boxes(scene.state.device_mesh.vertices, faces, scene.center)
        config = accelerator.config(scene.tree.width)
        is_aware = isinstance(accelerator, ProjectedBvh)
        self.builder = ProjectedBuilder(triangles, config) if is_aware else BinnedBuilder(triangles, config)
        self.builder.chunk = size
        self.builder.make_references()
        self.count = triangles.count // size
        self.nodes, self.scratch = self._fill(size)
        self.planes = wp.empty(self.count, dtype=Plane, device="cpu")

    def _fill(self, size: int) -> tuple[wp.array, Scratch]:
        """Places the nodes, fills their bins, and searches once as the build does, which leaves the bins of each in a slot."""
        first = size * np.arange(self.count)
        nodes = np.zeros(self.count, dtype=BinnedNode.numpy_dtype())
        nodes["frame"]["first"], nodes["frame"]["count"], nodes["frame"]["node"] = first, size, 2 * first
        nodes["chunk_first"], nodes["chunk_count"] = np.arange(self.count), 1
        nodes["part_first"], nodes["part_count"] = 2 * np.arange(self.count), 1
        chunks = np.zeros(self.count, dtype=Chunk.numpy_dtype())
        chunks["node"], chunks["begin"], chunks["end"] = np.arange(self.count), first, first + size
        live, lists = wp.array(nodes, dtype=BinnedNode, device="cpu"), wp.array(chunks, dtype=Chunk, device="cpu")
        domain, scratch = wp.empty(8 * self.count, dtype=float, device="cpu"), make_scratch(2 * self.count, self.builder.device)
        box = self.builder.tree.box.numpy().reshape(-1, 8)  # in place
        references = self.builder.references.numpy()[: 8 * size * self.count].reshape(self.count, size, 8)
        box[2 * first] = references.min(axis=1)
        builder = self.builder
        builder.run(
            levels.bin_chunks, self.count, builder.rules, builder.references, live, lists, builder.parts, domain, scratch
        )
        work = [builder.triangles.count, live, lists, domain, scratch, self.count, builder.tree]
        builder.run(builder.search_planes, self.count, builder.rules, builder.rays, *work)
        return live, scratch

    def run(self) -> np.ndarray:
        """Finds all planes; returns their costs."""
        builder = self.builder
        inputs = [builder.rules, builder.rays, self.nodes, self.scratch, self.count, builder.tree, self.planes]
        launch(make_search(builder.heuristic), self.count, inputs, device=builder.device, chunk=self.count)
        return self.planes.numpy()["cost"]


@cache
def make_axis_orders(is_facing: bool, repeats: int) -> wp.Kernel:
    """The kernel in which nodes order their axes: by the rays' directions at their centres, or by the sides of their boxes."""

    def order_axes(
        first: int,
        rules: AxisRules,
        mixture: Mixture,
        low: wp.array(dtype=wp.vec3),
        high: wp.array(dtype=wp.vec3),
        orders: wp.array(dtype=AxisOrder),
    ):
        """Item: a range of nodes, as many times as are repeated; each time writes the same."""
        begin = (first + wp.tid()) * wp.static(NODES)
        for _turn in range(wp.static(repeats)):
            for i in range(begin, wp.min(begin + wp.static(NODES), low.shape[0])):
                along = wp.vec3()
                if wp.static(is_facing):
                    along = facing(mixture, 0.5 * (low[i] + high[i]))
                orders[i] = axis_order(rules, high[i] - low[i], along, 0)

    return wp.kernel(order_axes, module="unique", enable_backward=False, module_options={"fuse_fp": False})


class AxisOrders:
    """The nodes of a tree, whose axes are to be ordered: what the thesis times for each node, apart from trying planes.

    Args:
        mesh: whose tree has the nodes, those of the default build.
        area: of the rays.
        order: "longest", by the sides of a node's box, or "facing", by the rays at its centre (`wrt.known_rays.ProjectedBvh`'s
            `axes`).
        repeats: how often `run` orders the axes of all nodes.
    """

    def __init__(self, mesh: TriangleMesh, area: InfluenceArea, order: str, repeats: int = 1) -> None:
        scene = Scene(mesh, Bvh(width=2), device="cpu")
        boxes = analyse(scene).boxes
        self.low, self.high = (wp.array(ends - scene.center, dtype=wp.vec3, device="cpu") for ends in (boxes.low, boxes.high))
        self.rules, self.count, self.repeats = AXIS_CHOICES[order].struct(), len(boxes.low), repeats
        triangles = triangle_boxes(scene.state.device_mesh.vertices, scene.state.device_mesh.faces, scene.center)
        self.mixture = known_rays(triangles, ProjectedBvh(areas=area).config(scene.tree.width)).mixture
        self.orders = wp.empty(self.count, dtype=AxisOrder, device="cpu")
        self.kernel = make_axis_orders(order == "facing", repeats)

    def run(self) -> np.ndarray:
        """(N, 3) the axes of each node, in the order in which a build would try them."""
        inputs = [self.rules, self.mixture, self.low, self.high, self.orders]
        launch(self.kernel, -(-self.count // NODES), inputs, device=wp.get_device("cpu"), chunk=1 << 20)
        return self.orders.numpy()["axis"]
