"""Memory for results and records is used again, but never while somebody holds it."""

from __future__ import annotations

import gc
import mmap
import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.builders.core.levels import LiveNode
from wrt.engine import device_memory, memory
from wrt.engine.device_hits import DTYPES, DeviceHits
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.memory import GRAIN, BlockPool, large_pages
from wrt.kernels.answers import ANSWERS

COUNT = 1 << 20


def test_blocks_come_back():
    pool = BlockPool(kept_bytes=8 * GRAIN)
    block = pool.take(3 * GRAIN - 5)
    assert block.nbytes == 3 * GRAIN
    pool.give_back(block)
    assert pool.free_bytes == 3 * GRAIN
    assert pool.take(GRAIN) is not block, "less than half as large"
    assert pool.take(2 * GRAIN) is block
    assert pool.free_bytes == 0


def test_too_small_a_block_stays():
    """A block that is smaller than what is asked for would be written beyond its end."""
    pool = BlockPool(kept_bytes=8 * GRAIN)
    pool.give_back(pool.take(GRAIN))
    assert pool.take(2 * GRAIN).nbytes == 2 * GRAIN
    assert pool.free_bytes == GRAIN


def test_no_more_is_kept_than_allowed():
    pool = BlockPool(kept_bytes=4 * GRAIN)
    blocks = [pool.take(GRAIN * size) for size in (1, 2, 3)]
    for block in blocks:
        pool.give_back(block)
    assert pool.free_bytes == 3 * GRAIN, "the blocks unused for longest went"
    pool.release()
    assert pool.free_bytes == 0


@pytest.mark.skipif(not hasattr(mmap, "MADV_FREE"), reason="only Linux takes pages when memory becomes scarce")
def test_more_is_kept_if_the_system_may_take_it():
    """The results of a query larger than what is kept were fresh memory, page fault by page fault, in every query."""
    pool = BlockPool(kept_bytes=4 * GRAIN, offered_bytes=4 * GRAIN)
    blocks = [pool.take(GRAIN * size) for size in (4, 3, 2)]
    for block in blocks[:2]:
        block[:] = 1
        pool.give_back(block)
    assert pool.free_bytes == 7 * GRAIN
    assert pool.take(3 * GRAIN) is blocks[1]
    blocks[1][:] = 2
    assert (blocks[1] == 2).all(), "what was offered can be written again"
    pool.give_back(blocks[1])
    pool.give_back(blocks[2])
    assert pool.free_bytes == 5 * GRAIN, "the blocks unused for longest went"


def test_no_more_is_kept_if_the_system_cannot_take_it(monkeypatch):
    monkeypatch.setattr(memory, "offer", lambda block: False)
    pool = BlockPool(kept_bytes=4 * GRAIN, offered_bytes=4 * GRAIN)
    for block in [pool.take(GRAIN * size) for size in (4, 3)]:
        pool.give_back(block)
    assert pool.free_bytes == 3 * GRAIN


@pytest.mark.parametrize("advice", [None, -1])
def test_blocks_are_not_offered_to_other_systems(monkeypatch, advice):
    """A system that does not know how, one that refuses, and memory of NumPy's own."""
    assert not memory.offer(np.empty(GRAIN, dtype=np.uint8))
    if advice is None:
        monkeypatch.delattr(mmap, "MADV_FREE", raising=False)
    else:
        monkeypatch.setattr(mmap, "MADV_FREE", advice, raising=False)
    assert not memory.offer(large_pages(GRAIN))


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


@pytest.mark.skipif(not hasattr(mmap, "MADV_HUGEPAGE"), reason="only Linux is asked for large pages")
def test_blocks_ask_for_large_pages():
    block = large_pages(GRAIN)
    address = block.ctypes.data
    for line in Path("/proc/self/smaps").read_text().splitlines():
        if bounds := re.match(r"([0-9a-f]+)-([0-9a-f]+) ", line):
            inside = int(bounds[1], 16) <= address < int(bounds[2], 16)
        elif inside and line.startswith("VmFlags:"):
            assert "hg" in line.split() or not Path("/sys/kernel/mm/transparent_hugepage").exists()
            return
    raise AssertionError("the block is in no mapping")


@pytest.mark.parametrize("advice", [None, -1])
def test_blocks_do_without_large_pages(monkeypatch, advice):
    """A system that does not know them, and one that refuses."""
    if advice is None:
        monkeypatch.delattr(mmap, "MADV_HUGEPAGE", raising=False)
    else:
        monkeypatch.setattr(mmap, "MADV_HUGEPAGE", advice, raising=False)
    block = large_pages(2 * GRAIN)
    block[:] = 3
    assert block.nbytes == 2 * GRAIN
    assert (block == 3).all()


def test_too_large_a_block_is_a_memory_error():
    with pytest.raises(MemoryError):
        large_pages(1 << 60)


def test_failed_allocations_say_for_what():
    """NumPy's error and Warp's, which is a RuntimeError; other errors stay what they are."""
    for error in (MemoryError("no"), RuntimeError("Failed to allocate 8 bytes on device 'cpu'")):
        with pytest.raises(MemoryError, match=r"too little memory for a tree, which take 8\.0 MB"):  # noqa: SIM117
            with memory.memory_for("a tree", 8_000_000):
                raise error
    with pytest.raises(RuntimeError, match="something else"), memory.memory_for("a tree", 8_000_000):
        raise RuntimeError("something else")


