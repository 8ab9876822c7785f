"""Running kernels on all cores: every item once, from any thread, stoppable, with the number of threads asked for."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.kernels.runtime import launch as launching
from wrt.kernels.runtime.argument_packing import copied
from wrt.kernels.runtime.cuda_commands import launch_again
from wrt.kernels.runtime.launch import (
    CUDA_BLOCK,
    MAX_CHUNK,
    Chunks,
    PreparedLaunch,
    launch,
    run_tasks,
    use_schedule,
    use_threads,
)
from wrt.kernels.runtime.launch_loop import Step, launch_loop
from wrt.kernels.runtime.recorded_launch import RecordedLaunch


@wp.kernel(enable_backward=False)
def count_visits(first: int, visits: wp.array(dtype=int)):
    i = first + wp.tid()
    visits[i] = visits[i] + 1


@wp.kernel(enable_backward=False)
def write_whether(first: int, whether: bool, visits: wp.array(dtype=int)):
    visits[first + wp.tid()] = wp.where(whether, 1, 2)


@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 4095, 100_003, 3_000_001])
@pytest.mark.parametrize("threads", [1, 2, 7])
def test_every_item_once(count, threads, device):
    visits = wp.zeros(max(count, 1), dtype=int, device=device)
    with use_threads(threads):
        launch(count_visits, count, [visits], device=wp.get_device(device))
    assert (visits.numpy()[:count] == 1).all()


@wp.kernel(enable_backward=False)
def note_chunk(first: int, begins: wp.array(dtype=int)):
    begins[first + wp.tid()] = first


def chunk_sizes(count: int, chunks: Chunks, threads: int) -> np.ndarray:
    """Sizes of the chunks in which `count` items were run, in order of the items."""
    begins = wp.full(count, -1, dtype=int, device="cpu")
    with use_threads(threads):
        PreparedLaunch(note_chunk, [begins], begins.device).run(count, chunks)
    firsts, sizes = np.unique(begins.numpy(), return_counts=True)
    assert (firsts == np.concatenate([[0], np.cumsum(sizes)[:-1]])).all()
    return sizes


@pytest.mark.parametrize("count", [2, 5, 40])
def test_one_by_one(count):
    """With as many chunks as items, every item is a launch of its own."""
    assert chunk_sizes(count, Chunks(1, MAX_CHUNK, count), 2).tolist() == [1] * count


@pytest.mark.parametrize("threads", [1, 2, 7, 64])
@pytest.mark.parametrize(("chunk", "longest", "per_thread"), [(1, MAX_CHUNK, 8), (32, 2048, 8), (256, 300, 2), (1, 1, 16)])
def test_chunks(threads, chunk, longest, per_thread):
    """They are all the items, no longer than allowed, and fall in size where items are uneven."""
    for count in (1, 31, 32, 33, 1000, 32_768, 100_003):
        sizes = chunk_sizes(count, Chunks(chunk, longest, per_thread), threads)
        assert sizes.sum() == count
        assert (sizes <= longest).all()
        assert (np.diff(sizes) <= 0).all()
        assert (2 * sizes[:-1] >= min(chunk, longest)).all()
    if per_thread == 8 and threads > 1 and chunk == 1:
        assert sizes[0] >= 3 * sizes[-2]


def test_repeated():
    """Every run does every item once, with whatever chunks."""
    values = wp.zeros(1000, dtype=int, device="cpu")
    launch = PreparedLaunch(count_visits, [values], values.device)
    with use_threads(3):
        for chunks in (Chunks(1000), Chunks(100, 300), Chunks(1, 1)):
            launch.run(1000, chunks)
    assert (values.numpy() == 3).all()


def test_a_job_is_repeated_only_for_the_same_items_chunks_threads_and_schedule():
    """The job of the last run is kept. One of fewer items, or whose queues are used up, would leave items out."""
    values = wp.zeros(5000, dtype=int, device="cpu")
    launch, runs = PreparedLaunch(count_visits, [values], values.device), 0
    for count, chunks, threads, schedule in (
        (5000, Chunks(100), 2, "guided"),
        (5000, Chunks(100), 2, "guided"),
        (2500, Chunks(100), 2, "guided"),
        (5000, Chunks(100), 2, "stealing"),
        (5000, Chunks(100), 2, "stealing"),
        (5000, Chunks(100), 3, "guided"),
        (5000, Chunks(50), 3, "guided"),
        (5000, Chunks(100), 1, "guided"),
    ):
        with use_threads(threads), use_schedule(schedule):
            launch.run(count, chunks)
        runs += count
        assert values.numpy().sum() == runs
    assert (values.numpy()[:2500] == 8).all()
    assert (values.numpy()[2500:] == 7).all()


def test_small_batches_stay_in_the_calling_thread():
    """A launch of fewer items than a chunk starts no thread."""
    code = (
        "import threading, warp as wp; wp.config.log_level = wp.LOG_WARNING\n"
        "from wrt.kernels.runtime.launch import run_tasks\n"
        "run_tasks(lambda i: None, 1)\n"
        "assert threading.active_count() == 1\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_tasks_run_side_by_side():
    """Two tasks that wait for each other can only finish on two threads."""
    barrier = threading.Barrier(2, timeout=10)
    with use_threads(2):
        run_tasks(lambda i: barrier.wait(), 2)


def test_nested_calls_do_not_deadlock():
    done = []
    with use_threads(2):
        run_tasks(lambda i: run_tasks(lambda j: done.append((i, j)), 4), 4)
    assert sorted(done) == [(i, j) for i in range(4) for j in range(4)]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_error_stops_the_rest(error):
    """The first exception comes back to the caller; tasks not yet begun are dropped; the pool works on."""
    begun = []

    def task(number: int) -> None:
        begun.append(number)
        if number == 3:
            raise error("stop")

    with use_threads(2), pytest.raises(error, match="stop"):
        run_tasks(task, 10_000)
    assert len(begun) < 10_000
    again = []
    with use_threads(2):
        run_tasks(again.append, 100)
    assert sorted(again) == list(range(100))


def test_ctrl_c_stops_a_long_query():
    """A real SIGINT during a long trace ends it with KeyboardInterrupt, long before it would be done."""
    code = """
