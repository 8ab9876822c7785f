"""Batches in blocks: the answer of one call wherever the cuts lie, from files and iterators, within memory, stoppable."""

from __future__ import annotations

import signal
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays

import wrt
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.query.batches import block_limits
from wrt.query.blocks import BYTES_PER_RAY, parse_memory

COUNT = 3000
ATTRIBUTES = ("t", "primitive_id", "geometry_id", "uv", "is_hit", "position", "normal")


@pytest.fixture(scope="module")
def mesh() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=4)


@pytest.fixture(scope="module")
def scene(mesh) -> wrt.Scene:
    return wrt.Scene([mesh, wrt.TriangleMesh(mesh.vertices + 0.3, mesh.faces)], device="cpu")


@pytest.fixture(scope="module")
def rays(mesh) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(mesh, COUNT, seed=4)


def for_rays(count: int) -> int:
    """Memory for so many rays a block."""
    return count * BYTES_PER_RAY


def gathered(blocks: wrt.batches.Blocks, name: str) -> np.ndarray:
    """An attribute of all blocks, which must follow one another."""
    blocks = list(blocks)
    assert [block.rows.start for block in blocks] == [0, *(block.rows.stop for block in blocks[:-1])]
    return np.concatenate([getattr(block.answer, name) for block in blocks])


