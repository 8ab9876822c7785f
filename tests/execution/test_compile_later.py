"""Kernels that are compiled later: single rays stand in for them, with the same hits, and no exit waits for them."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest
import warp as wp

import wrt
import wrt.device
from wrt.engine.facts.query_kinds import CLOSEST, Query
from wrt.engine.launch.expected_kernels import picture_rays, query_kernels
from wrt.engine.plan import contest, stand_ins
from wrt.engine.plan.choices import VARIABLE as AUTO_VARIABLE
from wrt.engine.plan.choices import find_plan
from wrt.engine.rays.device_rays import to_device
from wrt.kernels.compilation import compile_later
from wrt.kernels.compilation.compile_later import BEGIN_SECONDS, PATIENCE_SECONDS, MissingKernel
from wrt.kernels.compilation.kernel_cache import cached_files
from wrt.kernels.layout.mesh_placement import make_shift

COUNT = 10_000


class Missing:
    """A kernel that is there after some calls without it."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def spend(self, seconds: float) -> bool:
        assert seconds > 0.0
        self.left -= 1
        return self.left <= 0


@pytest.fixture(autouse=True)
def later(monkeypatch):
    monkeypatch.setenv(compile_later.VARIABLE, "1")
    monkeypatch.delenv(AUTO_VARIABLE, raising=False)
    yield
    wrt.device.set_auto(None)


@pytest.fixture
def scene():
    return wrt.Scene(wrt.scenes.build("teapot", level=4, ground=False), device="cpu", num_threads=1)


def rays_of(scene: wrt.Scene, count: int = COUNT) -> wrt.Rays:
    rng = np.random.default_rng(0)
    origins = rng.uniform(*scene.bounds, (count, 3)).astype(np.float32)
    return wrt.Rays(origins, rng.normal(size=(count, 3)).astype(np.float32))


def without_kernels(monkeypatch, calls: int = 1 << 30) -> None:
    """As if the kernels of all plans but those of single rays were not compiled until that many calls have been made."""
    monkeypatch.setattr(stand_ins, "needs_no_compiling", lambda kernel, device: False)
    monkeypatch.setattr(stand_ins, "missing_kernel", lambda *args: Missing(calls))
    monkeypatch.setattr(contest, "QUICK_CALLS", 0)


@pytest.mark.parametrize("query", ["intersect", "occluded", "count"])
def test_single_rays_stand_in_and_the_plan_of_the_rules_takes_over(scene, monkeypatch, query):
    rays, ask = rays_of(scene), getattr(scene, query)
    kind = {"intersect": "closest", "occluded": "any", "count": "count"}[query]
    wrt.device.set_auto("rules")
    ruled = scene.explain(rays, query=kind)
    expected = ask(rays)
    wrt.device.set_auto(None)
    without_kernels(monkeypatch, calls=3)
    engines = []
    for _ in range(5):
        found = ask(rays)
        if query == "intersect":
            assert all(np.array_equal(getattr(found, name), getattr(expected, name)) for name in ("t", "primitive_id", "uv"))
        else:
            assert np.array_equal(found, expected)
        engines.append(scene.explain(rays, query=kind).engine)
    assert ruled.engine != "single"
    assert engines == ["single"] * 2 + [ruled.engine] * 3


def test_the_plan_says_for_what_it_stands_in(scene, monkeypatch):
    rays = rays_of(scene)
    wrt.device.set_auto("rules")
    engine = scene.explain(rays).engine
    wrt.device.set_auto(None)
    without_kernels(monkeypatch)
    assert f"but the kernel for {engine} is not compiled" in scene.intersect(rays).plan.reason


def test_calls_that_nobody_times_wait_for_their_kernels(scene, monkeypatch):
    """They would do without for ever."""
    without_kernels(monkeypatch)
    rays = to_device(rays_of(scene), scene.state.device, scene.state.center)
    assert find_plan(scene.state, rays.facts, Query(CLOSEST), rays.sample).name != "single"


def test_a_picture_expects_the_kernels_of_what_stands_in(scene, monkeypatch):
    """And those of its rules where calls are not measured, as its ambient rays are not."""
    without_kernels(monkeypatch)
    rays = picture_rays(1 << 16, shared_origin=True, shadows=True)
    measured, ruled = (query_kernels(scene.state, rays, measured=which) for which in (True, False))
    assert [sum(name in kernel.key for kernel in measured) for name in ("single_ray", "packet_traversal")] == [2, 0]
    assert [sum(name in kernel.key for kernel in ruled) for name in ("single_ray", "packet_traversal")] == [0, 2]