import os, signal, threading, time
import numpy as np, warp as wp
wp.config.log_level = wp.LOG_WARNING
import wrt
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background inherits that it is ignored
scene = wrt.Scene(wrt.scenes.build("wood", trees=4), device="cpu")
rays = np.random.default_rng(0).normal(size=(400_000, 3)).astype(np.float32)
scene.intersect(rays[:1000] * 5, -rays[:1000], traversal="brute")
threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
start = time.perf_counter()
try:
    scene.intersect(rays * 5, -rays, traversal="brute")
except KeyboardInterrupt:
    print("interrupted")
assert scene.intersect([0, 0, 9.0], [0, 0, -1.0]).t >= 0
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    assert "interrupted" in result.stdout


def test_number_of_threads(monkeypatch):
    monkeypatch.setattr(launching, "_num_threads", None)
    monkeypatch.setattr(launching, "_default_threads", None)
    monkeypatch.delenv("WRT_NUM_THREADS", raising=False)
    assert wrt.get_num_threads() == launching.available_cores() >= 1
    wrt.set_num_threads(3)
    assert wrt.get_num_threads() == 3
    with use_threads(5):
        assert wrt.get_num_threads() == 5
        with use_threads(None):
            assert wrt.get_num_threads() == 5
    assert wrt.get_num_threads() == 3
    wrt.set_num_threads(None)
    assert wrt.get_num_threads() == launching.available_cores()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity") or launching.available_cores() < 2, reason="needs two cores")
