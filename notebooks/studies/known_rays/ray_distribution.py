"""The experiments of Falcone 2024 on trees for known rays, made again.

    measure        sections 6.2.1 to 6.2.3, 6.2.6 to 6.2.8: precision, costs and intersections, overlap of siblings by level
    build_times    section 6.2.4
    balances       section 6.2.5: the share of rays that an area has to settle, and what it saves
    top_levels     section 6.3: octree against array
    sweep          section 6.4: thresholds of the choice of axes
    memory         section 6.5

Each returns a list of plain dicts. Scenes, areas and the thesis' names of trees: `ray_cases`. Costs are the thesis' own, 1
a box and 1.2 a triangle, counted for rays that pass through all that they meet; times are ratios of turns.

References: falcone-2024 (chapter 6).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import radians, sin
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp

from studies.known_rays.ray_cases import TREES, Case
from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.builders.bvh.known_rays_config import USED_FALLBACK
from wrt.builders.bvh.phases.split_axes import AxisChoice
from wrt.builders.bvh.projected_binned import ProjectedBuilder
from wrt.builders.influence.area_top_level import TopLevel, lookup_margin, region_of
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea, PointInfluenceArea
from wrt.builders.influence.regions import contain_points
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.engine.launch.area_trees import CHUNK
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.influence.area_assignment import assign_rays
from wrt.kernels.influence.area_lanes import AreaSplits
from wrt.kernels.runtime.launch import launch
from wrt.known_rays.area_break_even import break_even
from wrt.known_rays.tree_analysis import TreeAnalysis, analyse
from wrt.scene.scene import Scene

Row = dict[str, Any]

REFERENCE = "SAH + LSPH"
"""The thesis' state of the art."""

REACHES = (0.45, 0.55, 0.7, 1.0)
"""Ends of areas for `balances`, as shares of the way through the scene and behind it."""

PROPERTIES = {
    "case 0": AxisChoice("facing", 0.4, 1.3, 0.9),
    "case 1": AxisChoice("facing", 0.1, 1.3, 0.9),
    "case 2": AxisChoice("facing", 0.8, 1.3, 0.9),
    "case 3": AxisChoice("facing", 0.4, 1.1, 0.7),
    "case 4": AxisChoice("facing", 0.4, 1.5, 1.1),
}
"""Table 6.2 and 6.3: least quality, acceptable and excellent sum of the children's hit probabilities."""


def scene_of(case: Case, tree: str) -> Scene:
    """The scene of a case with one of `TREES`, built by one thread."""
    return Scene(case.mesh, TREES[tree](case.area), device="cpu", num_threads=1)


def measure(cases: Iterable[Case], trees: Sequence[str] = tuple(TREES), *, rays: int = 1024) -> list[Row]:
    """Costs and precision.

    Returns:
        A row for each case and tree: scene, kind, way, tree; cost (counted, of rays that meet the scene's box), boxes,
        triangles (tests of such a ray), stopping (cost if rays stop at their closest hit), hit_share; estimate (of the cost, by
        the heuristic of the tree), error (|cost - estimate| / estimate), error_unclipped (the same, if what is outside of the
        window counted too); overlap (of siblings), overlaps (by level; NaN: none there), depth (levels below the root).
    """
    rows = []
    for case in cases:
        for tree in trees:
            scene = scene_of(case, tree)
            found = analyse(scene, case.area, case.rays(rays))
            passing, boxes = found.passing, found.boxes
            if tree.startswith("PAH"):
                estimates = [found.expected_cost, analyse(scene, unclipped(case.area)).expected_cost]
            else:
                estimates = [analyse(scene).expected_cost] * 2
            errors = [abs(passing.cost - estimate) / estimate for estimate in estimates]
            row = {"scene": case.scene, "kind": case.kind, "way": case.way, "tree": tree, "cost": passing.cost}
            row |= {"boxes": passing.boxes, "triangles": passing.triangles, "stopping": found.stopping.cost}
            row |= {"hit_share": found.hit_share, "estimate": estimates[0], "error": errors[0], "error_unclipped": errors[1]}
            row |= {"overlap": float(boxes.overlap_area.sum() / boxes.smaller_area.sum())}
            rows.append(row | {"overlaps": boxes.overlap_by_level(), "depth": int(boxes.level.max())})
    return rows


