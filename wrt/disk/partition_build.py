"""Building a partitioned scene out of core: one mesh, or one part, is in memory at a time.

**Phases.** *Read*: each mesh is checked and copied to the disk; bounds are joined. *Count*: triangles are counted by the cells
of a grid (`wrt.disk.spatial_parts`). *Distribute*: the triangles of each mesh are appended to the files of their parts,
with the vertices that they use and the numbers that they have in the whole scene. *Build*: each part gets its tree, relative
to the centre of the whole scene, and its triangle records, and is saved.

Everything happens in a folder beside the target, which is renamed when it is complete; after an error, nothing is left.

References: pharr-1997.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from wrt.atomic_files import named
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.disk.partition_files import (
    MAPPED,
    MAX_PARTS,
    MAX_TRIANGLES,
    RECORDS,
    RELATIVE,
    PartList,
    label_of,
    part_path,
    write_list,
)
from wrt.disk.spatial_parts import Division, Grid, divide
from wrt.engine.facts.scene_state import Settings, new_mark
from wrt.engine.plan.planner import default_test
from wrt.kernels.runtime.launch import as_device
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import pack_blocks
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import MAX_COORDINATE, MAX_EXTENT, as_meshes, members_of, place_meshes
from wrt.scene.archives import write_archive
from wrt.scene.mesh_state import MeshState
from wrt.scene.storage import scene_arrays


@dataclass
class MeshFiles:
    """The meshes of the scene, copied to a folder.

    Attributes:
        folder: the folder.
        names: names of the meshes.
        first: first triangle of each mesh, and the number of all triangles.
        low, high: (3,) float64, corners of the box of all triangles.
        dtype: of the vertices of all meshes together.
    """

    folder: Path
    names: list[str | None]
    first: list[int]
    low: np.ndarray
    high: np.ndarray
    dtype: np.dtype

    @classmethod
    def read(cls, geometry: Iterable[Any], folder: Path) -> MeshFiles:
        """Phase "read".

        Raises:
            TypeError: an item is neither a mesh nor the path of one.
            ValueError: there is no mesh, or the triangles are too many, too far away or spread too far.
            FileNotFoundError: there is no such file.
        """
        found = cls(folder, [], [0], np.full(3, np.inf), np.full(3, -np.inf), np.dtype(np.float32))
        for mesh in meshes_of(geometry):
            found._add(mesh)
        if not found.names:
            raise ValueError("geometry gives no mesh; pass at least one mesh or the path of one")
        return found

    def _add(self, mesh: TriangleMesh) -> None:
        number, total = len(self.names), self.first[-1] + mesh.triangle_count
        if total > MAX_TRIANGLES:
            raise ValueError(
                f"the meshes up to number {number} have {total:,} triangles, and a scene has {MAX_TRIANGLES:,} at most"
            )
        low, high = mesh.bounds
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
        if max(-self.low.min(), self.high.max()) > MAX_COORDINATE or (self.high - self.low).max() > MAX_EXTENT:
            raise ValueError(
                f"mesh {number} extends from {low.tolist()} to {high.tolist()}, and the meshes up to it across "
                f"{(self.high - self.low).max():.3g}; a scene may be {MAX_EXTENT:.3g} across and reach {MAX_COORDINATE:.3g}; "
                "repair the mesh, or scale the geometry down"
            )
        np.save(self.folder / f"vertices-{number}.npy", mesh.vertices)
        np.save(self.folder / f"faces-{number}.npy", mesh.faces)
        self.names.append(mesh.name)
        self.first.append(total)
        self.dtype = np.promote_types(self.dtype, mesh.vertices.dtype)

    @property
    def center(self) -> np.ndarray:
        """(3,) float64: the centre of the box of all triangles, as `wrt.meshes.placement.place_meshes` computes it."""
        return 0.5 * self.low + 0.5 * self.high

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Vertices and faces of one mesh after the other."""
        for number in range(len(self.names)):
            paths = (self.folder / f"{kind}-{number}.npy" for kind in ("vertices", "faces"))
            vertices, faces = (np.load(path, allow_pickle=False) for path in paths)
            yield vertices, faces

    def remove(self) -> None:
        """Deletes the copies."""
        for number in range(len(self.names)):
            for kind in ("vertices", "faces"):
                (self.folder / f"{kind}-{number}.npy").unlink()


