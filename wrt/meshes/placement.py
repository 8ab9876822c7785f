"""The geometry of a scene: meshes as given, and their union as one set of triangles."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.triangle_boxes import TriangleBoxes, triangle_boxes
from wrt.kernels.layout.mesh_placement import shifted
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.workspace import host_view, set_flat
from wrt.kernels.validation import as_int, host_array
from wrt.meshes.mesh import TriangleMesh

MAX_EXTENT = 2.0**36
"""Longest side of the bounding box of a scene's triangles, 6.9e10 units of length.

Triangle tests multiply three lengths in float32: an area by a distance, or two distances by an edge. For rays at a distance
D, sheared vertices are up to 2 D from the ray, so the three areas of the watertight test sum up to at most 3 (2 (2 D)^2),
and with the depths D of the vertices to 24 D^3. float32 holds values up to 2^128, hence D < 2^41. This leaves room for rays
that start 30 sides away, or whose directions are that long. Products in builders, areas times costs times 2^31 triangles,
stay below 2^110.
"""

MIN_EXTENT = 2.0**-32
"""Shorter longest sides, 2.3e-10 units of length, are warned of. The same products are as small as h^2 D with triangles of size
h, and float32 has numbers down to 2^-149: relative errors of 2^-24 need h^2 D > 2^-125. This leaves triangles of a 2^14th of
the side.
"""

MAX_COORDINATE = 2.0**120
"""Largest coordinate of a triangle in any scene: positions of hits and instances, and their sums and differences, are
finite in float32 with a margin of 2^8.
"""


@dataclass(frozen=True)
class PlacedMeshes:
    """All meshes of a scene as one, relative to its centre.

    Attributes:
        first: (meshes + 1,) the first triangle of each mesh, and the number of all triangles.
        center: (3,) float64.
        bounds: (3,) float32 each, corners of the box of all triangles, relative to the centre; no negative zeros.
        vertices: (V,) vec3 on the CPU.
        faces: (F,) vec3i on the CPU.
        mesh: the same on the scene's device; its box is set by `fill_in`.
    """

    first: np.ndarray
    center: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    vertices: wp.array
    faces: wp.array
    mesh: SceneMesh

    def boxes(self, device: wp.Device) -> TriangleBoxes:
        """The bounding boxes of the triangles, on the CPU or on the scene's device."""
        vertices, faces = (self.vertices, self.faces) if device.is_cpu else (self.mesh.vertices, self.mesh.faces)
        return triangle_boxes(vertices, faces, self.center, self.bounds)

    def fill_in(self, low: wp.vec3, high: wp.vec3) -> SceneMesh:
        """Sets the box of `mesh`, and returns it."""
        self.mesh.low, self.mesh.high = wp.vec3(*low), wp.vec3(*high)
        return self.mesh


def place_meshes(meshes: tuple[TriangleMesh, ...], device: wp.Device, center: np.ndarray | None = None) -> PlacedMeshes:
    """Joins meshes, subtracts their centre in float64, and copies them to a device in float32.

    Args:
        meshes: the meshes.
        device: the scene's.
        center: (3,) float64, another point to subtract: the centre of a scene of which these meshes are a part.

    Raises:
        ValueError: they are too large, or too far away (`find_bounds`).
    """
    low, high = find_bounds(meshes)
    center = 0.5 * low + 0.5 * high if center is None else center
    bounds = relative_bounds(np.array([low, high]), center)
    vertices, faces, first = join_meshes(meshes)
    host_vertices = shifted(center, vertices)
    host_faces = wp.array(faces, dtype=wp.vec3i, device="cpu", copy=False)
    mesh = SceneMesh()
    mesh.vertices, mesh.faces = host_vertices.to(device), host_faces.to(device)
    mesh.center = wp.vec3d(*map(float, center))
    mesh.geometry_first = wp.array(first, dtype=int, device=device)
    return PlacedMeshes(first, center, bounds, host_vertices, host_faces, mesh)


