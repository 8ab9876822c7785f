"""The benchmark measures what it says: rays where they belong, right ratios, wrong answers in sight. No timings here."""

from functools import partial

import numpy as np
import pytest
import trimesh

import wrt
from wrt.bench.comparisons.query_comparison import ask
from wrt.bench.core.agreement import closest_agreement, lists_agreement, occlusion_agreement, share
from wrt.bench.core.paired_timing import Contender, Timing, take_turns, time_call
from wrt.bench.core.workloads import WORKLOADS, Workload, WorkloadMaker
from wrt.bench.peers import embree as embree_peer
from wrt.bench.peers import peer_table
from wrt.bench.peers.embree import Embree
from wrt.bench.peers.embree_library import EMBREES
from wrt.bench.peers.engines import BRUTE_FORCE_PAIRS, all_engines
from wrt.bench.peers.peer import Answer, Peer, Query, device_rays
from wrt.bench.peers.peer_table import PEERS, make_peers
from wrt.engine.facts.query_kinds import AUTO
from wrt.kernels.traversal import TRAVERSALS
from wrt.scenes import teapot

SIZE = 16
MESH = teapot(level=2, ground=False)
SPHERE = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=2))
FULL = (AUTO, "brute", "single")  # traversals whose engines do all workloads
OTHERS = [engine for engine in all_engines(2, "cpu") if engine.traversal not in FULL]


def made(name, **options):
    return next(WorkloadMaker(MESH, **{"size": SIZE, **options}).make([name]))


# -- measuring ---------------------------------------------------------------------------------------------------------


class FakeClock:
    """Time passes only when a contender says so."""

    def __init__(self):
        self.now = 0.0
        self.log = []

    def __call__(self):
        return self.now

    def contender(self, name, *seconds, items=1, warm_up=None):
        durations = iter(seconds)

        def run():
            self.log.append(name)
            self.now += next(durations)
            return name

        return Contender(name, run, items, warm_up)


def test_contenders_take_turns_and_ratios_are_taken_round_by_round():
    clock = FakeClock()
    # the machine slows down tenfold after the second round: no ratio shows it
    slow = clock.contender("a", 99.0, 1.0, 1.0, 10.0), clock.contender("b", 99.0, 2.0, 3.0, 25.0)
    seen = []
    timings = take_turns(slow, 3, clock=clock, on_turn=seen.append)
    assert clock.log == seen == [*"ab", *"ab", *"ba", *"ab"], "the warm-ups, then rounds, each of which begins with the next"
    assert timings["a"].seconds == [1.0, 1.0, 10.0]
    assert (timings["b"].median, timings["b"].spread) == (3.0, (2.0, 25.0))
    assert timings["b"].ratio_to(timings["a"]) == 2.5
    assert timings["a"].ratio_to(timings["a"]) == 1.0
    assert timings["a"].result == "a"


def test_ratios_are_per_item():
    clock = FakeClock()
    contenders = [clock.contender("a", 0.0, 1.0, items=100), clock.contender("b", 0.0, 1.0, items=10)]
    timings = take_turns(contenders, 1, clock=clock)
    assert timings["b"].ratio_to(timings["a"]) == pytest.approx(10.0)


def test_a_turn_of_a_quick_contender_starts_with_an_untimed_call():
    clock = FakeClock()
    contenders = [clock.contender("a", 0.1, 0.3, 0.1, 0.3, 0.1), clock.contender("b", 2.0, 0.2, 9.0, 1.0)]
    timings = take_turns(contenders, 2, clock=clock, settle=0.5)
    assert timings["a"].seconds == pytest.approx([0.1, 0.1])
    assert timings["b"].seconds == pytest.approx([0.2, 1.0]), "its warm-up was slow, its first round quick"
    built = take_turns([clock.contender("c", 5.0, 1.0, warm_up=lambda: None)], 2, clock=clock, settle=0.5)
    assert built["c"].seconds == pytest.approx([5.0, 1.0]), "a warm-up of its own tells nothing"


