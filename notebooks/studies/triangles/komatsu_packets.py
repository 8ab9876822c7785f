"""Komatsu et al. 2008, what they left for later: bundles of shadow and of diffuse rays, with the precomputation counted.

A bundle shares its origin: the eye, or a point of the surface, from which rays go to samples of a lamp (shadow) or over the
hemisphere (diffuse). The proposed test and Plücker's precompute something of every triangle for every origin. For the eye
that is done once a picture, and the paper leaves it out of its times. For a point of the surface it is done for the rays of
that point alone.

    bundles       without a tree: time of a test, of the records of a triangle, and both together by the rays of an origin
    with_records  with a tree: rays of an origin from which on the engine's test of this kind pays

References: komatsu-2008.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np

from studies.triangles.isolated_tests import Beams, Soup, closest
from studies.triangles.komatsu_tables import CONTENDERS, LANES
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.core.workloads import WorkloadMaker, normalized
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import Record
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scenes import build

Row = dict[str, Any]

KINDS = ("camera", "shadow", "diffuse")

LAMP = 0.1
"""Edge of the square lamp, as a share of the scene's diagonal."""

PAIRS = 1 << 22
"""Pairs of a ray and a triangle in a call, about."""

SCENES: dict[str, Callable[[], TriangleMesh]] = {
    "teapot": lambda: build("teapot", level=24, ground=False),
    "stadium": lambda: build("teapot_in_stadium"),
    "atrium": lambda: build("atrium"),
    "wood": lambda: build("wood", trees=8),
}
"""Built-in scenes that stand for four of the paper's six models; the other two are its bunny and a smaller dragon."""

MODELS = {"bunny": "bunny.ply", "dragon": "dragon_res2.ply"}
"""Files of the Stanford models, where there is a folder with them."""


def scenes(models: Path | None) -> dict[str, TriangleMesh]:
    """The models that the folder has, and `SCENES`, by name."""
    files = {name: models / file for name, file in MODELS.items() if models is not None and (models / file).is_file()}
    found = {name: TriangleMesh.load(path) for name, path in files.items()}
    found |= {name: make() for name, make in SCENES.items()}
    return {name: TriangleMesh(mesh.vertices, mesh.faces, name=name) for name, mesh in found.items()}


def grid(count: int) -> np.ndarray:
    """(count, 2) midpoints of a square grid over the unit square, tile by tile of 2 x 2; count is a power of 4, at least 4."""
    edge = round(count**0.5)
    if edge * edge != count or edge % 2:
        raise ValueError(f"rays is {count}; it must be a power of 4, from 4 on")
    y, x = (np.arange(edge) + 0.5) / edge, (np.arange(edge) + 0.5) / edge
    points = np.stack(np.meshgrid(x, y), axis=-1)
    half = edge // 2
    return points.reshape(half, 2, half, 2, 2).transpose(0, 2, 1, 3, 4).reshape(count, 2)


