"""Memory for results is used again, but never while somebody holds it."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np
import pytest
import warp as wp

import wrt
from wrt import memory
from wrt.kernels.large_pages import ask_for_large_pages, find_advice
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


def test_triangle_records_of_large_scenes_lie_in_large_pages():
    """As far as the system can tell: the flag "hg" of the memory that holds the array."""
    array = wp.empty(3 << 20, dtype=float, device="cpu")
    ask_for_large_pages(array)
    array.fill_(1.0)
    assert float(array.numpy().sum()) == 3 << 20
    ask_for_large_pages(wp.empty(16, dtype=float, device="cpu"))  # too small: nothing happens
    if find_advice() is None or not Path("/sys/kernel/mm/transparent_hugepage").exists():
        pytest.skip("no large pages on demand")
    middle, inside, flags = array.ptr + array.capacity // 2, False, []
    for line in Path("/proc/self/smaps").read_text().splitlines():
        first, *rest = line.split()
        if "-" in first and not first.endswith(":"):
            begin, end = (int(number, 16) for number in first.split("-"))
            inside = begin <= middle < end
        elif inside and first == "VmFlags:":
            flags = rest
    assert "hg" in flags