def test_slow_contenders_sit_out_when_their_budget_is_spent():
    clock = FakeClock()
    contenders = [clock.contender("a", *[1.0] * 5), clock.contender("b", *[4.0] * 3)]
    timings = take_turns(contenders, 4, clock=clock, budget=9.0)
    assert timings["a"].seconds == [1.0] * 4
    assert timings["b"].seconds == [4.0, 4.0, None, None]
    assert timings["b"].ratio_to(timings["a"]) == 4.0
    assert Timing(1, [None, 1.0]).ratio_to(Timing(1, [1.0, None])) is None


def test_contenders_that_fail_are_left_out_with_the_reason():
    def fail():
        raise ValueError("needs a shared origin")

    clock = FakeClock()
    timings = take_turns([clock.contender("a", 1.0, 1.0), Contender("b", fail)], 1, clock=clock)
    assert timings["b"].error == "ValueError: needs a shared origin"
    assert timings["b"].times == []
    assert timings["a"].seconds == [1.0]


def test_warm_ups_of_their_own_are_not_timed():
    clock = FakeClock()
    warmed = []
    contender = clock.contender("a", 1.0, warm_up=lambda: warmed.append(True))
    assert take_turns([contender], 1, clock=clock)["a"].seconds == [1.0]
    assert warmed == [True]
    assert time_call(clock.contender("b", 0.5).run, clock) == 0.5


def test_agreement_counts_rays():
    primitive, expected = np.array([3, -1, 5, 7, -1]), np.array([3, -1, 6, -1, 2])
    t = np.array([1.0, np.inf, 2.0, 1.0, np.inf])
    found = closest_agreement(primitive, t, expected, np.array([1.0, np.inf, 2.05, np.inf, 4.0]), 0.1)
    assert (found.hits, found.same_hit, found.same_primitive, found.same_t) == (3, 0.6, 0.4, 0.6)
    assert closest_agreement(primitive, t, expected, t + 1.0, 0.1).same_t == 0.2
    occluded = occlusion_agreement(np.array([True, False, True]), np.array([True, True, True]))
    assert (occluded.hits, occluded.same_hit, occluded.same_primitive) == (2, pytest.approx(2 / 3), None)
    assert share(np.zeros(0, bool)) == 1.0
    # five rays: the same, one hit less, another triangle, none by both, the same in another order
    rays, triangles = np.array([0, 1, 1, 2, 4, 4]), np.array([7, 1, 2, 3, 5, 6])
    found = lists_agreement(5, np.array([4, 4, 0, 1, 2]), np.array([6, 5, 7, 1, 4]), rays, triangles)
    assert (found.hits, found.same_hit, found.same_primitive) == (5, 0.8, 0.6)


# -- peers -------------------------------------------------------------------------------------------------------------


def assert_agreement(peers, workloads):
    """Peers answer these workloads as the first of them does, which is wrt."""
    questions = [*ask(peers, MESH, WorkloadMaker(MESH, size=SIZE).make([name for name in workloads if name != "inside"]), 1)]
    if "inside" in workloads:  # what is inside an open mesh is a matter of taste
        questions += ask(peers, SPHERE, WorkloadMaker(SPHERE, size=SIZE).make(["inside"]), 1)
    for question in questions:
        assert question.reference == "wrt"
        for row in question.rows:
            assert row.error is None, row
            assert row.agreement.same_hit >= 0.99, row
            assert row.agreement.hits > 0 or question.workload == "ao"
            assert question.kind not in ("closest", "all") or row.agreement.same_primitive >= 0.99, row
            assert question.kind != "closest" or row.agreement.same_t >= 0.99, row


@pytest.mark.parametrize("peer_name", PEERS)
def test_every_peer_agrees_with_wrt(peer_name):
    """Engines are of one class: those of single rays and of brute force do all workloads, those on trees of a given width one,
    and all do all if asked."""
    peers, missing = make_peers([peer_name], 2, "cpu")
    if missing:
        pytest.skip(str(missing))
    others = [peer for peer in peers[1:] if getattr(peer, "traversal", AUTO) not in FULL]
    assert_agreement([peer for peer in peers if peer not in others], WORKLOADS)
    if peer_name == "engines":
        assert_agreement([peers[0], *(peer for peer in others if isinstance(peer.accelerator, wrt.Bvh))], ["near"])


