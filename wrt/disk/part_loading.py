"""Loading a part: its file is checked once, and then mapped into memory.

The first time a part is loaded, its file is checked as `wrt.Scene.load` checks one: checksum, sizes, and the indices in its
tree. Then each array is compared with what is in the file where kernels will read it: type with the order of bytes, shape,
order of the elements, and all elements. From then on the file is mapped and its arrays are used where they are, as long as it
has not changed since (size, time of change, inode); a file that has changed is checked again. Whoever writes into a mapped file
changes what kernels read.

A mapped part is neither copied nor computed: its triangle records are in the file as well (`wrt.disk.partition_build`).
Those of another triangle test are made when a query needs them, and so are all on a GPU, which makes them faster than they can
be copied to it.

**Large pages.** To map and to drop a part takes ten times as long if the system's cache holds its file in pages of 4 KB as if
it holds it in pages of 2 MB (notebooks/records/2026-11-23-parts-on-disk.md). Linux chooses their size when a file comes into
the cache: so files are written in one piece, and those that are not in the cache are first read through a mapping that asks
for large pages. Pages that are in the cache already stay as they are.
"""

from __future__ import annotations

import mmap
import os
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.disk.partition_files import RECORDS, RELATIVE, PartList, label_of, part_path
from wrt.engine.facts.scene_settings import Settings
from wrt.engine.facts.scene_state import SceneState
from wrt.engine.memory import empty, keep_alive
from wrt.kernels.layout.mesh_placement import shifted
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import as_device
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks
from wrt.scene.archives import ALIGNED, ArrayPlace, array_places, checked_reading, read_archive
from wrt.scene.mesh_state import MeshState
from wrt.scene.storage import parse_scene, tree_key

if TYPE_CHECKING:
    from wrt.kernels.triangle.support.record_blocks import Record

TREE = ("bounds", "child", "primitive")
"""Arrays of a part's tree."""

FORMS: dict[str, tuple[type, type, int]] = {
    "tree.bounds": (wp.float32, np.float32, 1),
    "tree.child": (wp.int32, np.int32, 1),
    "tree.primitive": (wp.int32, np.int32, 1),
    "faces.0": (wp.vec3i, np.int32, 2),
    "ids": (wp.int32, np.int32, 1),
    RELATIVE: (wp.vec3, np.float32, 2),
    RECORDS: (wp.float32, np.float32, 1),
}
"""Arrays of a part's file that kernels read where they are: Warp's type, NumPy's, and the number of axes. Names may begin with
`RECORDS`."""

MADV_POPULATE_READ = 22
"""Linux's advice to map pages for reading, since version 5.14."""


class Part(NamedTuple):
    """A part in memory.

    Attributes:
        state: its triangles and its tree, for queries.
        ids: (F,) int32 on the device: numbers of its triangles in the whole scene, ascending.
    """

    state: SceneState
    ids: wp.array

    @property
    def bytes(self) -> int:
        """Memory of the part, with its triangle records."""
        return self.state.bytes + self.ids.capacity


@dataclass(frozen=True)
class CheckedFile:
    """A file of a part that was checked.

    Attributes:
        identity: device, inode, size and time of change.
        places: where its arrays are; none if it cannot be mapped.
        tree: its tree, without arrays; None if this machine builds another one.
    """

    identity: tuple[int, ...]
    places: dict[str, ArrayPlace]
    tree: Bvh | None


