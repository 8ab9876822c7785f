"""Hashes of scenes and rays, by which a job notices that it is not the one that its folder began with.

Scenes are hashed whole. Batches of arrays of up to 256 MB each are hashed whole, block by block, so that every block can be
compared when it is computed. Of larger arrays, 64 pieces of 1 MB that are spread evenly over them are hashed, and of files the
size and the time of the last change. Of rays that a function makes, up to a million (2^20) are made and hashed, in up to 64
pieces that are spread evenly over the batch, and its code. What differs between these pieces only is not noticed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from wrt.cluster.identity.described import code_of
from wrt.kernels.compilation.cores import available_cores
from wrt.query.batches.block_rows import GeneratedRays, SkippedTriangles, cut_rows, is_cut
from wrt.query.batches.block_work import BlockWork
from wrt.rays.rays import Rays, leading_shape

WHOLE = 1 << 28
"""Bytes up to which arrays are hashed whole."""

PIECE = 1 << 20
"""Bytes of an array that are hashed at a time."""

PIECES = 64
"""Number of pieces of larger arrays, and of rays that a function makes, that are hashed."""

MADE = 1 << 20
"""Rays that a function makes for the hash at most, but one row a piece."""

_lock = threading.Lock()
_known: weakref.WeakKeyDictionary[Any, str] = weakref.WeakKeyDictionary()
"""Hashes of meshes and of states of scenes, which do not change."""


def scene_hash(scene: Any) -> str:
    """SHA-256 of all that answers depend on: triangles, instances, triangle test, version of wrt; not of the tree."""
    return remembered(scene.state, state_hash)


def state_hash(state: Any) -> str:
    """The hash of a state of a scene."""
    from wrt import __version__

    geometry_ids = getattr(state, "geometry_ids", ())
    whole = hashlib.sha256(json.dumps([__version__, state.triangle_test, len(state.meshes), *geometry_ids]).encode())
    for mesh in state.meshes:
        whole.update(remembered(mesh, mesh_hash).encode())
    if state.instances:
        whole.update(array_hash(np.array([instance.transform for instance in state.instances])).encode())
        whole.update(json.dumps([[instance.mask, instance.environment] for instance in state.instances]).encode())
    return whole.hexdigest()


def mesh_hash(mesh: Any) -> str:
    """The hash of a mesh's triangles."""
    return array_hash(mesh.vertices) + array_hash(mesh.faces)


def remembered(value: Any, make: Callable[[Any], str]) -> str:
    """The hash of an object that does not change, computed once."""
    with _lock:
        found = _known.get(value)
    if found is None:
        found = make(value)
        with _lock:
            _known[value] = found
    return found


def array_hash(values: Any) -> str:
    """SHA-256 of type, shape and all elements of an array, or of whatever has a shape and slices."""
    values = values.numpy() if isinstance(values, wp.array) else values
    shape = np.shape(values)
    if not shape:
        return hashed(["scalar", np.asarray(values).dtype.str, np.asarray(values).tobytes().hex()])
    return hashed(["array", type_of(values), list(shape), *map_threads(piece_hash, row_pieces(values, shape))])


