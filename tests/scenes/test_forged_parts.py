"""Parts of a scene that were forged with their checksum: what kernels would read as other bytes than were checked is refused.

Files are read by NumPy, which converts types and orders, and then mapped as they are. Where a test failed once, the process
ended with a segmentation fault.
"""

from __future__ import annotations

import io
import os
import shutil
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.disk.part_loading import PartLoader
from wrt.disk.partition_files import LIST, RECORDS, RELATIVE, part_path
from wrt.scene.archives import CHECKSUM, array_places, checksum, read_archive, write_archive
from wrt.scene.storage import pack_tree, unpack_tree

MESH = wrt.scenes.build("teapot", level=3)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("forged") / "scene"
    narrow = wrt.Bvh(width=4)  # so that there are several levels
    wrt.disk.PartitionedScene.build(MESH, path, part_triangles=400, accelerator=narrow, device="cpu")
    return path


@pytest.fixture(scope="module")
def rays():
    return mixed_rays(MESH, 500)


@pytest.fixture
def folder(built, tmp_path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "scene"))


def refused(folder: Path, rays, reason: str = "") -> None:
    """The part is refused, before and after the files around it are loaded, and also if it is tried again."""
    scene = wrt.disk.PartitionedScene(folder, device="cpu")
    for _ in range(2):
        with pytest.raises(ValueError, match=f"part 0 of this scene, or it is damaged .*{reason}"):
            scene.count(*rays)


def member(name: str, array: np.ndarray, dtype: np.dtype | None = None) -> bytes:
    """An array as in a file."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array, dtype=dtype), allow_pickle=False)
    return stream.getvalue()


MAPPED = ("faces.0", "ids", RELATIVE, "tree.bounds", "tree.child", "tree.primitive", RECORDS)


def full_name(arrays: dict[str, np.ndarray], name: str) -> str:
    return next(one for one in arrays if one.startswith(name)) if name == RECORDS else name


FORMS = {
    "big-endian": lambda array: array.astype(array.dtype.newbyteorder(">")),
    "narrow": lambda array: array.astype(np.float16 if array.dtype.kind == "f" else np.int16),
    "wide": lambda array: array.astype(np.float64 if array.dtype.kind == "f" else np.int64),
    "unsigned or integer": lambda array: array.view(np.uint32),
    "other kind": lambda array: array.view(np.int32 if array.dtype.kind == "f" else np.float32),
    "one axis more": lambda array: array[None],
    "columns": lambda array: array.reshape(-1, 1),
    "flat or in threes": lambda array: array.reshape(-1) if array.ndim == 2 else array[: len(array) // 3 * 3].reshape(-1, 3),
    "shorter": lambda array: array[:-1],
    "longer": lambda array: np.concatenate([array, array[-1:]]),
    "empty": lambda array: array[:0],
    "a scalar": lambda array: array.reshape(-1)[0],
    "in Fortran's order": lambda array: np.asfortranarray(array if array.ndim == 2 else array.reshape(-1, 2)),
    "text": lambda array: array.astype("S4"),
    "complex": lambda array: array.astype(np.complex64),
    "a record": lambda array: array.reshape(-1).view([("a", "<i4")]),
    "times": lambda array: np.zeros(array.shape, "<M8[s]"),
}


@pytest.mark.parametrize("name", MAPPED)
def test_arrays_of_another_form_are_refused(folder, rays, name):
    """Faces of 16 bits or of the other order of bytes were converted, checked, and then mapped as they were. Every array that
    kernels read where it is, in every form that NumPy reads."""
    path = part_path(folder, 0)
    arrays = read_archive(path)
    name = full_name(arrays, name)
    for kind, form in FORMS.items():
        changed = form(arrays[name])
        if changed.dtype == arrays[name].dtype and changed.shape == arrays[name].shape and kind != "in Fortran's order":
            continue
        write_archive(path, arrays | {name: changed})
        refused(folder, rays)
    write_archive(path, {key: array for key, array in arrays.items() if key != name})
    if name in (RELATIVE, full_name(arrays, RECORDS)):  # files may have none
        assert wrt.disk.PartitionedScene(folder, device="cpu").count(*rays).sum() > 0
    else:
        refused(folder, rays)


@pytest.mark.parametrize("name", ["faces.0", "ids", "tree.child", "tree.primitive"])
def test_indices_out_of_range_are_refused(folder, rays, name):
    """Numbers of triangles ended in -2^31: the difference from the one before wraps around in int32, and was positive."""
    path = part_path(folder, 0)
    arrays = read_archive(path)
    for place in (0, arrays[name].size // 2, -1):
        for value in (1 << 20, -(1 << 20), (1 << 31) - 1, -(1 << 31)):
            changed = arrays[name].copy()
            changed.reshape(-1)[place] = value
            write_archive(path, arrays | {name: changed})
            refused(folder, rays)


LEVELS = {
    "floats": lambda levels: levels.astype(np.float64),
    "NaN": lambda levels: np.concatenate([levels[:1], [np.nan], levels[-1:]]),
    "unsigned": lambda levels: levels.astype(np.uint64),
    "wrapping": lambda levels: np.int64([0, (1 << 63) - 1, -(1 << 63) + 5, levels[-1]]),
    "out of order": lambda levels: np.concatenate([levels[:1], levels[1:-1][::-1], levels[-1:]]),
    "beyond": lambda levels: np.concatenate([levels[:1], [1 << 40], levels[-1:]]),
    "columns": lambda levels: levels[:, None],
}


@pytest.mark.parametrize("kind", LEVELS)
def test_levels_of_a_tree_are_checked(folder, rays, kind):
    """With a NaN among the levels, no child was compared with any; differences of int64 wrap around."""
    path = part_path(folder, 0)
    arrays = read_archive(path)
    child = arrays["tree.child"].copy()
    if kind not in ("floats", "unsigned", "columns"):  # these are refused though their numbers are right
        child[np.flatnonzero(child >= 0)[-1]] = 1 << 28
    assert len(arrays["tree.level_first"]) > 3
    levels = LEVELS[kind](arrays["tree.level_first"])
    write_archive(path, arrays | {"tree.level_first": levels, "tree.child": child})
    refused(folder, rays)


def test_levels_that_wrap_around_are_refused():
    """The difference of each from the one before is positive in int64, and the root's child is far behind the last node."""
    scene = wrt.Scene(wrt.TriangleMesh(np.eye(3), [[0, 1, 2]]), "bvh", device="cpu")
    arrays = pack_tree(scene.tree)
    unpack_tree(arrays, 1)
    levels = np.int64([0, 1, 1 << 62, (1 << 63) - 1, -(1 << 62), 1])
    assert (np.diff(levels) > 0).all()
    child = np.full_like(arrays["child"], 1 << 28)
    with pytest.raises(ValueError, match="level_first does not divide the 1 nodes"):
        unpack_tree(arrays | {"level_first": levels, "child": child}, 1)


