"""Distances and collisions of meshes by wrt beside FCL's, a library for robotics: the same bodies, in turns, on one thread.

FCL walks trees of oriented boxes in float64, on one thread; for many bodies, it has a tree of their boxes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.analysis.mesh_pairs import clearance, closest_pair, overlapping_triangles
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

CROWD = 64
"""Instances of the third question."""

TOLERANCE = 1e-9
"""Distances agree within this share of the diagonal."""

BUDGET = 5.0
"""Seconds for each contender and question."""

MAX_CONTACTS = 10_000_000
"""Pairs of triangles that FCL lists."""


@dataclass(frozen=True)
class PairRow:
    """Figures of a contender.

    Attributes:
        question: which one.
        engine: name of the contender.
        seconds: a call, of the median round.
        ratio: that over wrt's, the median of rounds.
        answer: a distance, or the number of pairs that meet.
        agrees: whether that is wrt's.
        error: why it failed; None if it did not.
    """

    question: str
    engine: str
    seconds: float | None
    ratio: float | None
    answer: float | None
    agrees: bool | None
    error: str | None = None


def placements(mesh: TriangleMesh, count: int, apart: float) -> list[np.ndarray]:
    """(4, 4) each: copies that are turned at random, on a cubic grid `apart` times the longest side of the mesh apart."""
    from trimesh.transformations import random_rotation_matrix

    rng, side, center = np.random.default_rng(1), math.ceil(count ** (1 / 3)), np.asarray(mesh.center, dtype=np.float64)
    made = []
    for number in range(count):
        matrix = random_rotation_matrix(rng.random(3))
        cell = np.array([number % side, number // side % side, number // side**2])
        matrix[:3, 3] = apart * mesh.extent * cell - matrix[:3, :3] @ center
        made.append(matrix)
    return made


def questions(mesh: TriangleMesh) -> dict[str, list[np.ndarray]]:
    """Placements of the bodies, by the name of the question."""
    return {
        "distance of two": placements(mesh, 2, 1.1),
        "triangles that meet": placements(mesh, 2, 0.3),
        f"nearest of {CROWD}": placements(mesh, CROWD, 1.2),
    }


def wrt_calls(mesh: TriangleMesh, placed: Sequence[np.ndarray]) -> list[Callable[[], float]]:
    """Distance of the first two, number of their triangles that meet, and least distance of all."""
    scene = Scene([Instance(mesh, matrix) for matrix in placed], "bvh", device="cpu", num_threads=1)
    return [
        lambda: closest_pair(scene, 0, 1).distance,
        lambda: float(len(overlapping_triangles(scene, 0, 1))),
        lambda: clearance(scene).distance,
    ]


def fcl_calls(mesh: TriangleMesh, placed: Sequence[np.ndarray]) -> list[Callable[[], float]]:
    """The same by FCL."""
    import fcl

    model = fcl.BVHModel()
    model.beginModel(mesh.vertex_count, mesh.triangle_count)
    model.addSubModel(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces))
    model.endModel()
    bodies = [fcl.CollisionObject(model, fcl.Transform(matrix[:3, :3], matrix[:3, 3])) for matrix in placed]
    manager = fcl.DynamicAABBTreeCollisionManager()
    manager.registerObjects(bodies)
    manager.setup()

    def meeting() -> float:
        request, found = fcl.CollisionRequest(num_max_contacts=MAX_CONTACTS, enable_contact=False), fcl.CollisionResult()
        return float(fcl.collide(bodies[0], bodies[1], request, found))

    def nearest() -> float:
        found = fcl.DistanceData()
        manager.distance(found, fcl.defaultDistanceCallback)
        return float(found.result.min_distance)

    return [lambda: float(fcl.distance(bodies[0], bodies[1], fcl.DistanceRequest(), fcl.DistanceResult())), meeting, nearest]


def compare_pairs(mesh: TriangleMesh, rounds: int, on_turn: Callable[[str], Any]) -> Iterator[PairRow]:
    """Times wrt and FCL, which must be installed, with each question.

    Args:
        mesh: of all bodies.
        rounds: of each contender.
        on_turn: told what is under way.
    """
    tolerance = TOLERANCE * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
    for number, (question, placed) in enumerate(questions(mesh).items()):
        on_turn(f"build {question}")
        made = {"wrt": wrt_calls(mesh, placed), "FCL": fcl_calls(mesh, placed)}
        contenders = [Contender(name, calls[number]) for name, calls in made.items()]
        timings = take_turns(contenders, rounds, budget=BUDGET, settle=0.5, on_turn=on_turn)
        own = timings["wrt"]
        for name, timing in timings.items():
            if timing.error is not None:
                yield PairRow(question, name, None, None, None, None, timing.error)
                continue
            agrees = bool(abs(timing.result - own.result) <= tolerance)
            yield PairRow(question, name, timing.median, timing.ratio_to(own), timing.result, agrees)
