"""All descriptions of acceleration structures, and the names that stand for them."""

from __future__ import annotations

from functools import cache
from typing import Literal, TypeAlias, get_args

from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.tables import lookup

Accelerator: TypeAlias = KdTree | Bvh | ProjectedBvh | RayAwareBvh

AcceleratorName: TypeAlias = Literal["auto", "bvh", "kdtree"]

ACCELERATORS: dict[str, type[Bvh | KdTree]] = {"auto": Bvh, "bvh": Bvh, "kdtree": KdTree}
"""Names that `wrt.Scene` takes in place of a description."""


def resolve_accelerator(accelerator: str | Accelerator) -> Accelerator:
    """The description that a name stands for.

    Raises:
        ValueError: unknown name.
        TypeError: neither a name nor a description.
    """
    if isinstance(accelerator, Accelerator):
        return accelerator
    if not isinstance(accelerator, str):
        kind = type(accelerator).__name__
        names = ", ".join(f"wrt.{entry.__name__}" for entry in get_args(Accelerator))
        hint = "; pass vertices and faces as one mesh, wrt.TriangleMesh(vertices, faces)" if kind == "ndarray" else ""
        raise TypeError(f"accelerator must be a name or one of {names}, not {kind}{hint}")
    return _described(accelerator)


@cache
def _described(name: str) -> Accelerator:
    """The description of a name. It is frozen, so all scenes share it: checking it takes as long as some rays."""
    return lookup(ACCELERATORS, name, "accelerator")()
