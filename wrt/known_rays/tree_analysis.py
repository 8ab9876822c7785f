"""Quality of a BVH for given rays: expected from the areas of boxes, and counted by tracing; as tables, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.atomic_files import write_text
from wrt.engine.executor import trace
from wrt.engine.facts.query_kinds import CLOSEST, COUNT
from wrt.engine.launch.area_trees import assign
from wrt.engine.plan.choices import make_plan
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.validation import as_float

if TYPE_CHECKING:
    from wrt.builders.bvh.bvh_analysis import BoxMeasures
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.scene.scene import Scene

__all__ = ["CountedWork", "TreeAnalysis", "analyse", "analyse_areas"]

Statistics = Mapping[str, "Callable[[BoxMeasures], Any]"]
"""User-defined statistics, by name: functions from the measures of all boxes to one number for each box."""

BOX_COST = 1.0
TRIANGLE_COST = 1.2
"""Costs of one ray-box and one ray-triangle test, after Falcone (see `wrt.known_rays.influence_areas`)."""


@dataclass(frozen=True)
class CountedWork:
    """Work of rays, on average over those that meet the root's box.

    Attributes:
        rays: number of rays that meet the root's box.
        share: their share of all rays.
        boxes, triangles: tests per ray. Visiting a node of W children counts as W box tests.
        cost: cost of these tests.
    """

    rays: int
    share: float
    boxes: float
    triangles: float
    cost: float


@dataclass(frozen=True)
class TreeAnalysis:
    """Measures of a scene's bounding volume hierarchy.

    Attributes:
        boxes: one row per box: place, level, hit probability, cost, overlap of its children
            (`wrt.builders.bvh.bvh_analysis.BoxMeasures`).
        expected_cost: expected cost of a ray that meets the root's box and does not stop at hits.
        expected_boxes, expected_triangles: expected tests of such a ray.
        passing: work counted for the given rays, without stopping at hits; None without rays.
        stopping: work counted for the given rays, each up to its closest hit; None without rays.
        hit_share: share of the given rays that hit a triangle; None without rays.
        build_seconds: wall time of the build by phase.
        bytes: bytes of nodes and leaf lists.
        statistics: the statistics that `analyse` was given: (boxes,) float64 by name.
    """

    boxes: BoxMeasures
    expected_cost: float
    expected_boxes: float
    expected_triangles: float
    passing: CountedWork | None
    stopping: CountedWork | None
    hit_share: float | None
    build_seconds: dict[str, float]
    bytes: int
    statistics: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def error(self) -> float | None:
        """|counted - expected| / expected cost of rays that do not stop at hits; None without rays."""
        return None if self.passing is None else abs(self.passing.cost - self.expected_cost) / self.expected_cost

    @cached_property
    def levels(self) -> list[dict[str, Any]]:
        """Figures by level: nodes, leaves, triangles, expected boxes met, cost, the overlap of siblings (None if no siblings
        have an area), and the sum of each of the `statistics`.
        """
        boxes, overlap = self.boxes, self.boxes.overlap_by_level()
        rows = []
        for level in range(int(boxes.level.max()) + 1):
            here = boxes.level == level
            rows.append(
                {
                    "level": level,
                    "nodes": int((here & ~boxes.is_leaf).sum()),
                    "leaves": int((here & boxes.is_leaf).sum()),
                    "triangles": int(boxes.triangles[here].sum()),
                    "expected boxes met": float(boxes.hit_probability[here].sum()),
                    "expected cost": float(boxes.cost[here].sum()),
                    "sibling overlap": None if np.isnan(overlap[level]) else float(overlap[level]),
                    **{name: float(values[here].sum()) for name, values in self.statistics.items()},
                }
            )
        return rows

    def summary(self) -> dict[str, Any]:
        """Figures of the whole tree: nested dicts of plain numbers."""
        boxes = self.boxes
        total = boxes.smaller_area.sum()
        result: dict[str, Any] = {
            "nodes": int((~boxes.is_leaf).sum()),
            "leaves": int(boxes.is_leaf.sum()),
            "triangles": int(boxes.triangles.sum()),
            "bytes": self.bytes,
            "build seconds": {**self.build_seconds, "total": sum(self.build_seconds.values())},
            "sibling overlap": float(boxes.overlap_area.sum() / total) if total > 0.0 else None,
            "expected": {
                "boxes": self.expected_boxes,
                "triangles": self.expected_triangles,
                "cost": self.expected_cost,
            },
        }
        for name, work in (("passing", self.passing), ("stopping", self.stopping)):
            if work is not None:
                result[name] = dict(vars(work))
        if self.passing is not None:
            result |= {"error": self.error, "hit share": self.hit_share}
        return result

    def rows(self) -> list[dict[str, Any]]:
        """One row per box, of plain numbers, with the `statistics`; the overlap of children is None if fewer than two have an
        area."""
        boxes, overlap = self.boxes, self.boxes.overlap
        return [
            {
                "box": i,
                "parent": int(boxes.parent[i]),
                "level": int(boxes.level[i]),
                "leaf": bool(boxes.is_leaf[i]),
                "triangles": int(boxes.triangles[i]),
                **{f"low_{a}": float(boxes.low[i, k]) for k, a in enumerate("xyz")},
                **{f"high_{a}": float(boxes.high[i, k]) for k, a in enumerate("xyz")},
                "area": float(boxes.area[i]),
                "hit_probability": float(boxes.hit_probability[i]),
                "cost": float(boxes.cost[i]),
                "overlap": None if np.isnan(overlap[i]) else float(overlap[i]),
                **{name: float(values[i]) for name, values in self.statistics.items()},
            }
            for i in range(len(boxes.level))
        ]

    def to_dict(self) -> dict[str, Any]:
        """All figures as JSON types: "tree" (`summary`), "levels", "boxes" (`rows`)."""
        return {"tree": self.summary(), "levels": self.levels, "boxes": self.rows()}

    def save_json(self, path: str | Path) -> None:
        """Writes `to_dict` to a file at `path`, whole or not at all."""
        write_text(path, json.dumps(self.to_dict(), indent=1) + "\n")

    def save_csv(self, path: str | Path) -> None:
        """Writes `rows` to a CSV file at `path`, whole or not at all, with a header; None becomes an empty field."""
        rows, text = self.rows(), io.StringIO(newline="")
        writer = csv.DictWriter(text, rows[0])
        writer.writeheader()
        writer.writerows(rows)
        write_text(path, text.getvalue())


def analyse(
    scene: Scene,
    area: InfluenceArea | None = None,
    rays: Rays | None = None,
    *,
    box_cost: float = BOX_COST,
    triangle_cost: float = TRIANGLE_COST,
    statistics: Statistics | None = None,
) -> TreeAnalysis:
    """Measures the bounding volume hierarchy of a scene.

        area = wrt.known_rays.PointInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), fov=(60, 40), near=1, far=20)
        scene = wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(areas=[area]))
        print(wrt.known_rays.analyse(scene, area, rays).summary())

    Args:
        scene: a scene whose tree is a bounding volume hierarchy.
        area: the expected rays: they meet boxes in proportion to their projected areas. None: in proportion to their
            surface areas.
        rays: rays whose work is counted; None to trace none.
        box_cost, triangle_cost: cost of testing a ray against a box, and against a triangle; in [0, inf).
        statistics: statistics of your own, by name: functions from the measures of all boxes (`TreeAnalysis.boxes`) to one
            number for each box, such as `{"volume": lambda boxes: (boxes.high - boxes.low).prod(axis=1)}`.

    Raises:
        TypeError: an argument has a wrong type.
        ValueError: a scene of instances or of another kind of tree, `rays` is empty, a cost is out of range, a statistic has
            the name of a column that is there already, or does not return one number for each box.
    """
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.builders.tree import Bvh

    if not isinstance(scene.tree, Bvh):
        raise ValueError(f"scene has a {scene.accelerator.kind}; analyse measures wrt.Bvh and wrt.known_rays.ProjectedBvh")
    if scene.instances:
        raise ValueError("a scene of instances has a tree for each mesh; analyse wrt.Scene(scene.flattened()), or one mesh")
    if area is not None and not isinstance(area, InfluenceArea):
        kind = type(area).__name__
        raise TypeError(
            f"area must be a wrt.known_rays.PlaneInfluenceArea, a wrt.known_rays.PointInfluenceArea or None, not {kind}"
        )
    costs = _check(rays, box_cost, triangle_cost)
    return _measure(scene.state, scene.num_threads, area, rays, costs, statistics or {})


def analyse_areas(
    scene: Scene,
    rays: Rays | None = None,
    *,
    box_cost: float = BOX_COST,
    triangle_cost: float = TRIANGLE_COST,
    statistics: Statistics | None = None,
) -> tuple[TreeAnalysis, ...]:
    """Measures the tree of each influence area of a scene, as `analyse` measures the tree over all triangles.

    Args:
        scene: built with a `wrt.known_rays.RayAwareBvh`.
        rays: rays whose work is counted, each in the tree of its area, up to where it leaves the area; None to trace none.
        box_cost, triangle_cost, statistics: as in `analyse`.

    Returns:
        An analysis for each area that contains triangles, in the order of the accelerator's areas. Without rays in an area, its
        `passing` and `stopping` are None.

    Raises:
        TypeError, ValueError: as `analyse`; the scene has no influence areas.
    """
    if scene.state.area_trees is None:
        raise ValueError(
            "the scene has no influence areas with triangles; make it with accelerator=wrt.known_rays.RayAwareBvh(areas=...)"
        )
    trees, costs = scene.state.area_trees, _check(rays, box_cost, triangle_cost)
    parts = [None] * len(trees) if rays is None else _rays_by_area(scene, rays)
    return tuple(
        _measure(state, scene.num_threads, area, part, costs, statistics or {})
        for state, area, part in zip(trees.scenes, trees.areas, parts, strict=True)
    )


def _check(rays: Rays | None, box_cost: float, triangle_cost: float) -> tuple[float, float]:
    """The costs as numbers."""
    if rays is not None and not isinstance(rays, Rays):
        raise TypeError(f"rays must be a wrt.Rays, not {type(rays).__name__}; make one with wrt.Rays(origins, directions)")
    if rays is not None and not len(rays):
        raise ValueError("rays is empty and has no average work; pass None to trace no rays")
    costs = as_float("box_cost", box_cost), as_float("triangle_cost", triangle_cost)
    for name, cost in zip(("box_cost", "triangle_cost"), costs, strict=True):
        if not 0.0 <= cost < float("inf"):
            raise ValueError(f"{name} is {cost}; it must be finite and not negative")
    return costs


def _measure(
    scene: SceneState,
    threads: int | None,
    area: InfluenceArea | None,
    rays: Rays | None,
    costs: tuple[float, float],
    statistics: Statistics,
) -> TreeAnalysis:
    """The analysis of a scene's tree; `costs` of a box and of a triangle."""
    from wrt.builders.bvh.bvh_analysis import measure_boxes

    boxes = measure_boxes(scene.tree, area, scene.center, *costs)
    own = _own_statistics(statistics, boxes)
    passing = stopping = hit_share = None
    if rays is not None:
        meets = _meets_root(scene, rays)
        passing, _ = _count(scene, threads, rays, COUNT, meets, costs)
        stopping, hits = _count(scene, threads, rays, CLOSEST, meets, costs)
        hit_share = float((hits.primitive.numpy() >= 0).mean())
    return TreeAnalysis(
        boxes=boxes,
        expected_cost=float(boxes.cost.sum()),
        expected_boxes=float(scene.tree.width * boxes.hit_probability[~boxes.is_leaf].sum()),
        expected_triangles=float((boxes.hit_probability * boxes.triangles).sum()),
        passing=passing,
        stopping=stopping,
        hit_share=hit_share,
        build_seconds=dict(scene.tree.stats.seconds),
        bytes=scene.tree.bytes,
        statistics=own,
    )