def sampled_hash(values: Any) -> str:
    """As `array_hash`, of pieces that are spread evenly over a large array; of a file with its size and time of change."""
    values = values.numpy() if isinstance(values, wp.array) else values
    shape = np.shape(values)
    rows = max(1, PIECE * shape[0] // size_of(values))
    begins = np.unique(np.linspace(0, max(shape[0] - rows, 0), PIECES).astype(np.int64)).tolist()
    found = [values[begin : begin + rows] for begin in begins]
    file = []
    if isinstance(values, np.memmap) and values.filename is not None:
        status = os.stat(values.filename)
        file = [status.st_size, status.st_mtime_ns]
    return hashed(["samples", type_of(values), list(shape), file, *map_threads(piece_hash, found)])


def type_of(values: Any) -> str:
    """NumPy's name of the type of an array's elements."""
    return np.asarray(values[:0]).dtype.str


def size_of(values: Any) -> int:
    """Bytes of an array, or of whatever has a shape."""
    itemsize = getattr(getattr(values, "dtype", None), "itemsize", 8)
    if isinstance(values, wp.array):
        itemsize = wp.types.type_size_in_bytes(values.dtype)
    return math.prod(np.shape(values)) * itemsize


def row_pieces(values: Any, shape: tuple[int, ...]) -> Iterator[Any]:
    """The rows of an array in pieces of `PIECE` bytes or a row."""
    rows = max(1, PIECE * shape[0] // max(size_of(values), 1))
    return (values[begin : begin + rows] for begin in range(0, shape[0], rows))


def piece_hash(piece: Any) -> str:
    """SHA-256 of the bytes of an array."""
    return hashlib.sha256(np.ascontiguousarray(piece).reshape(-1).view(np.uint8)).hexdigest()


def map_threads(function: Callable[[Any], str], pieces: Iterator[Any] | list[Any]) -> list[str]:
    """The hashes of pieces; hashlib lets other threads run meanwhile."""
    pieces = list(pieces)
    if len(pieces) < 4:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(min(available_cores(), len(pieces))) as executor:
        return list(executor.map(function, pieces))


def hashed(parts: list[Any]) -> str:
    """SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def named_arrays(rays: Rays, columns: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays and numbers of some rays by name."""
    columns = {name: one.numbers if isinstance(one, SkippedTriangles) else one for name, one in columns.items()}
    return {**vars(rays), **columns}


def block_hash(rays: Rays, columns: Mapping[str, Any]) -> str:
    """The hash of the rays of a block, with their masks, environments and triangles to skip."""
    return joint_hash({name: array_hash(values) for name, values in named_arrays(rays, columns).items()})


def joint_hash(hashes: Mapping[str, str]) -> str:
    """The hash of arrays, from their own by name."""
    return hashed(sorted(hashes.items()))


def is_whole(work: BlockWork) -> bool:
    """Whether the rays of a batch are hashed whole, block by block."""
    return isinstance(work.rays, Rays) and all(size_of(one) <= WHOLE for one in named_arrays(work.rays, work.columns).values())


def hashes_of_blocks(work: BlockWork, length: int, rows: int) -> list[str]:
    """The hash of each block of a batch of arrays. Arrays that all blocks share are hashed once.

    Args:
        work: of the batch.
        length: number of rows.
        rows: of a block.
    """
    arrays, shared, cut = named_arrays(work.rays, work.columns), {}, {}
    for name, values in arrays.items():
        shape = leading_shape(values) if name in ("origins", "directions") else np.shape(values)
        if is_cut(shape, work.axes):
            cut[name] = values, shape
        else:
            shared[name] = array_hash(values)
    found = []
    for begin in range(0, length, rows):
        own = {name: cut_rows(values, shape, work.axes, begin, begin + rows) for name, (values, shape) in cut.items()}
        found.append(joint_hash(shared | {name: array_hash(values) for name, values in own.items()}))
    return found


def rays_hash(work: BlockWork, blocks: list[str] | None) -> str:
    """The hash of a batch of rays, and of its masks, environments and the triangles to skip.

    Args:
        work: of the batch.
        blocks: the hash of each block (`hashes_of_blocks`); None if the batch is not hashed whole.
    """
    if blocks is not None:
        return hashed(["whole", list(work.rays.shape), blocks])
    if isinstance(work.rays, GeneratedRays):
        arrays, made = named_arrays(Rays(0.0, 0.0), work.columns), generated_hash(work.rays)
    else:
        arrays, made = named_arrays(work.rays, work.columns), None
    each = {name: (array_hash if size_of(one) <= WHOLE else sampled_hash)(one) for name, one in arrays.items()}
    return hashed(["parts", list(work.rays.shape), made, joint_hash(each)])


def generated_hash(source: GeneratedRays) -> str:
    """The hash of rays that a function makes, from pieces of them, and of its code.

    Raises:
        TypeError, ValueError: as `wrt.GeneratedRays.rows`; and what the function raises.
    """
    length, each = source.shape[0], max(1, math.prod(source.shape[1:]))
    rows = max(1, MADE // (PIECES * each))
    begins = range(0, length, rows)
    if len(begins) > PIECES:
        begins = np.unique(np.linspace(0, length - rows, max(2, min(PIECES, MADE // each))).astype(np.int64)).tolist()
    found = [block_hash(source.rows(begin, min(begin + rows, length)), {}) for begin in begins]
    return hashed(["generated", list(source.shape), source.t_min, source.t_max, code_of(source.function), *found])
