"""Scenes, influence areas and trees of the experiments on known rays: those of Falcone 2024, with scenes that are built in.

The thesis has random triangles, a low-poly head (Suzanne), a cottage, the walls of it, a wood, a crowd, and Sponza (here: the
palace). Each is seen by parallel and by radial rays, four ways: along an axis, turned from it by 15 and by 45
degrees in a plane of two axes, and oblique to all.

References: falcone-2024 (sections 6.1, 6.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import cos, degrees, radians, sin

import numpy as np

from studies.known_rays.ray_scenes import head, palace
from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea, PointInfluenceArea, frame_of
from wrt.engine.rays.rays import Rays
from wrt.known_rays.influence_areas import corners_of
from wrt.known_rays.ray_casters import PlaneCaster
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes import build
from wrt.scenes.shapes import boxes, copies, lathe, sheets

COVERED = {"walls": (0.35, 0.35), "wood": (0.45, 0.45), "palace": (0.15, 0.6)}
"""Shares of the scene's width and height, as seen along the rays, that the window of an area shows; 0.9 of others."""

AWAY = {"palace": 0.13}
"""Distance of an area's window, or apex, from the middle of the scene, in radii of the scene's sphere: within the court of the
palace; 1.5 of others."""

DIRECTIONS = {
    "parallel": (0.0, 1.0, 0.0),
    "15 degrees": (sin(radians(15.0)), cos(radians(15.0)), 0.0),
    "45 degrees": (1.0, 1.0, 0.0),
    "oblique": (0.6, 1.0, -0.5),
}
"""Of the middle ray, by the thesis' names."""

KINDS = ("plane", "point")


def cottage() -> TriangleMesh:
    """A house of 10 x 8 m with three barred windows in front and a gabled roof: a few large triangles, and many small ones."""
    jambs = [0.0, 1.3, 2.7, 4.3, 5.7, 7.3, 8.7, 10.0]
    parts = [boxes((x, 0.2, 0.0), (x + 0.2, 7.8, 3.0)) for x in (0.0, 9.8)]
    parts.append(boxes((0.0, 7.8, 0.0), (10.0, 8.0, 3.0)))
    for number, (left, right) in enumerate(pairwise(jambs)):
        heights = [(0.0, 0.8), (2.2, 3.0)] if number % 2 else [(0.0, 3.0)]  # below and above a window, or a pier
        parts += [boxes((left, 0.0, low), (right, 0.2, high)) for low, high in heights]
    for x in jambs[1::2]:
        for bar in np.linspace(0.0, 1.36, 8):
            parts.append(boxes((x + bar, 0.08, 0.8), (x + bar + 0.04, 0.12, 2.2)))
            parts.append(boxes((x, 0.08, 0.8 + bar), (x + 1.4, 0.12, 0.84 + bar)))
    for lower, upper in (((-0.5, 2.8), (4.0, 5.5)), ((4.0, 5.5), (8.5, 2.8))):
        parts.append(sheets(np.array([[(x, y, z) for x in (-0.5, 10.5)] for y, z in (lower, upper)])))
    return TriangleMesh.concatenate(parts, name="cottage")


def crowd(people: int = 24, segments: int = 10, seed: int = 0) -> TriangleMesh:
    """Standing figures, turned from solids of revolution, in a jittered block of rows.

    Args:
        people: how many, at least 1.
        segments: corners of each circle, at least 3.
        seed: the same seed gives the same crowd.
    """
    coat = [(0.16, 0.75), (0.2, 0.95), (0.17, 1.15), (0.22, 1.4), (0.12, 1.5), (0.06, 1.53)]
    head = [(0.06, 1.53), (0.1, 1.6), (0.11, 1.68), (0.08, 1.77), (0.0, 1.8)]
    limb = np.array([(0.05, 0.0), (0.07, 0.1), (0.06, 0.4), (0.09, 0.8)])
    legs = copies(lathe(limb, segments), [(-0.09, 0.0, 0.0), (0.09, 0.0, 0.0)])
    arms = copies(lathe(limb * (0.7, 0.8), segments), [(-0.28, 0.0, 0.8), (0.28, 0.0, 0.8)])
    figure = TriangleMesh.concatenate([lathe(coat, segments), lathe(head, segments), legs, arms])
    random = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(people)))
    places = np.stack(np.divmod(np.arange(people), side), axis=1)[:, ::-1] * 0.9 + random.uniform(-0.2, 0.2, (people, 2))
    turned = []
    for x, y in places:
        angle, size = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.9, 1.1)
        turn = size * np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        turned.append(TriangleMesh(figure.vertices @ turn.T + (x, y, 0.0), figure.faces))
    return TriangleMesh.concatenate(turned, name="crowd")


