"""The thread pool: any number of callers, interrupts, signal handlers, fork and exit at any moment, and no work when idle."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from support.processes import run_process
from support.threads import from_threads, queries

import wrt
from wrt.kernels.compilation.cores import available_cores, cpu_quota
from wrt.kernels.runtime import launch as launching
from wrt.kernels.runtime import pool as pools
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, launch, use_schedule, use_threads
from wrt.kernels.runtime.schedules import SCHEDULES

pytestmark = pytest.mark.skipif(not pools.is_available(), reason="native helpers need Linux")


@wp.kernel(enable_backward=False)
def add_one(first: int, values: wp.array(dtype=int)):
    i = first + wp.tid()
    values[i] = values[i] + 1


@wp.kernel(enable_backward=False)
def work_long(first: int, rounds: int, values: wp.array(dtype=float)):
    i = first + wp.tid()
    x = float(i)
    for _ in range(rounds):
        x = wp.sqrt(x * 1.0001 + 1.0)
    values[i] = x


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("threads", [2, 5, 64])
def test_every_item_once_by_every_schedule(schedule, threads):
    for count in (2, 1000, 100_003):
        values = wp.zeros(count, dtype=int, device="cpu")
        with use_threads(threads), use_schedule(schedule):
            for _ in range(20):
                launch(add_one, count, [values], device=values.device, chunk=16)
        assert (values.numpy() == 20).all()


def test_an_unknown_schedule_is_refused_by_name():
    with pytest.raises(ValueError, match=r"'random'.*guided"), use_schedule("random"):
        pass


def test_python_hands_out_the_same_chunks(monkeypatch):
    """Where native helpers are not to be had."""
    monkeypatch.setattr(pools, "is_available", lambda: False)
    values = wp.zeros(100_003, dtype=int, device="cpu")
    with use_threads(3):
        launch(add_one, len(values), [values], device=values.device)
    assert (values.numpy() == 1).all()


def test_import_starts_no_thread():
    code = "import threading, wrt; assert threading.active_count() == 1"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_idle_process_takes_no_time():
    """50 ms after the last query helpers are asleep, once "auto" has loaded what it compares."""
    assert (
        run_process("""
from wrt.engine import background
ask()
while background._queue.qsize() or background._under_way.locked():
    time.sleep(0.01)
assert sum(not thread.name.startswith(("wrt-compile", "wrt-background")) for thread in threading.enumerate()) == 4
time.sleep(0.05)
before = time.process_time()
time.sleep(0.5)
print(time.process_time() - before < 0.005)
""").strip()
        == "True"
    )


@pytest.mark.parametrize("turns", [250, pytest.param(1000, marks=pytest.mark.exhaustive)])
def test_sixteen_callers_of_all_queries(turns):
    """16 threads ask hundreds of queries each, of all kinds; every answer is that of one thread."""
    mesh = wrt.scenes.build("teapot", level=2)
    expected = {name: ask() for name, ask in queries(wrt.Scene(mesh, device="cpu", num_threads=1)).items()}
    scene = wrt.Scene(mesh, device="cpu", num_threads=4)
    asked = queries(scene)
    names = list(asked)

    def work(number: int) -> None:
        for turn in range(turns):
            name = names[(number + turn) % len(names)]
            for answer, right in zip(asked[name](), expected[name], strict=True):
                np.testing.assert_array_equal(answer, right, err_msg=name)

    from_threads(work, 16)


def test_more_callers_than_slots():
    """The job queue has 64 slots; the callers that find none work alone."""
    values = [wp.zeros(20_000, dtype=int, device="cpu") for _ in range(100)]
    launches = [PreparedLaunch(add_one, [v], v.device) for v in values]

    def work(number: int) -> None:
        with use_threads(3):
            for _ in range(20):
                launches[number].run(20_000, Chunks(64))

    from_threads(work, len(values))
    assert all((v.numpy() == 20).all() for v in values)


def test_slots_come_back_when_their_threads_end():
    values = wp.zeros(5000, dtype=int, device="cpu")
    for _ in range(100):
        thread = threading.Thread(target=lambda: launch(add_one, 5000, [values], device=values.device, chunk=16))
        thread.start()
        thread.join()
    with use_threads(2):
        launch(add_one, 5000, [values], device=values.device, chunk=16)
        assert len(pools.the_pool()._free) >= 32


def test_a_signal_handler_may_ask():
    """A query inside a handler, while its thread's own query is under way."""
    run_process("""
answers = []
signal.signal(signal.SIGALRM, lambda *_: answers.append(ask()))
for _ in range(50):
    signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-4, 0.005))
    handled = len(answers)
    while len(answers) == handled:
        assert np.array_equal(ask(), expected)
assert answers
assert all(np.array_equal(answer, expected) for answer in answers)
""")


