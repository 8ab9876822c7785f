"""More of the experiments of Falcone 2024: what a coarse octree costs, queues and stacks, how many axes are tried.

    octree_levels   Table 6.1: cost of the areas' trees if an octree's leaf decides on the area, by the octree's levels
    walk_orders     section 5.1.2: counts with a queue, as in Algorithm 5.2, and with stacks
    cap_errors      section 6.2.1: error of estimates for rays that are uniform over a part of the sphere
    axes_tried      section 6.2.4: splitting planes' axes tried a node, by SPFH (thesis: 2.1) and by LSPH (1.5)

Each returns a list of plain dicts; see `studies.known_rays.ray_distribution` for scenes, trees and costs.

References: falcone-2024.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import warp as wp

from studies.known_rays.ray_cases import Case
from studies.known_rays.ray_distribution import REFERENCE, axis_tries, random_areas, scene_of, stretched
from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders.bvh.bvh_statistics import unpack
from wrt.builders.bvh.phases.split_axes import AxisChoice
from wrt.builders.influence.area_top_level import region_of
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea
from wrt.builders.influence.regions import contain_points
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.classics.studies.walk_orders import EMPTY, INNER, LEAF, ORDERS, Lanes, Walked, make_kernel
from wrt.kernels.runtime.launch import launch
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import pack_blocks
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks
from wrt.known_rays.ray_casters import CircularCapCaster, SquareCapCaster
from wrt.known_rays.tree_analysis import BOX_COST, TRIANGLE_COST, analyse
from wrt.scene.scene import Scene, scene_of_state

Row = dict[str, Any]

LSPH_QUALITY = 0.99
"""Least quality of an axis that the thesis gives LSPH."""


def aimed_rays(areas: Sequence[InfluenceArea], bounds: np.ndarray, count: int, seed: int) -> tuple[Rays, np.ndarray]:
    """Rays from random points of a box, each along the rays of a random area there; and (count,) those areas."""
    random = np.random.default_rng(seed)
    points = random.uniform(*bounds, (count, 3))
    chosen = random.integers(0, len(areas), count)
    directions = np.empty((count, 3))
    for number, area in enumerate(areas):
        own = chosen == number
        parallel = isinstance(area, PlaneInfluenceArea)
        directions[own] = area.frame[2] if parallel else points[own] - np.array(area.position)
    return Rays(points, directions), chosen


def octree_levels(
    scenes: Iterable[Case], depths: Sequence[int] = (3, 4, 5), *, areas: int = 20, rays: int = 4096, seed: int = 0
) -> list[Row]:
    """Table 6.1, as in the thesis: a ray goes to its area's tree if the octree's leaf around its origin lists the area.

    The engine tests the region besides, and searches no area in vain: the last row of a scene, whose depth is None.

    Args:
        scenes: one case of each scene; its area is not used.
        depths: levels of the octree below its root.
        areas: random areas, stretched to the scene's box.
        rays: how many, before those are left out that no leaf sends to their area.
        seed: of the rays.

    Returns:
        A row for each scene and depth: scene, depth, sent (rays that go to their area's tree), strangers (share of them that
        do not begin in the area), local (cost in the area's tree), fallback (cost with the search of the whole scene's tree
        after a miss), missed (share that has such a search).
    """
    rows = []
    for case in scenes:
        mesh, whole = case.mesh, Bvh(width=2, max_leaf_triangles=2)
        stretched_areas = [stretched(area, *mesh.bounds) for area in random_areas(areas, seed)]
        cast, chosen = aimed_rays(stretched_areas, mesh.bounds, rays, seed)
        inside = contain_points([region_of(area, *mesh.bounds) for area in stretched_areas], cast.origins)
        inside = inside[np.arange(rays), chosen]
        local = ProjectedBvh.published(stretched_areas[0])
        for depth in (*depths, None):
            accelerator = RayAwareBvh(areas=stretched_areas, whole=whole, local=local, top_level="octree", depth=depth or 1)
            scene = Scene(mesh, accelerator, device="cpu", num_threads=1)
            trees, sent = scene.state.area_trees, inside
            if depth is not None:
                listed = trees.top.candidates(cast.origins)
                places = {number: place for place, number in enumerate(trees.numbers)}
                sent = np.array([n in places and listed[i, places[n]] for i, n in enumerate(chosen.tolist())])
            row = {"scene": case.scene, "depth": depth, "sent": int(sent.sum())}
            row |= {"strangers": float(1.0 - inside[sent].mean())} | costs_of(scene, cast, chosen, sent)
            rest = Rays(cast.origins[~sent], cast.directions[~sent])
            elsewhere = total_cost(scene_of_state(scene.state.over(scene.tree)), rest) if len(rest) else 0.0
            rows.append(row | {"all": (row["fallback"] * row["sent"] + elsewhere) / rays})
    return rows


def costs_of(scene: Scene, cast: Rays, chosen: np.ndarray, sent: np.ndarray) -> Row:
    """Costs of the rays that are sent to their area's trees, an average over them: local, fallback, missed."""
    local, missing = 0.0, np.zeros(len(sent), dtype=bool)
    for number, state in zip(scene.state.area_trees.numbers, scene.state.area_trees.scenes, strict=True):
        own = np.flatnonzero(sent & (chosen == number))
        if len(own):
            part, rays = scene_of_state(state), Rays(cast.origins[own], cast.directions[own])
            local += total_cost(part, rays)
            missing[own] = ~part.intersect(rays).is_hit
    whole = scene_of_state(scene.state.over(scene.tree))
    again = total_cost(whole, Rays(cast.origins[missing], cast.directions[missing])) if missing.any() else 0.0
    count = max(int(sent.sum()), 1)
    return {"local": local / count, "fallback": (local + again) / count, "missed": float(missing[sent].mean())}


