"""Parts in memory: loaded when rays need them, within a budget.

The part unused for longest leaves first. In a round that needs each part once, those that it has not used leave first, and then
the newest: parts that stay are there for the next round, and memory that leaves is still in the processor's caches when the
next part is read into it.

A thread that loads the next part meanwhile was tried: with two cores it takes more time from tracing than it saves
(notebooks/records/2026-11-23-parts-on-disk.md).

The first time a part is loaded, its file is checked as `wrt.Scene.load` checks one: checksum, sizes, and the indices in its
tree. Later the arrays are read from the places where they are in the file, as long as the file has not changed since (size,
time of change, inode); a file that has changed is checked again.

References:
    M. Pharr, C. Kolb, R. Gershbein, P. Hanrahan: Rendering complex scenes with memory-coherent ray tracing. SIGGRAPH 1997
        (a cache of geometry, least recently used first).
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.kernels.layout.mesh_placement import shifted
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import as_device, run_tasks
from wrt.kernels.simd.lanes import native_width
from wrt.memory import empty
from wrt.partitioned.partition_files import PartList, label_of, part_path
from wrt.scene.archives import ArrayPlace, array_places, read_archive
from wrt.scene.mesh_state import MeshState
from wrt.scene.storage import UNREADABLE, parse_scene, tree_key
from wrt.state.scene_settings import Settings
from wrt.state.scene_state import SceneState

TYPES = {
    "tree.bounds": wp.float32,
    "tree.child": wp.int32,
    "tree.primitive": wp.int32,
    "faces.0": wp.vec3i,
    "ids": wp.int32,
}
"""Arrays of a part's file that are read as they are, and what they hold."""


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
        """Memory of the part, with the triangle records that queries have made."""
        return self.state.bytes + self.ids.capacity


@dataclass(frozen=True)
class CheckedFile:
    """A file of a part that was checked.

    Attributes:
        identity: inode, size and time of change.
        places: where its arrays are.
        tree: its tree, without arrays; None if this machine builds another one.
    """

    identity: tuple[int, ...]
    places: dict[str, ArrayPlace]
    tree: Bvh | None


@dataclass
class Traffic:
    """What was loaded.

    Attributes:
        loads: number of parts loaded.
        bytes_read: bytes read from files.
        peak_bytes: most memory of all parts together.
    """

    loads: int = 0
    bytes_read: int = 0
    peak_bytes: int = 0


