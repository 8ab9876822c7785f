"""Hashes of scenes, rays and options, by which a job notices that it is not the one that its folder began with.

Scenes are hashed whole. Arrays of rays are hashed whole up to 256 MB; of larger ones, and of rays that a function makes, rows
that are spread evenly over the batch, with the shape and the type, and of files the size and the time of the last change.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from types import FunctionType
from typing import Any

import numpy as np
import warp as wp

from wrt.query.batches.block_rows import GeneratedRays, SkippedTriangles
from wrt.rays.rays import Rays

WHOLE = 1 << 28
"""Bytes up to which arrays are hashed whole."""

SAMPLES = 1024
"""Rows of larger arrays that are hashed."""

CALLS, ROWS = 16, 64
"""Calls of a function that makes rays, and rows of each, that are hashed."""


def scene_hash(scene: Any) -> str:
    """SHA-256 of all that answers depend on: triangles, instances, triangle test, version of wrt; not of the tree."""
    from wrt import __version__

    state = hashlib.sha256(f"{__version__} {scene.triangle_test} {scene.geometry_ids}".encode())
    for mesh in scene.meshes:
        for array in (mesh.vertices, mesh.faces):
            add_array(state, array)
    for instance in scene.instances:
        add_array(state, np.asarray(instance.transform))
        state.update(f"{instance.mask} {instance.environment}".encode())
    return state.hexdigest()


def rays_hash(source: Rays | GeneratedRays, columns: Mapping[str, Any]) -> str:
    """SHA-256 of a batch of rays, and of its masks, environments and the triangles to skip."""
    state = hashlib.sha256(str(source.shape).encode())
    if isinstance(source, GeneratedRays):
        state.update(f"{source.t_min} {source.t_max}".encode())
        length = source.shape[0]
        for begin in np.unique(np.linspace(0, max(length - ROWS, 0), CALLS).astype(np.int64)).tolist():
            rays = source.rows(begin, min(begin + ROWS, length))
            for values in vars(rays).values():
                add_array(state, values)
    for name, values in {**({} if isinstance(source, GeneratedRays) else vars(source)), **columns}.items():
        state.update(name.encode())
        add_array(state, values.numbers if isinstance(values, SkippedTriangles) else values)
    return state.hexdigest()


def add_array(state: Any, values: Any) -> None:
    """Adds an array to a hash: whole, or rows spread over it."""
    if isinstance(values, wp.array):
        values = values.numpy()
    shape, dtype = np.shape(values), str(getattr(values, "dtype", type(values).__name__))
    state.update(f"{shape} {dtype}".encode())
    if isinstance(values, np.memmap) and values.filename is not None and values.nbytes > WHOLE:
        found = os.stat(values.filename)
        state.update(f"{found.st_size} {found.st_mtime_ns}".encode())
    size = int(np.prod(shape, dtype=np.float64)) * getattr(getattr(values, "dtype", None), "itemsize", 8)
    if not shape or size <= WHOLE:
        state.update(np.ascontiguousarray(values).data)
        return
    for row in np.linspace(0, shape[0] - 1, SAMPLES).astype(np.int64).tolist():
        state.update(np.ascontiguousarray(values[row : row + 1]).data)


def described(value: Any) -> Any:
    """Options as plain data that is the same in every process: functions by name and code, arrays by hash."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): described(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [described(one) for one in value]
    if isinstance(value, np.ufunc):
        return value.__name__
    if isinstance(value, (np.ndarray, np.generic)):
        state = hashlib.sha256()
        add_array(state, value)
        return state.hexdigest()
    if isinstance(value, partial):
        return [described(value.func), described(value.args), described(value.keywords)]
    if isinstance(value, FunctionType):
        code = value.__code__
        constants = [one for one in code.co_consts if not hasattr(one, "co_code")]
        state = hashlib.sha256(code.co_code + repr((constants, code.co_names)).encode())
        return [value.__qualname__, state.hexdigest(), described(value.__defaults__)]
    if is_dataclass(value):
        return [type(value).__name__, {field.name: described(getattr(value, field.name)) for field in fields(value)}]
    return [type(value).__name__, described(getattr(value, "__dict__", None) or repr(value))]


def options_text(value: Any) -> str:
    """Options as text, to compare and to show."""
    return json.dumps(described(value), sort_keys=True)
