"""The rays of path tracing, bounce by bounce, with what is known of them when they are spawned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.engine.device_hits import DeviceHits
from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.integrators.rendering_job import Rendering
from wrt.lights.sky_image import Sky
from wrt.materials.material import Material
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

BOUNCES = 10

ROOM = 1.25
"""Edge of the closed room around the model, in extents of the model: no ray leaves it."""

CELLS = 4
"""Materials change from cell to cell of a grid of this many cells along each axis of the model."""

MATERIALS = (
    Material(color=0.95),
    Material("mirror", color=0.95),
    Material(color=0.95, translucency=0.5),
    Material("glossy", color=0.95, roughness=0.3, metallic=1.0),
)
"""Light colours, so that rays rarely end before the last bounce."""

REFLECTED, TRANSMITTED = 0, 1


@dataclass(frozen=True)
class BounceRays:
    """The rays of one bounce, in the order of their camera rays.

    Attributes:
        bounce: 0 for camera rays.
        origins, directions: (N, 3) float32.
        kinds: (N,) int32, whether the parent's surface reflected or transmitted the ray.
        groups: (N,) int32, the material that the parent met; 0 for camera rays.
        sources: (N,) int32, place of the camera ray among those of the picture, square by square (`square_order`).
    """

    bounce: int
    origins: np.ndarray
    directions: np.ndarray
    kinds: np.ndarray
    groups: np.ndarray
    sources: np.ndarray


def enclosed(mesh: TriangleMesh) -> list[TriangleMesh]:
    """The triangles of a model around the origin, a mesh for each of `MATERIALS`, and a room around them."""
    low, high = (np.asarray(end, dtype=np.float64) for end in mesh.bounds)
    vertices = np.asarray(mesh.vertices, dtype=np.float64) - 0.5 * (low + high)
    extent = float((high - low).max())
    cells = np.floor((vertices[mesh.faces].mean(axis=1) / extent + 0.5) * CELLS).astype(int).sum(axis=1) % len(MATERIALS)
    meshes = [
        TriangleMesh(vertices.astype(np.float32), mesh.faces[cells == n]) for n in range(len(MATERIALS)) if (cells == n).any()
    ]
    half = 0.5 * ROOM * extent
    corners = np.array([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)], dtype=np.float32)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return [*meshes, TriangleMesh(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))]


def materials_of(meshes: list[TriangleMesh]) -> list[Material]:
    """A material for each mesh; the room, the last one, is matte."""
    return [*MATERIALS[: len(meshes) - 1], MATERIALS[0]]


class _Recorder:
    """Passes rays on to a tracer, and keeps the closest-hit rays of each generation."""

    def __init__(self, tracer: Any, job: _RecordedRendering) -> None:
        self._tracer, self._job = tracer, job

    def closest(self, origins: wp.array, directions: wp.array, count: int, **options: Any) -> DeviceHits:
        hits = self._tracer.closest(origins, directions, count, **options)
        rays = (origins.numpy()[:count].copy(), directions.numpy()[:count].copy())
        self._job.generations.append((*rays, self._job.slots(count), hits.primitive.numpy()[:count].copy()))
        return hits

    def blocked(self, *rays: Any, **options: Any) -> wp.array:
        return self._tracer.blocked(*rays, **options)


class _RecordedRendering(Rendering):
    """A picture in the making that keeps the rays of its generations."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.generations: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        super().__init__(*arguments, **options)

    def _take_state(self) -> None:
        super()._take_state()
        self._tracer = _Recorder(self._tracer, self)

    def _follow_in_tiles(self, *_: Any) -> bool:
        return False  # generations are recorded

    def slots(self, count: int) -> np.ndarray:
        """Places of the rays under way in the order of pixels, square by square."""
        return self._wave.queue.slot.numpy()[:count].copy()


def trace_paths(
    mesh: TriangleMesh, size: int, bounces: int = BOUNCES, threads: int | None = None
) -> tuple[Scene, list[BounceRays]]:
    """The model in a room with several materials, and the rays of its paths: one path from each of size x size pixels.

    Args:
        mesh: the model.
        size: pixels along an edge, at most 512.
        bounces: number of the last bounce.
        threads: on the CPU; None for all cores.

    Raises:
        ValueError: size or bounces are out of range.
    """
    if not 1 <= size <= 512 or bounces < 1:
        raise ValueError(f"size is {size} and bounces {bounces}; a size is from 1 to 512, and there is at least one bounce")
    meshes = enclosed(mesh)
    scene = Scene(meshes, Bvh(), num_threads=threads)
    if np.abs(scene.center).max() > 1e-6 * np.abs(scene.bounds).max():
        raise RuntimeError("the room is not around the origin, to which recorded rays are relative")
    corner = scene.bounds[1] * (0.55, 0.85, 0.35)
    camera = PinholeCamera(size, size, position=tuple(corner), look_at=(0.0, 0.0, 0.0), fov=60.0)
    options = {"integrator": "path", "samples": 1, "depth": bounces + 1, "roulette": False, "smooth": False}
    job = _RecordedRendering(scene, camera, lights=[Sky(1.0)], materials=materials_of(meshes), **options)
    job.advance()
    of_face = np.repeat(np.arange(len(meshes)), [one.triangle_count for one in meshes])
    corners = np.concatenate([one.vertices[one.faces] for one in meshes])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return scene, [_tagged(bounce, job.generations, of_face, normals) for bounce in range(len(job.generations))]


def _tagged(bounce: int, generations: list[tuple[np.ndarray, ...]], of_face: np.ndarray, normals: np.ndarray) -> BounceRays:
    """The rays of a generation, with what their parents met."""
    origins, directions, slots, _ = generations[bounce]
    kinds, groups = np.zeros((2, len(slots)), dtype=np.int32)
    if bounce > 0:
        _, before, parent_slots, primitives = generations[bounce - 1]
        parents = np.searchsorted(parent_slots, slots)
        met = primitives[parents]
        groups = of_face[met].astype(np.int32)
        sides = (normals[met] * directions).sum(axis=1) * (normals[met] * before[parents]).sum(axis=1)
        kinds = np.where(sides > 0.0, TRANSMITTED, REFLECTED).astype(np.int32)
    return BounceRays(bounce, origins, directions, kinds, groups, slots)
