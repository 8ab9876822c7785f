"""Verification of a scene: its answers on its own mesh and machine, compared with brute force in float64.

**Rays.** Random rays through the scene's box; rays aimed at vertices and at points on edges, where a test that is not
watertight loses hits; rays that graze a triangle almost in its plane. All start at float32 points relative to the scene's
centre, so that the scene and the reference trace the same rays.

**Reference.** Tests every triangle with the watertight test in float64 (`nearest64`), on the vertices as given.

**Faults.** The scene rounds to float32, and may answer as if a ray was shifted sideways by up to `TOLERANCE` of its reach
in the scene. Along the ray, the error has the same bound, plus `SLIVER_ERROR` L^2 / h, but at most L, on a triangle whose
length is L and height h as seen along the ray:

* a *false hit* is a hit whose point on the ray is farther than that from its triangle;
* a *miss* is a ray with no hit, or with one behind the reference's, if eight rays around it, shifted sideways by twice the
  tolerance, all hit something nearer. If they do not (at silhouettes and at the rims of holes), rounding may decide either
  way; these rays are counted as undecided.

If `occluded` contradicts `intersect`, that is a miss or a false hit, too. `contains` is compared with winding numbers
(`wrt.query.checks.inside_check`).

References: woop-2013.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wrt.engine.facts.query_kinds import ANY, CLOSEST, Query
from wrt.engine.rays.rays import Rays
from wrt.kernels.query.nearest64 import nearest_hits, vertex_rows
from wrt.kernels.runtime.launch import refuse_capture, use_threads
from wrt.kernels.validation import as_int
from wrt.meshes.mesh import TriangleMesh
from wrt.query.answers import closest_hits, ray_values
from wrt.query.checks.inside_check import InsideCheck, check_inside

if TYPE_CHECKING:
    from rich.console import Console

    from wrt.engine.facts.scene_state import SceneState

TOLERANCE = 2.0**-21
"""Largest accepted error, as a share of the ray's reach: eight roundings of half a unit in the last place."""

SLIVER_ERROR = 2.0**-22
"""A few units in the last place."""

MIN_SINE = 0.1
"""Sine of the angle between ray and triangle from which errors of t are measured: for smaller angles, they are unbounded."""

MIN_RELATIVE_SIDE = 2.0**-12
"""Longest side of a triangle, as a share of its distance from the centre that positions are relative to, below which
float32 resolves it with half of its 24 bits or fewer.
"""

MIN_EXTENT = 2.0**-34
"""Longest side of a mesh below which products of three lengths, such as an area times a distance, underflow the normal
range of float32, 2^-126, for triangles of a hundredth of that size.
"""

SLIVER = 1000.0
"""Ratio of length to height from which a triangle counts as a sliver."""

EXAMPLES = 5
"""Largest number of faults in a report."""

MISS, FALSE_HIT = "miss", "false hit"


@dataclass(frozen=True)
class Fault:
    """A wrong answer.

    Attributes:
        kind: "miss" or "false hit".
        origin, direction: the ray, in the scene's coordinates.
        triangle: the scene's answer, numbered through all meshes; -1 for none.
        expected: the reference's triangle; -1 for none.
        t, t_expected: distances of the two hits, in units of the direction's length; inf for none.
    """

    kind: str
    origin: tuple[float, ...]
    direction: tuple[float, ...]
    triangle: int
    expected: int
    t: float
    t_expected: float

    def __str__(self) -> str:
        found, wanted = ("nothing" if i < 0 else f"triangle {i} at t = {t!r}" for i, t in self._answers())
        return f"{self.kind}: {found} instead of {wanted}, origin {list(self.origin)}, direction {list(self.direction)}"

    def _answers(self) -> tuple[tuple[int, float], tuple[int, float]]:
        return (self.triangle, self.t), (self.expected, self.t_expected)