COLUMNS = {"box", "parent", "level", "leaf", "triangles", "area", "hit_probability", "cost", "overlap", "nodes", "leaves"} | {
    f"{end}_{axis}" for end in ("low", "high") for axis in "xyz"
}
"""Names of columns of `TreeAnalysis.rows` and `TreeAnalysis.levels`, which user-defined statistics cannot have."""


def _own_statistics(statistics: Statistics, boxes: BoxMeasures) -> dict[str, np.ndarray]:
    """(boxes,) float64 of each statistic."""
    found = {}
    for name, function in statistics.items():
        if name in COLUMNS:
            raise ValueError(f"statistics[{name!r}] has the name of a column that is there already; choose another name")
        values = np.asarray(function(boxes), dtype=np.float64)
        if values.shape != boxes.level.shape:
            raise ValueError(f"statistics[{name!r}] returned the shape {values.shape}; it must return {boxes.level.shape}")
        found[name] = values
    return found


def _rays_by_area(scene: Scene, rays: Rays) -> list[Rays | None]:
    """The rays of each area, limited to where they leave it; None for an area without rays."""
    with use_threads(scene.num_threads):
        buffers = to_device(rays, scene.device, scene.center)
        cuts = assign(scene.state, buffers.batch)
    area, cut = cuts.area.numpy(), cuts.cut.numpy()
    origins, directions, t_min, _ = _flat(rays)
    chosen = [np.flatnonzero(area == number) for number in range(len(scene.state.area_trees))]
    return [Rays(origins[i], directions[i], t_min[i], cut[i]) if len(i) else None for i in chosen]


