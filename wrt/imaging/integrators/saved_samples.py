"""The samples of an unfinished picture in a file, with a fingerprint of what the picture shows.

The film holds sums in float32, to which samples are added one by one. So a picture that is continued from the file is the same
bit for bit as one that was never interrupted. The fingerprint is a hash of everything the picture depends on: meshes with
their materials, instances, camera, lights, motion, integrator and settings. Samples of another picture are refused, and those
of a version of wrt that makes other samples or hits (`wrt.revisions`). The size of waves, memory for textures, exposure and
tone mapping may differ: they do not change samples.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wrt.meshes.mesh import TriangleMesh
from wrt.revisions import ANSWER_REVISION, SAMPLE_REVISION
from wrt.scene.archives import checked_reading, read_archive, write_archive

FILM = (("film", (3,)), ("squares", ()))
"""Arrays of the file, float32, and the shape of a pixel."""

REVISIONS = (SAMPLE_REVISION, ANSWER_REVISION)
"""Revisions of the code on which samples depend."""

NOT_IN_SAMPLES = ("wave", "texture_memory", "exposure", "tone_mapping", "samples")
"""Settings on which samples do not depend; their number is part of the fingerprint by itself."""


def fingerprint(*content: Any) -> str:
    """64 hexadecimal digits that tell contents apart: numbers, strings, arrays, meshes, and containers and objects of them."""
    state = hashlib.sha256()
    _add(state, content)
    return state.hexdigest()


def _add(state: Any, value: Any) -> None:
    """Adds a value to a hash, with its type and its size, so that no two different ones read alike."""
    if isinstance(value, TriangleMesh):
        value = {"vertices": value.vertices, "faces": value.faces, "materials": value.materials}
    if isinstance(value, np.ndarray):
        state.update(f"array {value.dtype.str} {value.shape};".encode())
        state.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8))
    elif isinstance(value, Mapping):
        state.update(f"mapping {len(value)};".encode())
        for key in sorted(value, key=repr):
            _add(state, repr(key))
            _add(state, value[key])
    elif isinstance(value, tuple | list):
        state.update(f"sequence {len(value)};".encode())
        for one in value:
            _add(state, one)
    elif value is None or isinstance(value, bool | int | float | str | np.generic):
        text = repr(value)
        state.update(f"value {len(text)} {text};".encode())
    else:
        state.update(f"{type(value).__name__};".encode())
        _add(state, {name: one for name, one in vars(value).items() if not name.startswith("_")})


def write_samples(path: Path, key: str, done: int, film: np.ndarray, squares: np.ndarray) -> None:
    """Writes the samples that all pixels have; the file is written completely or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    numbers = {"key": np.array(key), "revisions": np.array(REVISIONS), "done": np.array(done)}
    write_archive(path, numbers | {"film": film, "squares": squares})


def read_samples(path: Path, key: str, samples: int, pixels: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Number of samples of each pixel, (pixels, 3) their sums, and (pixels,) the sums of their squared luminance.

    Args:
        path: of the file.
        key: fingerprint of the picture.
        samples: of a pixel, when the picture is complete.
        pixels: number of pixels.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the samples are of another picture or another version of wrt, or the file is damaged.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no samples at '{path}': check the path (now in '{Path.cwd()}')")
    with checked_reading(path, "a file of samples", "render the picture from the start"):
        arrays = read_archive(path)
        found, done = str(arrays["key"]), int(arrays["done"])
        revisions = tuple(arrays["revisions"].tolist()) if "revisions" in arrays else None  # 0.1.0 wrote none
        shaped = all(arrays[name].dtype == np.float32 and arrays[name].shape == (pixels, *shape) for name, shape in FILM)
    if revisions != REVISIONS:
        raise ValueError(
            f"'{path}' is of another version of wrt, whose samples may differ (revisions {revisions or 'none'}, here "
            f"{REVISIONS}); go on with that version, or render from the start"
        )
    if found != key:
        raise ValueError(
            f"'{path}' holds samples of another picture: the scene, the camera, the lights or the settings changed; "
            "change them back, or render from the start"
        )
    if not (shaped and 1 <= done <= samples):
        raise ValueError(f"'{path}' is damaged: it does not hold {samples} samples of {pixels} pixels at most")
    return done, arrays["film"], arrays["squares"]