@dataclass(frozen=True)
class Verification:
    """The result of `Scene.verify`; `str()` formats it as a table.

    Attributes:
        rays: number of rays by kind: "random", "vertices", "edges", "grazing".
        hits: number of rays that hit, according to the reference, by kind.
        misses, false_hits: number of wrong answers, by kind.
        undecided: number of rays that rounding may decide either way, by kind.
        t_error: largest error of the distance to a hit, as a share of the ray's reach in the scene, among rays that hit the
            same triangle as in the reference at more than 6 degrees.
        mesh: counts of mesh defects: "open edges" (holes), "edges of more than two triangles", "duplicate triangles",
            "triangles without area", "slivers" (a thousand times as long as high), "triangles too small for where they are"
            (smaller than 1/4096 of their distance from the scene's centre, to which float32 positions are relative),
            "triangles of a mesh too small for float32" (less than 6e-11 across, where areas times distances underflow), and
            "vertices that no triangle uses" (which affect no answer).
        explained: number of faults at triangles with each defect.
        faults: the first few wrong answers.
        inside: of `Scene.contains`, with what that cannot answer on this mesh.
    """

    rays: dict[str, int]
    hits: dict[str, int]
    misses: dict[str, int]
    false_hits: dict[str, int]
    undecided: dict[str, int]
    t_error: float
    mesh: dict[str, int]
    explained: dict[str, int]
    faults: tuple[Fault, ...]
    inside: InsideCheck

    @property
    def ok(self) -> bool:
        """Whether no answer was wrong."""
        return not any((*self.misses.values(), *self.false_hits.values(), self.inside.wrong))

    def __str__(self) -> str:
        from io import StringIO

        from rich.console import Console

        console = Console(file=StringIO(), width=100, color_system=None)
        with console.capture() as capture:
            self.print(console)
        return "\n".join(line.rstrip() for line in capture.get().splitlines())

    def print(self, console: Console) -> None:
        """Prints the tables to a `rich.console.Console`."""
        from rich.table import Table

        table = Table("rays aimed at", title="Against brute force in float64", title_justify="left")
        for column in ("rays", "hit", "misses", "false hits", "undecided"):
            table.add_column(column, justify="right")
        columns = (self.rays, self.hits, self.misses, self.false_hits, self.undecided)
        for kind in self.rays:
            table.add_row(kind, *(f"{column[kind]:,}" for column in columns))
        console.print(table)
        console.print(f"largest error of a distance: {self.t_error:.2g} of the ray's reach in the scene", highlight=False)
        found = Table("in the mesh", title_justify="left")
        for column in ("number", "faults there"):
            found.add_column(column, justify="right")
        for sort, number in self.mesh.items():
            found.add_row(sort, f"{number:,}", f"{self.explained[sort]:,}")
        console.print(found)
        for fault in self.faults:
            console.print(str(fault), highlight=False, markup=False)
        for line in self.inside.lines():
            console.print(line, highlight=False, markup=False)
        right = "no answer of intersect and occluded is wrong" if self.inside.doubts else "no answer is wrong"
        console.print(right if self.ok else "answers are WRONG", highlight=False)


