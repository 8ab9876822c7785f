"""Random instances of small meshes."""

from __future__ import annotations

import numpy as np
import trimesh

import wrt
from wrt.engine.executor import trace
from wrt.engine.plan.choices import make_plan
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2))

BOX = wrt.TriangleMesh.from_trimesh(trimesh.creation.box())

FLAT = np.diag([1.0, 0.0, 1.0, 1.0])
"""A map that makes everything flat: it has no inverse."""


def move(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A translation."""
    return trimesh.transformations.translation_matrix([x, y, z])


def random_instances(count: int = 24, seed: int = 0) -> list[wrt.Instance]:
    """Two meshes under maps of every kind: turned, stretched, sheared, mirrored; the first two are the same."""
    rng = np.random.default_rng(seed)
    instances = []
    for k in range(count):
        matrix = move(*rng.uniform(-5, 5, 3))
        matrix[:3, :3] = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-0.5, 0.5, 3)
        instances.append(wrt.Instance((BALL, BOX)[k % 3 == 2], matrix, mask=1 << (k % 4)))
    return [instances[0], *instances]


def inverse_of(map: np.ndarray) -> np.ndarray:
    """The inverse of a (3, 3) map by elimination with row pivots, in the order in which instances have theirs computed."""
    rows = np.concatenate([map, np.eye(3)], axis=1)
    for column in range(3):
        for row in range(column + 1, 3):
            if abs(rows[row, column]) > abs(rows[column, column]):
                rows[[row, column]] = rows[[column, row]]
        for row in range(column + 1, 3):
            rows[row] -= (rows[row, column] / rows[column, column]) * rows[column]
    for row in (2, 1, 0):
        for known in range(row + 1, 3):
            rows[row, 3:] -= rows[row, known] * rows[known, 3:]
        rows[row, 3:] /= rows[row, row]
    np.testing.assert_allclose(rows[:, 3:], np.linalg.inv(map), rtol=0, atol=1e-12 * np.abs(rows[:, 3:]).max())
    return rows[:, 3:]


def asked_alone(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """(t, triangle, uv, count) of every instance, by brute force on the rays as its map takes them, rounded at the end."""
    answers = []
    for instance, number in zip(scene.instances, scene.geometry_ids, strict=True):
        part = scene.state.parts[number]
        inverse = inverse_of(instance.transform[:3, :3])
        place = instance.transform[:3, :3] @ part.center + instance.transform[:3, 3]
        with np.errstate(all="ignore"):
            relative = (origins.astype(np.float64) - scene.center) - (place - scene.center)
            own = [
                (inverse[:, 0] * v[:, :1] + inverse[:, 1] * v[:, 1:2] + inverse[:, 2] * v[:, 2:]).astype(np.float32)
                for v in (relative, directions.astype(np.float64))
            ]
        buffers = to_device(Rays(*own), part.device, np.zeros(3))
        batch, _ = trace(part, make_plan(part, buffers, "brute", "auto", "closest"), buffers, "closest")
        counted, _ = trace(part, make_plan(part, buffers, "brute", "auto", "count"), buffers, "count")
        answers.append((batch.t.numpy(), batch.primitive.numpy(), batch.uv.numpy(), counted.counts.numpy()))
    return answers