@pytest.mark.exhaustive
@pytest.mark.parametrize("engine", OTHERS, ids=lambda engine: engine.name)
def test_every_engine_agrees_in_all_workloads(engine):
    assert_agreement([*make_peers([], 2, "cpu")[0], engine], WORKLOADS)


@pytest.mark.parametrize("peer_name", PEERS)
def test_uv_and_t_name_the_same_point(peer_name):
    rays = made("near")
    for peer in make_peers([peer_name], 1, "cpu")[0]:
        peer.build(MESH)
        query = peer.closest(rays)
        answer = query.read(query.run())
        if answer.uv is None:
            continue
        hit = answer.primitive >= 0
        corners = MESH.vertices[MESH.faces[answer.primitive[hit]]]
        u, v = answer.uv[hit].T[..., None]
        points = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
        expected = rays.origins[hit] + rays.directions[hit] * answer.t[hit, None]
        np.testing.assert_allclose(points, expected, atol=1e-4 * MESH.extent, err_msg=peer.name)
        assert np.isinf(answer.t[~hit]).all()


def test_engines_cover_the_tables():
    engines = all_engines(2, "cpu")
    assert {engine.traversal for engine in engines} == {*TRAVERSALS}
    assert {engine.triangle_test for engine in engines} == {"auto"}, "tests are compared by `python -m studies triangle-tests`"
    assert len({engine.name for engine in engines}) == len(engines)
    brute = next(engine for engine in engines if engine.traversal == "brute")
    assert brute.ray_limit(BRUTE_FORCE_PAIRS // 1000) == 1000
    assert engines[-1].ray_limit(10**6) is None


def test_the_price_of_watertightness():
    """wrt takes part with a plain triangle test too, whose rays leak at edges where the default's do not."""
    rng = np.random.default_rng(0)
    corners = SPHERE.vertices[SPHERE.faces[rng.integers(0, SPHERE.triangle_count, 20000), :2]]
    aims = corners[:, 0] + rng.random((20000, 1)) * (corners[:, 1] - corners[:, 0])
    origins = np.broadcast_to(np.float32([0.1, 0.2, 0.3]), aims.shape)
    rays = Workload("edges", "closest", origins, (aims - origins).astype(np.float32), shares_origin=True)
    (question,) = ask(make_peers(["plain"], 1, "cpu")[0], SPHERE, [rays], 1)
    watertight, plain = question.rows
    assert (watertight.name, plain.name) == ("wrt", "wrt, plain")
    assert plain.agreement.hits < watertight.agreement.hits == len(rays)
    assert plain.ratio > 0.0


@pytest.mark.parametrize("name", ["far", "random"])
def test_rays_on_the_device_get_the_same_answers(name):
    rays = made(name)
    (engine,) = make_peers(["wrt"], 1, "cpu")[0]
    engine.build(MESH)
    query = engine.closest(rays)
    expected = query.read(query.run())
    hits = engine.scene.intersect(*device_rays(rays, "cpu"), 0.0, rays.t_max)
    np.testing.assert_array_equal(hits.t.numpy(), expected.t)
    np.testing.assert_array_equal(hits.primitive_id.numpy(), expected.primitive)


def test_missing_peers_are_reported_with_the_way_to_get_them(monkeypatch):
    class Absent(Peer):
        name, package = "Absent", "no_such_package"
        load = construct = closest = lambda self, *arguments: None

    monkeypatch.setitem(PEERS, "absent", lambda threads, device: [Absent()])
    peers, missing = make_peers(["absent"], 1, "cpu")
    assert [peer.name for peer in peers] == ["wrt"], "wrt is there whether named or not"
    assert missing == {"Absent": "needs no_such_package, which is not installed: pip install no_such_package"}
    with pytest.raises(ValueError, match="peer 'nobody' is unknown; choose from wrt"):
        make_peers(["nobody"], 1, "cpu")


def test_a_peer_that_cannot_be_imported_is_missing(monkeypatch, tmp_path):
    """Open3D was installed on a machine without libusb: `wrt bench` ended with the ImportError, after a minute of builds."""

    class Broken(Peer):
        name, package = "Broken", "package_without_its_library"
        load = construct = closest = lambda self, *arguments: None

    (tmp_path / "package_without_its_library.py").write_text("raise ImportError('libusb-1.0.so.0: no such file')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(PEERS, "broken", lambda threads, device: [Broken()])
    peers, missing = make_peers(["broken"], 1, "cpu")
    assert [peer.name for peer in peers] == ["wrt"]
    reason = "package_without_its_library is installed but cannot be imported: libusb-1.0.so.0: no such file"
    assert missing == {"Broken": reason}


@pytest.fixture(params=[*EMBREES], ids="version {}".format)
def embree(request):
    """Makes a version of Embree with a number of threads; skips where it is not to be had."""
    make = partial(Embree, version=request.param)
    if (reason := make().available()) is not None:
        pytest.skip(reason)
    return make


@pytest.mark.parametrize("rays", [1, 15, 16, 17, 255, 256, 257, 4097])
def test_embree_answers_the_same_with_any_number_of_threads(embree, rays):
    """Its packets are chunks of a job of the thread pool: none is left out, none runs past the end."""
    peer, reference = embree(1), make_peers(["wrt"], 1, "cpu")[0][0]
    peer.build(MESH)
    reference.build(MESH)
    for workload in (made("random", size=68), made("near", size=68)):
        workload = workload.thinned(rays)
        queries = [peer.asked_by(threads).closest(workload) for threads in (1, 2, 5)]
        answers = [query.read(query.run()) for query in queries]
        expected = reference.closest(workload)
        expected = expected.read(expected.run())
        agreement = closest_agreement(answers[0].primitive, answers[0].t, expected.primitive, expected.t, 1e-5 * MESH.extent)
        assert min(agreement.same_hit, agreement.same_primitive, agreement.same_t) >= 0.998  # its scene is not watertight
        for query, answer in zip(queries, answers, strict=True):
            again = query.read(query.run())
            for other in (answer, again):
                np.testing.assert_array_equal(other.t, answers[0].t)
                np.testing.assert_array_equal(other.primitive, answers[0].primitive)
                np.testing.assert_array_equal(other.uv, answers[0].uv)


@pytest.mark.parametrize("width", [4, 8, 16])
def test_embree_answers_the_same_in_packets_of_any_width(embree, width):
    peer = embree(2)
    peer.build(MESH)
    native = peer.closest(made("random"))
    expected = native.read(native.run())
    peer.width = width
    query = peer.closest(made("random"))
    answer = query.read(query.run())
    assert query.run().itemsize == width * {3: 80, 4: 84}[peer.version.number]
    np.testing.assert_array_equal(answer.primitive, expected.primitive)
    np.testing.assert_allclose(answer.t, expected.t, rtol=1e-5)
    occluded = peer.occluded(made("random"))
    np.testing.assert_array_equal(occluded.read(occluded.run()), expected.primitive >= 0)


def test_embree_finds_what_brute_force_finds(embree):
    """Triangles apart from each other, so that its test, which lets rays through along edges, differs nowhere."""
    rng = np.random.default_rng(1)
    corners = rng.uniform(-1.0, 1.0, (300, 1, 3)) + rng.uniform(-0.1, 0.1, (300, 3, 3))
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(900).reshape(-1, 3))
    peer, rays = embree(2), next(WorkloadMaker(mesh, size=60).make(["random"]))
    peer.build(mesh)
    query = peer.closest(rays)
    answer = query.read(query.run())
    expected = wrt.Scene(mesh, device="cpu").intersect(rays.origins, rays.directions, traversal="brute")
    assert 100 < expected.is_hit.sum() < len(rays) - 100
    np.testing.assert_array_equal(answer.primitive, expected.primitive_id)
    np.testing.assert_allclose(answer.t, expected.t, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(answer.uv[expected.is_hit], expected.uv[expected.is_hit], atol=1e-4)
    short = Workload("random", "occlusion", rays.origins, rays.directions, t_max=0.5)
    query = peer.occluded(short)
    np.testing.assert_array_equal(query.read(query.run()), expected.t <= 0.5)


def test_embree_is_held_to_avx2_where_wrt_is(embree, monkeypatch):
    monkeypatch.setattr(embree_peer, "target_name", lambda: "x86-64-v3")
    held = embree(1)
    held.build(MESH)
    assert held.width == 8
    assert held.note.endswith(", AVX2")
    query = held.closest(made("random"))
    answer = query.read(query.run())
    monkeypatch.undo()
    free = embree(1)
    free.build(MESH)
    query = free.closest(made("random"))
    np.testing.assert_array_equal(answer.primitive, query.read(query.run()).primitive)
    assert not free.note.endswith("AVX2")


def test_each_version_of_embree_is_one_contender():
    """The old name stands for both; whoever asks for all contenders gets each once."""
    peers, missing = make_peers(["embree", "embree3", "embree4"], 2, "cpu")
    names = [peer.name for peer in peers] + [*missing]
    assert sorted(names) == ["Embree 3", "Embree 4", "wrt"]


def test_embree_that_is_missing_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(embree_peer, "library", lambda version: None)
    peers, missing = make_peers(["embree"], 1, "cpu")
    assert [peer.name for peer in peers] == ["wrt"]
    assert "libembree3-3" in missing["Embree 3"]
    assert "pip install embreex" in missing["Embree 4"]


def test_embreex_does_not_build_embree_4_with_its_threads(monkeypatch):
    """Its own device is for all cores: beside it, Embree 4 with one thread was built by two, twice as fast as its row said."""
    monkeypatch.setattr(peer_table, "available_cores", lambda: 2)
    monkeypatch.setattr(Peer, "available", lambda self: None)
    monkeypatch.setattr(Embree, "available", lambda self: None)
    peers, missing = make_peers(["embree", "embreex", "trimesh_embreex"], 1, "cpu")
    assert [peer.name for peer in peers] == ["wrt", "Embree 3", "Embree 4"]
    assert set(missing) == {"embreex", "trimesh+embreex"}
    assert "builds with all cores" in missing["embreex"]
    for names, threads in ((["embree", "embreex"], 2), (["embree3", "embreex"], 1)):
        assert not make_peers(names, threads, "cpu")[1]


def test_embree_is_not_built_with_the_threads_of_another_peer(embree):
    """All devices of a process share threads: one with two threads gave them to another that should have had one."""
    one, two = embree(1), embree(2)
    two.build(MESH)
    with pytest.raises(RuntimeError, match="would build with 2, not 1"):
        one.build(MESH)
    del two
    one.build(MESH)
    query = one.closest(made("far"))
    assert (query.read(query.run()).primitive >= 0).any()
    with pytest.raises(RuntimeError, match="would build with 1, not 2"):
        one.asked_by(2).commit()


def test_a_fast_wrong_answer_shows():
    class Liar(Peer):
        name, package = "Liar", "wrt"

        def load(self, mesh):
            pass

        def construct(self):
            pass

        def closest(self, rays):
            return Query(lambda: len(rays), lambda count: Answer(np.ones(count), np.zeros(count, np.int32)))

    peers = [*make_peers(["wrt"], 1, "cpu")[0], Liar()]
    (question,) = ask(peers, MESH, [made("far")], 1)
    liar = question.rows[1]
    assert liar.agreement.hits == SIZE * SIZE
    assert liar.agreement.same_primitive < 0.1
    (occlusion,) = ask(peers, MESH, [made("shadow")], 1)
    assert [row.name for row in occlusion.rows] == ["wrt"], "peers without the query are not asked it"