@pytest.mark.parametrize("case", ["rules", "off", "named", "very many"])
def test_where_nothing_stands_in(scene, monkeypatch, case):
    without_kernels(monkeypatch)
    rays, options = rays_of(scene), {}
    if case == "rules":
        wrt.device.set_auto("rules")
    elif case == "off":
        monkeypatch.setenv(compile_later.VARIABLE, "0")
    elif case == "very many":
        monkeypatch.setattr(stand_ins, "MAX_RAYS", COUNT - 1)
    else:
        options = {"traversal": "stream"}
    assert scene.intersect(rays, **options).plan.traversal == "stream"


@pytest.mark.parametrize("text", ["yes", "2"])
def test_a_setting_that_is_none(monkeypatch, text):
    monkeypatch.setenv(compile_later.VARIABLE, text)
    with pytest.raises(ValueError, match=f"WRT_COMPILE_LATER is '{text}'; set it to 0"):
        compile_later.is_possible()


def test_embedded_interpreters_compile_nothing_later(monkeypatch):
    """To start the program in which Python runs would start it a second time."""
    assert compile_later.is_possible()
    for name in ("/usr/bin/blender", "", None):
        monkeypatch.setattr(sys, "executable", name)
        assert not compile_later.is_possible()


def shift_kernel() -> MissingKernel:
    return MissingKernel(make_shift, wp.vec3, make_shift(wp.vec3))


def wait_for(condition, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_another_process_compiles_into_the_same_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    missing, files = shift_kernel(), cached_files(make_shift(wp.vec3).module, wp.get_device("cpu"), 1)
    assert not missing.spend(0.5 * BEGIN_SECONDS)
    assert missing._process is None, "what takes so little starts no process"
    assert not missing.spend(BEGIN_SECONDS)
    wait_for(lambda: missing.spend(0.0))
    assert all(path.exists() for path in files)


@pytest.mark.skipif(not hasattr(os, "getsid"), reason="sessions and groups of processes are POSIX")
def test_a_process_gives_way_within_the_session():
    """Linux may share cores out among sessions, whatever the priorities of their processes."""
    process = compile_later._start(b"")
    try:
        wait_for(lambda: os.getpriority(os.PRIO_PROCESS, process.pid) == compile_later.LOWEST_PRIORITY)
        assert os.getpgid(process.pid) == process.pid, "Ctrl-C is not for it"
        assert os.getsid(process.pid) == os.getsid(0)
    finally:
        compile_later.end(process)


def test_a_kernel_that_is_missed_too_long_is_waited_for(monkeypatch):
    monkeypatch.setattr(compile_later, "PROGRAM", "import time; time.sleep(600)")
    missing = shift_kernel()
    assert not missing.spend(BEGIN_SECONDS)
    assert missing.spend(PATIENCE_SECONDS)
    assert missing._process.returncode is not None, "its process is ended"


def test_no_more_processes_than_may_compile(monkeypatch):
    monkeypatch.setenv("WRT_COMPILE_JOBS", "1")
    monkeypatch.setattr(compile_later, "PROGRAM", "import time; time.sleep(600)")
    first, second = shift_kernel(), shift_kernel()
    assert not first.spend(BEGIN_SECONDS)
    assert not second.spend(BEGIN_SECONDS)
    assert second._process is None
    first._stop()
    assert not second.spend(0.0)
    assert second._process is not None
    compile_later.stop()
    assert second._process.returncode is not None


def test_a_process_that_cannot_be_started_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert shift_kernel().spend(BEGIN_SECONDS)


def test_a_program_that_ends_does_not_wait_and_its_kernel_is_compiled(tmp_path):
    """Nor does Python warn of the process that goes on."""
    begin, done = tmp_path / "begin", tmp_path / "done"
    waits = f"import os, time\nwhile not os.path.exists({str(begin)!r}): time.sleep(0.05)\nopen({str(done)!r}, 'w')"
    program = f"""
import warp as wp
from wrt.kernels.compilation import compile_later
from wrt.kernels.compilation.kernel_cache import init_warp
from wrt.kernels.layout.mesh_placement import make_shift
wp.config.log_level = wp.LOG_ERROR  # Warp warns of an old Python
init_warp()
compile_later.PROGRAM = {waits!r}
assert not compile_later.MissingKernel(make_shift, wp.vec3, make_shift(wp.vec3)).spend(1.0)
print("begun")
"""
    command = [sys.executable, "-W", "error::ResourceWarning", "-c", program]
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path / "cache")}
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert (result.returncode, result.stdout, result.stderr) == (0, "begun\n", "")
    begin.touch()
    wait_for(done.exists)