def total_cost(scene: Scene, rays: Rays) -> float:
    """Counted cost of all rays, each up to its closest hit."""
    stopping = analyse(scene, None, rays).stopping
    return stopping.cost * stopping.rays


def lanes_of(scene: Scene) -> Lanes:
    """The children of a scene's nodes, lane by lane."""
    flat, width = unpack(scene.tree), scene.tree.width
    lanes = Lanes()
    kinds = np.where(flat.is_leaf, LEAF, np.where(flat.is_inner, INNER, EMPTY))
    first = np.where(flat.is_leaf, flat.first_block * width, flat.child)
    for name, values in (("kind", kinds), ("first", first), ("count", flat.triangles)):
        setattr(lanes, name, wp.array(values.ravel().astype(np.int32), dtype=int, device="cpu"))
    for name in ("low", "high"):
        setattr(lanes, name, wp.array(getattr(flat, name).reshape(-1, 3), dtype=wp.vec3, device="cpu"))
    return lanes


def walk(scene: Scene, rays: Rays, order: str, *, stops: bool = True) -> np.ndarray:
    """(rays,) structured counts of walking a scene's BVH (`wrt.kernels.classics.studies.walk_orders`).

    Args:
        scene: with a BVH, on the CPU.
        rays: rays.
        order: "queue", "stack" or "sorted".
        stops: whether what lies behind the closest hit is left out.
    """
    test, mesh = TRIANGLE_TESTS["woop"], scene.state.device_mesh
    blocks: TriangleBlocks = pack_blocks(test.record, mesh.vertices, mesh.faces, scene.tree.primitive, scene.tree.width)
    buffers, lanes = to_device(rays, scene.device, scene.center), lanes_of(scene)
    waiting = wp.empty((buffers.count, lanes.kind.shape[0]), dtype=int, device="cpu")
    found = wp.empty(buffers.count, dtype=Walked, device="cpu")
    inputs = [lanes, blocks, scene.tree.low, scene.tree.high, buffers.batch, waiting, found]
    launch(make_kernel(order, scene.tree.width, test, stops), buffers.count, inputs, device=scene.device, chunk=64)
    return found.numpy()


def walk_orders(cases: Iterable[Case], trees: Sequence[str] = (REFERENCE, "PAH + SPFH"), *, rays: int = 1024) -> list[Row]:
    """Counts by the order of visits.

    Returns:
        A row for each case, tree and order: scene, kind, way, tree, order, cost (up to the closest hit), passing (without an
        end at hits), boxes, triangles (of the first), most (children that wait at a time, at most, mean over the rays).
    """
    rows = []
    for case in cases:
        cast = case.rays(rays)
        for tree in trees:
            scene = scene_of(case, tree)
            for order in ORDERS:
                found, through = (walk(scene, cast, order, stops=stops) for stops in (True, False))
                boxes, triangles = (found[name].mean() for name in ("boxes", "triangles"))
                row = {"scene": case.scene, "kind": case.kind, "way": case.way, "tree": tree, "order": order}
                row |= {"cost": BOX_COST * boxes + TRIANGLE_COST * triangles, "boxes": boxes, "triangles": triangles}
                passing = BOX_COST * through["boxes"].mean() + TRIANGLE_COST * through["triangles"].mean()
                rows.append(row | {"passing": float(passing), "most": float(found["most"].mean())})
    return rows


def axes_tried(cases: Iterable[Case]) -> list[Row]:
    """Axes that are tried in a node.

    Returns:
        A row for each case and way to choose: scene, kind, way, axes ("SPFH", "LSPH"), tried (a node, mean), fallback (share of
        nodes).
    """
    rows = []
    for case in cases:
        choices = {"SPFH": AxisChoice("facing"), "LSPH": AxisChoice("longest", least_quality=LSPH_QUALITY)}
        for name, axes in choices.items():
            accelerator = ProjectedBvh.published(case.area, axes=axes, cost="pah" if name == "SPFH" else "sah")
            tried, fallback = axis_tries(Scene(case.mesh, accelerator, device="cpu"))
            row = {"scene": case.scene, "kind": case.kind, "way": case.way, "axes": name}
            rows.append(row | {"tried": tried, "fallback": fallback})
    return rows


def cap_errors(points: Iterable[Case], *, rays: int = 1024) -> list[Row]:
    """Errors of PAH + SPFH for point areas whose rays are uniform over the sphere, as the thesis casts them.

    Args:
        points: cases with point areas.
        rays: of each.

    Returns:
        A row for each case and cap: scene, way, cap ("square": what the window shows; "circular": the cone inscribed in it),
        error (|counted cost - estimate| / estimate) of rays from the near plane on.
    """
    rows = []
    for case in points:
        area, scene = case.area, scene_of(case, "PAH + SPFH")
        cone = CircularCapCaster(position=area.position, direction=area.direction, angle=min(area.fov) / 2)
        for name, caster in (("square", SquareCapCaster.of(area)), ("circular", cone)):
            directions = caster.rays(rays).directions
            cast = Rays(np.array([area.position]), directions / (directions @ area.frame[2])[:, None], area.near)
            found = analyse(scene, area, cast)
            error = abs(found.passing.cost - found.expected_cost) / found.expected_cost
            rows.append({"scene": case.scene, "way": case.way, "cap": name, "error": error})
    return rows
