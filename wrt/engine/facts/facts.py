"""Facts that a plan depends on: of rays, and of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from wrt.engine.facts.query_kinds import AUTO, FEW_RAYS


class RayFacts(NamedTuple):
    """Facts about rays that are there, or are still to be made. (A tuple: it is made in every call, and is a key.)

    Attributes:
        count: number of rays.
        shape: their leading shape.
        shared_origin: whether they are stored with one origin for all.
        coherent: whether neighbouring rays are similar.
        scattered: whether neighbouring rays start far apart.
        columns: columns of the image whose pixels, row by row, the rays belong to; 0 if they are not those of an image.
    """

    count: int  # type: ignore[assignment]
    shape: tuple[int, ...]
    shared_origin: bool = False
    coherent: bool = True
    scattered: bool = False
    columns: int = 0


@dataclass(frozen=True, kw_only=True)
class SceneFacts:
    """Facts about a scene's state.

    Attributes:
        tree: kind of its tree, "bvh" or "kdtree".
        width: triangles tested at once, and children of a node of a BVH.
        triangles: number of triangles.
        instances: number of instances; 0 in scenes of one level.
        is_cuda: whether it lives on a GPU.
        own_spaces: whether its trees have coordinate spaces of their own, so that rays go one by one.
        is_lazy: whether its tree is built while rays are traced.
        shares_leaves: whether a triangle may be in several leaves of the BVH.
        by_area: whether its trees are those of influence areas.
        triangle_test: of queries that name no other, or "auto".
        few_rays: number of rays up to which each is traced on its own on the CPU.
        has_masks: whether hits are decided one by one, by alpha masks.
        points: whether its tree is over points (`wrt.sensors.PointCloud`); `triangles` is their number then, and
            `triangle_test` one of `wrt.kernels.clouds.cloud_test.TESTS`.
    """

    tree: str
    width: int
    triangles: int
    instances: int = 0
    is_cuda: bool = False
    own_spaces: bool = False
    is_lazy: bool = False
    shares_leaves: bool = False
    by_area: bool = False
    triangle_test: str = AUTO
    few_rays: int = FEW_RAYS
    has_masks: bool = False
    points: bool = False

    @property
    def can_be_wide(self) -> bool:
        """Whether the scene has a single, complete kd-tree (`wrt.engine.facts.wide_trees`)."""
        return self.tree == "kdtree" and not (self.is_lazy or self.instances or self.own_spaces or self.has_masks)