def test_cores_are_counted_again_in_a_forked_child_and_when_asked():
    """The count is kept between queries; a worker that is pinned to a core after the fork must not use its parent's."""
    code = """
import os, wrt
os.environ.pop("WRT_NUM_THREADS", None)
cores, first = wrt.get_num_threads(), {min(os.sched_getaffinity(0))}
if os.fork() == 0:
    os.sched_setaffinity(0, first)
    os._exit(0 if wrt.get_num_threads() == 1 else 1)
assert os.waitstatus_to_exitcode(os.wait()[1]) == 0
os.sched_setaffinity(0, first)
assert wrt.get_num_threads() == cores
wrt.set_num_threads(None)
assert wrt.get_num_threads() == 1
print("done")
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.split()[-1:] == ["done"], result.stderr


@pytest.mark.parametrize("bad", [0, -1, 10_000])
def test_bad_numbers_of_threads(bad):
    with pytest.raises(ValueError, match="from 1 to 1024"):
        wrt.set_num_threads(bad)
    with pytest.raises(TypeError, match="must be an int"):
        wrt.set_num_threads(2.0)


@pytest.mark.parametrize(
    ("value", "printed"), [("3", "3"), (" 2 ", "2"), ("", None), ("x", "error"), ("0", "error"), ("1.5", "error")]
)
def test_environment_variable(value, printed):
    code = """
import wrt
try:
    print(wrt.get_num_threads())
except ValueError as problem:
    assert "WRT_NUM_THREADS" in str(problem)
    print("error")
"""
    environment = {**os.environ, "WRT_NUM_THREADS": value}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert result.stdout.split()[-1] == (printed or str(launching.available_cores()))


def test_results_after_fork():
    """A forked child, which has none of the pool's threads, can trace."""
    if not hasattr(os, "fork"):
        pytest.skip("this system does not fork")
    code = """
import os, numpy as np, warp as wp
wp.config.log_level = wp.LOG_WARNING
import wrt
wrt.set_num_threads(2)
scene = wrt.Scene(wrt.scenes.build("teapot", level=3), device="cpu")
rays = np.random.default_rng(0).normal(size=(20000, 3)).astype(np.float32)
expected = scene.intersect(rays * 9, -rays).t
child = os.fork()
if child == 0:
    os._exit(0 if np.array_equal(scene.intersect(rays * 9, -rays).t, expected) else 1)
assert os.waitpid(child, 0)[1] == 0
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, timeout=120)


@wp.kernel(enable_backward=False)
def halve(first: int, by: int, numbers: wp.array(dtype=int), turns: wp.array(dtype=int)):
    numbers[0] = numbers[0] / by
    turns[by] = turns[by] + 1


@pytest.mark.parametrize("threads", [1, 2, 7])
@pytest.mark.parametrize("is_native", [True, False])
def test_a_loop_of_launches(threads, is_native, device, monkeypatch):
    """Two turns in a circle: as many items as a number says, which shrinks until it is 0; every step sees the one before."""
    if not is_native:
        monkeypatch.setattr(launching.native, "is_available", lambda: False)
    visits, turns = wp.zeros(5000, dtype=int, device=device), wp.zeros(4, dtype=int, device=device)
    numbers = wp.array([5000, 3], dtype=int, device=device)

    def turn(by: int) -> list[Step]:
        return [Step(count_visits, [visits], number=0), Step(halve, [by, numbers, turns], count=1)]

    with use_threads(threads):
        launch_loop([turn(2), turn(3)], numbers, wp.get_device(device))
    expected, left = np.zeros(5000, dtype=int), 5000
    for level in range(100):
        expected[:left] += 1
        left //= 2 if level % 2 == 0 else 3
        if left == 0:
            break
    assert (visits.numpy() == expected).all()
    assert turns.numpy().tolist() == [0, 0, level // 2 + 1, (level + 1) // 2]
    assert numbers.numpy().tolist() == [0, 3]


def test_ctrl_c_stops_a_loop_of_launches():
    """Also between two steps, and one that would never end."""
    code = """
