"""The files of a partitioned scene: a list of its parts, and a scene file for each part.

`scene.npz` lists the parts; `part-00000.npz` and so on are files of `wrt.Scene.save` with more arrays: the numbers that the
part's triangles have in the whole scene, and a label that says which part of which scene it is. Most files also hold what need
not be computed when a part is loaded: vertices relative to the scene's centre, and triangle records in the order of the
tree's leaves. Each is an archive with a checksum (`wrt.scene.archives`). A part whose arrays or label do not match is refused.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from wrt.scene.archives import check_format, checked_reading, read_archive, write_archive

FORMAT = 1
"""Version of the list of parts; incremented when the contents change."""

LIST = "scene.npz"

RELATIVE = "relative"
"""Array of a part's vertices relative to the scene's centre (`shifted` computes them). Files of earlier versions have none."""

RECORDS = "records."
"""Begin of the name of the array of triangle records; the name of a triangle test that reads such records follows."""

MAX_TRIANGLES = (1 << 31) - 1
"""Greatest number of triangles: they are numbered with 32 bits."""

MAX_PARTS = 65_534
"""Greatest number of parts."""

LARGEST = 1 << 50
"""Greatest number of bytes of a part's tree, and of lanes of its leaves."""

MAPPED = ("faces.", "ids", RELATIVE, "tree.", RECORDS)
"""Begins of the names of arrays that are mapped into memory."""


@dataclass(frozen=True)
class PartList:
    """The parts of a scene, and what they have in common.

    Attributes:
        mark: identifier of the scene, in the label of each of its parts.
        names: names of the meshes.
        first: (meshes + 1,) int64, first triangle of each mesh, and the number of all triangles.
        center: (3,) float64, which positions are relative to.
        bounds: (2, 3) float32, corners of the box of all triangles, relative to the centre.
        low, high: (P, 3) float32, corners of the box of each part, relative to the centre.
        triangles, vertices, slots: (P,) int64, numbers of triangles, of vertices, and of lanes of leaf blocks of each part.
        tree_bytes: (P,) int64, bytes of each part's tree.
    """

    mark: str
    names: tuple[str | None, ...]
    first: np.ndarray
    center: np.ndarray
    bounds: np.ndarray
    low: np.ndarray
    high: np.ndarray
    triangles: np.ndarray
    vertices: np.ndarray
    slots: np.ndarray
    tree_bytes: np.ndarray

    ARRAYS = ("first", "center", "bounds", "low", "high", "triangles", "vertices", "slots", "tree_bytes")

    def __len__(self) -> int:
        """Number of parts."""
        return len(self.triangles)

    def bytes_with(self, components: int) -> np.ndarray:
        """(P,) int64: memory of each part with records of this many floats per triangle: as in `wrt.Scene.bytes`, and 4 bytes
        per triangle for its number in the whole scene."""
        return self.tree_bytes + 12 * self.vertices + 16 * self.triangles + 4 * components * self.slots


def part_path(folder: Path, number: int) -> Path:
    """The file of a part."""
    return folder / f"part-{number:05d}.npz"


def label_of(mark: str, number: int) -> str:
    """The label of a part."""
    return json.dumps({"scene": mark, "part": number})


def write_list(folder: Path, parts: PartList) -> None:
    """Writes the list of parts.

    Raises:
        OSError: it cannot be written.
    """
    header = {"partitioned": FORMAT, "mark": parts.mark, "names": parts.names}
    arrays = {name: getattr(parts, name) for name in PartList.ARRAYS}
    write_archive(folder / LIST, arrays | {"header": np.array(json.dumps(header))})


def read_list(folder: Path) -> PartList:
    """Reads the list of parts.

    Raises:
        FileNotFoundError: the folder has none.
        ValueError: it is damaged, or of another version.
    """
    path = folder / LIST
    if not path.is_file():
        raise FileNotFoundError(
            f"no partitioned scene in '{folder}': there is no file '{LIST}'; make one with wrt.disk.PartitionedScene.build"
        )
    with checked_reading(path, "the list of a partitioned scene", "build it again"):
        arrays = read_archive(path)
        header = json.loads(str(arrays["header"]))
        check_format(header["partitioned"], FORMAT)
        values = {name: arrays[name] for name in PartList.ARRAYS}
        parts = PartList(mark=header["mark"], names=tuple(header["names"]), **values)
        check_list(parts)
        return parts


def check_list(parts: PartList) -> None:
    """Checks what a list of parts holds: types, shapes, and numbers that belong together.

    Raises:
        TypeError, ValueError: it is not one that `write_list` wrote.
    """
    meshes, count = len(parts.names), len(parts)
    if not isinstance(parts.mark, str) or not all(name is None or isinstance(name, str) for name in parts.names):
        raise ValueError("its mark or a name is not a text")
    forms = {
        "first": (np.int64, (meshes + 1,)),
        "center": (np.float64, (3,)),
        "bounds": (np.float32, (2, 3)),
        **dict.fromkeys(("low", "high"), (np.float32, (count, 3))),
        **dict.fromkeys(("triangles", "vertices", "slots", "tree_bytes"), (np.int64, (count,))),
    }
    for name, (dtype, shape) in forms.items():
        array = getattr(parts, name)
        if array.dtype != dtype or array.shape != shape:
            raise ValueError(f"{name} holds {array.shape} of {array.dtype.str}, not {shape} of {np.dtype(dtype).str}")
    if not (meshes and 1 <= count <= MAX_PARTS):
        raise ValueError(f"it lists {meshes} meshes and {count} parts")
    first, triangles = parts.first.tolist(), parts.triangles.tolist()
    if first[0] != 0 or not all(a < b for a, b in pairwise(first)) or min(triangles) < 1 or sum(triangles) != first[-1]:
        raise ValueError("its numbers of triangles do not belong together")
    if first[-1] > MAX_TRIANGLES or not ((parts.vertices >= 1) & (parts.vertices <= 3 * parts.triangles)).all():
        raise ValueError("its numbers of triangles or of vertices are too large or too small")
    for name in ("slots", "tree_bytes"):
        if not ((getattr(parts, name) >= 1) & (getattr(parts, name) <= LARGEST)).all():
            raise ValueError(f"its {name} are too large or too small")
    if not np.isfinite(parts.center).all() or not all(map(is_boxes, ((parts.low, parts.high), parts.bounds))):  # type: ignore[arg-type]
        raise ValueError("its boxes are not finite, or a lower corner is above the upper one")


def is_boxes(corners: Sequence[np.ndarray]) -> bool:
    """Whether lower and upper corners are finite and in order."""
    low, high = corners
    return bool(np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all())