def test_interrupts_at_random_moments():
    """200 times Ctrl-C during queries and builds; all that is asked afterwards is right, and no slot is lost.

    Python drops an exception that is raised while it deletes an object, Ctrl-C too. The timer therefore repeats: a child whose
    only interrupt was dropped would never end.
    """
    run_process("""
random.seed(1)
signal.signal(signal.SIGALRM, signal.default_int_handler)
mesh = wrt.scenes.build("teapot", level=4)
interrupts = 0
while interrupts < 200:
    try:
        signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-4, 0.03), 0.5)
        while True:
            assert np.array_equal(ask(), expected)
            wrt.Scene(mesh, device="cpu")
    except KeyboardInterrupt:
        interrupts += 1
signal.setitimer(signal.ITIMER_REAL, 0)
assert np.array_equal(ask(), expected)
assert len(pools.the_pool()._free) == 63, len(pools.the_pool()._free)
assert not pools.the_pool()._interrupted
""")


def test_ctrl_c_is_answered_at_once():
    """Within 0.1 s or the chunk under way, whatever the number of items."""
    values = wp.zeros(1 << 22, dtype=float, device="cpu")
    slow = PreparedLaunch(work_long, [20_000, values], values.device)
    previous = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with use_threads(2):
            slow.run(64, Chunks(1))
            signal.setitimer(signal.ITIMER_REAL, 0.1, 0.5)
            began = time.perf_counter()
            with pytest.raises(KeyboardInterrupt):
                slow.run(len(values), Chunks(1, 16))
            assert time.perf_counter() - began < 5.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def test_an_interrupted_wait_frees_nothing_that_helpers_use(monkeypatch):
    """After a second Ctrl-C, while the first one waits for helpers, what they write to is kept until they are done."""
    values = wp.zeros(64, dtype=float, device="cpu")
    slow = PreparedLaunch(work_long, [30_000_000, values], values.device)
    owner = threading.Event()
    pool, turn = pools.the_pool(), pools.Slot.turn
    turns = []

    def interrupted(slot: pools.Slot) -> None:
        turns.append(slot)
        if len(turns) == 1:
            turn(slot)  # the first turn ends after the caller's first chunk, with a helper in its own
        if len(turns) <= 2:
            raise KeyboardInterrupt
        turn(slot)

    monkeypatch.setattr(pools.Slot, "turn", interrupted)
    monkeypatch.setattr(pool, "_reap", lambda: None)
    with use_threads(2), pytest.raises(KeyboardInterrupt):
        slow.run(64, Chunks(1, 1), owner)
    monkeypatch.undo()
    assert any(entry[1][1][1] is owner for entry in pool._interrupted)
    until = time.monotonic() + 60
    while pool._interrupted and time.monotonic() < until:
        pool._reap()
        time.sleep(0.01)
    assert not pool._interrupted
    assert not turns[0].is_busy


