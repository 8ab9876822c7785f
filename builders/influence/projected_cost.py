"""The projected area heuristic: the weight of a box where the directions of rays are known, for a mixture of influence areas.

**Problem.** The surface area heuristic assumes that the share of rays that meet a box, among those that meet the enclosing box,
is the ratio of their surface areas. This holds for lines in all directions. In front of a light or a camera, the share is the
ratio of the areas that the boxes cover as seen along the rays (Falcone 2024, chapter 2; `wrt.kernels.influence`).

**Cost.** Prices are those of `wrt.builders.cost`: a split costs weight(left) leaf(n_left) + weight(right) leaf(n_right) over
the node's weight. Only the weight of a box changes, and a mixture of distributions is a sum of weights,

    weight(box) = sum over areas of share_i A_i(box) / A_i(scene)  +  share of the others S(box) / S(scene)

where A_i is the projected area and S the surface area: the probability that a ray that meets the scene's box meets this box. An
area that does not see the scene's box is omitted. If no area sees it, only the surface area counts.

**Rays in all directions.** Projected areas are 0 for flat boxes seen from the side, and for boxes outside all areas, so all
splits of such boxes would cost the same. A small share of rays in all directions (`RayDistribution.others`) decides there.

References: falcone-2024; fabianowski-2009.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
import warp as wp

from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea, PointInfluenceArea
from wrt.kernels.influence.box_clipping import projected_area
from wrt.kernels.influence.view import AreaView, direction_at
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY
from wrt.kernels.validation import as_numbers


@wp.struct
class Mixture:
    """`RayDistribution` for a scene, for kernels."""

    views: wp.array(dtype=AreaView)
    factor: wp.array(dtype=float)
    """(areas,) share of an area's rays over the projected area of the scene's box; 0 if the area does not see that box."""
    share: wp.array(dtype=float)
    """(areas,) share of an area's rays among those of all areas."""
    count: int
    """Number of areas."""
    weighed: int
    """Number of areas that count in weights: all, or 0 if only the surface area counts."""
    others: float
    """Share of rays in all directions over half the surface area of the scene's box."""
    area: float
    """Projected area of the scene's box, averaged over the areas."""


@dataclass(frozen=True)
class RayDistribution:
    """The distribution of rays as a mixture.

    Attributes:
        areas: influence areas, at least one.
        shares: share of the rays of each area, above 0; only their ratios count. None for equal shares.
        others: share of all rays that go in all directions, in [0, 1]; with 1, boxes are weighed by surface area.

    Raises:
        TypeError: `areas` contains an object of another type.
        ValueError: there is no area, or a value is out of its range.
    """

    areas: tuple[InfluenceArea, ...]
    shares: tuple[float, ...] | None = None
    others: float = 1e-3

    def __post_init__(self) -> None:
        object.__setattr__(self, "areas", check_areas(self.areas))
        if self.shares is not None:
            object.__setattr__(self, "shares", tuple(as_numbers("shares", self.shares, (None,), finite=False).tolist()))
            if len(self.shares) != len(self.areas) or not all(share > 0.0 and isfinite(share) for share in self.shares):
                raise ValueError(f"shares is {self.shares}; pass {len(self.areas)} numbers above 0, one per area, or None")
        if not 0.0 <= self.others <= 1.0:
            raise ValueError(f"others is {self.others}; it must be from 0 to 1")

    def mixture(self, low: np.ndarray, high: np.ndarray, center: np.ndarray, device: wp.Device) -> Mixture:
        """The weights for a scene.

        Args:
            low, high: (3,) the scene's box, relative to `center`.
            center: (3,) the origin of the scene's positions.
            device: device on which trees are built.
        """
        views = wp.array([area.view(center) for area in self.areas], dtype=AreaView, device=device)
        scene = [wp.array([corner], dtype=wp.vec3, device=device) for corner in (low, high)]
        seen = np.array([project(area.view(center), *scene)[0] for area in self.areas], dtype=np.float64)
        shares = np.ones(len(seen)) if self.shares is None else np.array(self.shares)
        shares = np.where(seen > 0.0, shares, 0.0)
        others = self.others if shares.any() else 1.0
        shares /= max(shares.sum(), np.finfo(float).tiny)
        x, y, z = np.asarray(high, dtype=np.float64) - low
        surface = x * y + y * z + z * x
        mixture = Mixture()
        mixture.views = views
        factor = np.divide((1.0 - others) * shares, seen, out=np.zeros(len(seen)), where=seen > 0.0)
        mixture.factor = wp.array(factor, dtype=float, device=device)
        mixture.share = wp.array(shares, dtype=float, device=device)
        mixture.count = len(seen)
        mixture.weighed = len(seen) if others < 1.0 else 0
        mixture.area = float(shares @ seen)
        mixture.others = others / surface if surface > 0.0 else 0.0
        return mixture


def check_areas(areas: Sequence[InfluenceArea]) -> tuple[InfluenceArea, ...]:
    """The areas as a tuple; raises ValueError if there is none, TypeError for an object of another type."""
    if isinstance(areas, PlaneInfluenceArea | PointInfluenceArea):
        return (areas,)
    areas = tuple(areas)
    if not areas:
        raise ValueError(
            "areas is empty; pass at least one wrt.known_rays.PlaneInfluenceArea or wrt.known_rays.PointInfluenceArea"
        )
    for area in areas:
        if not isinstance(area, PlaneInfluenceArea | PointInfluenceArea):
            kind = type(area).__name__
            raise TypeError(
                f"areas must hold wrt.known_rays.PlaneInfluenceArea and wrt.known_rays.PointInfluenceArea, not {kind}"
            )
    return areas


@exact_kernel
def project_boxes(
    first: int,
    view: AreaView,
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    areas: wp.array(dtype=float),
):
    """Item: a box. Writes its projected area."""
    i = first + wp.tid()
    areas[i] = projected_area(view, low[i], high[i])


def project(view: AreaView, low: wp.array, high: wp.array) -> np.ndarray:
    """(boxes,) float32 projected areas of boxes, see `projected_area`."""
    areas = wp.empty(len(low), dtype=float, device=low.device)
    launch(project_boxes, len(low), [view, low, high, areas], device=low.device)
    return areas.numpy()


@wp.func
def half_surface(low: wp.vec3, high: wp.vec3):
    """Half the surface area of a box."""
    size = high - low
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.func
def box_weight(mixture: Mixture, low: wp.vec3, high: wp.vec3):
    """Probability that a ray that meets the scene's box meets this box; INFINITY, never NaN, if float32 overflows."""
    weight = mixture.others * half_surface(low, high)
    for i in range(mixture.weighed):
        weight += mixture.factor[i] * projected_area(mixture.views[i], low, high)
    return wp.where(weight < INFINITY, weight, INFINITY)


@wp.func
def facing(mixture: Mixture, center: wp.vec3):
    """Shares of the direction of rays at a point along each axis, |v_x| / (|v_x| + |v_y| + |v_z|) and so on, averaged over
    areas."""
    total = wp.vec3()
    for i in range(mixture.count):
        along = wp.abs(direction_at(mixture.views[i], center))
        length = along[0] + along[1] + along[2]
        if length > 0.0:
            total += along * (mixture.share[i] / length)
    return total
