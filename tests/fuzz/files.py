"""Damaged files: `TriangleMesh.load` and `Scene.load` refuse them with a clear error, or read them; nothing else.

A small mesh is written in some format; then bytes are changed, moved, cut off or repeated, numbers in text are replaced, or
words of 32 bits set to the ends of their range. Arrays of saved scenes are changed as arrays too, because their archives notice
changed bytes. What could be read becomes a scene, and rays are shot at it. More memory than a process may take is a failure, as
is a crash.
"""

from __future__ import annotations

import io
import re
import tempfile
import warnings
from pathlib import Path

import numpy as np

import wrt

from . import floats
from .cases import Case, WrongAnswer

FORMATS = ("obj", "ply", "ply_ascii", "stl", "stl_ascii", "off", "glb", "npz")

NUMBERS = (
    b"1e39", b"-1e39", b"nan", b"inf", b"1e400", b"-1", b"0", b"4294967296", b"2147483647", b"99999999999999999999", b"1e-46",
    b"", b"x", b"1/1/1", b"0x10", b"1.5",
)  # fmt: skip
"""In place of a number in text."""

WORDS = np.array([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7F800000, 0x7FC00001, 0x7F7FFFFF, 0x00000001], dtype=np.uint32)
"""In place of 32 bits."""

CLEAN = (ValueError, TypeError, OSError)
"""Errors that tell a user what is wrong."""


def make_case(rng: np.random.Generator) -> Case:
    """A file of some format, damaged."""
    style = str(rng.choice(FORMATS))
    data = written(rng, style)
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        data = MUTATIONS[rng.integers(len(MUTATIONS))](rng, data)
    return Case("files", {"suffix": style.split("_")[0]}, {"data": np.frombuffer(data, dtype=np.uint8)})


def written(rng: np.random.Generator, style: str) -> bytes:
    """A small mesh, or a scene, as a file; arrays of scenes may be damaged."""
    import trimesh

    points = rng.normal(size=(int(rng.integers(1, 9)), 3, 3)).astype(np.float32)
    vertices, faces = floats.shared(rng, points)
    if style == "npz":
        return scene_file(rng, wrt.TriangleMesh(vertices, faces))
    mesh, (suffix, _, text) = trimesh.Trimesh(vertices, faces, process=False), style.partition("_")
    if suffix == "stl" and text:
        suffix = "stl_ascii"
    options = {"encoding": "ascii"} if suffix == "ply" and text else {}
    data = mesh.export(file_type=suffix, **options)
    return data.encode() if isinstance(data, str) else bytes(data)


def scene_file(rng: np.random.Generator, mesh: wrt.TriangleMesh) -> bytes:
    """A saved scene, with some of its arrays changed."""
    tree = wrt.Bvh(width=int(rng.choice([2, 8]))) if rng.random() < 0.5 else wrt.KdTree(width=8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.npz"
        wrt.Scene(mesh, tree, device="cpu").save(path)
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
    for _ in range(int(rng.integers(0, 3))):
        name = str(rng.choice(list(arrays)))
        arrays[name] = changed(rng, arrays[name])
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def changed(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    """An array with other values, another shape or another type."""
    kind = rng.integers(0, 4)
    if array.dtype.kind == "U":
        text = MUTATIONS[rng.integers(len(MUTATIONS))](rng, str(array).encode())
        return np.array(text.decode(errors="replace"))
    if kind == 0 or array.size == 0:
        return array.ravel()[: int(rng.integers(0, array.size + 1))]
    if kind == 1:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return array.astype(rng.choice(["f4", "f8", "i4", "i8", "u1", "U4", "c8"]))
    if kind == 2:
        return np.tile(array, 2)
    array = np.array(array, copy=True)
    if array.dtype.itemsize == 4:
        array.reshape(-1).view(np.uint32)[rng.integers(array.size)] = rng.choice(WORDS)
    return array


# -- damage ------------------------------------------------------------------------------------------------------------


def flip_bits(rng: np.random.Generator, data: bytes) -> bytes:
    """Some bytes are others."""
    array = np.frombuffer(data, dtype=np.uint8).copy()
    if len(array):
        places = rng.integers(0, len(array), int(rng.integers(1, 6)))
        array[places] = rng.integers(0, 256, len(places))
    return array.tobytes()


def set_word(rng: np.random.Generator, data: bytes) -> bytes:
    """32 bits are at an end of their range."""
    at = int(rng.integers(0, max(1, len(data) - 3)))
    return data[:at] + rng.choice(WORDS).tobytes() + data[at + 4 :]


def cut_off(rng: np.random.Generator, data: bytes) -> bytes:
    """The end is missing."""
    return data[: int(rng.integers(0, len(data) + 1))]


def repeat(rng: np.random.Generator, data: bytes) -> bytes:
    """A part is there twice, or missing."""
    a, b = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    return data[:b] + data[a:] if rng.random() < 0.5 else data[:a] + data[b:]


def replace_number(rng: np.random.Generator, data: bytes) -> bytes:
    """A number in text is another one."""
    found = list(re.finditer(rb"[-+]?\d[\d.eE+-]*", data[: 1 << 16]))
    if not found:
        return set_word(rng, data)
    chosen = found[rng.integers(len(found))]
    return data[: chosen.start()] + NUMBERS[rng.integers(len(NUMBERS))] + data[chosen.end() :]


MUTATIONS = (flip_bits, set_word, cut_off, repeat, replace_number, replace_number, replace_number)


def run_case(case: Case) -> str:
    """Loads the file, and what is in it is asked a few rays."""
    data, suffix = case.arrays["data"].tobytes(), case.options["suffix"]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(folder) / f"file.{suffix}"
        path.write_bytes(data)
        try:
            if suffix == "npz":
                scene = wrt.Scene.load(path, device="cpu")
            else:
                scene = wrt.Scene(wrt.TriangleMesh.load(path), device="cpu")
        except CLEAN as error:
            if not str(error):
                raise WrongAnswer("an error without a message") from error
            return "refused"
    low, high = scene.bounds
    origins = np.nan_to_num(np.array([low, high, (low + high) / 2]))
    directions = np.array([[1.0, 1.0, 1.0], [-1.0, -0.5, -1.0], [0.0, 0.0, 1.0]])
    scene.intersect(origins, directions, traversal="single")
    scene.count(origins, directions, traversal="single")
    return "read"
