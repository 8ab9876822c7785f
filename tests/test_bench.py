"""The benchmark measures what it says: rays where they belong, right ratios, wrong answers in sight. No timings here."""

import json
import os

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from wrt.bench import plot, startup
from wrt.bench.command import bench, run_benchmark
from wrt.bench.contract import Answer, Peer, Query, device_rays
from wrt.bench.engines import BRUTE_FORCE_PAIRS, all_engines
from wrt.bench.measure import (
    Contender,
    Timing,
    closest_agreement,
    occlusion_agreement,
    share,
    take_turns,
    time_call,
)
from wrt.bench.peers import PEERS, make_peers
from wrt.bench.questions import ask
from wrt.bench.report import percent, print_report, times
from wrt.bench.workloads import AO_RANGE, OFFSET, WORKLOADS, WorkloadMaker, pixel_order
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.mesh import TriangleMesh
from wrt.scenes import teapot

SIZE = 16
MESH = teapot(level=2, ground=False)


def made(name, **options):
    return next(WorkloadMaker(MESH, **{"size": SIZE, **options}).make([name]))


@pytest.fixture(scope="module")
def report():
    options = {"size": SIZE, "rounds": 2, "threads": 2, "startup": False}
    return run_benchmark([TriangleMesh(MESH.vertices, MESH.faces, name="teapot")], **options)


# -- workloads ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORKLOADS)
def test_workloads_are_float32_and_the_same_every_time(name):
    one, two = made(name), made(name)
    for a, b in ((one.origins, two.origins), (one.directions, two.directions)):
        assert a.dtype == np.float32
        assert a.shape == (len(one), 3)
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)
    assert one.name == name
    assert len(one) == SIZE * SIZE or (one.query == "occlusion" and 0 < len(one) < SIZE * SIZE)