def verify(scene: SceneState, samples: int, seed: int) -> Verification:
    """Verifies a scene; see `wrt.Scene.verify`."""
    refuse_capture("verify", scene.device)
    samples, seed = as_int("samples", samples, len(KINDS)), as_int("seed", seed, 0)
    scene.require_whole("verify")
    joined = scene.flattened()
    vertices, faces = joined.vertices.astype(np.float64) - scene.center, joined.faces
    sizes = [samples // len(KINDS) + (number < samples % len(KINDS)) for number in range(len(KINDS))]
    rng = np.random.default_rng(seed)
    parts = [make(rng, vertices[faces], size) for make, size in zip(KINDS.values(), sizes, strict=True)]
    origins, directions = (np.concatenate(values).astype(np.float32) for values in zip(*parts, strict=True))
    origins, directions = origins.astype(np.float64), directions.astype(np.float64)
    with use_threads(scene.num_threads):
        check = Check(scene, vertices, faces, origins, directions)
        inside = check_inside(scene, joined, rng, samples, TOLERANCE)
    kind_of = np.repeat(np.arange(len(KINDS)), sizes)

    def by_kind(marked: np.ndarray) -> dict[str, int]:
        return dict(zip(KINDS, np.bincount(kind_of[marked], minlength=len(KINDS)).tolist(), strict=True))

    defects = triangle_defects(joined) | precision_defects(scene, joined)
    wrong = np.flatnonzero(check.missed | check.false)
    triangle = np.where(check.false, check.primitive, check.expected)[wrong]
    return Verification(
        rays=by_kind(np.ones(samples, dtype=bool)),
        hits=by_kind(check.expected >= 0),
        misses=by_kind(check.missed),
        false_hits=by_kind(check.false),
        undecided=by_kind(check.undecided),
        t_error=check.t_error(),
        mesh={defect: number for defect, (number, _) in defects.items()},
        explained={defect: int(marked[triangle[triangle >= 0]].sum()) for defect, (_, marked) in defects.items()},
        faults=tuple(check.fault(ray) for ray in wrong[:EXAMPLES]),
        inside=inside,
    )


class Check:
    """A scene's answers for rays relative to its centre, with the reference's.

    Attributes:
        primitive, t: (N,) the scene's answers.
        expected, t_expected: (N,) the reference's.
        missed, false, undecided: (N,) bool, as defined in the module's docstring.
    """

    def __init__(
        self, scene: SceneState, vertices: np.ndarray, faces: np.ndarray, origins: np.ndarray, directions: np.ndarray
    ) -> None:
        self.center, self.vertices, self.faces = scene.center, vertices, faces
        self.origins, self.directions = origins, directions
        rays = Rays(origins + scene.center, directions)
        hits = closest_hits(scene, rays, Query(CLOSEST))
        occluded = ray_values(scene, rays, Query(ANY))
        self.primitive, self.t = hits.batch.primitive.numpy(), hits.t.astype(np.float64)
        self.corners = vertex_rows(vertices, faces)
        self.expected, self.t_expected = nearest_hits(self.corners, origins, directions)
        low, high = vertices[faces].min(axis=(0, 1)), vertices[faces].max(axis=(0, 1))
        self.tolerance = TOLERANCE * np.maximum(np.abs(low - origins), np.abs(high - origins)).max(axis=1)
        self.lengths = np.linalg.norm(directions, axis=1)
        self.t_tolerance = self.tolerance + self.sliver_errors()
        self.false = self.off_their_triangles() | (occluded & (self.expected < 0) & ~hits.is_hit)
        found = np.flatnonzero(self.expected >= 0)
        nearest = self.t_expected[found] * self.lengths[found] + self.t_tolerance[found]
        behind = np.zeros(len(origins), dtype=bool)
        behind[found] = self.t[found] * self.lengths[found] > nearest
        suspects = np.flatnonzero(behind | ((self.expected >= 0) & ~occluded))
        self.missed, self.undecided = np.zeros(len(origins), dtype=bool), np.zeros(len(origins), dtype=bool)
        for ray in suspects.tolist():
            sure = self.is_covered(ray, self.t[ray] if occluded[ray] else np.inf)
            (self.missed if sure else self.undecided)[ray] = True

    def sliver_errors(self) -> np.ndarray:
        """(N,) additional error bound along the ray for hits on triangles that are slivers as seen from it; 0 for misses."""
        corners = self.vertices[self.faces[self.primitive]]
        edges = np.roll(corners, -1, axis=1) - corners
        longest = np.linalg.norm(edges, axis=2).max(axis=1)
        seen = np.abs((np.cross(edges[:, 0], edges[:, 1]) * self.directions).sum(axis=1))  # area by length, times two
        height = seen / np.maximum(longest * self.lengths, np.finfo(float).tiny)
        thin = longest * np.minimum(longest * SLIVER_ERROR, height) / np.maximum(height, np.finfo(float).tiny)
        return np.where(self.primitive >= 0, thin, 0.0)

    def off_their_triangles(self) -> np.ndarray:
        """(N,) bool: hits whose point is too far from their triangle."""
        import trimesh

        off, hit = np.zeros(len(self.t), dtype=bool), np.flatnonzero(self.primitive >= 0)
        if len(hit):
            points = self.origins[hit] + self.t[hit, None] * self.directions[hit]
            corners = self.vertices[self.faces[self.primitive[hit]]]
            # in units of each ray's tolerance, because trimesh takes small lengths for 0, whatever the mesh's size
            corners = (corners - points[:, None]) / self.t_tolerance[hit, None, None]
            nearest = trimesh.triangles.closest_point(corners, np.zeros_like(points))
            off[hit] = ~(np.linalg.norm(nearest, axis=1) <= 1.0)
        return off

    def is_covered(self, ray: int, t: float) -> bool:
        """Whether the eight rays around this one all hit something before `t`."""
        direction = self.directions[ray] / self.lengths[ray]
        across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
        across /= np.linalg.norm(across)
        angles = np.arange(8) * (np.pi / 4)
        around = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(direction, across)
        origins = self.origins[ray] + 2.0 * self.tolerance[ray] * around
        _, found = nearest_hits(self.corners, origins, np.tile(self.directions[ray], (8, 1)))
        return bool((found * self.lengths[ray] < t * self.lengths[ray] - self.t_tolerance[ray]).all())

    def t_error(self) -> float:
        """Largest error of the distance to a hit, as a share of the ray's reach, where it is measured."""
        same = np.flatnonzero((self.primitive == self.expected) & (self.primitive >= 0))
        a, b, c = self.vertices[self.faces[self.primitive[same]]].transpose(1, 0, 2)
        normals, directions = np.cross(b - a, c - a), self.directions[same]
        sizes = np.linalg.norm(normals, axis=1) * self.lengths[same]
        same = same[np.abs((normals * directions).sum(axis=1)) > MIN_SINE * sizes]
        errors = np.abs(self.t[same] - self.t_expected[same]) * self.lengths[same]
        return float((errors * TOLERANCE / self.tolerance[same]).max(initial=0.0))

    def fault(self, ray: int) -> Fault:
        """A wrong answer, for the report."""
        origin, direction = (self.origins[ray] + self.center).tolist(), self.directions[ray].tolist()
        kind = FALSE_HIT if self.false[ray] else MISS
        answer, expected = int(self.primitive[ray]), int(self.expected[ray])
        return Fault(kind, tuple(origin), tuple(direction), answer, expected, float(self.t[ray]), float(self.t_expected[ray]))


def nearest64(
    vertices: np.ndarray, faces: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hits at t >= 0 by brute force in float64, edges included: ((N,) triangle or -1, (N,) t or inf)."""
    return nearest_hits(vertex_rows(vertices, faces), origins, directions)


# -- rays --------------------------------------------------------------------------------------------------------------


def random_rays(rng: np.random.Generator, corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from in and around the box of the triangles (F, 3, 3) to points in it."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    size = (high - low).max()
    origins = rng.uniform(low - 0.5 * size, high + 0.5 * size, (count, 3))
    return origins, rng.uniform(low, high, (count, 3)) - origins


def rays_at_vertices(rng: np.random.Generator, corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays with such origins to corners of triangles."""
    return _aimed(rng, corners, count, 0.0)


def rays_at_edges(rng: np.random.Generator, corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays with such origins to points on edges."""
    return _aimed(rng, corners, count, rng.random((count, 1)))


def _aimed(
    rng: np.random.Generator, corners: np.ndarray, count: int, weight: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    origins = random_rays(rng, corners, count)[0].astype(np.float32).astype(np.float64)
    face, corner = rng.integers(0, len(corners), count), rng.integers(0, 3, count)
    a, b = corners[face, corner], corners[face, (corner + 1) % 3]
    return origins, a + weight * (b - a) - origins


def grazing_rays(rng: np.random.Generator, corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays to points of triangles, almost in their planes: at angles from 0.1 to 1e-6 radians."""
    a, b, c = corners[rng.integers(0, len(corners), count)].transpose(1, 0, 2)
    points = np.einsum("kn,kni->ni", rng.dirichlet((1, 1, 1), count).T, np.stack([a, b, c]))
    size = (corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max()
    unit = [edge / np.maximum(np.abs(edge).max(axis=1, keepdims=True), np.finfo(float).tiny) for edge in (b - a, c - a)]
    normals = np.cross(*unit)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    along = unit[0] * rng.uniform(-1, 1, (count, 1)) + unit[1] * rng.uniform(-1, 1, (count, 1))
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    directions = along + normals * 10.0 ** rng.uniform(-6, -1, (count, 1)) * rng.choice([-1.0, 1.0], (count, 1))
    return points - size * rng.uniform(0.1, 1.5, (count, 1)) * directions, directions


KINDS = {"random": random_rays, "vertices": rays_at_vertices, "edges": rays_at_edges, "grazing": grazing_rays}


# -- the mesh ----------------------------------------------------------------------------------------------------------


def triangle_defects(mesh: TriangleMesh) -> dict[str, tuple[int, np.ndarray]]:
    """Mesh defects by position, as in `TriangleMesh.summary`: their number, and (F,) bool which triangles have them."""
    from trimesh.grouping import hashable_rows

    surface = mesh.welded().to_trimesh()
    _, edge, uses = np.unique(hashable_rows(surface.edges_sorted), return_inverse=True, return_counts=True)
    uses_of_edges = uses[edge].reshape(-1, 3)
    _, same, copies = np.unique(hashable_rows(np.sort(surface.faces, axis=1)), return_inverse=True, return_counts=True)
    repeated = copies[same] > 1
    flat = ~mesh.face_normals.any(axis=1)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    scale = np.maximum(longest, np.finfo(float).tiny)
    edges = (corners[:, 1:] - corners[:, :1]) / scale[:, None, None]
    slivers = (np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) * SLIVER < 1.0) & ~flat
    return {
        "open edges": (int((uses == 1).sum()), (uses_of_edges == 1).any(axis=1)),
        "edges of more than two triangles": (int((uses > 2).sum()), (uses_of_edges > 2).any(axis=1)),
        "duplicate triangles": (int((copies - 1).sum()), repeated),
        "triangles without area": (int(flat.sum()), flat),
        "slivers": (int(slivers.sum()), slivers),
    }


def precision_defects(scene: SceneState, joined: TriangleMesh) -> dict[str, tuple[int, np.ndarray]]:
    """Triangles that float32 resolves badly: their number, and (F,) bool which ones; and unused vertices, which mark none."""
    lost, tiny = [], []
    for part in scene.parts:
        own = len(lost)
        for mesh in part.meshes:
            corners = mesh.vertices[mesh.faces].astype(np.float64) - part.center
            longest = np.abs(corners - np.roll(corners, 1, axis=1)).max(axis=(1, 2))
            lost.append((longest < MIN_RELATIVE_SIDE * np.abs(corners).max(axis=(1, 2))) & (longest > 0.0))
        extent = np.ptp(part.bounds, axis=0).max()
        tiny += [np.full(len(mask), 0.0 < extent < MIN_EXTENT) for mask in lost[own:]]
    if scene.instances:
        lost, tiny = ([masks[number] for number in scene.geometry_ids] for masks in (lost, tiny))
    unresolved = {
        "triangles too small for where they are": np.concatenate(lost),
        "triangles of a mesh too small for float32": np.concatenate(tiny),
    }
    unused = sum(int((~mesh.referenced).sum()) for mesh in scene.meshes)
    found = {name: (int(mask.sum()), mask) for name, mask in unresolved.items()}
    return found | {"vertices that no triangle uses": (unused, np.zeros(joined.triangle_count, dtype=bool))}
