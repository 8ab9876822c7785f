"""Break-even analysis of influence areas: whether their trees pay for a batch of rays, by counted work.

    print(wrt.known_rays.break_even(scene, rays.origins, rays.directions))

A ray of an area costs C_local in the area's tree. The area settles a share s of its rays: those that hit before they leave
the area, or end there. Each of the others costs another C_miss in the whole scene's tree. Without areas, each ray costs
C_global. So the area pays if

    C_local + (1 - s) C_miss < C_global,   that is   s > (C_local + C_miss - C_global) / C_miss

(Falcone 2024, section 6.2.5; the last line there has a plus before C_global.) Rays that an area does not settle differ from
the others, so C_miss is not C_global: all three costs are counted, on a sample of the batch.

**Cost** of a ray is the scene's cost model applied to its counted work: nodes visited, and triangles tested in blocks of
the tree's width, by single rays. Finding the area of a ray is added (`AREA_LOOKUP_COST`).

References: falcone-2024.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.facts.query_kinds import ANY, AUTO, CLOSEST
from wrt.engine.launch.area_trees import assign, with_range
from wrt.engine.launch.batch import trace_batch
from wrt.engine.memory import empty
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import Plan, plan_for_query
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import as_rays
from wrt.kernels.query.ordering.ray_order import sort_rays
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.validation import as_int
from wrt.tables import one_of

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.rays.rays import Rays
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.scene.scene import Scene

AREA_LOOKUP_COST = 2.0
"""Cost of finding the area of a ray, in node visits (notebooks/records/2026-11-21-influence-areas.md)."""

SAMPLES = 1 << 14
"""Default number of rays whose work is counted."""


def break_even_share(cost_local: float, cost_global: float, cost_miss: float) -> float:
    """Share of its rays that an area's tree must settle to pay; 0 or less: it always pays, above 1: never.

    Args:
        cost_local: mean cost of a ray in the area's tree.
        cost_global: mean cost of the same rays in the whole scene's tree.
        cost_miss: mean cost in the whole scene's tree of the rays that the area does not settle; 0 if it settles all.

    Raises:
        ValueError: a cost is negative or not finite.
    """
    for name, cost in (("cost_local", cost_local), ("cost_global", cost_global), ("cost_miss", cost_miss)):
        if not 0.0 <= cost < inf:
            raise ValueError(f"{name} is {cost}; it must be finite and not negative")
    if cost_miss == 0.0:
        return 0.0 if cost_local < cost_global else inf
    return (cost_local + cost_miss - cost_global) / cost_miss


@dataclass(frozen=True)
class AreaBreakEven:
    """Costs and savings of an area's tree.

    Attributes:
        area: the influence area.
        share: share of the batch's rays that belong to it.
        settled: share of those that need no other tree.
        cost_local, cost_global, cost_miss: mean costs of a ray, as in `break_even_share`; cost_local includes finding the
            area.
    """

    area: InfluenceArea
    share: float
    settled: float
    cost_local: float
    cost_global: float
    cost_miss: float

    @property
    def break_even(self) -> float:
        """Share of its rays that the area must settle to pay."""
        return break_even_share(self.cost_local, self.cost_global, self.cost_miss)

    @property
    def cost(self) -> float:
        """Mean cost of a ray of the area with influence areas."""
        return self.cost_local + (1.0 - self.settled) * self.cost_miss

    @property
    def ratio(self) -> float:
        """Cost of the area's rays without influence areas, over the cost with them: the area pays if this is above 1."""
        return self.cost_global / self.cost

    @property
    def pays(self) -> bool:
        """Whether the area settles more than the break-even share."""
        return self.settled > self.break_even

    def __str__(self) -> str:
        needed = "any share" if self.break_even <= 0.0 else f"{self.break_even:.0%}" if self.break_even <= 1.0 else "no share"
        verdict = "pays" if self.pays else "does not pay"
        return (
            f"{type(self.area).__name__} with {self.share:.1%} of the rays {verdict}: it settles {self.settled:.0%} of them, "
            f"break-even at {needed}; a ray costs {self.cost_local:.1f} here, {self.cost_miss:.1f} if not settled, and "
            f"{self.cost_global:.1f} without areas: {self.ratio:.2f} times"
        )