@pytest.mark.parametrize("size", [1, 100, 700, 2999, 10**6])
def test_same_answers_whatever_the_size(scene, rays, size):
    """Few rays are traced by another kernel than many, and coherent ones by another than these; that does not show."""
    origins, directions = (array[: 40 if size == 1 else COUNT] for array in rays)
    whole = scene.intersect(origins, directions, 0.01, 5.0)
    blocks = scene.intersect_blocks(origins, directions, 0.01, 5.0, memory=for_rays(size))
    assert len(blocks) == -(-len(origins) // size)
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(gathered(blocks, name), getattr(whole, name))
    assert blocks.done == len(origins)
    blocks = scene.intersect_blocks(origins[:40], directions[:40], precise=True, memory=for_rays(size))
    np.testing.assert_array_equal(gathered(blocks, "t"), scene.intersect(origins[:40], directions[:40], precise=True).t)
    dark = [answer for _, answer in scene.occluded_blocks(origins, directions, memory=for_rays(size))]
    np.testing.assert_array_equal(np.concatenate(dark), scene.occluded(origins, directions))
    counts = [answer for _, answer in scene.count_blocks(origins, directions, memory=for_rays(size))]
    np.testing.assert_array_equal(np.concatenate(counts), scene.count(origins, directions))


def test_broadcast_rows(scene, rays):
    """Blocks are rows of the first axis: pictures stay pictures, and what all rows share is not cut."""
    origins, directions = (array.reshape(50, 60, 3) for array in rays)
    bounds = np.linspace(0.5, 3.0, 50)[:, None]
    for some in (
        Rays(origins, directions, 0.0, bounds),
        Rays(origins[:, :1], directions[0], np.linspace(0.0, 0.1, 60)),
        Rays(np.float64([3, 4, 5]), directions, 0.0, bounds),
        Rays(origins, [[[0.0, 0.0, 1.0]]]),
        Rays(wp.array(origins, dtype=wp.vec3, device="cpu"), wp.array(directions, dtype=float, device="cpu")),
    ):
        whole = scene.intersect(some)
        blocks = list(scene.intersect_blocks(some, memory=for_rays(7 * 60 + 5)))
        assert [rows for rows, _ in blocks] == [slice(i, min(i + 7, 50)) for i in range(0, 50, 7)]
        for name in ("t", "primitive_id", "position"):
            parts = [getattr(hits, name) for _, hits in blocks]
            assert all(isinstance(part, type(getattr(whole, name))) for part in parts)
            together = np.concatenate([np.asarray(part) for part in parts])
            np.testing.assert_array_equal(together, np.asarray(getattr(whole, name)))
    assert [rows for rows, _ in scene.occluded_blocks(origins, directions, memory=1)] == [slice(i, i + 1) for i in range(50)]
    assert list(scene.occluded_blocks(origins[:0], directions[:0])) == []


def test_iterators(scene, rays):
    """Items of any size, pairs or `wrt.Rays`; those too large for a block come in parts."""
    origins, directions = rays
    cuts = [0, 10, 11, 1500, 1500, 2000, COUNT]
    parts = [slice(*cut) for cut in pairwise(cuts)]
    whole = scene.intersect(origins, directions, 0.0, 4.0)
    pairs = ((origins[part], directions[part]) for part in parts)
    blocks = scene.intersect_blocks(pairs, t_max=4.0, memory=for_rays(600))
    np.testing.assert_array_equal(gathered(blocks, "t"), whole.t)
    with pytest.raises(TypeError, match="iterator"):
        len(blocks)
    several = [wrt.Rays(origins[part].tolist() or origins[:0], directions[part], 0.0, 4.0) for part in parts]
    counts = np.empty(COUNT + 5, dtype=np.int64)
    assert scene.count_blocks(several, memory=for_rays(600)).write(counts) == COUNT
    np.testing.assert_array_equal(counts[:COUNT], scene.count(origins, directions, 0.0, 4.0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16])
def test_from_file_to_file(scene, rays, dtype, tmp_path):
    """Memory-mapped rays, wider, narrower and with columns between, to memory-mapped answers."""
    with np.errstate(over="ignore"):
        lines = np.concatenate(rays, axis=1).astype(dtype)
    np.save(tmp_path / "rays.npy", lines)
    mapped = np.load(tmp_path / "rays.npy", mmap_mode="r")
    whole = scene.intersect(lines[:, :3], lines[:, 3:])
    out = {
        name: np.lib.format.open_memmap(tmp_path / f"{name}.npy", "w+", np.asarray(getattr(whole, name)).dtype, shape)
        for name, shape in (("t", (COUNT,)), ("primitive_id", (COUNT,)), ("position", (COUNT, 3)), ("is_hit", (COUNT,)))
    }
    assert scene.intersect_blocks(mapped[:, :3], mapped[:, 3:], memory=for_rays(701)).write(out) == COUNT
    for name in out:
        np.testing.assert_array_equal(np.load(tmp_path / f"{name}.npy"), getattr(whole, name))
    dark = np.zeros(COUNT, dtype=bool)
    scene.occluded_blocks(mapped[:, :3], mapped[:, 3:], memory=for_rays(701)).write(dark)
    np.testing.assert_array_equal(dark, whole.is_hit)


def test_a_mapped_file_is_read_where_it_is(rays, tmp_path):
    """Contiguous float32 of a file goes to the kernels as it is, and a part of it too."""
    np.save(tmp_path / "rays.npy", rays[0])
    mapped = np.load(tmp_path / "rays.npy", mmap_mode="r")
    for part in (mapped, mapped[100:900]):
        batch = to_device(Rays(part, part), wp.get_device("cpu"), np.zeros(3)).batch
        assert batch.origins.ptr == batch.directions.ptr == part.ctypes.data


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_memory_stays_bounded(mesh, tmp_path):
    """Of a file with 24 MB of rays that have to be converted, no more is ever held than the bound says.

    By two threads, whose stacks the first pass has touched: of many, some would have nothing to do until the second one.
    """
    scene = wrt.Scene(mesh, device="cpu", num_threads=2)

    def held() -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return sum(int(line.split()[1]) << 10 for line in lines if line.startswith("RssAnon"))

    count, bound = 1_000_000, 10_000_000
    directions = np.lib.format.open_memmap(tmp_path / "rays.npy", "w+", np.float64, (count, 3))
    directions[:] = np.random.default_rng(0).standard_normal((count, 3))
    directions.flush()
    directions = np.load(tmp_path / "rays.npy", mmap_mode="r")
    origins = np.broadcast_to(np.float64(scene.center), directions.shape)

    def peak(count: int) -> int:
        most = 0
        for _, hits in scene.intersect_blocks(origins[:count], directions[:count], memory=bound):
            assert hits.position.shape == hits.normal.shape
            most = max(most, held())
        return most

    peak(100_000)  # loads all that is needed: kernels, and on a machine with CUDA the driver's part of it
    before = held()
    assert peak(count) - before < bound


class Stop:
    """An array during whose writing Ctrl-C is pressed."""

    def __init__(self, length: int, presses: int = 1):
        self.values, self.presses = np.full(length, -1, dtype=np.int32), presses
        self.shape, self.dtype = self.values.shape, self.values.dtype

    def __setitem__(self, rows: slice, values: np.ndarray):
        for _ in range(self.presses if rows.start else 0):
            signal.raise_signal(signal.SIGINT)
        self.values[rows] = values


@pytest.fixture
def default_handler():
    """Ctrl-C as a fresh process has it: what runs notebooks in the same process may have left another handler."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)


@pytest.mark.usefixtures("default_handler")
def test_interrupt_between_blocks(scene, rays):
    """The block under way is finished and written; the scene and the blocks go on as if nothing had been."""
    whole, out = scene.count(*rays), Stop(COUNT)
    blocks = scene.count_blocks(*rays, memory=for_rays(800))
    with pytest.raises(KeyboardInterrupt):
        blocks.write(out)
    assert blocks.done == 1600
    np.testing.assert_array_equal(out.values[:1600], whole[:1600])
    assert (out.values[1600:] == -1).all()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    blocks.write(out.values)
    np.testing.assert_array_equal(out.values, whole)
    twice = Stop(COUNT, presses=2)
    with pytest.raises(KeyboardInterrupt):
        blocks.write(twice)
    assert (twice.values[800:] == -1).all()
    assert blocks.done == 800


def test_progress(scene, rays, capsys):
    for _ in scene.occluded_blocks(*rays, memory=for_rays(1000)):
        pass
    assert capsys.readouterr() == ("", "")
    scene.occluded_blocks(*rays, memory=for_rays(1000), progress=True).write(np.zeros(COUNT, dtype=bool))
    assert "3,000 rays" in capsys.readouterr().err
    for _ in scene.occluded_blocks(iter([rays]), progress=True):
        break
    assert capsys.readouterr().out == ""


def test_progress_in_a_log(capsys, monkeypatch):
    """Without a terminal: a line after the first block, one a minute, and one at the end, which say how far it is."""
    now = [0.0]
    monkeypatch.setattr(block_limits, "perf_counter", lambda: now[0])
    with block_limits.progress_bar(True, 1_000, start=400) as advance:
        for _ in range(6):
            now[0] += 25.0
            advance(100)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" rays")[0].split()[-1] for line in lines] == ["500", "800", "1,000"]
    assert lines[1].endswith("800 rays of 1,000 (80.0%), 0.0 M/s, 0.8 min left")
    with block_limits.progress_bar(True, None) as advance:
        advance(2_000_000)
    assert "min left" not in capsys.readouterr().err


def test_amounts_of_memory():
    given = (1, "2", "3 B", "1.5kB", "256 MB", "2GiB", "0.1")
    assert [parse_memory(memory) for memory in given] == [1, 2, 3, 1500, 256 * 10**6, 2 << 30, 1]
    for bad in ("", "MB", "-1", "0", 0, -5, "1 XB", "nan", "1e9", "1 BB", "1 I"):
        with pytest.raises(ValueError, match="memory"):
            parse_memory(bad)
    for bad in (1.5, None, True):
        with pytest.raises(TypeError, match="memory"):
            parse_memory(bad)


def test_refused(scene, rays):
    origins, directions = rays
    with pytest.raises(TypeError, match="directions is missing"):
        scene.intersect_blocks(origins)
    with pytest.raises(TypeError, match="not both"):
        scene.count_blocks(wrt.Rays(origins, directions), directions)
    with pytest.raises(ValueError, match="leading axis"):
        scene.intersect_blocks(origins[0], directions[0])
    with pytest.raises(ValueError, match="t_max must be numbers"):
        scene.intersect_blocks(iter([rays]), t_max=np.ones(3))
    with pytest.raises(TypeError, match="item 1 of the iterator"):
        list(scene.intersect_blocks(iter([rays, origins])))
    with pytest.raises(ValueError, match="broadcast"):
        scene.intersect_blocks(origins, directions[:-1])
    blocks = scene.intersect_blocks(origins, directions)
    for out, message in (
        (np.zeros(COUNT, np.float32), "dict"),
        ({"depth": np.zeros(COUNT)}, "choose from t, primitive_id"),
        ({"t": np.zeros(COUNT - 1)}, r"out\['t'\] has shape"),
        ({"uv": np.zeros((COUNT, 3))}, r"must be \(3000, 2\)"),
        ({"primitive_id": np.zeros(COUNT, np.int16)}, "make it int32"),
        ({"t": np.zeros(COUNT, int)}, "make it float32"),
    ):
        with pytest.raises(ValueError, match=message):
            blocks.write(out)
    with pytest.raises(ValueError, match="hold at least"):
        scene.occluded_blocks(iter([rays])).write(np.zeros(COUNT - 1, bool))
