"""Triangle meshes, from which every scene is made; checked once, by the constructor.

A mesh is an indexed face set: an array of points and an array of vertex index triples, with or without materials. The
constructor checks all geometry, so that builders and kernels can rely on finite points, valid indices and at least one
triangle. Degenerate triangles (zero area) and duplicates are allowed, since real models have many;
`TriangleMesh.summary` counts them.

The arrays are never reordered: triangle i of the arrays (or of the file) is `primitive_id` i in every answer. They are
read-only copies: kernels follow the indices in `faces` without checks, and a tree is valid only for the vertices that it
was built over. Meshes, scenes and, on the CPU, kernels share the one copy.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.atomic_files import replaced
from wrt.kernels.validation import as_bool, as_numbers
from wrt.materials.material import Material
from wrt.materials.mesh_materials import MeshMaterials, joined_materials, make_mesh_materials
from wrt.meshes.exact_encoding import encode_mesh
from wrt.meshes.files.mesh_reading import OWN_FORMATS, read_by_trimesh, read_own_format
from wrt.meshes.files.up_in_files import with_stated_up
from wrt.meshes.graph_transforms import graph_transform
from wrt.meshes.height_map import height_map_arrays
from wrt.meshes.mesh_arrays import checked_faces, checked_vertices, frozen
from wrt.meshes.mesh_measures import extremes, first_of_equal_points, normals_and_areas
from wrt.meshes.up_axis import Direction, checked_up, common_up, mapped_up, up_of_format

if TYPE_CHECKING:
    import trimesh

    from wrt.array_types import ArrayLike, Numbers

__all__ = ["TriangleMesh"]


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

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, *, name: str | None = None, up: ArrayLike | None = None) -> None:
        self._vertices = checked_vertices(vertices)
        self._faces = checked_faces(faces, len(self._vertices))
        self.name = name
        self._up = checked_up(up)
        self._materials: MeshMaterials | None = None

    # -- input and output --------------------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path, *, materials: bool | None = None, outside: bool = False) -> TriangleMesh:
        """Reads a .ply, .obj, .stl, .off, .gltf or .glb file, or one in any other format that trimesh knows.

        Nothing is merged or reordered: primitive ids are the file's triangle order. A polygon becomes its triangles in place:
        n - 2 for n corners, a fan if it is convex, else ears in its plane. The default scene of a glTF file is flattened, node
        by node, each before its children, in the pose of the nodes and with the default weights of morph targets; scenes of
        other formats as in `from_trimesh`. Axes and units stay as they are in the file. `up` is y for glTF, OBJ, OFF and PLY
        files, and None for all others, unless a comment of `save` states another.

        Args:
            path: of the file, a regular one.
            materials: whether to read materials, texture coordinates and colours; None: of all formats except OBJ.
            outside: whether the file may refer to buffers, images and material libraries that are not below its folder, also
                by symbolic links or absolute paths. Of other formats, trimesh reads what it finds.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: unknown format, unreadable content, no triangles, an extension of glTF that is required and not
                supported, an image of more than 2^27 pixels, a reference to what may not be read, or bad geometry as in the
                constructor. The message says which.

        Warns:
            UserWarning: what does not change the shape is left out: an image that is missing or broken, colours or texture
                coordinates that are NaN, bytes behind the end, faces of fewer than three corners. Once for each.
        """
        path = Path(path)
        if not path.exists() or path.is_dir():
            raise FileNotFoundError(f"no mesh file at '{path}': check the path (now in '{Path.cwd()}')")
        suffix = path.suffix.lower().lstrip(".")
        materials = None if materials is None else as_bool("materials", materials)
        outside = as_bool("outside", outside)
        if suffix in OWN_FORMATS:
            found: Any = read_own_format(path, suffix, materials, outside)
        elif not path.is_file():
            raise ValueError(f"'{path}' is a pipe or a device, not a regular file; copy its content to a file first")
        else:
            found = read_by_trimesh(path, suffix)
        try:
            if suffix in OWN_FORMATS:
                mesh = cls(found.vertices, found.faces, name=path.stem, up=found.up)
                mesh._materials = found.materials
            else:
                mesh = cls.from_trimesh(found, name=path.stem, materials=materials is not False)
        except ValueError as error:
            raise ValueError(f"'{path}': {error}") from error
        mesh._up = mesh._up or up_of_format(suffix)
        return mesh

    @classmethod
    def from_trimesh(
        cls, source: trimesh.Trimesh | trimesh.Scene, *, name: str | None = None, materials: bool = True
    ) -> TriangleMesh:
        """Converts a trimesh mesh, or a trimesh scene flattened into world coordinates, with its materials if asked to.

        Every node of the scene's graph that holds a mesh is transformed and appended, instances included. Point clouds and
        paths are left out.

        Raises:
            TypeError: `source` is neither a trimesh.Trimesh nor a trimesh.Scene.
            ValueError: no triangles, or bad geometry as in the constructor.
        """
        import trimesh

        if isinstance(source, trimesh.Trimesh):
            mesh = cls(source.vertices, source.faces, name=name)
            if as_bool("materials", materials):
                from wrt.materials.trimesh_materials import read_materials

                mesh._materials = read_materials(source)
            return mesh
        if not isinstance(source, trimesh.Scene):
            raise TypeError(
                f"expected a trimesh.Trimesh or trimesh.Scene, got {type(source).__name__}; "
                "give arrays to TriangleMesh(vertices, faces) and paths to TriangleMesh.load(path)"
            )
        parts, known = [], {}
        for node in source.graph.nodes_geometry:
            matrix, data = graph_transform(source, node, known), source.graph.transforms.node_data
            geometry = source.geometry[data[node]["geometry"]]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
                parts.append(cls.from_trimesh(geometry, materials=materials).transformed(matrix))
        if not parts:
            raise ValueError("no triangles in it: a mesh needs at least one (point clouds and paths do not count)")
        return cls.concatenate(parts, name=name)

    @classmethod
    def from_heightmap(cls, heights: ArrayLike, *, spacing: Numbers = 1.0, origin: ArrayLike = (0, 0, 0)) -> TriangleMesh:
        """A terrain, z up: vertex i * columns + j is at origin + (j dx, i dy, heights[i, j]), float64.

        Args:
            heights: (rows, columns) real, at least 2 x 2; cells with a NaN or an infinity at a corner are left out.
            spacing: a number, or (dx, dy), not 0; dy < 0 for rows from the north.
            origin: (3,).

        Raises:
            TypeError: not real numbers.
            ValueError: wrong shapes, a spacing of 0, a number that is not finite, or no cell with four heights.
        """
        return cls(*height_map_arrays(heights, spacing, origin), up=(0, 0, 1))

    def to_trimesh(self) -> trimesh.Trimesh:
        """Returns a trimesh.Trimesh with copies of the arrays; no vertices are merged."""
        import trimesh

        return trimesh.Trimesh(self._vertices.copy(), self._faces.copy(), process=False)

    def save(self, path: str | Path) -> None:
        """Writes a file in the format of the extension of `path` (.ply .obj .stl .glb .off ...), without materials.

        An upward direction that is not the format's own (y in glTF, OBJ, OFF and PLY files) is kept. PLY, OBJ, OFF and STL have
        no place for it: it is a comment, which `load` reads and other programs skip. In glTF files, where y is up by standard,
        a node turns the mesh, so that it stands upright in other programs; `load` undoes that.

        PLY, OBJ and OFF files hold the vertices exactly. An old file is replaced when the new one is complete.

        Raises:
            ValueError: trimesh cannot write that format into one file.
            OSError: the file cannot be written.

        Warns:
            UserWarning: the format moves the vertices: STL and glTF hold float32, Collada files seven digits.
        """
        suffix = Path(path).suffix.lower().lstrip(".")
        try:
            data = encode_mesh(self.to_trimesh(), suffix)
        except ValueError as error:
            raise ValueError(f"cannot write '{path}' as '.{suffix}' ({error}); use .ply, .obj, .stl or .glb") from error
        with replaced(path, streams=True) as file:
            file.write(with_stated_up(data, suffix, self._up))

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
    def materials(self) -> MeshMaterials | None:
        """Materials of the triangles (`with_materials`); None if there are none."""
        return self._materials

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
        return normals_and_areas(self._vertices, self._faces)[0]

    @property
    def surface_area(self) -> float:
        """Sum of the triangle areas, in squared units of the vertices."""
        return float(normals_and_areas(self._vertices, self._faces)[1].sum())

    def summary(self) -> dict[str, Any]:
        """Counts and measures of the mesh as plain Python values.

        Returns:
            A dict with the keys `name`, `triangles`, `vertices`, `bounds` ([[x, y, z], [x, y, z]]), `surface_area`,
            `degenerate_triangles` (zero area), `duplicate_triangles` (triangles with the same three corners as an earlier
            one, in any order), and `is_closed`: every edge belongs to exactly two triangles. The last two compare
            positions, not indices: vertices that coincide exactly count as one, and triangles that thereby collapse to a
            line or a point are ignored by `is_closed`.
        """
        normals, areas = normals_and_areas(self._vertices, self._faces)
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
        return np.sort(first_of_equal_points(self._vertices)[self._faces], axis=1).astype(np.int64)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the constructor's arguments, so that unpickled meshes are checked and read-only."""
        made = partial(TriangleMesh, name=self.name, up=self._up), (self._vertices, self._faces)
        return made if self._materials is None else (*made, {"_materials": self._materials})

    def __repr__(self) -> str:
        label = f"'{self.name}', " if self.name else ""
        low, high = (", ".join(f"{value:.4g}" for value in corner) for corner in self.bounds)
        return (
            f"TriangleMesh({label}{self.triangle_count:,} triangles, {self.vertex_count:,} vertices, "
            f"bounds ({low}) to ({high}))"
        )

    # -- derived meshes ----------------------------------------------------------------------------------------------------

    def transformed(self, matrix: ArrayLike) -> TriangleMesh:
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
        matrix = as_numbers("matrix", matrix, finite=False)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError(f"matrix must be a finite 4 x 4 array, got shape {matrix.shape}: {matrix.tolist()}")
        if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], rtol=0.0, atol=1e-12):
            raise ValueError(f"matrix must be affine, its last row (0, 0, 0, 1); got {matrix[3].tolist()}")
        moved = self._vertices @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        faces = self._faces[:, [0, 2, 1]] if mirrored else self._faces
        up = mapped_up(self._up, matrix[:3, :3])
        result = TriangleMesh(moved.astype(self._vertices.dtype, copy=False), faces, name=self.name, up=up)
        result._materials = self._materials.mirrored() if mirrored and self._materials is not None else self._materials
        return result

    def with_materials(
        self,
        materials: Material | Iterable[Material],
        of_face: ArrayLike | None = None,
        *,
        uv: ArrayLike | None = None,
        colors: ArrayLike | None = None,
    ) -> TriangleMesh:
        """The same mesh with materials. `transformed`, `concatenate`, `welded`, pickles and `Scene.save` keep them; mesh
        files do not.

        Args:
            materials: a `wrt.Material` for all triangles, or several.
            of_face: (F,) the material of each triangle, as its place in `materials`; None: all have the first one.
            uv: (V, 2) or (F, 3, 2) texture coordinates of vertices or corners.
            colors: (V, 3) or (F, 3, 3) linear colours of vertices or corners, which multiply the material's.

        Raises:
            TypeError, ValueError: wrong types, shapes or values.
        """
        made = make_mesh_materials(self._faces, self.vertex_count, materials, of_face, uv, colors)
        return self._like(self._vertices, self._faces, made)

    def _like(self, vertices: np.ndarray, faces: np.ndarray, materials: MeshMaterials | None) -> TriangleMesh:
        """A mesh of the same name and upward direction."""
        mesh = TriangleMesh(vertices, faces, name=self.name, up=self._up)
        mesh._materials = materials
        return mesh

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
        joined = TriangleMesh(vertices, faces, name=name, up=common_up(meshes))
        parts = [mesh.materials for mesh in meshes]
        joined._materials = joined_materials(parts, [mesh.triangle_count for mesh in meshes], Material())
        return joined

    def welded(self) -> TriangleMesh:
        """Merges vertices that coincide exactly and drops unused ones; triangles and their order stay the same."""
        faces = first_of_equal_points(self._vertices)[self._faces]
        kept, faces = np.unique(faces, return_inverse=True)
        return self._like(self._vertices[kept], faces.reshape(-1, 3), self._materials)