class PartCache:
    """The parts of a scene that are in memory.

    Args:
        folder: the folder of the scene.
        parts: the list of its parts.
        settings: of the scene.
        budget: most memory of all parts together, in bytes.
    """

    def __init__(self, folder: Path, parts: PartList, settings: Settings, budget: int) -> None:
        self.folder, self.parts, self.settings, self.budget = folder, parts, settings, budget
        self.traffic = Traffic()
        self._loaded: OrderedDict[int, Part] = OrderedDict()
        self._bytes: dict[int, int] = {}
        self._total = 0
        self._used: set[int] | None = None
        self._checked: dict[int, CheckedFile] = {}
        self.is_loaded = np.zeros(len(parts), dtype=bool)

    @property
    def bytes(self) -> int:
        """Memory of all loaded parts."""
        return self._total

    def clear(self) -> None:
        """Drops all parts."""
        self._loaded.clear()
        self._bytes.clear()
        self._total = 0
        self.is_loaded[:] = False

    @contextmanager
    def one_round(self) -> Iterator[None]:
        """For a `with` block in which each part is needed once at most."""
        self._used = set()
        try:
            yield
        finally:
            self._used = None

    def part(self, number: int, expected_bytes: int) -> Part:
        """A part, loaded if it is not in memory.

        Args:
            number: of the part.
            expected_bytes: its memory with the records of the query; so much is made free first.

        Raises:
            FileNotFoundError, PermissionError: the file is gone, or may not be read.
            ValueError: it is damaged, or the part of another scene.
        """
        if number not in self._loaded:
            self.make_room(expected_bytes)
            self._loaded[number] = part = self._load(number)
            self._bytes[number] = part.bytes
            self._total += part.bytes
            self.is_loaded[number] = True
            self.traffic.loads += 1
        self._loaded.move_to_end(number)
        if self._used is not None:
            self._used.add(number)
        return self._loaded[number]

    def make_room(self, expected_bytes: int) -> None:
        """Drops parts until so much more memory is within the budget."""
        while self._loaded and self._total + expected_bytes > self.budget:
            oldest = next(iter(self._loaded))
            newest_leaves = self._used is not None and oldest in self._used  # then so are all
            number, _ = self._loaded.popitem(last=newest_leaves)
            self._total -= self._bytes.pop(number)
            self.is_loaded[number] = False

    def note_use(self, number: int) -> None:
        """Records the memory in use, once a query has made the triangle records of a part."""
        now = self._loaded[number].bytes
        self._total += now - self._bytes[number]
        self._bytes[number] = now
        self.traffic.peak_bytes = max(self.traffic.peak_bytes, self.bytes)

    def _load(self, number: int) -> Part:
        path = part_path(self.folder, number)
        if not path.is_file():
            raise FileNotFoundError(
                f"part {number} of the scene is gone: no file '{path}'; restore it, or build the scene again"
            )
        known, identity = self._checked.get(number), identity_of(path)
        if known is not None and known.identity == identity and known.tree is not None:
            return self._read_again(path, known)
        self._checked.pop(number, None)
        try:
            return self._read_checked(path, number, identity)
        except PermissionError:
            raise
        except UNREADABLE as error:
            reason = f"{type(error).__name__}: {error}"
            raise ValueError(
                f"'{path}' is not part {number} of this scene, or it is damaged ({reason}); restore it, or build the scene "
                "again"
            ) from error

    def _read_checked(self, path: Path, number: int, identity: tuple[int, ...]) -> Part:
        """Reads a part and checks all of it.

        Raises:
            ValueError, TypeError, KeyError, RuntimeError, OSError: it is damaged, or another part.
        """
        arrays = read_archive(path)
        self.traffic.bytes_read += sum(array.nbytes for array in arrays.values())
        if str(arrays["label"]) != label_of(self.parts.mark, number):
            raise ValueError(f"its label is {arrays['label']}")
        (mesh,), accelerator, _, known, _ = parse_scene(arrays)
        ids, count = arrays["ids"], int(self.parts.triangles[number])
        if ids.dtype != np.int32 or ids.shape != (count,) or mesh.triangle_count != count:
            raise ValueError(f"it has {mesh.triangle_count} triangles and {ids.shape} numbers, not {count}")
        if ids[0] < 0 or ids[-1] >= self.parts.first[-1] or (np.diff(ids) <= 0).any():
            raise ValueError("the numbers of its triangles do not ascend, or are not those of the scene")
        vertices, width = shifted(self.parts.center, mesh.vertices), native_width(self.settings.device)
        faces = wp.array(mesh.faces, dtype=wp.vec3i, device=as_device("cpu"), copy=False)
        is_ours = tree_key(vertices.numpy(), mesh.faces, accelerator, width) == known.key
        tree = known.known
        if not is_ours:  # another version of wrt wrote it, or vectors have another width
            tree = accelerator.build(triangle_boxes(vertices, faces, self.parts.center), width)
        low, high = (wp.vec3(*corner.tolist()) for corner in self.parts.bounds)
        tree = replace(tree, low=low, high=high)
        bare = replace(tree, bounds=None, child=None, primitive=None) if is_ours else None
        self._checked[number] = CheckedFile(identity, array_places(path), bare)
        return self._placed(tree, vertices, faces, wp.array(ids, dtype=int, device=as_device("cpu"), copy=False))

    def _read_again(self, path: Path, known: CheckedFile) -> Part:
        """Reads the arrays of a file that was checked before.

        Raises:
            ValueError: the file became shorter meanwhile.
        """
        arrays: dict[str, Any] = {}
        wanted = [*TYPES.items(), ("vertices.0", None)]

        def read(number: int) -> None:
            name, dtype = wanted[number]
            place = known.places[name]
            array = fresh(place) if dtype is None else empty(place.shape[0], dtype, as_device("cpu"))
            fill(path, place, array if dtype is None else array.numpy())
            arrays[name] = array

        run_tasks(read, len(wanted))
        self.traffic.bytes_read += sum(known.places[name].bytes for name, _ in wanted)
        tree = replace(known.tree, **{name: arrays[f"tree.{name}"] for name in ("bounds", "child", "primitive")})
        vertices = shifted(self.parts.center, arrays["vertices.0"], empty)
        return self._placed(tree, vertices, arrays["faces.0"], arrays["ids"])

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


def identity_of(path: Path) -> tuple[int, ...]:
    """What changes if a file is written or replaced: inode, size, time of change."""
    status = os.stat(path)
    return status.st_ino, status.st_size, status.st_mtime_ns


def fill(path: Path, place: ArrayPlace, array: np.ndarray) -> None:
    """Reads an array of a file.

    Raises:
        ValueError: the file ends early.
    """
    with open(path, "rb", buffering=0) as file:
        file.seek(place.offset)
        if file.readinto(memoryview(array.reshape(-1).view(np.uint8))) != array.nbytes:
            raise ValueError(f"'{path}' ends early; restore it, or build the scene again")


def fresh(place: ArrayPlace) -> np.ndarray:
    """A NumPy array for an array of a file, with undefined contents; its memory may be reused."""
    block = empty(place.bytes, wp.uint8, as_device("cpu"))
    return block.numpy().view(place.dtype).reshape(place.shape)
