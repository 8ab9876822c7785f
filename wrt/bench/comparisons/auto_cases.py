"""The cases of `wrt bench auto`: scenes, and the kinds and numbers of rays for each.

    view     closest hit   a pinhole view that sees all of the scene
    scan     closest hit   a spinning lidar of 64 beams, at the centre of the scene
    random   closest hit   rays from anywhere to anywhere
    shadow   occlusion     from what the view sees to a point light
    ao       occlusion     ambient occlusion from the same points

Rays of `wrt.bench.core.workloads` but for `scan`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.bench.core.workloads import CLOSEST, OCCLUSION, Workload, WorkloadMaker
from wrt.engine.rays.rays import Rays
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scenes import atrium

KINDS = ("view", "scan", "random", "shadow", "ao")

SIZES = (64, 256, 1024)
"""Edges of the views in pixels; the other kinds have about as many rays as the view has pixels."""

BEAMS, LOWEST, HIGHEST = 64, -22.5, 22.5
"""Beams of the lidar, and their elevations in degrees."""

BUNNIES = 10
"""Copies of the model that stand in the atrium of `world` and `instances`."""

LONGEST_COPY = 2.0
"""Longest extent of a copy, in metres."""

BLOCKS, STREET = 288, 0.3
"""Houses along an edge of `city`, and the share of a plot that is not built on: 288 * 288 * 12 triangles and the ground."""


@dataclass(frozen=True)
class Case:
    """Rays to ask of a scene.

    Attributes:
        kind: one of `KINDS`.
        workload: the rays as flat arrays, for peers.
        rays: the same as wrt takes them.
    """

    kind: str
    workload: Workload
    rays: Rays

    @property
    def is_occlusion(self) -> bool:
        """Whether the query is for any hit."""
        return self.workload.query == OCCLUSION

    @property
    def rays_count(self) -> int:
        """Number of rays."""
        return len(self.workload)


def cases(mesh: TriangleMesh, kinds: Sequence[str] = KINDS, sizes: Sequence[int] = SIZES) -> Iterator[Case]:
    """The cases of a mesh; those without rays are left out.

    Args:
        mesh: what the rays are shot at; for instances, all of them as one mesh.
        kinds: of `KINDS`.
        sizes: edges of the views, multiples of 4.
    """
    for size in sizes:
        rows, tiles = (WorkloadMaker(mesh, size=size, order=order) for order in ("rows", "tiles"))
        makers: dict[str, Any] = {
            "view": lambda rows=rows: rows.view("far"),
            "scan": lambda size=size: scan(mesh, max(size * size // BEAMS, 1)),
            "random": lambda tiles=tiles: tiles.random("random"),
            "shadow": lambda tiles=tiles: tiles.shadow("shadow"),
            "ao": lambda tiles=tiles: tiles.ambient("ao"),
        }
        for kind in kinds:
            made = makers[kind]()
            if len(made):
                origins = made.origins[0] if made.shares_origin else made.origins
                shape = (BEAMS, -1, 3) if kind == "scan" else (-1, 3)
                yield Case(kind, made, Rays(origins, made.directions.reshape(shape), 0.0, made.t_max))


def scan(mesh: TriangleMesh, columns: int) -> Workload:
    """A turn of a spinning lidar at the centre of a mesh, about z: 64 beams, one after the other, of this many rays."""
    elevation = np.radians(np.linspace(HIGHEST, LOWEST, BEAMS))[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)[None, :]
    level = np.cos(elevation)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth], axis=-1)
    directions = directions.reshape(-1, 3).astype(np.float32)
    origins = np.broadcast_to(mesh.center.astype(np.float32), directions.shape)
    return Workload("scan", CLOSEST, origins, directions, shares_origin=True)


def copies(model: TriangleMesh) -> list[Instance]:
    """An atrium with copies of a model on a circle around its centre."""
    ground = atrium()
    scale = LONGEST_COPY / float((model.bounds[1] - model.bounds[0]).max())
    instances = [Instance(ground)]
    for turn in np.arange(BUNNIES) * 2.0 * np.pi / BUNNIES:
        transform = np.diag([scale, scale, scale, 1.0])
        place = ground.center + np.array([5.0 * np.cos(turn), 3.0 * np.sin(turn), 0.0])
        transform[:3, 3] = place - scale * model.center
        instances.append(Instance(model, transform))
    return instances


def city(blocks: int = BLOCKS) -> TriangleMesh:
    """Houses of different heights on a square grid, each a box of 12 triangles, and the ground; z is up."""
    rng = np.random.default_rng(0)
    corner = np.stack(np.meshgrid(np.arange(blocks), np.arange(blocks), [0.0]), axis=-1).reshape(-1, 3) - blocks / 2.0
    corner[:, 2] = 0.0
    size = np.array([1.0 - STREET, 1.0 - STREET, 0.0]) + rng.exponential(1.5, len(corner))[:, None] * [0.0, 0.0, 1.0]
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    sides = [(0, 3, 2), (0, 1, 3), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5), (2, 7, 6), (2, 3, 7), (0, 6, 4), (0, 2, 6)]
    sides += [(1, 7, 3), (1, 5, 7)]
    vertices = (corner[:, None] + unit * size[:, None]).reshape(-1, 3)
    faces = (8 * np.arange(len(corner))[:, None, None] + np.array(sides)).reshape(-1, 3)
    half = blocks / 2.0
    ground = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    faces = np.concatenate([faces, len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])])
    return TriangleMesh(np.concatenate([vertices, ground]).astype(np.float32), faces.astype(np.int32), name="city")


SCENES = ("model", "world", "instances", "city")
"""A model alone; an atrium with copies of it in one tree, and the same as instances; a city without it."""


def scene_of(name: str, model: TriangleMesh, threads: int | None = None) -> tuple[Scene, TriangleMesh]:
    """A scene of `SCENES` on the CPU, and its triangles as one mesh."""
    if name in ("world", "instances"):
        scene = Scene(copies(model), device="cpu", num_threads=threads)
        mesh = scene.flattened()
        return (scene, mesh) if name == "instances" else (Scene(mesh, device="cpu", num_threads=threads), mesh)
    mesh = city() if name == "city" else model
    return Scene(mesh, device="cpu", num_threads=threads), mesh


def subdivided(mesh: TriangleMesh, times: int = 1) -> TriangleMesh:
    """The same surface with every triangle divided into four, `times` times."""
    divided = mesh.to_trimesh()
    for _ in range(times):
        divided = divided.subdivide()
    return TriangleMesh(divided.vertices, divided.faces, name=f"{mesh.name or 'mesh'} x {4**times}")