def meshes_of(geometry: Iterable[Any]) -> Iterator[TriangleMesh]:
    """The meshes that a caller gave, one after the other: meshes, trimesh objects or paths, or an iterable of such."""
    if isinstance(geometry, (str, Path, TriangleMesh)) or hasattr(geometry, "faces") or hasattr(geometry, "graph"):
        geometry = [geometry]
    if not isinstance(geometry, Iterable):
        raise TypeError(f"geometry must be meshes, paths of files, or an iterable of such, not {type(geometry).__name__}")
    for item in geometry:
        for member in members_of(item):
            if isinstance(member, (str, Path)):
                yield TriangleMesh.load(member)
            else:
                yield from as_meshes(member)


def build_parts(
    geometry: Any, folder: Path, settings: Settings, part_triangles: int, store_records: bool, advance: Any
) -> None:
    """Builds a partitioned scene in a folder that does not exist yet; arguments as in `wrt.disk.PartitionedScene.build`.

    Args:
        advance: called with the number of triangles that a phase has dealt with, and its name.
    """
    with replaced_folder(folder) as work:
        meshes = MeshFiles.read(geometry, work)
        grid = Grid.over(meshes.low, meshes.high)
        counts = np.zeros(int(np.prod(grid.shape)), dtype=np.int64)
        for vertices, faces in meshes:
            counts += np.bincount(grid.cells_of(vertices, faces), minlength=len(counts))
            advance(len(faces), "counting")
        division = divide(counts.reshape(grid.shape), part_triangles)
        if division.parts > MAX_PARTS:
            raise ValueError(
                f"part_triangles is {part_triangles}, which makes {division.parts:,} parts of {meshes.first[-1]:,} triangles; "
                f"there may be {MAX_PARTS:,}: give parts more triangles"
            )
        distribute(meshes, grid, division, work, advance)
        meshes.remove()
        mark, rows = new_mark(), []
        for number in range(division.parts):
            rows.append(build_part(work, number, meshes, settings, mark, store_records))
            advance(rows[-1]["triangles"], "building")
        columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        first, bounds = np.array(meshes.first, dtype=np.int64), global_bounds(meshes)
        write_list(work, PartList(mark, tuple(meshes.names), first, meshes.center, bounds, **columns))


def global_bounds(meshes: MeshFiles) -> np.ndarray:
    """(2, 3) float32: the box of all triangles relative to the centre, as `wrt.meshes.placement.place_meshes` rounds it."""
    return np.array([(corner - meshes.center).astype(np.float32) + np.float32(0.0) for corner in (meshes.low, meshes.high)])


def distribute(meshes: MeshFiles, grid: Grid, division: Division, folder: Path, advance: Any) -> None:
    """Phase "distribute": appends triangles to the files of their parts, in ascending order of their numbers."""
    seen = np.zeros(len(division.first_part) - 1, dtype=np.int64)
    vertices_of = np.zeros(division.parts, dtype=np.int64)
    for (vertices, faces), first in zip(meshes, meshes.first[:-1], strict=True):
        part = division.parts_of(grid.cells_of(vertices, faces), seen)
        order = np.argsort(part, kind="stable")
        begins = np.searchsorted(part[order], np.arange(division.parts + 1))
        place = np.empty(len(vertices), dtype=np.int32)
        for number in np.flatnonzero(np.diff(begins)).tolist():
            chosen = order[begins[number] : begins[number + 1]]
            used = np.unique(faces[chosen])
            place[used] = np.arange(len(used), dtype=np.int32)
            append(folder, number, "vertices", vertices[used].astype(meshes.dtype))
            append(folder, number, "faces", place[faces[chosen]] + np.int32(vertices_of[number]))
            append(folder, number, "ids", (chosen + first).astype(np.int32))
            vertices_of[number] += len(used)
        advance(len(faces), "distributing")


