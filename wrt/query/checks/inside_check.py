"""`Scene.contains` compared with winding numbers, and what it cannot answer on a mesh.

`contains` counts crossings of a ray, or sums their signs; the reference sums the solid angles of all triangles in float64,
seen from a point (`winding_numbers`). The sum is a whole number where the surface is closed and faces one way. A point is then
inside, by each rule of `contains`, if the number is odd, positive, or not zero. Triangles that repeat an earlier one, the same
side in front, are left out, unless the sums are whole numbers only with them.

**What nobody can tell.** Where a surface has holes, or triangles that are turned over, the sum is no whole number, and three
rays may disagree: answers there are compared, too, but a difference is a doubt and no fault. A triangle that occurs with both
sides in front counts twice, as it must where two bodies touch, and cancels where a sheet was meant. In several bodies at a
time, a point is inside by parity if their number is odd. `InsideCheck.doubts` names what of this a mesh has.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wrt.kernels.query.nearest64 import vertex_rows, winding_numbers
from wrt.meshes.mesh_measures import first_of_equal_points
from wrt.query.inside import PARITY, RULES, contains

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.meshes.mesh import TriangleMesh

MAX_PAIRS = 20_000_000
"""Pairs of a point and a triangle for which winding numbers are computed."""

FEWEST_POINTS = 16

WHOLE = 1e-6
"""Largest distance of a sum of solid angles from the whole number that it stands for."""


@dataclass(frozen=True)
class InsideCheck:
    """The result of the comparison, of points at random in the box of all triangles.

    Attributes:
        points: number of points; 0 if the scene does not answer `contains`.
        wrong: answers, by any rule, that contradict a winding number that is a whole number, on a closed surface.
        near: of these contradictions, points that are within rounding of a triangle; they are not in `wrong`.
        unsure: answers that differ from a winding number, rounded, where the surface is open or triangles are turned over.
        doubts: what `contains` cannot answer on this mesh, or takes in one of two ways, a sentence each.
    """

    points: int
    wrong: int
    near: int
    unsure: int
    doubts: tuple[str, ...]

    def lines(self) -> list[str]:
        """The result in words."""
        counts = f"{self.wrong:,} wrong, {self.near:,} undecided, {self.unsure:,} where the mesh has no inside"
        found = (
            [f"contains: {self.points:,} points, by {len(RULES)} rules, against winding numbers, {counts}"]
            if self.points
            else []
        )
        return found + [f"contains: {doubt}" for doubt in self.doubts]


def check_inside(
    scene: SceneState, joined: TriangleMesh, rng: np.random.Generator, samples: int, tolerance: float
) -> InsideCheck:
    """Compares `Scene.contains` with winding numbers.

    Args:
        scene: the scene.
        joined: all its triangles, as `flattened`.
        rng: where points come from.
        samples: most points; fewer if there are many triangles (`MAX_PAIRS`).
        tolerance: distance from a triangle within which a point may be on either side, as a share of the scene's extent.
    """
    corners = joined.vertices[joined.faces].astype(np.float64) - scene.center
    whole, distinct = surfaces(joined)
    if any(one.mask == 0 or one.environment >= 0 for one in scene.instances):
        return InsideCheck(0, 0, 0, 0, ("not compared, as instances are masked or in environments", *distinct.doubts()))
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    count = min(samples, max(FEWEST_POINTS, MAX_PAIRS // len(corners)))
    points = rng.uniform(low, high, (count, 3)).astype(np.float32).astype(np.float64)
    try:
        answers = {rule: contains(scene, points + scene.center, rule=rule) for rule in RULES}
    except ValueError as refusal:
        return InsideCheck(0, 0, 0, 0, (f"not compared: {refusal}", *distinct.doubts()))
    vertices = joined.vertices.astype(np.float64) - scene.center
    surface, turns = distinct, winding_numbers(vertex_rows(vertices, joined.faces[distinct.kept]), points)
    if len(whole.kept) > len(distinct.kept):
        with_repeated = winding_numbers(vertex_rows(vertices, joined.faces[whole.kept]), points)
        if are_whole(with_repeated).sum() > are_whole(turns).sum():
            surface, turns = whole, with_repeated
    doubts, nearest, is_whole = surface.doubts(), np.rint(turns), are_whole(turns)
    expected = {PARITY: nearest % 2 == 1, "winding": nearest != 0, "union": nearest > 0}
    differs = np.stack([answers[rule] != expected[rule] for rule in RULES])
    unsure = differs & ~(is_whole & (surface.odd_edges == 0))
    suspects = np.nonzero(differs & ~unsure)[1]
    near = np.array([is_near(point, corners, tolerance * (high - low).max()) for point in points[suspects]], dtype=bool)
    if surface.odd_edges == 0 and not is_whole.all():
        doubts.append(f"triangles are turned over: {(~is_whole).sum():,} winding numbers are no whole numbers")
    if several := (np.abs(nearest) > 1).sum():
        doubts.append(f"{several:,} points are in several bodies; by parity they count as inside if the number of these is odd")
    return InsideCheck(count, int((~near).sum()), int(near.sum()), int(unsure.sum()), tuple(doubts))


def are_whole(turns: np.ndarray) -> np.ndarray:
    """(N,) bool: winding numbers that are whole numbers."""
    return np.abs(turns - np.rint(turns)) < WHOLE


@dataclass(frozen=True)
class Surface:
    """Triangles of a mesh that have an area, by the positions of their corners.

    Attributes:
        kept: their numbers.
        both_sides: number of triangles that repeat another one turned over.
        odd_edges: number of edges of an odd number of the triangles: holes.
    """

    kept: np.ndarray
    both_sides: int
    odd_edges: int

    def doubts(self) -> list[str]:
        """What a parity cannot answer on this surface, or answers in one of two ways."""
        found = []
        if self.odd_edges:
            found.append(
                f"{self.odd_edges:,} edges have an odd number of triangles: near holes, the majority of three rays decides"
            )
        if self.both_sides:
            found.append(f"{self.both_sides:,} triangles repeat another one turned over: both count, as where two bodies touch")
        return found


def surfaces(mesh: TriangleMesh) -> tuple[Surface, Surface]:
    """All triangles of a mesh, and those that repeat no earlier one with the same side in front."""
    corners = first_of_equal_points(mesh.vertices)[mesh.faces]
    proper = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    turn = (corners[proper].argmin(axis=1)[:, None] + np.arange(3)) % 3
    rows = np.take_along_axis(corners[proper], turn, axis=1)
    first = np.sort(np.unique(rows, axis=0, return_index=True)[1])
    both_sides = len(first) - len(np.unique(np.sort(rows, axis=1), axis=0))
    return (
        Surface(proper, both_sides, odd_edges(rows)),
        Surface(proper[first], both_sides, odd_edges(rows[first])),
    )


def odd_edges(corners: np.ndarray) -> int:
    """Number of edges of an odd number of the triangles (F, 3)."""
    ordered = np.sort(corners, axis=1)
    edges = np.concatenate([ordered[:, [0, 1]], ordered[:, [1, 2]], ordered[:, [0, 2]]])
    return int((np.unique(edges, axis=0, return_counts=True)[1] % 2).sum())


def is_near(point: np.ndarray, corners: np.ndarray, distance: float) -> bool:
    """Whether a point is within a distance of one of the triangles (F, 3, 3)."""
    import trimesh

    around = (corners.min(axis=1) - distance <= point) & (point <= corners.max(axis=1) + distance)
    # in units of the distance, because trimesh takes small lengths for 0
    close = (corners[around.all(axis=1)] - point) / max(distance, np.finfo(float).tiny)
    nearest = trimesh.triangles.closest_point(close, np.zeros((len(close), 3))) if len(close) else np.full((1, 3), np.inf)
    return bool((np.linalg.norm(nearest, axis=1) <= 1.0).any())