import signal, time
import warp as wp
wp.config.log_level = wp.LOG_WARNING
from test_launch import Step, count_visits, launch_loop, use_threads
signal.signal(signal.SIGALRM, signal.default_int_handler)
visits, numbers = wp.zeros(64, dtype=int, device="cpu"), wp.array([64], dtype=int, device="cpu")
for _ in range(20):
    signal.setitimer(signal.ITIMER_REAL, 0.05, 5.0)
    try:
        with use_threads(2):
            launch_loop([[Step(count_visits, [visits])]], numbers, visits.device)
    except KeyboardInterrupt:
        continue
    raise SystemExit("the loop ended")
assert len(set(visits.numpy().tolist())) <= 21
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, cwd=os.path.dirname(__file__))


@wp.struct
class Scaled:
    values: wp.array(dtype=float)
    factor: float


@wp.kernel(enable_backward=False)
def write_scaled(first: int, scaled: Scaled, out: wp.array(dtype=float)):
    i = first + wp.tid()
    out[i] = scaled.factor * scaled.values[i]


@pytest.mark.parametrize("make", [PreparedLaunch, partial(RecordedLaunch, structs=(1,))], ids=["prepared", "recorded"])
def test_another_struct_in_a_prepared_launch(make, device):
    """Its arrays live as long as the launch, and those of the first one may be gone."""
    device, count = wp.get_device(device), 5000
    if make is PreparedLaunch and device.is_cuda:
        pytest.skip("launches on CUDA are recorded")

    def scaled(factor: float) -> Scaled:
        struct = Scaled()
        struct.values, struct.factor = wp.array(np.arange(count), dtype=float, device=device), factor
        return struct

    out = wp.zeros(count, dtype=float, device=device)
    launch = make(write_scaled, [scaled(1.0), out], device)
    for factor in (1.0, 2.0, 3.0):
        launch.replace(1, scaled(factor))
        gc.collect()
        launch.run(count, Chunks())
        np.testing.assert_array_equal(out.numpy(), factor * np.arange(count, dtype=np.float32))


def test_a_launch_is_repeated_with_other_arguments(device):
    """Also with those that Warp converts, of other sizes, and a struct whose values were changed after it was copied."""
    device = wp.get_device(device)
    first = Scaled()
    first.values, first.factor = wp.array(np.arange(100), dtype=float, device=device), 2.0
    other = copied(first)
    other.factor, first.factor = 5.0, 3.0
    assert other.values is first.values
    block = CUDA_BLOCK if device.is_cuda else 1
    for count, scaled, factor in [(100, first, 3.0), (7, other, 5.0), (100, first, 3.0), (64, other, 5.0)]:
        out = wp.zeros(count, dtype=float, device=device)
        for number in (0, np.int32(0)):  # Warp's own launch takes the second one
            out.zero_()
            launch_again(write_scaled, count, [number, scaled, out], device, block)
            np.testing.assert_array_equal(out.numpy(), factor * np.arange(count, dtype=np.float32))
    with pytest.raises(RuntimeError):
        launch_again(write_scaled, 7, [0, first, wp.zeros(7, dtype=int, device=device)], device, block)


def test_a_bool_is_packed_too(monkeypatch, device):
    """As numbers are: Warp's own launch, which takes far longer, is not asked again."""
    device = wp.get_device(device)
    block, out = CUDA_BLOCK if device.is_cuda else 1, wp.zeros(5, dtype=int, device=device)
    launch(write_whether, 5, [True, out], device=device)  # loads it
    launch_again(write_whether, 5, [0, True, out], device, block)
    monkeypatch.setattr(wp, "launch", None)
    for whether in (False, True):
        launch_again(write_whether, 5, [0, whether, out], device, block)
        assert (out.numpy() == (1 if whether else 2)).all()