class PartLoader:
    """Loads the parts of a scene.

    Args:
        folder: the folder of the scene.
        parts: the list of its parts.
        settings: of the scene.

    Attributes:
        bytes_read: bytes of the file that were read or mapped for the latest part.
    """

    def __init__(self, folder: Path, parts: PartList, settings: Settings) -> None:
        self.folder, self.parts, self.settings = folder, parts, settings
        self.bytes_read = 0
        self._checked: dict[int, CheckedFile] = {}

    def load(self, number: int, record: Record | None) -> Part:
        """Loads a part, with its triangle records if its file has those of this kind.

        Raises:
            FileNotFoundError, PermissionError: the file is gone, or may not be read.
            ValueError: it is damaged, or the part of another scene.
        """
        path = part_path(self.folder, number)
        if not path.is_file():
            raise FileNotFoundError(
                f"part {number} of the scene is gone: no file '{path}'; restore it, or build the scene again"
            )
        with open(path, "rb", buffering=0) as file:  # what is checked and what is mapped is this file, whatever replaces it
            known, identity = self._checked.get(number), identity_of(file)
            if known is not None and known.identity == identity and known.tree is not None:
                return self._map(file, known, record)
            self._checked.pop(number, None)
            with checked_reading(path, f"part {number} of this scene", "restore it, or build the scene again"):
                known, part = self._check(file, number, identity)
            self._checked[number] = known
            return part or self._map(file, known, record)

    def _check(self, file: FileIO, number: int, identity: tuple[int, ...]) -> tuple[CheckedFile, Part | None]:
        """Reads a part and checks all of it. Returns the part if it cannot be mapped, because its tree is built again here.

        Raises:
            ValueError, TypeError, KeyError, RuntimeError, OSError: it is damaged, or another part.
        """
        fetch(file)
        arrays = read_archive(file)
        if str(arrays["label"]) != label_of(self.parts.mark, number):
            raise ValueError(f"its label is {arrays['label']}")
        known: Any
        (mesh,), accelerator, _, known, _ = parse_scene(arrays)
        ids, count = arrays["ids"], int(self.parts.triangles[number])
        if ids.dtype != np.int32 or ids.shape != (count,) or mesh.triangle_count != count:
            raise ValueError(f"it has {mesh.triangle_count} triangles and {ids.shape} numbers, not {count}")
        if mesh.vertex_count != self.parts.vertices[number]:
            raise ValueError(f"it has {mesh.vertex_count} vertices, not {self.parts.vertices[number]}")
        if ids[0] < 0 or ids[-1] >= self.parts.first[-1] or (ids[1:] <= ids[:-1]).any():  # differences of int32 may wrap around
            raise ValueError("the numbers of its triangles do not ascend, or are not those of the scene")
        vertices, width = shifted(self.parts.center, mesh.vertices), native_width(self.settings.device)
        low, high = (wp.vec3(*corner.tolist()) for corner in self.parts.bounds)
        if tree_key(vertices.numpy(), mesh.faces, accelerator, width) == known.key:
            check_extras(arrays, vertices.numpy(), len(known.known.primitive))
            places = array_places(file)
            check_places(file, places, arrays)
            bare = replace(known.known, bounds=None, child=None, primitive=None, low=low, high=high)
            return CheckedFile(identity, places, bare), None
        # a version of wrt with other builders wrote it, or vectors have another width
        self.bytes_read = sum(array.nbytes for array in arrays.values())
        faces = wp.array(mesh.faces, dtype=wp.vec3i, device=as_device("cpu"), copy=False)
        tree = accelerator.build(triangle_boxes(vertices, faces, self.parts.center), width)
        numbers = wp.array(ids, dtype=int, device=as_device("cpu"), copy=False)
        part = self._placed(replace(tree, low=low, high=high), vertices, faces, numbers)  # type: ignore[arg-type]
        return CheckedFile(identity, {}, None), part

    def _map(self, file: FileIO, known: CheckedFile, record: Record | None) -> Part:
        """Maps the arrays of a file that was checked before.

        Raises:
            ValueError: the file became shorter meanwhile.
        """
        stored = next((name for name in known.places if name.startswith(RECORDS)), None)
        if stored is not None and (
            TRIANGLE_TESTS[stored.removeprefix(RECORDS)].record != record or not self.settings.device.is_cpu
        ):
            stored = None
        has_relative = RELATIVE in known.places
        names = [name for name in FORMS if name not in (RELATIVE, RECORDS)]
        names += [RELATIVE if has_relative else "vertices.0", *([stored] if stored else [])]
        arrays = mapped(file, {name: known.places[name] for name in names})
        self.bytes_read = sum(known.places[name].bytes for name in names)
        vertices = arrays[RELATIVE] if has_relative else shifted(self.parts.center, arrays["vertices.0"], empty)
        tree = replace(known.tree, **{name: arrays[f"tree.{name}"] for name in TREE})
        part = self._placed(tree, vertices, arrays["faces.0"], arrays["ids"])
        if stored is not None:
            blocks = TriangleBlocks()
            blocks.records, blocks.primitive = arrays[stored], tree.primitive
            part.state.cache.records["bvh", record] = None, blocks
        return part

    def _placed(self, tree: Bvh, vertices: wp.array, faces: wp.array, ids: wp.array) -> Part:
        """The part on the scene's device."""
        device = self.settings.device
        mesh = SceneMesh()
        mesh.vertices, mesh.faces = vertices.to(device), faces.to(device)
        mesh.center = wp.vec3d(*map(float, self.parts.center))
        mesh.low, mesh.high = tree.low, tree.high
        state = MeshState(
            settings=self.settings, meshes=(), center=self.parts.center, built_tree=tree.to(device), device_mesh=mesh
        )
        return Part(state, ids.to(device))