def relative_bounds(bounds: np.ndarray, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) float32 each: the corners of a box relative to a point, as vertices become: rounding keeps their order.

    Args:
        bounds: (2, 3) float64.
        center: (3,) float64.
    """
    with np.errstate(over="ignore"):
        low, high = (bounds - center).astype(np.float32) + np.float32(0.0)
    return low, high


def lay_out_few(meshes: tuple[TriangleMesh, ...]) -> tuple[np.ndarray, np.ndarray, SceneMesh]:
    """`place_meshes` for few triangles on the CPU, in a fraction of the time, up to the vertices' new positions.

    Returns:
        The centre, (3,) float64; (V, 3) vertices of all meshes as they were given; the scene's mesh with its box, and
        with room for the vertices.

    Raises:
        ValueError: as `find_bounds`.
    """
    low, high = meshes[0].bounds.tolist()
    if len(meshes) > 1:
        bounds = np.array([mesh.bounds for mesh in meshes])
        low, high = bounds[:, 0].min(axis=0).tolist(), bounds[:, 1].max(axis=0).tolist()
    side = max([b - a for a, b in zip(low, high, strict=True)])
    if max(*high, -min(low)) > MAX_COORDINATE or side > MAX_EXTENT or 0.0 < side < MIN_EXTENT:
        find_bounds(meshes)  # raises the error, or warns
    center = [0.5 * a + 0.5 * b for a, b in zip(low, high, strict=True)]
    vertices, faces, first = join_meshes(meshes)
    mesh = SceneMesh()
    set_flat(mesh, "vertices", host_view(np.empty((len(vertices), 3), dtype=np.float32), wp.vec3))
    set_flat(mesh, "faces", host_view(faces, wp.vec3i))
    set_flat(mesh, "geometry_first", host_view(first.astype(np.int32), wp.int32))
    mesh.center = wp.vec3d(*center)
    for name, corner in (("low", low), ("high", high)):  # rounded as vertices are, and without negative zeros
        relative = (ctypes.c_float * 3)(*[a - b for a, b in zip(corner, center, strict=True)])
        setattr(mesh, name, wp.vec3(*[value + 0.0 for value in relative]))
    return np.array(center), vertices, mesh


def find_center(meshes: Sequence[TriangleMesh]) -> np.ndarray:
    """(3,) float64: the centre of the bounding box of all triangles, which positions are relative to.

    Vertices that no triangle uses do not count: one far from all triangles would cost the others precision.

    Raises:
        ValueError: as `find_bounds`.
    """
    low, high = find_bounds(meshes)
    return 0.5 * low + 0.5 * high


def find_bounds(meshes: Sequence[TriangleMesh]) -> tuple[np.ndarray, np.ndarray]:
    """(3,) float64 each: lower and upper corner of the bounding box of all triangles.

    A longest side shorter than MIN_EXTENT, but not 0, is warned of.

    Raises:
        ValueError: the box has a side longer than MAX_EXTENT, or a coordinate is beyond MAX_COORDINATE.
    """
    bounds = np.array([mesh.bounds for mesh in meshes])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    if 0.0 < (high - low).max() < MIN_EXTENT:
        warnings.warn(TINY.format((high - low).max(), MIN_EXTENT), stacklevel=3)
    if max(-low.min(), high.max()) > MAX_COORDINATE:
        raise ValueError(f"{_outlier(meshes, np.zeros(3))} is beyond {MAX_COORDINATE:.3g}, {_REMEDY}")
    if (high - low).max() > MAX_EXTENT:
        raise ValueError(
            f"the geometry is {(high - low).max():.3g} across, more than the {MAX_EXTENT:.3g} within which float32 can hold "
            f"areas and distances: {_outlier(meshes)} is the farthest from the others, {_REMEDY}"
        )
    return low, high


TINY = (
    "the geometry is {:.3g} across: in less than {:.3g}, float32 cannot hold products of lengths, so that hits of rays lose "
    "digits or are wrong; scale the geometry up, or ask with precise=True"
)
"""What is said of geometry that is too small for triangle tests in float32."""

_REMEDY = "a coordinate that is probably an error; repair or remove it, or scale the geometry down"


def _outlier(meshes: Sequence[TriangleMesh], middle: np.ndarray | None = None) -> str:
    """Describes the used vertex that is farthest from a point; None: from the median of all of them."""
    used = [np.flatnonzero(mesh.referenced) for mesh in meshes]
    points = [mesh.vertices[own].astype(np.float64) for mesh, own in zip(meshes, used, strict=True)]
    if middle is None:
        middle = np.median(np.concatenate(points), axis=0)
    far = [np.abs(own * 0.5 - middle * 0.5).max(axis=1) for own in points]  # halved: a difference may overflow
    number = int(np.argmax([own.max() for own in far]))
    vertex = int(used[number][far[number].argmax()])
    mesh = meshes[number]
    label = f" ({mesh.name!r})" if mesh.name else ""
    return f"vertex {vertex} of mesh {number}{label}, {mesh.vertices[vertex].tolist()},"


def members_of(geometry: Any, above: tuple[int, ...] = ()) -> list[Any]:
    """The members of a sequence and of nested sequences, or the one object that is not a sequence.

    Args:
        geometry: that object.
        above: identities of the sequences that contain it.

    Raises:
        ValueError: a sequence contains itself.
    """
    if not isinstance(geometry, Sequence) or isinstance(geometry, (str, bytes)):
        return [geometry]
    if id(geometry) in above:
        raise ValueError("geometry is a sequence that contains itself; pass the meshes themselves")
    above = (*above, id(geometry))
    return [member for item in geometry for member in members_of(item, above)]


def hierarchy_of(geometry: Any) -> Any:
    """The nested sequences of a geometry with numbers in place of meshes. A sequence of one is its member."""
    count = 0

    def walk(item: Any) -> Any:
        nonlocal count
        if not isinstance(item, Sequence) or isinstance(item, (str, bytes)):
            count += 1
            return count - 1
        below = tuple(part for part in map(walk, item) if part != ())
        return below[0] if len(below) == 1 else below

    return walk(geometry)


def nested(hierarchy: Any, meshes: Sequence[Any]) -> Any:
    """The geometry of a hierarchy: meshes in place of numbers."""
    return [nested(part, meshes) for part in hierarchy] if isinstance(hierarchy, tuple) else meshes[hierarchy]


def as_meshes(geometry: Any) -> tuple[TriangleMesh, ...]:
    """The meshes that a scene was given, in order.

    Raises:
        TypeError: an object that is not a mesh.
        ValueError: an empty sequence, or one that contains itself.
    """
    if isinstance(geometry, TriangleMesh):
        return (geometry,)
    if isinstance(geometry, Sequence) and not isinstance(geometry, (str, bytes)):
        if not (members := members_of(geometry)):
            raise ValueError("geometry is an empty sequence; pass at least one mesh")
        return tuple(mesh for member in members for mesh in as_meshes(member))
    if hasattr(geometry, "graph") or hasattr(geometry, "faces"):
        return (TriangleMesh.from_trimesh(geometry),)
    raise TypeError(
        f"geometry must be a wrt.TriangleMesh, a trimesh object or a sequence of them, not {type(geometry).__name__}; "
        "load files with wrt.TriangleMesh.load(path)"
    )


def check_index(index: Any, count: int, what: str, name: str = "index") -> int:
    """Checks an index of a mesh or instance, 0 to count - 1; name: of the argument.

    Raises:
        TypeError: not an int.
        ValueError: out of range.
    """
    index = as_int(name, index)
    if not 0 <= index < count:
        raise ValueError(f"{name} is {index}, but the scene's {what} indices go from 0 to {count - 1}")
    return index


def check_indices(index: Any, count: int, what: str) -> np.ndarray:
    """(M,) indices of meshes or instances, of one index or a sequence of them.

    Raises:
        TypeError, ValueError: as `check_index`; an empty sequence.
    """
    values = np.atleast_1d(host_array("index", index))
    if not (values.ndim == 1 and values.dtype.kind in "iu" and len(values) and values.min() >= 0 and values.max() < count):
        values = np.array([check_index(one, count, what) for one in values.tolist()], dtype=np.int64)
        if not len(values):
            raise ValueError(f"index is empty; pass the index of an {what}, or several")
    return values


def moved_mesh(mesh: TriangleMesh, vertices: Any) -> TriangleMesh:
    """The mesh with new vertices; its faces are shared.

    Raises:
        TypeError: vertices are missing, or not real numbers.
        ValueError: another number of vertices, or NaN or infinite ones.
    """
    if vertices is None:
        raise TypeError("vertices is missing; pass an array of as many points as the mesh has vertices")
    points = host_array("vertices", vertices)
    if points.ndim and len(points) != mesh.vertex_count:
        raise ValueError(
            f"vertices has {len(points)} points, but the mesh has {mesh.vertex_count}; for other triangles, make a new scene"
        )
    moved = TriangleMesh(points, mesh.faces, name=mesh.name, up=mesh.up)
    moved._materials = mesh.materials
    moved.__dict__["referenced"] = mesh.referenced  # the same triangles use the same vertices
    return moved


def moved_meshes(meshes: tuple[TriangleMesh, ...], index: Any, vertices: Any) -> dict[int, TriangleMesh]:
    """The meshes of a scene that get new vertices, by their index; arguments as in `wrt.Scene.update`.

    Raises:
        TypeError: `vertices` beside a mapping, an empty mapping, an index that is not an int, or as `moved_mesh`.
        ValueError: no such mesh, one of them twice, or as `moved_mesh`.
    """
    if not isinstance(index, Mapping):
        number = check_index(index, len(meshes), "mesh")
        return {number: moved_mesh(meshes[number], vertices)}
    if vertices is not None:
        raise TypeError("index is a mapping, which holds the vertices of each mesh; leave vertices out")
    if not index:
        raise TypeError("index is an empty mapping; give the new vertices of at least one mesh")
    return {
        (number := check_index(one, len(meshes), "mesh")): moved_mesh(meshes[number], points) for one, points in index.items()
    }


def join_meshes(meshes: tuple[TriangleMesh, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and the first triangle of each mesh, for the union of all meshes."""
    if len(meshes) == 1:
        return meshes[0].vertices, meshes[0].faces, np.array([0, meshes[0].triangle_count])
    counts = np.cumsum([0] + [mesh.triangle_count for mesh in meshes])
    offsets = np.cumsum([0] + [mesh.vertex_count for mesh in meshes])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)])
    return vertices, faces.astype(np.int32), counts
