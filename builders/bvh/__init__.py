"""Builders of bounding volume hierarchies: one file per method, and the table of all builders.

**Contract.** A builder is a function `build(triangles, config) -> Bvh`. It takes the boxes of the triangles
(`wrt.builders.triangle_boxes.TriangleBoxes`), and the cost model and leaf size as a frozen `BvhConfig`. It returns a tree in
the layout of `wrt.kernels.layout.bvh_nodes`, with the time of each phase. Builders make a binary tree (`tree`); `collapse`
converts it to wide nodes. Every triangle is in exactly one leaf. Every box is the exact union of the boxes of its triangles.
Trees for known rays may divide triangles among leaves (`wrt.builders.bvh.spatial`).

To add a builder, write its file and add one line to `BVH_BUILDERS`. The tests, the command line and the benchmarks read the
table. The sweep, which "auto" does not choose, is in `wrt.builders.classics`; its module is imported when it builds.
"""

from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from wrt.builders.bvh import binned_bvh as binned
from wrt.builders.bvh import hploc
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.core.late_import import classic
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import TriangleBoxes


def never(config: BvhConfig) -> bool:
    """`BvhBuilder.on_cuda` of builders with subtrees of one thread each, which suit cores."""
    return False


@dataclass(frozen=True)
class BvhBuilder:
    """A method of building a bounding volume hierarchy.

    Attributes:
        name: key in `BVH_BUILDERS`.
        paper: authors, title, year.
        build: (boxes, config) -> tree.
        kernels: (config, triangles) -> one kernel of each module that a build needs, for compiling them beforehand.
        on_cuda: (config) -> whether the tree of a scene on CUDA is built there; if not, it is built on the CPU and copied.
    """

    name: str
    paper: str
    build: Callable[[TriangleBoxes, BvhConfig], Bvh]
    kernels: Callable[[BvhConfig, int], list[wp.Kernel]]
    on_cuda: Callable[[BvhConfig], bool] = never


BVH_BUILDERS: dict[str, BvhBuilder] = {
    builder.name: builder
    for builder in (
        BvhBuilder(
            "binned",
            "Wald: On fast construction of SAH-based bounding volume hierarchies (2007)",
            binned.build,
            binned.kernels,
        ),
        BvhBuilder(
            "hploc",
            "Benthin, Meister, Barczak, Mehalwal, Tsakok, Kensler: H-PLOC (2024)",
            hploc.build,
            hploc.kernels,
            hploc.needs_no_collapse,
        ),
        BvhBuilder(
            "sweep",
            "Wald, Boulos, Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies (2007)",
            classic("bvh.sweep_bvh"),
            classic("bvh.sweep_bvh", "kernels"),
        ),
    )
}