def check_extras(arrays: dict[str, np.ndarray], vertices: np.ndarray, slots: int) -> None:
    """Checks what a part's file holds so that it need not be computed again, if it holds it.

    Args:
        arrays: of the file.
        vertices: (V, 3) float32, relative to the scene's centre.
        slots: number of lanes of the leaf blocks of its tree.

    Raises:
        ValueError, KeyError: it does not fit the part.
    """
    if RELATIVE in arrays and not np.array_equal(arrays[RELATIVE], vertices, equal_nan=True):
        raise ValueError("its vertices differ from those relative to the scene's centre")
    for name in arrays:
        if name.startswith(RECORDS):
            size = slots * TRIANGLE_TESTS[name.removeprefix(RECORDS)].record.components
            if arrays[name].dtype != np.float32 or arrays[name].shape != (size,):
                raise ValueError(f"{name} holds {arrays[name].shape} of {arrays[name].dtype}, not {size} of float32")


def form_of(name: str) -> tuple[type, type, int] | None:
    """Warp's type, NumPy's type and the number of axes of an array that kernels read where it is; None for others."""
    return FORMS.get(RECORDS if name.startswith(RECORDS) else name)


def check_places(file: FileIO, places: dict[str, ArrayPlace], arrays: dict[str, np.ndarray]) -> None:
    """Checks that arrays are in the file as kernels read them there, with the contents that were checked.

    An archive may hold the same numbers in another type, such as int16, in another order of bytes or of indices, or compressed.
    NumPy reads all of them alike; kernels would follow indices of other bytes.

    Args:
        file: a part's file.
        places: where its arrays are.
        arrays: what was read of it and checked.

    Raises:
        ValueError: an array is there in another form.
    """
    size = os.fstat(file.fileno()).st_size
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapping:
        for name, array in arrays.items():
            form = form_of(name) or ((None, array.dtype.newbyteorder("="), 2) if name == "vertices.0" else None)
            if form is None:
                continue
            (_, dtype, axes), place = form, places[name]
            if place.dtype != dtype or len(place.shape) != axes or (axes == 2 and (place.shape[1] != 3 or place.is_fortran)):
                raise ValueError(
                    f"{name} holds {place.shape} of {place.dtype.str}, and must be mapped as {np.dtype(dtype).str}"
                )
            if place.offset + place.bytes > size or mapping[place.offset : place.offset + place.bytes] != array.tobytes():
                raise ValueError(f"{name} is not in the file as it was read")


def identity_of(file: FileIO) -> tuple[int, ...]:
    """What changes if a file is written or replaced: device, inode, size, time of change."""
    status = os.fstat(file.fileno())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def mapped(file: FileIO, places: dict[str, ArrayPlace]) -> dict[str, Any]:
    """Arrays of a checked file as flat Warp arrays on the CPU in mapped memory, which may only be read; vertices as they were
    given as a NumPy array.

    Their pages are mapped at once where the system can do that: page faults would take several times as long. Arrays that do
    not begin at multiples of `ALIGNED`, in files of earlier versions, are copied.

    Raises:
        ValueError: the file is shorter than it was.
    """
    begin = min(place.offset for place in places.values()) // mmap.ALLOCATIONGRANULARITY * mmap.ALLOCATIONGRANULARITY
    end = max(place.offset + place.bytes for place in places.values())
    if os.fstat(file.fileno()).st_size < end:
        raise ValueError(f"'{file.name}' ends early; restore it, or build the scene again")
    mapping = mmap.mmap(file.fileno(), end - begin, offset=begin, access=mmap.ACCESS_READ)
    populate(mapping)
    space = np.frombuffer(mapping, dtype=np.uint8)
    address, cpu = space.__array_interface__["data"][0] - begin, as_device("cpu")
    arrays: dict[str, Any] = {}
    for name, place in places.items():
        dtype = form[0] if (form := form_of(name)) else None
        if dtype is None or (address + place.offset) % ALIGNED:
            piece = space[place.offset - begin : place.offset - begin + place.bytes]
            array = np.array(piece).view(place.dtype).reshape(place.shape, order="F" if place.is_fortran else "C")
            arrays[name] = array if dtype is None else wp.array(array, dtype=dtype, device=cpu, copy=False)
            continue
        count = place.bytes // wp.types.type_size_in_bytes(dtype)
        mapped = wp.array(ptr=address + place.offset, dtype=dtype, shape=count, capacity=place.bytes, device=cpu)
        arrays[name] = keep_alive(mapped, space)
    return arrays


def populate(mapping: mmap.mmap) -> None:
    """Maps all pages of a mapping at once, large ones where there are any; on Linux only."""
    if not sys.platform.startswith("linux"):
        return
    for advice in (mmap.MADV_HUGEPAGE, MADV_POPULATE_READ):
        with suppress(OSError):  # an earlier Linux: pages are mapped when they are accessed
            mapping.madvise(advice)


def fetch(file: FileIO) -> None:
    """Brings a file into the system's cache, in large pages if it is not there yet."""
    if os.fstat(file.fileno()).st_size:
        populate(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