@dataclass(frozen=True)
class BreakEven:
    """The break-even analysis of all areas of a scene for a batch of rays.

    Attributes:
        areas: the areas with rays in the batch.
        unassigned_share: share of the rays that belong to no area.
        rays: number of rays whose work was counted.
    """

    areas: tuple[AreaBreakEven, ...]
    unassigned_share: float
    rays: int

    @property
    def ratio(self) -> float:
        """Cost of all rays with an area without influence areas, over the cost with them; 1 if there are none."""
        if not self.areas:
            return 1.0
        return sum(area.share * area.cost_global for area in self.areas) / sum(area.share * area.cost for area in self.areas)

    @property
    def pays(self) -> bool:
        """Whether influence areas pay for the rays that have one."""
        return self.ratio > 1.0

    def __str__(self) -> str:
        head = f"Influence areas {'pay' if self.pays else 'do not pay'}: {self.ratio:.2f} times by the work of {self.rays} rays"
        return "\n".join([head, *map(str, self.areas), f"{self.unassigned_share:.1%} of the rays belong to no area"])


def break_even(
    scene: Scene,
    origins: Rays | ArrayLike,
    directions: ArrayLike | None = None,
    t_min: Numbers = 0.0,
    t_max: Numbers = inf,
    *,
    query: str = CLOSEST,
    samples: int = SAMPLES,
) -> BreakEven:
    """Whether the influence areas of a scene pay for such rays, by the counted work of evenly spaced samples.

    Args:
        scene: built with a `wrt.known_rays.RayAwareBvh`.
        origins, directions, t_min, t_max: as in `Scene.intersect`.
        query: "closest" or "any".
        samples: largest number of rays traced.

    Raises:
        TypeError: as `Scene.intersect`.
        ValueError: as `Scene.intersect`; the scene has no influence areas; an unknown query.
    """
    if scene.state.area_trees is None:
        raise ValueError(
            "the scene has no influence areas with triangles; make it with accelerator=wrt.known_rays.RayAwareBvh(areas=...)"
        )
    one_of((CLOSEST, ANY), query, "query")
    with use_threads(scene.num_threads):
        buffers = to_device(as_rays(origins, directions, t_min, t_max), scene.device, scene.center)
        plan = plan_for_query(make_plan(scene.state, buffers, "single", AUTO, query), query)
        count = min(as_int("samples", samples, 1), buffers.count)
        rays = select_rays(buffers.batch, np.arange(count) * buffers.count // max(count, 1), scene.device)
        return count_break_even(scene.state, plan, rays, query)


def count_break_even(scene: SceneState, plan: Plan, rays: RayBatch, query: str) -> BreakEven:
    """Counts the work of all rays, by area."""
    local, cuts = scene.area_trees, assign(scene, rays)
    area, rest, count = cuts.area.numpy(), cuts.rest.numpy(), max(rays.count, 1)
    cut, left = with_range(rays, "t_max", cuts.cut), with_range(rays, "t_min", cuts.rest)
    found = []
    for number in range(len(local)):
        chosen = np.flatnonzero(area == number)
        if len(chosen):
            whole, _ = costs(scene, plan, rays, chosen, query)
            here, hit = costs(local.scenes[number], plan, cut, chosen, query)
            missed = chosen[~hit & np.isfinite(rest[chosen])]
            again, _ = costs(scene, plan, left, missed, query)
            means = (AREA_LOOKUP_COST + here.mean(), whole.mean(), again.mean() if len(missed) else 0.0)
            settled = 1.0 - len(missed) / len(chosen)
            found.append(AreaBreakEven(local.areas[number], len(chosen) / count, settled, *map(float, means)))
    return BreakEven(tuple(found), float((area == len(local)).sum() / count), rays.count)


def costs(scene: SceneState, plan: Plan, rays: RayBatch, chosen: np.ndarray, query: str) -> tuple[np.ndarray, np.ndarray]:
    """Cost of the chosen rays in a scene's tree, and whether each hits anything."""
    hits, work = trace_batch(scene, plan, select_rays(rays, chosen, scene.device), query, True)
    counted, cost = work.numpy(), scene.accelerator.config(scene.tree.width).cost
    ray_cost = cost.traversal * counted["nodes"] + cost.block * counted["triangles"] / scene.tree.width
    return ray_cost, hits.primitive.numpy() >= 0 if hits.occluded is None else hits.occluded.numpy()


def select_rays(rays: RayBatch, chosen: np.ndarray, device: wp.Device) -> RayBatch:
    """The rays of a batch with these indices."""
    return sort_rays(rays, wp.array(chosen.astype(np.int32), dtype=int, device=device), empty)