def unclipped(area: InfluenceArea) -> InfluenceArea:
    """The area with a window so wide that it cuts nothing off."""
    if isinstance(area, PlaneInfluenceArea):
        return replace(area, width=1e3 * area.width, height=1e3 * area.height)
    return replace(area, fov=(170.0, 170.0))


def faster(rows: Iterable[Row], tree: str, figure: str = "cost") -> dict[tuple[str, str, str], float]:
    """(cost of the reference - cost) / cost, as in the thesis, by (scene, kind, way); above 0: cheaper than the reference."""
    costs = {(row["scene"], row["kind"], row["way"], row["tree"]): row[figure] for row in rows}
    return {key[:3]: costs[(*key[:3], REFERENCE)] / cost - 1.0 for key, cost in costs.items() if key[3] == tree}


def average(rows: Iterable[Row], figure: str, *by: str) -> dict[tuple[str, ...], float]:
    """Means of a figure over the rows that agree in the columns `by`."""
    groups: dict[tuple[str, ...], list[float]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in by), []).append(row[figure])
    return {key: float(np.mean(values)) for key, values in groups.items()}


def build_times(cases: Iterable[Case], trees: Sequence[str] = tuple(TREES), *, rounds: int = 5) -> list[Row]:
    """Time of the whole build on one thread.

    Returns:
        A row for each case and tree: scene, kind, way, tree, seconds, ratio (to `REFERENCE`), least, greatest.
    """
    rows = []
    for case in cases:
        runs = {tree: lambda case=case, tree=tree: scene_of(case, tree) for tree in dict.fromkeys((REFERENCE, *trees))}
        timings = timed(runs, rounds)
        rows += [
            {"scene": case.scene, "kind": case.kind, "way": case.way, "tree": tree} | ratios(timing, timings[REFERENCE])
            for tree, timing in timings.items()
        ]
    return rows


def balances(cases: Iterable[Case], *, rays: int = 4096, reaches: Sequence[float] = REACHES) -> list[Row]:
    """Areas that end within the scene, so that some of their rays need the whole scene's tree.

    Returns:
        A row for each case and reach: scene, kind, way, reach, settled (share of the rays), break_even (share that would be
        enough), saved (cost without the area / cost with it - 1), cost_local, cost_global, cost_miss.
    """
    rows = []
    for case in cases:
        name, end = ("depth", case.area.depth) if case.kind == "plane" else ("far", case.area.far)
        for reach in reaches:
            area = replace(case.area, **{name: reach * end})
            local = ProjectedBvh.published(area)
            whole = Bvh(width=2, traversal_cost=local.traversal_cost, block_cost=2 * local.triangle_cost, max_leaf_triangles=2)
            scene = Scene(case.mesh, RayAwareBvh(areas=[area], whole=whole, local=local), device="cpu")
            if scene.state.area_trees is None:
                continue
            found = break_even(scene, case.rays(rays), samples=rays)
            if not found.areas:
                continue
            (balance,) = found.areas
            costs = {f"cost_{name}": getattr(balance, f"cost_{name}") for name in ("local", "global", "miss")}
            row = {"scene": case.scene, "kind": case.kind, "way": case.way, "reach": reach, "settled": balance.settled}
            rows.append(row | {"break_even": balance.break_even, "saved": balance.ratio - 1.0} | costs)
    return rows


def random_areas(count: int, seed: int = 0, size: float = 1.0) -> list[InfluenceArea]:
    """Influence areas in the unit cube, of parallel and of radial rays in turn; each holds a sixth of it, on average.

    Args:
        count: how many.
        seed: the same seed gives the same areas.
        size: by which lengths and fields of view are scaled, above 0 and at most 1.
    """
    random = np.random.default_rng(seed)
    areas: list[InfluenceArea] = []
    for number in range(count):
        place = {"position": random.uniform(0.1, 0.9, 3), "direction": random.normal(size=3)}
        if number % 2:
            fov, far = size * random.uniform(60.0, 110.0, 2), size * random.uniform(0.6, 1.2)
            areas.append(PointInfluenceArea(**place, fov=fov, near=0.01 * far, far=far))
        else:
            width, height, depth = size * random.uniform(0.5, 1.0, 3)
            areas.append(PlaneInfluenceArea(**place, width=width, height=height, depth=depth))
    return areas


