"""Triangle meshes, from which every scene is made; checked once, by the constructor.

A mesh is an indexed face set: an array of points and an array of vertex index triples, without materials or texture
coordinates. The constructor checks all geometry, so that builders and kernels can rely on finite points, valid indices and
at least one triangle. Degenerate triangles (zero area) and duplicates are allowed, since real models have many;
`TriangleMesh.summary` counts them.

The arrays are never reordered: triangle i of the arrays (or of the file) is `primitive_id` i in every answer. They are
read-only copies: kernels follow the indices in `faces` without checks, and a tree is valid only for the vertices that it
was built over. Meshes, scenes and, on the CPU, kernels share the one copy.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.meshes.mesh_arrays import checked_faces, checked_vertices, frozen
from wrt.meshes.up_axis import Direction, checked_up, common_up, mapped_up, up_of_format

if TYPE_CHECKING:
    import trimesh

__all__ = ["TriangleMesh"]

# An angle below four rounding steps of float64 cannot be told from zero: the triangle counts as degenerate.
_SINE_OF_DEGENERATE = 4.0 * np.finfo(np.float64).eps


class TriangleMesh:
    """An immutable indexed triangle mesh.

    Triangle i has the corners `vertices[faces[i]]`, in counter-clockwise order seen from the side that its normal points
    to.

    Args:
        vertices: (V, 3) points, in any unit of length. float32 and float64 are kept; other real types become float64.
        faces: (F, 3) integer vertex indices, zero-based, F >= 1; stored as int32.
        name: a label for messages and tables.
        up: (3,) the upward direction, of any length: the default of `wrt.PinholeCamera.framing` and `wrt render`. None if it
            is not known; they then take z.

    Both arrays are copied, and the copies are read-only: later changes to the caller's arrays affect neither the mesh nor a
    scene made from it. To move vertices, call `wrt.Scene.update`. Arrays of another mesh are shared, not copied.

    Raises:
        TypeError: `vertices` is not real-valued, or `faces` is not an integer array.
        ValueError: wrong shape, no triangle, NaN or infinite vertices (also unreferenced ones), an index out of range,
            or `up` is not three finite numbers that are not all zero.
    """

    def __init__(self, vertices: Any, faces: Any, *, name: str | None = None, up: Any = None) -> None:
        self._vertices = checked_vertices(vertices)
        self._faces = checked_faces(faces, len(self._vertices))
        self.name = name
        self._up = checked_up(up)

    # -- input and output --------------------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path) -> TriangleMesh:
        """Reads a file in any format that trimesh knows (.ply .obj .stl .glb .off ...).

        Nothing is merged or reordered: primitive ids are the file's triangle order. Files with a scene graph are
        flattened as in `from_trimesh`, in the order of their nodes. Polygons are triangulated by trimesh. Axes and
        units stay as they are in the file. `up` is y for glTF, OBJ, OFF and PLY files, and None for all others.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: unknown format, unreadable content, no triangles, or bad geometry as in the constructor.
        """
        import trimesh

        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"no mesh file at '{path}': check the path (now in '{Path.cwd()}')")
        suffix = path.suffix.lower().lstrip(".")
        known = sorted(trimesh.available_formats())
        if suffix not in known:
            raise ValueError(f"cannot read '{path}': unknown mesh format '.{suffix}'; the known ones are {known}")
        try:
            if suffix == "obj":
                source = io.BytesIO(_positions_only(path.read_bytes()))
                loaded = trimesh.load(source, file_type="obj", process=False)
            else:
                loaded = trimesh.load(path, process=False)
        except (PermissionError, MemoryError):
            raise
        except Exception as error:  # the readers of thirty formats raise many types of error
            reason = f"{type(error).__name__}: {error}"
            raise ValueError(f"cannot read '{path}' as .{suffix} ({reason}); is the file complete?") from error
        if not isinstance(loaded, trimesh.Trimesh | trimesh.Scene):
            raise ValueError(f"'{path}' holds a {type(loaded).__name__} without triangles; save it as a triangle mesh")
        try:
            mesh = cls.from_trimesh(loaded, name=path.stem)
        except ValueError as error:
            raise ValueError(f"'{path}': {error}") from error
        mesh._up = up_of_format(suffix)
        return mesh

    @classmethod
    def from_trimesh(cls, source: trimesh.Trimesh | trimesh.Scene, *, name: str | None = None) -> TriangleMesh:
        """Converts a trimesh mesh, or a trimesh scene flattened into world coordinates.

        Every node of the scene's graph that holds a mesh is transformed and appended, instances included. Point clouds and
        paths are left out.

        Raises:
            TypeError: `source` is neither a trimesh.Trimesh nor a trimesh.Scene.
            ValueError: no triangles, or bad geometry as in the constructor.
        """
        import trimesh

        if isinstance(source, trimesh.Trimesh):
            return cls(source.vertices, source.faces, name=name)
        if not isinstance(source, trimesh.Scene):
            raise TypeError(
                f"expected a trimesh.Trimesh or trimesh.Scene, got {type(source).__name__}; "
                "give arrays to TriangleMesh(vertices, faces) and paths to TriangleMesh.load(path)"
            )
        parts = []
        for node in source.graph.nodes_geometry:
            matrix, geometry_name = source.graph[node]
            geometry = source.geometry[geometry_name]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
                parts.append(cls(geometry.vertices, geometry.faces).transformed(matrix))
        if not parts:
            raise ValueError("no triangles in it: a mesh needs at least one (point clouds and paths do not count)")
        return cls.concatenate(parts, name=name)

    def to_trimesh(self) -> trimesh.Trimesh:
        """Returns a trimesh.Trimesh with copies of the arrays; no vertices are merged."""
        import trimesh

        return trimesh.Trimesh(self._vertices.copy(), self._faces.copy(), process=False)

    def save(self, path: str | Path) -> None:
        """Writes a file in the format of the extension of `path` (.ply .obj .stl .glb .off ...).

        Raises:
            ValueError: trimesh cannot write that format.
        """
        suffix = Path(path).suffix.lower().lstrip(".")
        try:
            self.to_trimesh().export(str(path), file_type=suffix)
        except ValueError as error:
            raise ValueError(f"cannot write '{path}' as '.{suffix}' ({error}); use .ply, .obj, .stl or .glb") from error

    # -- properties --------------------------------------------------------------------------------------------------------

    @property
    def vertices(self) -> np.ndarray:
        """(V, 3) float32 or float64 points, read-only."""
        return self._vertices

    @property
    def faces(self) -> np.ndarray:
        """(F, 3) int32 vertex indices, read-only."""
        return self._faces

    @property
    def up(self) -> Direction | None:
        """Upward direction, a unit vector; None if it is not known."""
        return self._up

    @property
    def vertex_count(self) -> int:
        """V, including vertices that no triangle uses."""
        return len(self._vertices)

    @property
    def triangle_count(self) -> int:
        """F, the number of triangles."""
        return len(self._faces)

    @cached_property
    def referenced(self) -> np.ndarray:
        """(V,) bool, read-only: whether a triangle uses the vertex. Unused vertices do not affect bounds, centre or extent."""
        return frozen(np.bincount(self._faces.ravel(), minlength=self.vertex_count) > 0)

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the bounding box of all triangles.

        Vertices that no triangle uses do not count.
        """
        points = self._vertices if self.referenced.all() else self._vertices[self.referenced]
        return frozen(np.array(extremes(points), dtype=np.float64))

    @property
    def center(self) -> np.ndarray:
        """(3,) float64, the centre of `bounds`."""
        return 0.5 * self.bounds[0] + 0.5 * self.bounds[1]

    @property
    def extent(self) -> float:
        """Length of the diagonal of `bounds`, in units of the vertices."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @property
    def face_normals(self) -> np.ndarray:
        """(F, 3) float64 unit normals, right-handed; zero for degenerate triangles. Computed on every call."""
        return _normals_and_areas(self._vertices, self._faces)[0]

    @property
    def surface_area(self) -> float:
        """Sum of the triangle areas, in squared units of the vertices."""
        return float(_normals_and_areas(self._vertices, self._faces)[1].sum())

    def summary(self) -> dict[str, Any]:
        """Counts and measures of the mesh as plain Python values.

        Returns:
            A dict with the keys `name`, `triangles`, `vertices`, `bounds` ([[x, y, z], [x, y, z]]), `surface_area`,
            `degenerate_triangles` (zero area), `duplicate_triangles` (triangles with the same three corners as an earlier
            one, in any order), and `is_closed`: every edge belongs to exactly two triangles. The last two compare
            positions, not indices: vertices that coincide exactly count as one, and triangles that thereby collapse to a
            line or a point are ignored by `is_closed`.
        """
        normals, areas = _normals_and_areas(self._vertices, self._faces)
        corners = self._sorted_corners
        order = np.lexsort(corners.T)
        repeats = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
        return {
            "name": self.name,
            "triangles": self.triangle_count,
            "vertices": self.vertex_count,
            "bounds": self.bounds.tolist(),
            "surface_area": float(areas.sum()),
            "degenerate_triangles": int((~normals.any(axis=1)).sum()),
            "duplicate_triangles": int(repeats.sum()),
            "is_closed": self.is_closed,
        }

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge belongs to exactly two triangles, comparing positions as in `summary`."""
        corners = self._sorted_corners
        proper = corners[(corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])]
        edges = np.concatenate([proper[:, [0, 1]], proper[:, [1, 2]], proper[:, [0, 2]]])
        keys = np.sort(edges[:, 0] * self.vertex_count + edges[:, 1])
        pairs = len(keys) > 0 and len(keys) % 2 == 0 and (keys[0::2] == keys[1::2]).all()
        return bool(pairs and (keys[1:-1:2] != keys[2::2]).all())

    @property
    def _sorted_corners(self) -> np.ndarray:
        """(F, 3) int64, the corners of each triangle in ascending order; coincident vertices count as the first of them."""
        return np.sort(_first_of_equal_points(self._vertices)[self._faces], axis=1).astype(np.int64)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the constructor's arguments, so that unpickled meshes are checked and read-only."""
        return partial(TriangleMesh, name=self.name, up=self._up), (self._vertices, self._faces)

    def __repr__(self) -> str:
        label = f"'{self.name}', " if self.name else ""
        low, high = (", ".join(f"{value:.4g}" for value in corner) for corner in self.bounds)
        return (
            f"TriangleMesh({label}{self.triangle_count:,} triangles, {self.vertex_count:,} vertices, "
            f"bounds ({low}) to ({high}))"
        )

    # -- derived meshes ----------------------------------------------------------------------------------------------------

    def transformed(self, matrix: Any) -> TriangleMesh:
        """Applies an affine map: p -> (matrix @ [p, 1])[:3].

        A map that mirrors (negative determinant) also swaps vertices 1 and 2 of every triangle, so that normals keep
        pointing outward. The type of the vertices is kept; the product is computed in float64.

        Args:
            matrix: (4, 4) real, last row (0, 0, 0, 1).

        Returns:
            A new mesh with the same name. Its upward direction is mapped, too.

        Raises:
            ValueError: wrong shape, not finite, or a perspective last row.
        """
        matrix = np.asarray(matrix, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError(f"matrix must be a finite 4 x 4 array, got shape {matrix.shape}: {matrix.tolist()}")
        if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], rtol=0.0, atol=1e-12):
            raise ValueError(f"matrix must be affine, its last row (0, 0, 0, 1); got {matrix[3].tolist()}")
        moved = self._vertices @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        faces = self._faces[:, [0, 2, 1]] if mirrored else self._faces
        up = mapped_up(self._up, matrix[:3, :3])
        return TriangleMesh(moved.astype(self._vertices.dtype, copy=False), faces, name=self.name, up=up)

    @staticmethod
    def concatenate(meshes: Iterable[TriangleMesh], *, name: str | None = None) -> TriangleMesh:
        """Joins meshes into one called `name`, with triangles in the given order; float64 if any mesh is.

        Its `up` is that of the meshes which have one, and None if these differ.

        Raises:
            ValueError: `meshes` is empty.
        """
        meshes = list(meshes)
        if not meshes:
            raise ValueError("meshes is empty: give at least one TriangleMesh")
        starts = np.cumsum([0] + [mesh.vertex_count for mesh in meshes[:-1]])
        vertices = np.concatenate([mesh.vertices for mesh in meshes])
        faces = np.concatenate([mesh.faces + np.int64(start) for mesh, start in zip(meshes, starts, strict=True)])
        return TriangleMesh(vertices, faces, name=name, up=common_up(meshes))

    def welded(self) -> TriangleMesh:
        """Merges vertices that coincide exactly and drops unused ones; triangles and their order stay the same."""
        faces = _first_of_equal_points(self._vertices)[self._faces]
        kept, faces = np.unique(faces, return_inverse=True)
        return TriangleMesh(self._vertices[kept], faces.reshape(-1, 3), name=self.name, up=self._up)