SCENES: dict[str, Callable[[], TriangleMesh]] = {
    "random 100": lambda: build("random_triangles", count=100, size=0.25),
    "random 1000": lambda: build("random_triangles", count=1000, size=0.15),
    "head": head,
    "cottage": cottage,
    "walls": cottage,
    "wood": lambda: build("wood", trees=5, leaves=1),
    "crowd": crowd,
    "palace": palace,
}
"""By the thesis' names, but for Suzanne and Sponza. Of the walls, areas show a part that all rays hit."""


@dataclass(frozen=True)
class Case:
    """A scene seen from an influence area.

    Attributes:
        scene: key in `SCENES`.
        mesh: its triangles.
        kind: "plane" or "point".
        way: key in `DIRECTIONS`.
    """

    scene: str
    mesh: TriangleMesh
    kind: str
    way: str

    @cached_property
    def area(self) -> InfluenceArea:
        """What shows most of the scene, or `COVERED` of it."""
        corners = corners_of(self.mesh.bounds)
        direction, center, radius = DIRECTIONS[self.way], self.mesh.center, self.mesh.extent / 2
        seen = (corners - center) @ frame_of(direction, (0.0, 0.0, 1.0)).T
        half = np.array(COVERED.get(self.scene, (0.9, 0.9))) * np.abs(seen[:, :2]).max(axis=0)
        forward = np.array(direction) / np.linalg.norm(direction)
        away = AWAY.get(self.scene, 1.5) * radius
        place = {"position": center - away * forward, "direction": direction, "up": (0.0, 0.0, 1.0)}
        if self.kind == "plane":
            return PlaneInfluenceArea(**place, width=2 * half[0], height=2 * half[1], depth=3 * radius)
        fov = [2.0 * degrees(np.arctan(size / away)) for size in half]
        return PointInfluenceArea(**place, fov=fov, near=0.01 * radius, far=3 * radius)

    def rays(self, count: int, seed: int = 0) -> Rays:
        """So many of the area's rays, evenly over its window; of a point area, from its near plane on."""
        if self.kind == "plane":
            return PlaneCaster.of(self.area).rays(count, seed)
        even = PlaneCaster(position=(0, 0, 0), direction=(0, 0, 1), up=(0, 1, 0), width=2, height=2).rays(count, seed)
        across = even.origins[:, :2] * self.area.tangents * (-1.0, 1.0)
        return Rays(np.array([self.area.position]), np.c_[across, np.ones(count)] @ self.area.frame, self.area.near)


def cases(
    scenes: Sequence[str] = tuple(SCENES), kinds: Sequence[str] = KINDS, ways: Sequence[str] = tuple(DIRECTIONS)
) -> Iterator[Case]:
    """Every scene from every area."""
    for scene in scenes:
        mesh = SCENES[scene]()
        yield from (Case(scene, mesh, kind, way) for kind in kinds for way in ways)


TREES: dict[str, Callable[[InfluenceArea], ProjectedBvh]] = {
    "SAH + LSPH": lambda area: ProjectedBvh.published(area, cost="sah", axes="longest"),
    "SAH + SPFH": lambda area: ProjectedBvh.published(area, cost="sah", axes="facing"),
    "PAH + LSPH": lambda area: ProjectedBvh.published(area, axes="longest"),
    "PAH + SPFH": lambda area: ProjectedBvh.published(area),
    "SAH, all axes": lambda area: ProjectedBvh.published(area, cost="sah", axes="all"),
    "PAH, all axes": lambda area: ProjectedBvh.published(area, axes="all"),
}
"""By the thesis' names: surface area and projected area heuristic; longest and facing axes. The last two are not in it."""