def top_levels(
    counts: Sequence[int] = (20,),
    depths: Sequence[int] = (0, 3, 4, 5, 6),
    *,
    size: float = 1.0,
    rays: int = 1 << 16,
    rounds: int = 7,
) -> list[Row]:
    """Octrees and arrays over random areas.

    Args:
        counts: numbers of areas.
        depths: levels of octrees below the root; 0 for an array.
        size: of `random_areas`.
        rays: how many look their areas up.
        rounds: number of rounds per depth.

    Returns:
        A row for each count and depth: areas, depth, cells, bytes, build (seconds), error (share by which the leaves around
        random points list more areas than hold them), seconds (to find the areas of all rays), ratio (to the first of
        `depths`), least, greatest; listed (areas a point).
    """
    rows = []
    for count in counts:
        areas = random_areas(count, size=size)
        finders = {str(depth): Finder(areas, depth, rays) for depth in depths}
        timings = timed({name: finder.find for name, finder in finders.items()}, rounds)
        for name, finder in finders.items():
            row = {"areas": count, "depth": int(name), "cells": finder.top.cells, "bytes": finder.top.bytes}
            row |= {"build": finder.seconds, "listed": finder.listed.sum(axis=1).mean(), "error": finder.error}
            rows.append(row | ratios(timings[name], timings[str(depths[0])]))
    return rows