def _count(
    scene: SceneState, threads: int | None, rays: Rays, query: str, meets: np.ndarray, costs: tuple[float, float]
) -> tuple[CountedWork, DeviceHits]:
    """Work of the rays that meet the root's box, and the hits of all rays."""
    with use_threads(threads):
        buffers = to_device(rays, scene.device, scene.center)
        hits, work = trace(scene, make_plan(scene, buffers, "single", "auto", query), buffers, query, counters=True)
    counts = work.numpy()
    boxes = scene.tree.width * float(counts["nodes"][meets].mean()) if meets.any() else 0.0
    triangles = float(counts["triangles"][meets].mean()) if meets.any() else 0.0
    cost = boxes * costs[0] + triangles * costs[1]
    return CountedWork(int(meets.sum()), float(meets.mean()), boxes, triangles, cost), hits


def _meets_root(scene: SceneState, rays: Rays) -> np.ndarray:
    """(rays,) whether each meets the box of all triangles between t_min and t_max, in float64."""
    origins, directions, t_min, t_max = (values.astype(np.float64) for values in _flat(rays))
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (scene.bounds[:, None] - origins) / directions
    entry, leave = np.fmin(*ends).max(axis=-1), np.fmax(*ends).min(axis=-1)
    return np.maximum(entry, t_min) <= np.minimum(leave, t_max)


def _flat(rays: Rays) -> tuple[np.ndarray, ...]:
    """(N, 3) origins, (N, 3) directions, (N,) t_min and (N,) t_max of rays."""
    origins, directions, t_min, t_max = (
        np.asarray(a.numpy() if hasattr(a, "numpy") else a) for a in (rays.origins, rays.directions, rays.t_min, rays.t_max)
    )
    shape = np.broadcast_shapes(origins.shape[:-1], directions.shape[:-1], t_min.shape, t_max.shape)
    vectors = (np.broadcast_to(a, (*shape, 3)).reshape(-1, 3) for a in (origins, directions))
    return *vectors, *(np.broadcast_to(a, shape).ravel() for a in (t_min, t_max))
