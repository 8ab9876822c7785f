"""Builders of bounding volume hierarchies: one file per way to build, and the table of them.

**Contract.** A builder is a function `build(triangles, config) -> Bvh`: boxes of the triangles in
(`wrt.builders.triangle_boxes.TriangleBoxes`), cost model and leaf size as a frozen `BvhConfig`, a tree in the layout of
`wrt.kernels.layout.bvh_nodes` out, with the time of each phase. Builders make a binary tree (`tree`); `collapse` makes it wide.
Every triangle is in exactly one leaf; every box is the exact union of the boxes of its triangles.

To add a builder: write its file, add one line to `BVH_BUILDERS`; tests, command line and benchmarks pick it up.
"""

from collections.abc import Callable
from dataclasses import dataclass

from wrt.builders.bvh import binned_bvh as binned
from wrt.builders.bvh import sweep_bvh as sweep
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import TriangleBoxes


@dataclass(frozen=True)
class BvhBuilder:
    """A way to build a bounding volume hierarchy.

    Attributes:
        name: key in `BVH_BUILDERS`.
        paper: authors, title, year.
        build: (boxes, config) -> tree.
    """

    name: str
    paper: str
    build: Callable[[TriangleBoxes, BvhConfig], Bvh]


BVH_BUILDERS: dict[str, BvhBuilder] = {
    builder.name: builder
    for builder in (
        BvhBuilder("binned", "Wald: On fast construction of SAH-based bounding volume hierarchies (2007)", binned.build),
        BvhBuilder(
            "sweep",
            "Wald, Boulos, Shirley: Ray tracing deformable scenes using dynamic bounding volume hierarchies (2007)",
            sweep.build,
        ),
    )
}