def append(folder: Path, number: int, kind: str, values: np.ndarray) -> None:
    """Appends the bytes of an array to a file of a part."""
    with open(folder / f"{number}.{kind}", "ab") as file:
        np.ascontiguousarray(values).tofile(file)


def build_part(
    folder: Path, number: int, meshes: MeshFiles, settings: Settings, mark: str, store_records: bool
) -> dict[str, Any]:
    """Phase "build": writes the file of a part; returns its row of the list of parts."""
    files = {kind: folder / f"{number}.{kind}" for kind in ("vertices", "faces", "ids")}
    vertices = np.fromfile(files["vertices"], dtype=meshes.dtype).reshape(-1, 3)
    mesh = TriangleMesh(vertices, np.fromfile(files["faces"], dtype=np.int32).reshape(-1, 3))
    ids = np.fromfile(files["ids"], dtype=np.int32)
    state, low, high = part_state(mesh, settings, meshes.center, global_bounds(meshes))
    extra = {"ids": ids, "label": np.array(label_of(mark, number)), RELATIVE: state.device_mesh.vertices.numpy()}
    if store_records:
        extra |= stored_records(state)
    arrays = scene_arrays(state) | extra
    names = sorted(arrays, key=lambda name: name.startswith(MAPPED))  # these lie together, at the end
    write_archive(part_path(folder, number), {name: arrays[name] for name in names}, in_one_piece=True)
    for path in files.values():
        path.unlink()
    sizes = {"triangles": len(ids), "vertices": len(vertices), "slots": len(state.tree.primitive)}
    return {"low": low, "high": high, **sizes, "tree_bytes": state.tree.bytes}


def part_state(
    mesh: TriangleMesh, settings: Settings, center: np.ndarray, bounds: np.ndarray
) -> tuple[MeshState, np.ndarray, np.ndarray]:
    """The state of a part on the CPU, and the corners of its box, (3,) float32 each.

    Its tree has the box of the whole scene: boxes are widened, and hits rounded, as in the whole scene
    (`wrt.kernels.simd.boxes`).
    """
    host = as_device("cpu")
    placed = place_meshes((mesh,), host, center)
    boxes = triangle_boxes(placed.vertices, placed.faces, center)
    tree = settings.accelerator.build(boxes, native_width(settings.device))
    tree = replace(tree, low=wp.vec3(*bounds[0].tolist()), high=wp.vec3(*bounds[1].tolist()))
    state = MeshState(
        settings=replace(settings, device=host),
        meshes=(mesh,),
        center=center,
        built_tree=tree,
        device_mesh=placed.fill_in(tree.low, tree.high),
    )
    return state, boxes.low, boxes.high


def stored_records(state: MeshState) -> dict[str, np.ndarray]:
    """The triangle records of a part's tree, by the name of their array."""
    test, mesh, tree = default_test(state.triangle_test), state.device_mesh, state.tree
    blocks = pack_blocks(TRIANGLE_TESTS[test].record, mesh.vertices, mesh.faces, tree.primitive, tree.width)
    return {RECORDS + test: blocks.records.numpy()}


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """A new folder beside `folder`, which gets its name at the end; after an error, nothing is left.

    Raises:
        FileExistsError: `folder` exists and is not empty.
        OSError: it cannot be written; the error names `folder`.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"'{folder}' exists and is not an empty folder; choose another path, or delete it first")
    work = folder.with_name(f".{folder.name}.{new_mark()[:16]}")
    work.mkdir(parents=True)
    try:
        with named(folder, work):
            yield work
        if folder.exists():
            folder.rmdir()
        work.rename(folder)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