@pytest.mark.parametrize(("name", "factor"), [("far", 1.1), ("near", 0.55)])
def test_views_look_at_the_centre_from_the_stated_distance(name, factor):
    view = made(name)
    assert view.shares_origin
    assert view.origins.strides[0] == 0
    towards = view.origins[0] - MESH.center
    expected = factor * MESH.extent / 2 / np.tan(np.radians(22.5))
    assert np.linalg.norm(towards) == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(towards / expected, np.array([0.3, 0.25, 1.0]) / np.linalg.norm([0.3, 0.25, 1.0]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(view.directions, axis=1), 1.0, rtol=1e-6)
    middle = view.directions.mean(axis=0)
    np.testing.assert_allclose(middle / np.linalg.norm(middle), -towards / expected, atol=1e-5)


def test_far_sees_all_of_the_mesh():
    view = made("far")
    eye, cosines = view.origins[0], view.directions @ (-np.array([0.3, 0.25, 1.0]) / np.linalg.norm([0.3, 0.25, 1.0]))
    to_vertices = MESH.vertices - eye
    along = to_vertices @ (MESH.center - eye) / np.linalg.norm(to_vertices, axis=1) / np.linalg.norm(MESH.center - eye)
    assert along.min() > cosines.min()


def test_tiles_and_rows_hold_the_same_rays():
    tiles, rows = made("far"), made("far", order="rows")
    order = pixel_order(SIZE, "tiles")
    np.testing.assert_array_equal(tiles.directions, rows.directions[order])
    assert order[:6].tolist() == [0, 1, 2, 3, SIZE, SIZE + 1]
    assert order[16] == 4
    assert rows.directions[1, 1] == pytest.approx(rows.directions[0, 1], abs=0.05)
    assert rows.directions[0, 1] > rows.directions[-1, 1], "the first row is the upper one"


def test_random_rays_fill_the_box():
    rays = made("random", size=32)
    low, high = MESH.bounds
    assert (rays.origins >= low.astype(np.float32)).all()
    assert (rays.origins <= high.astype(np.float32)).all()
    assert np.abs(rays.directions.mean(axis=0)).max() < 0.1
    assert not np.array_equal(rays.directions, made("random", size=32, seed=1).directions)


def test_shadow_rays_end_at_the_light():
    maker = WorkloadMaker(MESH, size=SIZE)
    (rays,) = maker.make(["shadow"])
    np.testing.assert_allclose(rays.origins + rays.directions * rays.t_max, np.tile(maker.light, (len(rays), 1)), rtol=1e-5)
    assert np.linalg.norm(maker.light - MESH.center) > MESH.extent / 2, "the light is outside"


def test_ao_rays_leave_the_surface_upwards_with_a_cosine_distribution():
    maker = WorkloadMaker(MESH, size=64)
    (rays,) = maker.make(["ao"])
    points, normals = maker.visible
    cosines = np.sum(normals * rays.directions, axis=1)
    assert cosines.min() > -1e-6
    assert cosines.mean() == pytest.approx(2 / 3, abs=0.05)
    assert rays.t_max == pytest.approx(AO_RANGE * MESH.extent)
    view = made("far", size=64)
    assert (np.sum((view.origins[0] - points) * normals, axis=1) > 0).all(), "normals face the eye"
    hits = wrt.Scene(MESH, device="cpu").intersect(points, (-normals).astype(np.float32))
    assert hits.is_hit.all()
    assert hits.t.max() < 2 * OFFSET * MESH.extent, "the points lie just above the surface"


def test_thinned_workloads_are_evenly_picked():
    for rays in (made("far"), made("random")):
        few = rays.thinned(50)
        chosen = rays.chosen(50)
        assert len(few) == 50
        assert len(few.origins) == 50
        np.testing.assert_array_equal(few.directions, rays.directions[chosen])
        np.testing.assert_array_equal(few.origins, rays.origins[chosen])
        assert set(np.diff(chosen)) <= {len(rays) // 50, len(rays) // 50 + 1}
        assert rays.thinned(10**9) is rays


def test_workloads_refuse_bad_arguments():
    with pytest.raises(ValueError, match="multiple of 4"):
        WorkloadMaker(MESH, size=6)
    assert len(made("far", size=6, order="rows")) == 36
    with pytest.raises(ValueError, match="order 'spiral' is unknown"):
        WorkloadMaker(MESH, order="spiral")
    with pytest.raises(ValueError, match="workload 'fog' is unknown; choose from far"):
        made("fog")


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
    assert clock.log == ["a", "b"] * 4 == seen
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


# -- peers -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("peer_name", PEERS)
def test_every_peer_agrees_with_wrt(peer_name):
    peers, missing = make_peers([peer_name], 2, "cpu")
    if missing:
        pytest.skip(str(missing))
    for question in ask(peers, MESH, WorkloadMaker(MESH, size=SIZE).make(WORKLOADS), 1):
        assert question.reference == "wrt"
        for row in question.rows:
            assert row.error is None, row
            assert row.agreement.same_hit >= 0.99, row
            assert row.agreement.hits > 0 or question.workload == "ao"
            if question.kind == "closest":
                assert row.agreement.same_primitive >= 0.99, row
                assert row.agreement.same_t >= 0.99, row


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
    assert {engine.traversal for engine in engines} == {"auto", *TRAVERSALS}
    assert {engine.triangle_test for engine in engines} == {"auto", *TRIANGLE_TESTS}
    assert len({engine.name for engine in engines}) == len(engines)
    brute = next(engine for engine in engines if engine.traversal == "brute")
    assert brute.ray_limit(BRUTE_FORCE_PAIRS // 1000) == 1000
    assert engines[-1].ray_limit(10**6) is None


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
    assert missing == {"Absent": 'not installed; pip install "wrt[peers]"'}
    with pytest.raises(ValueError, match="peer 'nobody' is unknown; choose from wrt"):
        make_peers(["nobody"], 1, "cpu")


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


# -- report and command line -------------------------------------------------------------------------------------------

ROW = {"name", "threads", "device", "note", "rays", "seconds", "median", "least", "greatest", "rays_per_second", "ratio"}
ROW |= {"agreement", "details", "error"}


def test_the_report_is_complete_plain_data(report):
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert set(data) == {"format", "machine", "options", "models", "startup", "missing"}
    assert {"cpu", "threads", "simd_bits", "gpu", "system", "python", "versions"} == set(data["machine"])
    assert {"wrt", "warp-lang", "numpy"} <= set(data["machine"]["versions"])
    (model,) = data["models"]
    assert (model["name"], model["triangles"]) == ("teapot", MESH.triangle_count)
    assert [question["workload"] for question in model["questions"]] == [*WORKLOADS, None]
    for question in model["questions"]:
        assert question["reference"] in [row["name"] for row in question["rows"]]
        for row in question["rows"]:
            assert set(row) == ROW
            assert row["error"] is None
            assert row["least"] <= row["median"] <= row["greatest"]
            assert row["ratio"] > 0
            assert (row["agreement"] is None) == (question["kind"] == "build")
            if row["name"] == question["reference"]:
                assert row["ratio"] == 1.0


def test_every_builder_is_there_with_one_thread_and_with_all(report):
    rows = {row.name: row for row in report.models[0].questions[-1].rows}
    for name in KDTREE_BUILDERS:
        one, all_threads = rows[f"wrt {name}, 1 thread"], rows[f"wrt {name}, 2 threads"]
        assert one.details["phases"]
        assert one.details["tree_bytes_per_triangle"] == all_threads.details["tree_bytes_per_triangle"] > 0
        assert one.details["record_bytes_per_triangle"] >= 36
        assert one.details["speedup_over_one_thread"] is None
        assert all_threads.details["speedup_over_one_thread"] > 0


def test_tables_show_every_contender(report, capsys):
    from rich.console import Console

    print_report(report, Console(width=180))
    text = capsys.readouterr().out
    for question in report.models[0].questions:
        assert question.workload is None or f"{question.workload} {question.rays:,}" in text
        assert all(row.name in text for row in question.rows)
    assert os.getcwd() not in text


def test_numbers_are_not_rounded_to_something_better():
    assert (percent(1.0), percent(0.999999), percent(None)) == ("100 %", "99.999 %", "-")
    assert (times(1.234), times(4321.0), times(None)) == ("1.23x", "4,321x", "-")


def test_startup_runs_fresh_processes(monkeypatch):
    calls = []

    def fake(script, device, threads, *, empty_cache=False):
        calls.append(empty_cache)
        return {"import": 0.5}

    monkeypatch.setattr(startup, "run_process", fake)
    question = startup.ask_startup([], 1, "cpu", 2)
    assert [row.name for row in question.rows] == ["import warp", "import wrt", "wrt, first hit", startup.EMPTY_CACHE]
    assert calls == [False] * 9 + [True], "three warm-ups, two rounds of three, one empty cache"
    assert all(row.details["phases"] == {"import": 0.5} for row in question.rows)


def test_a_fresh_process_answers_and_failures_say_why():
    phases = startup.run_process(startup.IMPORT_WRT + startup.GRID + startup.USE_WRT, "cpu", 1)
    assert list(phases) == ["import", "init", "data", "scene", "first query"]
    with pytest.raises(RuntimeError, match=r"a fresh process failed:.*no way"):
        startup.run_process("raise ValueError('no way')", "cpu", 1)


def test_the_command_writes_tables_figures_and_a_picture(tmp_path):
    pytest.importorskip("matplotlib")
    MESH.save(tmp_path / "pot.ply")
    command = [str(tmp_path / "pot.ply"), "--size", "8", "--rounds", "1", "--no-startup", "--no-builders", "--peer", "wrt"]
    command += [
        "--workload",
        "far",
        "--workload",
        "shadow",
        "--json",
        str(tmp_path / "a.json"),
        "--plot",
        str(tmp_path / "a.png"),
    ]
    done = CliRunner().invoke(bench, command)
    assert done.exit_code == 0, done.output
    assert "Closest hit: pot" in done.output
    assert "Build" not in done.output
    data = json.loads((tmp_path / "a.json").read_text())
    assert [question["workload"] for question in data["models"][0]["questions"]] == ["far", "shadow"]
    assert str(tmp_path) not in json.dumps(data), "no paths in what is published"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_file.ply"], "built-in scenes are teapot"),
        (["teapot", "--workload", "fog"], "'fog' is not one of 'far'"),
        (["teapot", "--peer", "nobody"], "'nobody' is not one of 'wrt'"),
        (["teapot", "--device", "cuda:99"], "'cuda:99' is not there; choose from cpu"),
        (["teapot", "--size", "6"], "multiple of 4"),
        (["teapot", "--rounds", "0"], "--rounds"),
        (["teapot", "--threads", "0"], "--threads"),
    ],
)
def test_the_command_refuses_what_it_cannot_do(arguments, message):
    done = CliRunner().invoke(bench, arguments)
    assert done.exit_code != 0
    assert message in done.output
    assert "Traceback" not in done.output


def test_a_plot_without_matplotlib_says_what_to_install(monkeypatch):
    monkeypatch.setattr(plot, "matplotlib_missing", lambda: "a plot needs matplotlib: pip install it")
    done = CliRunner().invoke(bench, ["teapot", "--plot", "a.png"])
    assert done.exit_code == 2
    assert "a plot needs matplotlib" in done.output
