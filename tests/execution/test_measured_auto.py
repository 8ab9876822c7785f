"""Queries whose engines "auto" compares: the answers stay the same, the plan follows the times, and what was learned is kept.

Times come from made-up clocks, so that no test depends on the machine.
"""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import wrt
import wrt.device
from wrt.engine import executor
from wrt.engine.facts.query_kinds import Query
from wrt.engine.launch import parts
from wrt.engine.plan import choices, contest, learner
from wrt.engine.plan.learner import Learner
from wrt.kernels.compilation.module_compiler import NotCompiledError, without_compiling
from wrt.kernels.runtime import launch

COUNT = 10_000


@pytest.fixture
def mesh() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=4, ground=False)


@pytest.fixture
def scene(mesh, monkeypatch) -> wrt.Scene:
    """On one thread; kernels of rivals are loaded, and here compiled, at once."""
    monkeypatch.setattr(executor, "run_in_background", lambda task: task())
    monkeypatch.setattr(executor, "without_compiling", lambda: threading.Lock())
    return wrt.Scene(mesh, device="cpu", num_threads=1)


@pytest.fixture(autouse=True)
def measured(monkeypatch):
    monkeypatch.delenv(choices.VARIABLE, raising=False)
    yield
    wrt.device.set_auto(None)


def random_rays(mesh: wrt.TriangleMesh, count: int = COUNT) -> wrt.Rays:
    rng = np.random.default_rng(0)
    return wrt.Rays(rng.uniform(*mesh.bounds, (count, 3)).astype(np.float32), rng.normal(size=(count, 3)).astype(np.float32))


OTHERS = 1e-5
"""Seconds a ray of an engine that a test does not name."""