def test_fork_during_queries():
    """Children that are forked while other threads trace get right answers from pools of their own."""
    run_process("""
scene.occluded(rays * 9, -rays)  # compiled before: children do not wait for a compiler among busy threads
done = threading.Event()
def trace():
    while not done.is_set():
        assert np.array_equal(ask(), expected)
threads = [threading.Thread(target=trace) for _ in range(2)]
for thread in threads:
    thread.start()
parents = pools.the_pool()
for _ in range(20):
    time.sleep(random.uniform(0, 0.01))
    child = os.fork()
    if child == 0:
        values = wp.zeros(100_000, dtype=float, device="cpu")
        right = np.array_equal(scene.occluded(rays * 9, -rays), np.isfinite(expected))
        own = pools.the_pool()
        os._exit(0 if right and own is not parents and not own.closed else 1)
    assert os.waitpid(child, 0)[1] == 0
done.set()
for thread in threads:
    thread.join()
""")


@pytest.mark.parametrize("end", ["pass", "sys.exit(0)", "os._exit(0)"])
def test_exit_during_a_query(end):
    """The interpreter exits while daemon threads trace: no crash, no hang."""
    run_process(
        f"""
def trace():
    while True:
        ask()
for _ in range(3):
    threading.Thread(target=trace, daemon=True).start()
time.sleep(random.uniform(0.05, 0.2))
sys.stderr = open(os.devnull, "w")
{end}
""",
        seconds=60,
    )


def test_many_threads_on_few_cores():
    run_process("""
wrt.set_num_threads(64)
for _ in range(20):
    assert np.array_equal(ask(), expected)
assert np.array_equal(wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu").intersect(rays * 9, -rays).t, expected)
""")


def test_spawned_processes():
    """`multiprocessing` with "spawn" and "fork" both work after a query."""
    for method in ("spawn", "fork"):
        run_process(f"""
import multiprocessing
with multiprocessing.get_context({method!r}).Pool(2) as processes:
    answers = processes.map(wrt.get_num_threads, []) or processes.starmap(np.square, [(3,), (4,)])
assert answers == [9, 16]
assert np.array_equal(ask(), expected)
""")


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, math.inf),
        ({"cpu.max": "max 100000"}, math.inf),
        ({"cpu.max": "150000 100000"}, 1.5),
        ({"a/cpu.max": "400000 100000", "cpu.max": "200000 100000"}, 2.0),
        ({"a/cpu.max": "50000 100000", "cpu.max": "max 100000"}, 0.5),
        ({"a/cpu.max": "broken"}, math.inf),
    ],
)
def test_quota_of_control_groups(tmp_path: Path, files, expected):
    """Version 2: the least limit of the group and of those above it."""
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
    process = tmp_path / "cgroup"
    process.write_text("0::/a\n")
    assert cpu_quota(process, tmp_path) == expected


def test_quota_of_control_groups_of_version_1(tmp_path: Path):
    (tmp_path / "cpu/docker/x").mkdir(parents=True)
    (tmp_path / "cpu/docker/x/cpu.cfs_quota_us").write_text("300000\n")
    (tmp_path / "cpu/docker/x/cpu.cfs_period_us").write_text("100000\n")
    process = tmp_path / "cgroup"
    process.write_text("5:memory:/docker/x\n4:cpu,cpuacct:/docker/x\n")
    assert cpu_quota(process, tmp_path) == 3.0


def test_available_cores_follow_affinity():
    code = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); import wrt; print(wrt.get_num_threads())"
    environment = {name: value for name, value in os.environ.items() if name != "WRT_NUM_THREADS"}
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment).stdout
    assert printed.split()[-1] == "1"
    assert available_cores() >= 1
    assert launching.native is pools


def test_nobody_else_leads_a_job_whose_owner_waits():
    """Two threads that led one job could end the next job of its slot before its time."""

    class Interrupted:
        is_idle, has_helpers, is_busy, owner_waits, turns = False, False, True, True, 0

        def stop(self) -> None:
            pass

        def turn(self) -> None:
            self.turns += 1
            self.is_idle = True

    pool, slot = pools.the_pool(), Interrupted()
    pool._interrupted.append((slot, None))
    pool._reap()
    assert (slot.turns, slot.is_busy) == (0, True)
    slot.owner_waits = False  # it was interrupted again
    pool._reap()
    assert (slot.turns, slot.is_busy) == (1, False)
    assert not pool._interrupted
