"""Memory for results is used again, but never while somebody holds it."""

from __future__ import annotations

import gc

import numpy as np
import warp as wp

import wrt
from wrt import memory
from wrt.builders.kdtree.reference_levels import LiveRange
from wrt.memory import GRAIN, BlockPool

COUNT = 1 << 20


def test_blocks_come_back():
    pool = BlockPool(kept_bytes=8 * GRAIN)
    block = pool.take(3 * GRAIN - 5)
    assert block.nbytes == 3 * GRAIN
    pool.give_back(block)
    assert pool.waiting_bytes == 3 * GRAIN
    assert pool.take(GRAIN) is not block, "less than half as large"
    assert pool.take(2 * GRAIN) is block
    assert pool.waiting_bytes == 0


def test_no_more_is_kept_than_allowed():
    pool = BlockPool(kept_bytes=4 * GRAIN)
    blocks = [pool.take(GRAIN * size) for size in (1, 2, 3)]
    for block in blocks:
        pool.give_back(block)
    assert pool.waiting_bytes == 3 * GRAIN, "the blocks unused for longest went"
    pool.release()
    assert pool.waiting_bytes == 0


def test_arrays_share_memory_only_one_after_the_other():
    device = wp.get_device("cpu")
    memory.release()
    first = memory.empty(COUNT, wp.float32, device)
    view = first.numpy()
    view[:] = 7.0
    address = first.ptr
    del first
    gc.collect()
    second = memory.empty(COUNT, wp.float32, device)
    assert second.ptr != address, "the view holds it"
    second.fill_(1.0)
    assert (view == 7.0).all()
    del view
    gc.collect()
    assert memory.empty(COUNT, wp.float32, device).ptr == address


def test_hits_stay_as_they_are():
    """Results of an earlier query are not overwritten by later ones, whatever part of them is still held."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device="cpu")
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(300_000, 3)).astype(np.float32) * 9
    held, expected = [], []
    for turn in range(4):
        hits = scene.intersect(np.roll(origins, turn, axis=0), -origins)
        held += [hits.t, hits.primitive_id, hits.uv[::7], hits.position]
        expected += [array.copy() for array in held[-4:]]
        del hits
    for array, copy in zip(held, expected, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_layouts_worked_out_once():
    """Structs with a known layout go to NumPy and back as others do, by one dtype."""
    layout = LiveRange.numpy_dtype()
    assert layout is LiveRange.numpy_dtype()
    assert layout == np.dtype(type(LiveRange).numpy_dtype(LiveRange))
    nodes = np.zeros(3, dtype=layout)
    nodes["frame"]["triangles"], nodes["split"]["position"], nodes["left"] = [1, 2, 3], 0.5, [7, 8, 9]
    again = wp.array(nodes, dtype=LiveRange, device="cpu").numpy()
    assert again.dtype == layout
    assert again.tobytes() == nodes.tobytes()
