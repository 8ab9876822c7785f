"""Statistics of a scene, its tree and its build: `Scene.statistics()`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from wrt.builders.bvh.bvh_statistics import BvhStatistics, bvh_statistics
from wrt.builders.kdtree.kdtree_statistics import KdTreeStatistics, kdtree_statistics
from wrt.engine.plan.planner import DEFAULT_TEST
from wrt.kernels.triangle import TRIANGLE_TESTS

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState


@dataclass(frozen=True)
class SceneStatistics:
    """Statistics of a scene's meshes, of its tree, and of the build.

    Attributes:
        triangles: number of triangles of all meshes.
        geometries: number of meshes.
        tree: counts, histograms and cost of the tree.
        tree_bytes: bytes of the nodes, the leaf lists, and the records of the default triangle test.
        mesh_bytes: bytes of vertices and faces on the device.
        build_seconds: wall time of the build by phase.
        build_peak_bytes: peak of the build's device memory.
    """

    triangles: int
    geometries: int
    tree: KdTreeStatistics | BvhStatistics
    tree_bytes: int
    mesh_bytes: int
    build_seconds: dict[str, float]
    build_peak_bytes: int

    @property
    def tree_bytes_per_triangle(self) -> float:
        """Bytes of the tree, per triangle."""
        return self.tree_bytes / self.triangles

    def to_dict(self) -> dict[str, Any]:
        """Nested dicts, lists and numbers, as JSON types."""
        memory = {"bytes": self.tree_bytes, "bytes per triangle": self.tree_bytes_per_triangle}
        return {
            "mesh": {"triangles": self.triangles, "geometries": self.geometries, "bytes": self.mesh_bytes},
            "tree": {**tree_figures(self.tree), **memory},
            "build": {
                "seconds": {**self.build_seconds, "total": sum(self.build_seconds.values())},
                "peak bytes": self.build_peak_bytes,
                "peak bytes per triangle": self.build_peak_bytes / self.triangles,
            },
            "leaves by depth": self.tree.depth_histogram.tolist(),
            "leaves by triangles": self.tree.leaf_size_histogram.tolist(),
        }


def tree_figures(tree: KdTreeStatistics | BvhStatistics) -> dict[str, Any]:
    """Statistics of a tree, by name."""
    if isinstance(tree, BvhStatistics):
        own = {"node fill": tree.node_fill}
    else:
        own = {
            "empty leaves": tree.empty_leaves,
            "references": tree.references,
            "references per triangle": tree.duplication,
        }
    counts = {"nodes": tree.nodes, "leaves": tree.leaves, **own}
    return {**counts, "block fill": tree.block_fill, "greatest depth": tree.max_depth, "SAH cost": tree.sah_cost}


def scene_statistics(scene: SceneState) -> SceneStatistics:
    """Measures a scene."""
    scene.require("statistics")
    cost = scene.accelerator.config(scene.tree.width).cost
    measure = bvh_statistics if scene.accelerator.kind == "bvh" else kdtree_statistics
    record = TRIANGLE_TESTS[DEFAULT_TEST].record
    mesh_bytes = sum(array.capacity for array in (scene.device_mesh.vertices, scene.device_mesh.faces))
    return SceneStatistics(
        triangles=scene.triangle_count,
        geometries=len(scene.meshes),
        tree=measure(scene.tree, scene.triangle_count, cost),
        tree_bytes=scene.tree.bytes + 4 * record.components * len(scene.tree.primitive),
        mesh_bytes=mesh_bytes,
        build_seconds=dict(scene.tree.stats.seconds),
        build_peak_bytes=scene.tree.stats.peak_bytes,
    )