def frame_at(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to each of (N, 3) unit vectors, and to each other."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    across = normalized(np.cross(normals, helper))
    return across, np.cross(normals, across)


def bundles_of(mesh: TriangleMesh, kind: str, rays: int, points: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Bundles: an origin (3,) and its directions (rays, 3).

    Args:
        mesh: any.
        kind: "camera": one eye, `rays` of its rays in the middle of a view; "shadow": visible points and samples of a square
            lamp; "diffuse": the same points and directions distributed by the cosine law.
        rays: of a bundle, a power of 4, at least 4.
        points: bundles; one for the camera.
    """
    maker = WorkloadMaker(mesh, size=64)
    square = grid(rays)
    if kind == "camera":
        view = maker.view("far")
        middle = mesh.center - view.origins[0]
        across, up = (axis[0] for axis in frame_at(normalized(middle[None])))
        directions = middle + 0.25 * mesh.extent * ((square[:, :1] - 0.5) * across + (square[:, 1:] - 0.5) * up)
        return [(view.origins[0].astype(np.float64), directions)]
    places, normals = maker.visible
    chosen = np.linspace(0, len(places) - 1, points + 2).astype(int)[1:-1]
    found = []
    across, up = frame_at(normalized(normals[chosen]))
    for number, place in enumerate(places[chosen].astype(np.float64)):
        if kind == "shadow":
            lamp = maker.light + LAMP * mesh.extent * ((square[:, :1] - 0.5) * across[0] + (square[:, 1:] - 0.5) * up[0])
            found.append((place, lamp - place))
        else:
            radius, angle = np.sqrt(square[:, :1]), 2.0 * np.pi * square[:, 1:]
            above = np.sqrt(1.0 - square[:, :1]) * normalized(normals[chosen])[number]
            found.append((place, above + radius * (np.cos(angle) * across[number] + np.sin(angle) * up[number])))
    return found


def record_time(soup: Soup, record: Record, width: int, rounds: int) -> float:
    """Seconds to make the records of all triangles for an origin."""
    with use_threads(1):
        (timing,) = take_turns([Contender("", lambda: soup.pack(record, width), len(soup))], rounds, clock=thread_time).values()
    return timing.median


def bundles(
    mesh: TriangleMesh,
    kinds: Sequence[str] = KINDS,
    *,
    rays: int = 16,
    points: int = 4,
    width: int = LANES,
    rounds: int = 5,
    pairs: int = PAIRS,
) -> list[Row]:
    """The paper's tests on bundles without a tree.

    Args:
        mesh: any; its triangles are thinned evenly so that a call has about `pairs` pairs.
        kinds: of bundles.
        rays: of a bundle, a power of 4.
        points: bundles of a kind, each with records of its own.
        width: lanes, at most `rays`.
        rounds: turns.
        pairs: of a ray and a triangle in a call, about.

    Returns:
        A row for each kind and contender: kind, rays, contender, nanoseconds (a test), ratio (to Möller's), records
        (nanoseconds a triangle and origin; 0 if they do not depend on it), counted (nanoseconds a test with the records of
        each origin), ratio_counted, pays_from (rays of an origin from which on the test with its records is faster than
        Möller's; inf: never).
    """
    rows = []
    for kind in kinds:
        made = bundles_of(mesh, kind, rays, points)
        kept = max(1, min(mesh.triangle_count, pairs // (len(made) * rays)))
        chosen = np.linspace(0, mesh.triangle_count - 1, kept).astype(int)
        corners = mesh.vertices[mesh.faces[chosen]] - mesh.center
        soups = [Soup(corners, origin - mesh.center) for origin, _ in made]
        beams = [Beams((origin - mesh.center)[None], directions) for origin, directions in made]
        timings = timed_bundles(soups, beams, rays, width, rounds)
        tests = len(made) * rays * len(corners)
        reference = timings["Möller"]
        plain = 1e9 * reference.median / tests
        for name, timing in timings.items():
            own, record = 1e9 * timing.median / tests, CONTENDERS[name].record
            records = 1e9 * record_time(soups[0], record, width, rounds) / len(corners) if record.per_origin else 0.0
            row = {"kind": kind, "rays": rays, "contender": name, "nanoseconds": own, "ratio": timing.ratio_to(reference)}
            row |= {"records": records, "counted": own + records / rays, "ratio_counted": (own + records / rays) / plain}
            rows.append(row | {"pays_from": records / (plain - own) if own < plain else float("inf")})
    return rows


def timed_bundles(soups: list[Soup], beams: list[Beams], rays: int, width: int, rounds: int) -> Mapping[str, Timing]:
    """Time of all bundles by each of the paper's tests, records made beforehand."""

    def run_of(form: Any) -> Callable[[], list[Any]]:
        runs = [closest(form, soup, beam, frustum=rays, width=width) for soup, beam in zip(soups, beams, strict=True)]
        return lambda: [run() for run in runs]

    items = len(soups) * rays * len(soups[0])
    with use_threads(1):
        return take_turns(
            [Contender(name, run_of(form), items) for name, form in CONTENDERS.items()], rounds, clock=thread_time
        )


def with_records(mesh: TriangleMesh, kinds: Sequence[str] = KINDS, *, rays: int = 4096, rounds: int = 7) -> list[Row]:
    """The engine's test of this kind through a BVH in packets, for one bundle, beside Möller and Trumbore's.

    Returns:
        A row for each kind: kind, rays, ratio (time without records, to Möller and Trumbore's), records (time to make them,
        to the same), pays_from (rays of the origin; inf: never).
    """
    scene, rows = Scene(mesh, "bvh", device="cpu", num_threads=1), []
    for kind in kinds:
        ((origin, directions), *_) = bundles_of(mesh, kind, rays, 1)
        batch = Rays(np.broadcast_to(origin.astype(np.float32), directions.shape), directions.astype(np.float32))
        runs = []
        for name in ("moeller_trumbore", "komatsu"):
            plan = replace(scene.explain(batch, traversal="packet", triangle_test=name), culling="interval")
            runs.append(Contender(name, lambda plan=plan, batch=batch: scene.intersect(batch, traversal=plan).t, rays))
        soup = Soup(mesh.vertices[mesh.faces] - mesh.center, origin - mesh.center)
        pack = partial(soup.pack, TRIANGLE_TESTS["komatsu"].record, native_width(scene.device))
        runs.append(Contender("records", pack, rays))
        with use_threads(1):
            timings = take_turns(runs, rounds, clock=thread_time)
        plain = timings["moeller_trumbore"]
        ratio, records = timings["komatsu"].ratio_to(plain), timings["records"].ratio_to(plain)
        pays = rays * records / (1.0 - ratio) if ratio < 1.0 else float("inf")
        rows.append({"kind": kind, "rays": rays, "ratio": ratio, "records": records, "pays_from": pays})
    return rows