def forge_archive(path: Path, arrays: dict[str, np.ndarray], change) -> None:
    """Writes an archive whose members `change` makes, given the archive, a name and the bytes of an array."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.comment = bytes(60_000)  # the file is larger than the sum of its arrays
        for name, array in {**arrays, CHECKSUM: np.array(checksum(arrays))}.items():
            change(archive, name, member(name, array))


def test_archives_that_read_differently_are_refused(folder, rays):
    """Compressed members, whose bytes in the file are others; two members of one name; other bytes where the local header
    points to."""
    path = part_path(folder, 0)
    arrays = read_archive(path)

    def compressed(archive, name, content):
        kind = zipfile.ZIP_DEFLATED if name == "faces.0" else zipfile.ZIP_STORED
        archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content, compress_type=kind)

    forge_archive(path, arrays, compressed)
    with zipfile.ZipFile(path) as archive:
        assert sum(one.file_size for one in archive.infolist()) < path.stat().st_size
    refused(folder, rays, "its arrays are compressed")

    def twice(archive, name, content):
        archive.writestr(f"{name}.npy", content)
        if name == "faces.0":
            archive.writestr(f"{name}.npy", content)

    with pytest.warns(UserWarning, match="Duplicate name"):
        forge_archive(path, arrays, twice)
    refused(folder, rays, "two of its arrays have the same name")


def test_contents_are_compared_where_they_are_mapped(folder, rays, monkeypatch):
    """Whatever leads to another place of the file than the one that was read."""
    path = part_path(folder, 0)
    places = array_places(path)
    moved = {**places, "faces.0": places["faces.0"]._replace(offset=places["faces.0"].offset + 12)}
    monkeypatch.setattr("wrt.disk.part_loading.array_places", lambda file: moved)
    refused(folder, rays, r"faces\.0 is not in the file as it was read")
    moved["faces.0"] = places["faces.0"]._replace(offset=os.stat(path).st_size - 8)
    refused(folder, rays, r"faces\.0 is not in the file as it was read")


def test_arrays_that_are_not_aligned_are_copied(folder, rays, built):
    """Kernels read vectors at multiples of 64 bytes."""
    expected = wrt.disk.PartitionedScene(built, device="cpu").intersect(*rays)
    path = part_path(folder, 0)
    forge_archive(path, read_archive(path), lambda archive, name, content: archive.writestr(f"x/{name}.npy"[2:], content))
    assert any(place.offset % 64 for place in array_places(path).values())
    scene = wrt.disk.PartitionedScene(folder, device="cpu")
    for _ in range(2):
        assert_same_hits(scene.intersect(*rays), expected)
        scene.release()


def test_a_file_that_is_replaced_while_it_is_checked(folder, rays, built, monkeypatch):
    """What is mapped is the file that was checked, though another one has its name by now."""
    expected = wrt.disk.PartitionedScene(built, device="cpu").intersect(*rays)
    path, check = part_path(folder, 0), PartLoader._check
    arrays = read_archive(path)
    forged = folder.parent / "forged"
    write_archive(forged, arrays | {"faces.0": np.full_like(arrays["faces.0"], 1 << 28)})

    def checked(self, file, number, identity):
        found = check(self, file, number, identity)
        if number == 0 and forged.exists():
            os.replace(forged, path)
        return found

    monkeypatch.setattr(PartLoader, "_check", checked)
    scene = wrt.disk.PartitionedScene(folder, device="cpu")
    assert_same_hits(scene.intersect(*rays), expected)
    assert not forged.exists()
    scene.release()
    with pytest.raises(ValueError, match="part 0 of this scene, or it is damaged"):
        scene.intersect(*rays)


LISTS = {
    "fewer boxes": lambda one: {"low": one["low"][:-1]},
    "wide boxes": lambda one: {"low": one["low"].astype(np.float64)},
    "big-endian boxes": lambda one: {"high": one["high"].astype(">f4")},
    "boxes of NaN": lambda one: {"low": one["low"] * np.float32(np.nan)},
    "boxes inside out": lambda one: {"low": one["high"], "high": one["low"]},
    "infinite bounds": lambda one: {"bounds": np.float32([[-np.inf] * 3, [np.inf] * 3])},
    "a centre of two": lambda one: {"center": one["center"][:2]},
    "a centre of NaN": lambda one: {"center": np.full(3, np.nan)},
    "no parts": lambda one: {name: one[name][:0] for name in ("low", "high", "triangles", "vertices", "slots", "tree_bytes")},
    "more triangles": lambda one: {"triangles": one["triangles"] + 1},
    "negative triangles": lambda one: {"triangles": -one["triangles"]},
    "triangles as floats": lambda one: {"triangles": one["triangles"].astype(float)},
    "too many in all": lambda one: {"first": one["first"] << 40, "triangles": one["triangles"] << 40},
    "meshes out of order": lambda one: {"first": one["first"][::-1].copy()},
    "more meshes": lambda one: {"first": np.append(one["first"], one["first"][-1] + 1)},
    "other vertices": lambda one: {"vertices": one["vertices"] * 0},
    "huge trees": lambda one: {"tree_bytes": one["tree_bytes"] + (1 << 62)},
    "negative lanes": lambda one: {"slots": -one["slots"]},
    "header of another kind": lambda one: {"header": np.array('{"partitioned": 1, "mark": 3, "names": [null]}')},
    "names of another kind": lambda one: {"header": np.array('{"partitioned": 1, "mark": "a", "names": [3]}')},
    "names that are none": lambda one: {"header": np.array('{"partitioned": 1, "mark": "a", "names": 3}')},
}


@pytest.mark.parametrize("kind", LISTS)
def test_lists_of_parts_are_checked(folder, kind):
    """Their arrays were taken as they were, and made the upper tree."""
    arrays = read_archive(folder / LIST)
    write_archive(folder / LIST, arrays | LISTS[kind](arrays))
    with pytest.raises(ValueError, match="not the list of a partitioned scene, or it is damaged"):
        wrt.disk.PartitionedScene(folder, device="cpu")


def test_a_part_with_other_numbers_than_the_list(folder, rays):
    """The list says how much memory a part takes."""
    arrays = read_archive(folder / LIST)
    write_archive(folder / LIST, arrays | {"vertices": np.maximum(arrays["vertices"] - 1, 1)})
    refused(folder, rays, r"it has \d+ vertices, not \d+")


def test_headers_of_arrays_are_bounded(tmp_path):
    """What a header declares is compared with the bytes that are there."""
    path = tmp_path / "archive"
    for shape in ("(-1,)", "(4611686018427387904, 4)", "(1,)"):
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
        content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header + b"\n" + bytes(16)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a.npy", content)
        with pytest.raises(ValueError, match="does not match its size"):
            read_archive(path)