# -- checks and measures -----------------------------------------------------------------------------------------------


def extremes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest value of each column of an (N, 3) array. By column, NumPy takes a twentieth of the time."""
    columns = points.T
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


def _normals_and_areas(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (F, 3), zero where degenerate, and areas (F,).

    Both edges are first scaled to about unit length, so that products neither underflow nor overflow.
    """
    corner = vertices[faces[:, 0]].astype(np.float64)
    edge1 = vertices[faces[:, 1]] - corner
    edge2 = vertices[faces[:, 2]] - corner
    scale1 = np.abs(edge1).max(axis=1)
    scale2 = np.abs(edge2).max(axis=1)
    edge1 /= np.where(scale1 > 0.0, scale1, 1.0)[:, None]
    edge2 /= np.where(scale2 > 0.0, scale2, 1.0)[:, None]
    normals = np.cross(edge1, edge2)
    lengths = np.linalg.norm(normals, axis=1)
    lengths[lengths <= _SINE_OF_DEGENERATE] = 0.0  # both edges have lengths from 1 to sqrt(3), or zero
    normals *= np.where(lengths > 0.0, 1.0 / np.where(lengths > 0.0, lengths, 1.0), 0.0)[:, None]
    return normals, 0.5 * lengths * scale1 * scale2


def _first_of_equal_points(points: np.ndarray) -> np.ndarray:
    """(V,) for every point, the smallest index of a point with exactly the same coordinates (-0.0 equals 0.0)."""
    order = np.lexsort(points.T)  # stable: equal points stay in the order of their indices
    ranked = points[order]
    starts = np.concatenate([[True], (ranked[1:] != ranked[:-1]).any(axis=1)])
    first = np.empty(len(points), dtype=np.int64)
    first[order] = order[starts][np.cumsum(starts) - 1]
    return first


def _positions_only(text: bytes) -> bytes:
    """Strips an .obj file of groups, materials, texture coordinates and normals.

    Readers group triangles by material and split vertices by texture coordinate; without these, the file's order is kept.
    """
    text = re.sub(rb"(?m)^[ \t]*(?:o|g|s|usemtl|mtllib|vt|vn)\b[^\r\n]*", b"", text)
    return re.sub(rb"(?m)(?<=\d)/[-\d/]*", b"", text)
