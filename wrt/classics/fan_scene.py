"""Scenes whose trees have leaves of fans (`wrt.kernels.traversal.fan_trees`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.builders import tree as common
from wrt.builders.triangle_fans import TriangleFans
from wrt.classics.fan_arrays import fan_boxes, fans_of, on_device
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.traversal.fan_brute_force import FAN_FORMS, NORMALS, VERTICES, VERTICES_NORMALS, FanSet
from wrt.meshes.placement import as_meshes, place_meshes
from wrt.scene.mesh_state import MeshState
from wrt.scene.scene import Scene
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.accelerators.accelerator import Accelerator, AcceleratorName
    from wrt.meshes.instance import Geometry

DEFAULT_TREES = {
    AUTO: Bvh(max_leaf_triangles=1),
    "bvh": Bvh(max_leaf_triangles=1),
    "kdtree": KdTree(width=1, block_cost=4.0),
}
"""Trees over fans: fans are tested one by one, and each costs as much as a few steps."""


class FanScene(Scene):
    """Meshes as triangle fans, in a tree whose leaves list fans.

        scene = wrt.classics.FanScene(mesh, "bvh")
        hits = scene.intersect(origins, directions)  # of the triangles, as by wrt.Scene

    Hits are bit for bit those of brute force over the fans. They are those of single triangles but for rays within rounding of
    an edge. Closest and any hit; rays are traced one at a time. Made for measurements: a leaf of W triangles, tested together,
    is faster.

    Args:
        geometry: as in `wrt.Scene`, without instances.
        accelerator: "auto", "bvh", "kdtree", a `wrt.Bvh` or a `wrt.KdTree` that neither clips nor is lazy.
        form: what is stored of fans, key in `wrt.kernels.traversal.fan_brute_force.FAN_FORMS`.
        device, num_threads: as in `wrt.Scene`.

    Attributes:
        fans: the `wrt.builders.triangle_fans.TriangleFans`; vertices are numbered by position.

    Raises:
        TypeError, ValueError: as `wrt.Scene`; an unknown form; another tree.

    References: galin-akkouche-2005.
    """

    fans: TriangleFans

    def __init__(
        self,
        geometry: Geometry,
        accelerator: AcceleratorName | Accelerator = AUTO,
        *,
        form: str = NORMALS,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        from wrt.kernels.traversal.fan_trees import FAN_TESTS

        lookup(FAN_FORMS, form, "form")
        tree: Any = DEFAULT_TREES.get(accelerator, accelerator) if isinstance(accelerator, str) else accelerator
        settings = as_settings(tree, FAN_TESTS[form], device, num_threads)
        accelerator, meshes = settings.accelerator, as_meshes(geometry)
        if not isinstance(accelerator, Bvh) and not (
            isinstance(accelerator, KdTree) and not accelerator.is_lazy and not accelerator.split_clipping
        ):
            raise TypeError(
                f"accelerator must be a wrt.Bvh, or a wrt.KdTree that neither clips nor is lazy, not {accelerator!r}"
            )
        with use_threads(settings.num_threads):
            placed = place_meshes(meshes, settings.device)
            mesh = placed.fill_in(wp.vec3(), wp.vec3())
            holder = _Triangles(mesh, settings.device)
            self.fans = fans_of(holder)
            trees = FanTrees.build(self.fans, on_device(holder, self.fans, has_edges(form)), accelerator, form, settings.device)
        self.state = FanState(
            settings=settings,
            meshes=meshes,
            center=placed.center,
            built_tree=trees,
            device_mesh=placed.fill_in(trees.low, trees.high),
            only_single=True,
        )

    def __repr__(self) -> str:
        return f"FanScene({self.triangle_count} triangles in {len(self.fans)} fans, device={str(self.device)!r})"


@dataclass(frozen=True)
class _Triangles:
    """What `fans_of` and `on_device` read of a scene."""

    device_mesh: Any
    device: wp.Device


@dataclass(frozen=True, eq=False, kw_only=True)
class FanState(MeshState):
    """The state of a scene of fans."""

    is_plain: ClassVar[bool] = False

    refused: ClassVar[dict[str, str]] = {
        "update": "the fans of this scene are fixed; make a new one, or a wrt.Scene to update",
        "statistics": "statistics are those of triangles; use wrt.Scene(scene.meshes).statistics()",
        "float64 vertices": "precise=True and gradients need a tree of triangles; use wrt.Scene(scene.meshes)",
        "count": (
            "fans answer closest-hit and any-hit queries; for contains, count, intersect_all and visible "
            "use wrt.Scene(scene.meshes)"
        ),
        "save": "trees of fans cannot be saved; save the fans (wrt.classics.fan_files), or the meshes",
        "pickle": "trees of fans cannot be pickled; pickle the meshes",
        "handle": "kernels need the handle of a tree of triangles; use wrt.Scene(scene.meshes).handle()",
    }


@dataclass(frozen=True)
class FanTrees:
    """A tree over fans, with the interface that a scene needs of its tree.

    Attributes:
        tree: numbers fans.
        fans: on the device.
        form: key in `FAN_FORMS`.
        primitive: no triangles, in blocks of `width`: leaves list fans.
    """

    tree: common.Bvh | common.KdTree
    fans: FanSet
    form: str
    primitive: wp.array

    @classmethod
    def build(cls, fans: TriangleFans, made: FanSet, accelerator: Bvh | KdTree, form: str, device: wp.Device) -> FanTrees:
        """Builds the tree over the boxes of the fans."""
        from wrt.builders.triangle_boxes import boxes_of

        tree = accelerator.build(boxes_of(*fan_boxes(fans, made, has_edges(form))), native_width(device)).to(device)
        return cls(tree, made, form, wp.array(np.full(tree.width, -1), dtype=int, device=device))

    @property
    def width(self) -> int:
        """Children of a node, and fans of a block."""
        return self.tree.width

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path of a BVH."""
        return getattr(self.tree, "depth", 0)

    @property
    def low(self) -> wp.vec3:
        """Lower corner of the box of all triangles."""
        return self.fans.low

    @property
    def high(self) -> wp.vec3:
        """Upper corner of the box of all triangles."""
        return self.fans.high

    @property
    def bytes(self) -> int:
        """Bytes of nodes and leaf lists, and of the vertices, numbers and planes of fans that the form reads."""
        fans, names = self.fans, ["first", "centre", "rim", "primitive", "corner"]
        names += ["normal"] * (self.form in (NORMALS, VERTICES_NORMALS, "planes")) + ["planes"] * (self.form == "planes")
        return self.tree.bytes + sum(getattr(fans, name).capacity for name in names)

    @property
    def kind(self) -> str:
        """Kind of the tree."""
        return "kdtree" if isinstance(self.tree, common.KdTree) else "bvh"

    @property
    def kernel_factory(self) -> Callable[[Any], wp.Kernel]:
        """Makes the kernel that walks the tree, from a `TraversalConfig`."""
        from wrt.kernels.traversal.fan_trees import make_fan_tree_kernel

        return partial(make_fan_tree_kernel, kind=self.kind, form=self.form)

    def struct(self) -> Any:
        """The tree as a traversal kernel reads it."""
        from wrt.kernels.traversal.fan_trees import FAN_TREES

        made: Any = FAN_TREES[self.kind][0]()
        made.order, made.fans = self.tree.primitive, self.fans
        if self.kind == "bvh":
            made.tree = self.tree.struct()
        else:
            made.tree.nodes, made.tree.low, made.tree.high = self.tree.nodes, self.tree.low, self.tree.high
        return made


def has_edges(form: str) -> bool:
    """Whether rims are stored relative to centres."""
    return form not in (VERTICES, VERTICES_NORMALS)
