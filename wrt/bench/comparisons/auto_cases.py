"""The cases of `wrt bench auto`: scenes, and the kinds and numbers of rays for each.

    view     closest hit   a pinhole view that sees all of the scene
    scan     closest hit   a spinning lidar of 64 beams, at the centre of the scene
    places   closest hit   the same with 65,536 rays at each of 20 places anywhere in the scene, whatever the size
    random   closest hit   rays from anywhere to anywhere
    sorted   closest hit   the same by the octants of their directions and the cells of their origins
    shuffled closest hit   those of the view in any order
    short    closest hit   from what the view sees, in all directions, to a fiftieth of the scene's diagonal
    shadow   occlusion     from what the view sees to a point light
    ao       occlusion     ambient occlusion from the same points

Rays of `wrt.bench.core.workloads`, and others made of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wrt.bench.core.workloads import CLOSEST, OCCLUSION, Workload, WorkloadMaker, normalized
from wrt.engine.rays.rays import Rays
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scenes import atrium

KINDS = ("view", "scan", "places", "random", "sorted", "shuffled", "short", "shadow", "ao")

SIZES = (64, 256, 1024)
"""Edges of the views in pixels; the other kinds have about as many rays as the view has pixels."""

BEAMS, LOWEST, HIGHEST = 64, -22.5, 22.5
"""Beams of the lidar, and their elevations in degrees."""

PLACES, TURN = 20, 1024
"""Places of the lidar in `places`, and rays of a beam there."""

SHORT = 0.02
"""Length of short rays, as a share of the diagonal of the scene's box."""

CELLS = 16
"""Cells along an axis by which rays are sorted."""

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
        kind: one of `KINDS`, or "place" and a number.
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
            "sorted": lambda tiles=tiles: in_order(tiles.random("random"), sorted_order),
            "shuffled": lambda rows=rows: in_order(rows.view("far"), shuffled_order),
            "short": lambda tiles=tiles: short(tiles),
            "shadow": lambda tiles=tiles: tiles.shadow("shadow"),
            "ao": lambda tiles=tiles: tiles.ambient("ao"),
        }
        for kind in kinds:
            if kind in makers:
                yield from case_of(kind, makers[kind]())
    if "places" in kinds:
        for number, place in enumerate(places(mesh)):
            yield from case_of(f"place {number}", scan(mesh, TURN, place))


def case_of(kind: str, made: Workload) -> Iterator[Case]:
    """The case of some rays; none if there are no rays."""
    if len(made):
        origins = made.origins[0] if made.shares_origin else made.origins
        shape = (BEAMS, -1, 3) if made.name == "scan" else (-1, 3)
        yield Case(kind, made, Rays(origins, made.directions.reshape(shape), 0.0, made.t_max))


def scan(mesh: TriangleMesh, columns: int, place: np.ndarray | None = None) -> Workload:
    """A turn of a spinning lidar at a place, or the centre of a mesh, about z: 64 beams, one after the other, of this many
    rays."""
    elevation = np.radians(np.linspace(HIGHEST, LOWEST, BEAMS))[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)[None, :]
    level = np.cos(elevation)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth], axis=-1)
    directions = directions.reshape(-1, 3).astype(np.float32)
    point = mesh.center if place is None else place
    return Workload(
        "scan", CLOSEST, np.broadcast_to(point.astype(np.float32), directions.shape), directions, shares_origin=True
    )


def places(mesh: TriangleMesh, seed: int = 0) -> np.ndarray:
    """(20, 3) float64: points anywhere in the box of a mesh."""
    return np.random.default_rng(seed).uniform(*mesh.bounds, (PLACES, 3))  # type: ignore[call-overload]


def short(maker: WorkloadMaker) -> Workload:
    """Short rays from the surface."""
    points, normals = maker.visible
    directions = normalized(np.random.default_rng(1).normal(size=points.shape))
    directions *= np.where(np.sum(directions * normals, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return Workload("short", CLOSEST, points, directions.astype(np.float32), t_max=SHORT * maker.mesh.extent)


def in_order(rays: Workload, order: Callable[[Workload], np.ndarray]) -> Workload:
    """Rays in another order."""
    numbers = order(rays)
    origins = rays.origins if rays.shares_origin else rays.origins[numbers]
    return replace(rays, origins=origins, directions=rays.directions[numbers])


def shuffled_order(rays: Workload) -> np.ndarray:
    """Any order."""
    return np.random.default_rng(2).permutation(len(rays))


def sorted_order(rays: Workload) -> np.ndarray:
    """By octants of directions, then by cells of origins."""
    low, high = rays.origins.min(axis=0), rays.origins.max(axis=0)
    cells = np.minimum((rays.origins - low) / (high - low) * CELLS, CELLS - 1).astype(np.int64)
    octant = (rays.directions < 0.0) @ np.array([4, 2, 1])
    return np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0], octant))


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
