"""Embree asked with flat arrays gives the answers that it gives in packets, and is not mistaken for it."""

import numpy as np
import pytest

import wrt
from wrt.bench.commands.benchmark import BenchOptions, run_benchmark
from wrt.bench.comparisons.build_comparison import builder_peers
from wrt.bench.core.benchmark_results import Question, Row
from wrt.bench.core.workloads import Workload, WorkloadMaker
from wrt.bench.peers.embree import Embree
from wrt.bench.peers.embree_arrays import EmbreeArrays
from wrt.bench.peers.embree_library import EMBREES
from wrt.bench.peers.peer_table import DEFAULT_PEERS, PEERS, make_peers
from wrt.scenes import teapot

MESH = teapot(level=2, ground=False)


@pytest.fixture(scope="module", params=[*EMBREES], ids="version {}".format)
def both(request):
    """A version of Embree in packets and with flat arrays, built with two threads; skips where it is not to be had."""
    peers = Embree(2, request.param), EmbreeArrays(2, request.param)
    if (reason := peers[0].available()) is not None:
        pytest.skip(reason)
    for peer in peers:
        peer.build(MESH)
    return peers


def answer(query):
    query.run()
    return query.read(query.run())


def made(name):
    return next(WorkloadMaker(MESH, size=68).make([name]))


@pytest.mark.parametrize("rays", [1, 15, 16, 17, 257, 4097])
@pytest.mark.parametrize("threads", [1, 5])
def test_flat_arrays_have_the_answers_of_packets(both, rays, threads):
    """Rays that do not fill their last packet, rays from one point and from many, bounds of t."""
    packets, arrays = both
    for workload in (made("random"), made("near")):
        workload = workload.thinned(rays)
        expected, found = answer(packets.closest(workload)), answer(arrays.asked_by(threads).closest(workload))
        hit = expected.primitive >= 0
        np.testing.assert_array_equal(found.primitive, expected.primitive)
        np.testing.assert_array_equal(found.t, expected.t)
        np.testing.assert_array_equal(found.uv[hit], expected.uv[hit])
        reach = 1.01 * float(np.median(expected.t[hit])) if hit.any() else 1.0
        short = Workload(workload.name, "occlusion", workload.origins, workload.directions, reach, workload.shares_origin)
        np.testing.assert_array_equal(answer(arrays.asked_by(threads).occluded(short)), answer(packets.occluded(short)))
        bounded = answer(arrays.closest(short))
        np.testing.assert_array_equal(bounded.t, np.where(expected.t <= np.float32(reach), expected.t, np.inf))
    assert rays < 4097 or 100 < hit.sum() < rays


@pytest.mark.parametrize("width", [4, 8, 16])
def test_packets_of_any_width_are_filled_from_flat_arrays(both, width, monkeypatch):
    packets, arrays = both
    rays = made("random").thinned(1001)
    expected = answer(packets.closest(rays))
    monkeypatch.setattr(arrays, "width", width)
    found = answer(arrays.closest(rays))
    np.testing.assert_array_equal(found.primitive, expected.primitive)
    np.testing.assert_allclose(found.t, expected.t, rtol=1e-5)
    np.testing.assert_array_equal(answer(arrays.occluded(rays)), expected.primitive >= 0)


def test_flat_arrays_have_the_answers_of_wrt(both):
    _, arrays = both
    rays = made("random")
    found, hits = answer(arrays.closest(rays)), wrt.Scene(MESH, device="cpu").intersect(rays.origins, rays.directions)
    same = found.primitive == hits.primitive_id
    assert same.mean() >= 0.998  # its scene is not watertight
    np.testing.assert_allclose(found.t[same], hits.t[same], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found.uv[same & hits.is_hit], hits.uv[same & hits.is_hit], atol=1e-3)


def test_the_strict_comparison_remains_the_default(monkeypatch):
    """Whoever names no peer gets none that fills packets while the clock runs; "embree" does not mean them either."""
    assert not {"embree3-flat", "embree4-flat"} & {*DEFAULT_PEERS}
    assert {*DEFAULT_PEERS} < {*PEERS}
    monkeypatch.setattr(Embree, "available", lambda self: None)
    names = [peer.name for peer in make_peers(["embree", "embree3-flat", "embree4-flat"], 2, "cpu")[0]]
    assert names == ["wrt", "Embree 3", "Embree 4", "Embree 3 flat", "Embree 4 flat"]
    assert run_benchmark([], BenchOptions(builders=False, startup=False, peers=("wrt",))).missing == {}


def test_the_fastest_embree_is_one_whose_packets_were_filled_before():
    rows = [Row(name, 1, "cpu", ratio=ratio) for name, ratio in (("Embree 3", 1.5), ("Embree 4", 2.0), ("Embree 3 flat", 1.25))]
    assert Question("closest", "far", 4, "wrt", rows).embree_ratios == [1.5, 2.0]


def test_embree_with_flat_arrays_is_built_once(both):
    """Its build is Embree's: a second line would compare the same code with itself."""
    found = [peer.name for peer in builder_peers(both, 1000, 1, "cpu") if peer.name.startswith("Embree")]
    assert found == [both[0].name]
    assert both[1].note.endswith("; the time includes filling packets from flat arrays and copying answers to flat arrays")