class Clock:
    """A clock that the engine that runs moves on by its own time a ray."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, rates: dict[str, float]) -> None:
        self.now, self.rates, self.engines = 0.0, rates, []
        trace = executor.trace_chosen
        monkeypatch.setattr(executor, "call_clock", lambda: lambda: self.now)

        def traced(scene, chosen, rays, kind, *args):
            self.engines.append(chosen.name)
            self.now += rays.facts.count * self.rates.get(chosen.name, OTHERS)
            return trace(scene, chosen, rays, kind, *args)

        monkeypatch.setattr(executor, "trace_chosen", traced)


def same(one: wrt.Hits, other: wrt.Hits) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("t", "primitive_id", "uv"))


def learned(scene: wrt.Scene) -> Learner:
    (found,) = scene.state.cache.learned.values()
    return found


@pytest.mark.parametrize("fastest", ["stream", "interleaved", "packet, leaf_boxes"])
def test_the_fastest_engine_is_used(scene, mesh, monkeypatch, fastest):
    rays = random_rays(mesh)
    wrt.device.set_auto("rules")
    expected = scene.intersect(rays)
    wrt.device.set_auto(None)
    clock = Clock(monkeypatch, {"stream": 2e-6, "interleaved": 2e-6} | {fastest: 1e-6})
    assert all(same(scene.intersect(rays), expected) for _ in range(30))
    assert {"stream", "interleaved", "packet, leaf_boxes"} == {*clock.engines}
    assert clock.engines[-5:] == [fastest] * 5
    plan = scene.explain(rays)
    assert plan.engine == fastest
    assert "measured, in microseconds a ray: " + fastest + " 1, " in plan.reason
    assert scene.intersect(rays).plan == plan


def test_few_rays_and_given_plans_are_not_compared(scene, mesh, monkeypatch):
    clock = Clock(monkeypatch, dict.fromkeys(("single", "stream", "interleaved"), 1e-3))
    few, many = random_rays(mesh, 100), random_rays(mesh)
    for _ in range(10):
        scene.intersect(few)
        scene.intersect(many, traversal="stream")
        scene.intersect(many, traversal=scene.explain(many, traversal="interleaved"))
    assert not scene.state.cache.learned
    assert len(clock.engines) == 30


def test_the_rules_alone(scene, mesh, monkeypatch):
    """The same calls always use the same engine."""
    wrt.device.set_auto("rules")
    rays = random_rays(mesh)
    plan = scene.explain(rays)
    clock = Clock(monkeypatch, {"stream": 1.0, "interleaved": 2.0})
    assert all(scene.intersect(rays).plan == plan for _ in range(20))
    assert {*clock.engines} == {plan.traversal}
    assert not scene.state.cache.learned


def test_the_rules_alone_by_the_environment(monkeypatch):
    assert wrt.device.get_auto() == "measured"
    monkeypatch.setenv(choices.VARIABLE, "rules")
    assert wrt.device.get_auto() == "rules"
    wrt.device.set_auto("measured")
    assert wrt.device.get_auto() == "measured"
    wrt.device.set_auto(None)
    monkeypatch.setenv(choices.VARIABLE, "guess")
    with pytest.raises(ValueError, match="WRT_AUTO 'guess' is unknown; choose from measured, rules"):
        wrt.device.get_auto()


def test_bad_settings():
    with pytest.raises(ValueError, match="how 'best' is unknown"):
        wrt.device.set_auto("best")
    with pytest.raises(TypeError, match="how must be a name"):
        wrt.device.set_auto(3)  # type: ignore[arg-type]


def test_rays_that_start_elsewhere_are_looked_at(scene, mesh, monkeypatch):
    """A lidar that jumps: the rules choose again, at once if the calls so far have paid for it."""
    sphere = np.random.default_rng(0).normal(size=(64, 64, 3)).astype(np.float32)
    directions = np.sort(sphere, axis=0)
    looks = []
    monkeypatch.setattr(executor, "choose_plan", lambda *args: looks.append(args) or choices.choose_plan(*args))
    monkeypatch.setattr(executor, "call_clock", lambda: iter(range(10**6)).__next__)
    for point in ([0, 0, 9], [0, 0, 9], [0, 0, 9.001], [0, 9, 0], [0, 9, 0]):
        scene.intersect(np.array(point, dtype=np.float32), directions)
    assert len(looks) == 1 or not scene.explain([0, 0, 9], directions).coherent


def test_another_guess_keeps_the_rivals(scene, mesh, monkeypatch):
    """What the rules choose at another place is compared with what was chosen and tried before."""
    Clock(monkeypatch, {"stream": 2e-6, "interleaved": 1e-6})
    rays = random_rays(mesh)
    for _ in range(30):
        scene.intersect(rays)
    (known,) = (kept[0].contest for kept in scene.state.cache.choices.values())
    before = set(known.ways())
    assert {"stream", "interleaved"} < before
    brought = executor.to_device(rays, scene.state.device, scene.state.center)
    single = choices.find_plan(scene.state, brought.facts, Query("closest", "single"))
    known.renew(scene.state, single)
    assert known.ways()[0] == "single"
    assert set(known.ways()) == before | {"single"}
    assert known.learner.best == "single"


def test_parts_cost_a_share_of_a_call(monkeypatch):
    """A trial that calls as a whole cannot afford may be made in parts of one."""
    monkeypatch.setattr(learner, "FEWEST_CALLS", 2)
    one = Learner("a")
    one.tell("a", COUNT, 1.0)
    one.conclude({"a": 1e-4, "b": 1.9e-4})
    for _ in range(10):
        one.tell("a", COUNT, 1.0)
    assert not one.is_due(("a", "b"))
    assert one.is_due(("a", "b"), 0.2)


def test_updates_keep_what_was_learned(scene, mesh, monkeypatch):
    Clock(monkeypatch, {"stream": 2e-6, "interleaved": 1e-6})
    rays = random_rays(mesh)
    for _ in range(30):
        scene.intersect(rays)
    before = learned(scene)
    scene.update(0, vertices=mesh.vertices * np.float32(1.01))
    assert learned(scene) is before
    assert scene.explain(rays).reason.count("measured") == 1


def test_threads_at_once(scene, mesh):
    rays = random_rays(mesh)
    expected = scene.intersect(rays, traversal="stream")
    with ThreadPoolExecutor(4) as pool:
        found = [*pool.map(lambda _: scene.intersect(rays), range(200))]
    assert all(same(one, expected) for one in found)


def test_kernels_that_are_not_compiled_are_left_out(mesh, monkeypatch):
    """Nothing is compiled for a comparison, and the reason names what is missing."""
    monkeypatch.setattr(executor, "run_in_background", lambda task: task())
    scene, rays = wrt.Scene(mesh, device="cpu", num_threads=1), random_rays(mesh)
    clock = Clock(monkeypatch, {"stream": 2e-6, "interleaved": 1e-6})
    trace = executor.trace_chosen

    def refuse(scene, chosen, rays, kind, *args):
        if rays.facts.count == executor.LOADED_RAYS:
            raise NotCompiledError("not compiled")
        return trace(scene, chosen, rays, kind, *args)

    monkeypatch.setattr(executor, "trace_chosen", refuse)
    plans = [scene.intersect(rays).plan for _ in range(30)]
    assert len({*clock.engines}) == 1
    assert "; not compiled: " in plans[-1].reason


def test_nothing_is_compiled_inside_without_compiling(monkeypatch):
    import warp as wp

    def kernel(first: int, out: wp.array(dtype=int)):  # type: ignore[valid-type]
        out[first + wp.tid()] = 12345

    made = wp.Kernel(kernel, module=wp.get_module("never_compiled_here"), key="kernel")
    with without_compiling(), pytest.raises(NotCompiledError, match="never_compiled_here"):
        launch.load([made], wp.get_device("cpu"))


def small_parts(monkeypatch) -> None:
    monkeypatch.setattr(parts, "RAYS_PER_THREAD", 128)
    monkeypatch.setattr(parts, "LARGEST_SHARE", 0.95)
    monkeypatch.setattr(parts, "WHOLE_SHARE", 0.95)
    monkeypatch.setattr(parts, "GROUP", 64)
    monkeypatch.setattr(parts, "ROWS", 16)


@pytest.mark.parametrize("columns", [0, 100])
def test_a_batch_in_parts(scene, mesh, monkeypatch, columns):
    """Hits of a batch whose parts several engines trace are those of one engine, to the bit; each ray is traced once."""
    small_parts(monkeypatch)
    count = 180_000 if columns else 60_000
    rays = wrt.PinholeCamera.framing(mesh, columns, count // columns).rays() if columns else random_rays(mesh, count)
    expected = scene.intersect(rays, traversal="single")
    traced: list[tuple[str, int, int]] = []
    run = parts.compare_parts

    def compared(plans, best, count, size, trace, unit):
        def noted(chosen, begin, number):
            traced.append((chosen.name, begin, number))
            trace(chosen, begin, number)
            return 1.0 if chosen.name == best else 1.1

        rates, lost, gaps = run(plans, best, count, size, noted, unit)
        traced.extend(("", begin, end - begin) for begin, end in gaps)
        return rates, lost, gaps

    monkeypatch.setattr(parts, "compare_parts", compared)
    monkeypatch.setattr(contest, "LOAD_SECONDS", 0.0)
    for _ in range(12):
        assert same(scene.intersect(rays), expected)
    assert traced, "the batch was not divided"
    covered = np.zeros(count, dtype=int)
    for _, begin, number in traced:
        covered[begin : begin + number] += 1
    trials = covered.min()
    assert trials >= 1
    assert (covered == trials).all(), "each ray is traced once in a trial"
    names = {name for name, *_ in traced if name}
    assert len(names) >= 2
    unit = parts.ROWS * columns or parts.GROUP
    assert all(begin % unit == 0 for name, begin, _ in traced if name)


def test_parts_of_made_up_plans():
    """Places are spread over the batch; a hopeless plan has one part; what is left are the ranges between."""
    seconds, traced = {"a": 1.0, "b": 0.5, "c": 9.0}, []
    plans = {name: name for name in seconds}

    def trace(plan: str, begin: int, count: int) -> float:
        traced.append((plan, begin, count))
        return seconds[plan] * count

    rates, lost, gaps = parts.compare_parts(plans, "a", 100_000, 1000, trace, 100)  # type: ignore[arg-type]
    assert [plan for plan, *_ in traced] == ["a", "b", "c", "b", "b"]
    assert rates == {"a": 1.0, "b": 0.5, "c": 1.5}, "a part that takes long counts as one that was disturbed"
    assert lost == 500.0 + 8500.0
    ranges = sorted([(begin, begin + count) for _, begin, count in traced] + [gap for gap in gaps if gap[0] < gap[1]])
    assert ranges[0][0] == 0
    assert ranges[-1][1] == 100_000
    assert all(one[1] == other[0] for one, other in itertools.pairwise(ranges))


def test_a_part_that_was_disturbed_decides_nothing():
    """At one of three places the best plan took long: it stays."""
    taken: list[str] = []

    def trace(plan: str, begin: int, count: int) -> float:
        taken.append(plan)
        return 1.5 if taken.count("a") == 2 and plan == "a" else 1.0

    rates, _, _ = parts.compare_parts({"a": "a", "b": "b"}, "a", 100_000, 1000, trace, 100)  # type: ignore[arg-type, dict-item]
    assert rates["b"] >= rates["a"]


def test_small_batches_are_not_divided(scene, mesh):
    rays = executor.to_device(random_rays(mesh), scene.state.device, scene.state.center)
    plan = choices.find_plan(scene.state, rays.facts, executor.QUERIES["closest"])
    assert parts.part_size({"a": plan, "b": plan}, rays) is None