@pytest.mark.skipif(not hasattr(mmap, "MADV_HUGEPAGE"), reason="elsewhere blocks begin where NumPy likes")
def test_blocks_begin_at_different_lines_of_the_cache():
    blocks = [large_pages(GRAIN) for _ in range(16)]
    begins = {block.ctypes.data % 4096 for block in blocks}
    assert len(begins) == 16
    assert all(begin % 64 == 0 for begin in begins)


def test_records_share_memory_only_one_after_the_other(monkeypatch):
    """Those of a scene are in such a block, which waits for the next scene when nobody holds them."""
    monkeypatch.setattr(memory, "MIN_BYTES", 1)
    mesh = wrt.scenes.build("teapot", level=10)  # records of fewer triangles are arrays of their own
    scene, larger = wrt.Scene(mesh, device="cpu"), wrt.Scene(wrt.TriangleMesh(2.0 * mesh.vertices, mesh.faces), device="cpu")
    plan = scene.explain([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])
    memory.release()
    held = records_of(scene.state, plan, None).records.numpy()
    address, kept = held.ctypes.data, held.copy()
    del scene
    gc.collect()
    assert memory._pool.free_bytes == 0, "the view holds them"
    assert records_of(larger.state, plan, None).records.ptr != address
    np.testing.assert_array_equal(held, kept)
    del held
    gc.collect()
    assert memory._pool.free_bytes == GRAIN
    assert records_of(wrt.Scene(mesh, device="cpu").state, plan, None).records.ptr == address


def test_layouts_worked_out_once():
    """Structs with a known layout go to NumPy and back as others do, by one dtype."""
    layout = LiveNode.numpy_dtype()
    assert layout is LiveNode.numpy_dtype()
    assert layout == np.dtype(type(LiveNode).numpy_dtype(LiveNode))
    nodes = np.zeros(3, dtype=layout)
    nodes["frame"]["triangles"], nodes["split"]["position"], nodes["left"] = [1, 2, 3], 0.5, [7, 8, 9]
    again = wp.array(nodes, dtype=LiveNode, device="cpu").numpy()
    assert again.dtype == layout
    assert again.tobytes() == nodes.tobytes()


@wp.struct
class Cut:
    """As kernels see the arrays of `test_arrays_of_one_allocation`."""

    a: wp.array(dtype=wp.vec3)
    b: wp.array(dtype=wp.float64)
    c: wp.array(dtype=wp.int32)


def test_arrays_of_one_allocation():
    """Aligned, apart, and alive as long as one of them."""
    kinds, device = {"a": wp.vec3, "b": wp.float64, "c": wp.int32}, wp.get_device("cpu")
    block = memory.ArraysOfBlock(kinds, 1000, device)
    found = {name: block[name].array for name in kinds}
    struct = Cut()
    block.write_to(struct)
    for number, (name, array) in enumerate(found.items()):
        field = getattr(struct.__ctype__(), name)
        assert (field.data, field.ndim, field.shape[0], field.strides[0]) == (array.ptr, 1, 1000, array.strides[0])
        assert (array.dtype, array.shape) == (kinds[name], (1000,))
        array.fill_(number + 1)
    last = found.pop("c")
    np.testing.assert_array_equal(found["a"].numpy(), 1.0)
    np.testing.assert_array_equal(found["b"].numpy(), 2.0)
    assert (found["b"].ptr - found["a"].ptr) % memory.ALIGNED == 0
    del found, array, block, struct
    gc.collect()
    np.testing.assert_array_equal(last.reshape((10, 100)).numpy(), 3)
    assert len(memory.ArraysOfBlock(kinds, 0, device)["a"]) == 0


@pytest.mark.parametrize("kind", ["closest", "any", "count"])
def test_answers_have_the_arrays_of_their_kind_alone(kind, device):
    """Arrays beside them would be of memory that belongs to others."""
    for count in (3, 5000):
        hits = DeviceHits.new(kind, count, wp.get_device(device))
        made = {name for name in DTYPES if getattr(hits, name) is not None}
        assert made == set(ANSWERS[kind].stored.columns)
        assert all(getattr(hits, name).shape == (count,) for name in made)


def test_memory_of_blocks_in_cycles_is_not_freed(device):
    """The collector finalises all of a cycle, and memory that then waits for others must not have been freed."""
    memory.release()
    freed, block = [], device_memory.take_block(5000, wp.get_device(device))
    own = device_memory._taken[block.ptr]
    free, own.deleter = own.deleter, lambda ptr, size: freed.append(ptr)
    address, cycle = block.ptr, [block]
    cycle.append(cycle)
    del block, cycle, own
    gc.collect()
    assert freed == []
    again = device_memory.take_block(5000, wp.get_device(device))
    assert again.ptr == address
    device_memory._taken[address].deleter = free


@pytest.mark.cuda
@pytest.mark.skipif(not wp.get_cuda_devices(), reason="there is no CUDA device here")
def test_answers_on_cuda_take_memory_that_nobody_holds():
    device = wp.get_cuda_devices()[0]
    memory.release()
    held = device_memory.take_block(5_000_000, device)
    address = held.ptr
    other = device_memory.take_block(5_000_000, device)
    assert other.ptr != address
    del held
    gc.collect()
    assert device_memory.waiting_bytes() == 5 << 20
    assert device_memory.take_block(4_900_000, device).ptr == address, "as many whole megabytes"
    with wp.ScopedStream(wp.Stream(device)):
        assert device_memory.take_block(5_000_000, device).ptr != address, "of another stream"
    memory.release()
    assert device_memory.waiting_bytes() == 0