class Finder:
    """A top level, and rays from random points of the unit cube, half of them affine to some area if they start there.

    Args:
        areas: influence areas.
        depth: of the octree; 0 for an array.
        rays: how many.
    """

    def __init__(self, areas: Sequence[InfluenceArea], depth: int, rays: int) -> None:
        random = np.random.default_rng(1)
        low, high = np.zeros(3), np.ones(3)
        self.points = random.uniform(low, high, (rays, 3))
        directions = random.normal(size=(rays, 3))
        plane = [area for area in areas if isinstance(area, PlaneInfluenceArea)]
        directions[::2] = np.array([area.direction for area in plane])[random.integers(0, len(plane), len(directions[::2]))]
        device = wp.get_device("cpu")
        self.regions = [region_of(area, low, high) for area in areas]
        self.rays = to_device(Rays(self.points, directions), device, np.full(3, 0.5)).batch
        begin = perf_counter()
        touch = lookup_margin(areas, np.full(3, 0.5))
        self.top = TopLevel(areas, self.regions, touch, depth, sin(radians(1.0)), np.full(3, 0.5), device)
        self.seconds = perf_counter() - begin
        found = self.found = AreaSplits()
        found.area, found.cut, found.rest = (
            wp.empty(rays, dtype=t, device=device) for t in (wp.uint16, wp.float32, wp.float32)
        )
        self.sums = wp.empty(-(-rays // CHUNK), dtype=wp.vec4i, device=device)

    def find(self) -> np.ndarray:
        """The area of each ray, as tracing finds it."""
        none = wp.empty(0, dtype=int, device=self.sums.device)
        inputs = [self.rays, CHUNK, self.top.struct, none, 0, wp.vec3(-0.5), wp.vec3(0.5), self.found, self.sums]
        launch(assign_rays, len(self.sums), inputs, device=self.sums.device, chunk=1)
        return self.found.area.numpy()

    @cached_property
    def listed(self) -> np.ndarray:
        """(rays, areas) bool: those that the leaf around each origin lists."""
        return self.top.candidates(self.points)

    @property
    def error(self) -> float:
        """Areas that are listed but do not hold the point, over those that hold it."""
        inside = contain_points(self.regions, self.points)
        return float((self.listed & ~inside).sum() / max(inside.sum(), 1))


def sweep(cases: Iterable[Case], properties: Mapping[str, AxisChoice] = PROPERTIES, *, rays: int = 1024) -> list[Row]:
    """Other thresholds.

    Returns:
        A row for each choice of axes: name, the thresholds, cost (counted), tried (planes' axes a node), fallback (share of the
        nodes, where no axis of enough quality would do): means over the cases.
    """
    rows = []
    for case in cases:
        for name, axes in properties.items():
            accelerator = ProjectedBvh.published(case.area, axes=axes)
            scene = Scene(case.mesh, accelerator, device="cpu")
            counted = analyse(scene, case.area, case.rays(rays)).passing.cost
            tried, fallback = axis_tries(scene)
            rows.append({"name": name, "cost": counted, "tried": tried, "fallback": fallback})
    means = {figure: average(rows, figure, "name") for figure in ("cost", "tried", "fallback")}
    return [
        {"name": name, "least_quality": axes.least_quality, "acceptable": axes.acceptable, "excellent": axes.excellent}
        | {figure: values[(name,)] for figure, values in means.items()}
        for name, axes in properties.items()
    ]


def axis_tries(scene: Scene) -> tuple[float, float]:
    """Axes tried a node of the binary tree, and share of the nodes whose choice fell back on the longest side.

    Args:
        scene: built with a `wrt.known_rays.ProjectedBvh`; its tree is built again.
    """
    triangles = triangle_boxes(scene.state.device_mesh.vertices, scene.state.device_mesh.faces, scene.center)
    builder = ProjectedBuilder(triangles, scene.accelerator.config(scene.tree.width))
    builder.build()
    tried = builder.rays.tried.numpy()
    tried = tried[tried > 0]
    axes = sum((tried >> axis & 1).mean() for axis in range(3)) if len(tried) else 0.0
    return float(axes), float((tried & USED_FALLBACK > 0).mean()) if len(tried) else 0.0


def memory(cases: Iterable[Case], counts: Sequence[int] = (1, 20), depth: int = 4) -> list[Row]:
    """Bytes of the whole scene's tree, of the areas' trees and of the octree that finds them; triangle records are left out.

    Args:
        cases: scenes; one area is the case's own, more are random ones in the scene's box.
        counts: numbers of areas.
        depth: levels of the octree below its root.

    Returns:
        A row for each case and count: scene, triangles, areas, whole, local, top (bytes), ratio (of all to the whole's).
    """
    rows = []
    for case in cases:
        low, high = case.mesh.bounds
        for count in counts:
            areas = [case.area] if count == 1 else [stretched(area, low, high) for area in random_areas(count)]
            scene = Scene(case.mesh, RayAwareBvh(areas=areas, top_level="octree", depth=depth), device="cpu")
            whole, top = scene.tree.bytes, scene.state.area_trees.top.bytes
            local = scene.state.area_trees.bytes - top
            row = {"scene": case.scene, "triangles": case.mesh.triangle_count, "areas": count}
            rows.append(row | {"whole": whole, "local": local, "top": top, "ratio": (whole + local + top) / whole})
    return rows


def stretched(area: InfluenceArea, low: np.ndarray, high: np.ndarray) -> InfluenceArea:
    """An area of the unit cube, moved and scaled to a box by its greatest side."""
    size = float(np.max(high - low))
    changes = {"position": low + np.array(area.position) * (high - low)}
    lengths = ("width", "height", "depth") if isinstance(area, PlaneInfluenceArea) else ("near", "far")
    return replace(area, **changes, **{name: size * getattr(area, name) for name in lengths})


def half_window(area: InfluenceArea) -> np.ndarray:
    """(2,) half the width and height of an area's window: of a point area, at depth 1."""
    return np.array((area.width / 2, area.height / 2) if isinstance(area, PlaneInfluenceArea) else area.tangents)


def outlines(found: TreeAnalysis, area: InfluenceArea, level: int) -> np.ndarray:
    """(N, 2, 2) segments in the plane of the area's window: the edges of all boxes at a level, all of them in front of it."""
    boxes = found.boxes
    here = boxes.level == level
    corners = np.array([np.where([k & 1, k & 2, k & 4], boxes.high[here], boxes.low[here]) for k in range(8)])
    ends = [(k, k | bit) for k in range(8) for bit in (1, 2, 4) if not k & bit]
    seen = (corners - np.array(area.position)) @ area.frame.T
    across = seen[..., :2] if isinstance(area, PlaneInfluenceArea) else seen[..., :2] / seen[..., 2:]
    return np.concatenate([across[list(pair)].transpose(1, 0, 2) for pair in ends])


def picture(case: Case, size: int = 200) -> np.ndarray:
    """(size, size) how much surfaces face the rays, from 0 to 1, as the area's window shows them; NaN where nothing is."""
    area = case.area
    x, y = np.meshgrid(*2 * [(np.arange(size) + 0.5) / size * 2 - 1], indexing="xy")
    across = np.stack([x, -y], axis=-1) * half_window(area) @ area.frame[:2]
    if case.kind == "plane":
        origins = area.position + across
        rays = Rays(origins, np.broadcast_to(area.frame[2], origins.shape))
    else:
        rays = Rays(np.array(area.position), across + area.frame[2])
    hits = Scene(case.mesh, device="cpu").intersect(rays, traversal="single")
    unit = rays.directions / np.linalg.norm(rays.directions, axis=-1, keepdims=True)
    return np.where(hits.is_hit, np.abs((hits.normal * unit).sum(axis=-1)), np.nan)
