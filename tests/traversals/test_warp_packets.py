"""Packets, streams and frusta of CUDA warps: the hits of persistent threads, to the bit, on every device. On the CPU
their kernels trace rays one by one; what threads do together runs on CUDA, and is compiled for it everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from support.hostile_rays import KINDS, MESHES, HostileRays
from support.ptx import assert_fuses_boxes_alone, compile_to_ptx

import wrt
from studies.gpu_warps import BASE, Traced, compare_ways
from wrt.bench.core.workloads import CLOSEST, OCCLUSION, Workload
from wrt.kernels.classics.studies.warp_packets import WARP, WAYS, make_kernel

pytestmark = [pytest.mark.classics]

BVH = wrt.Bvh(width=2, max_leaf_triangles=2)


def assert_same(scene: wrt.Scene, way: str, origins: np.ndarray, directions: np.ndarray, t_max: float = np.inf) -> int:
    """The answers of a way to both queries, and those of persistent threads; returns how many rays are occluded."""
    for query in (CLOSEST, OCCLUSION):
        traced = Traced(scene, Workload("rays", query, origins, directions, t_max))
        found = []
        for name in (way, BASE):
            traced.hits.clear(traced.kind)
            traced.launcher(name)()
            found.append(traced.answers())
        for ours, theirs in zip(*found, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    return int(found[1][0].sum())


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", MESHES)
def test_hostile_rays(name, way, device):
    """From everywhere, and those of one point, among them such as are no rays; of any number."""
    scene = wrt.Scene(MESHES[name](), BVH, device=device)
    for kind in KINDS if device != "cpu" else ("to edges",):
        with np.errstate(over="ignore"):
            origins, directions = KINDS[kind](HostileRays(scene.meshes[0], 700))
            origins, directions = (np.asarray(values, dtype=np.float32) for values in (origins, directions))
        assert_same(scene, way, origins, directions)
    rng = np.random.default_rng(3)
    eye = np.broadcast_to(np.float32(scene.bounds[1] + 0.3 * np.ptp(scene.bounds)), (300, 3))
    toward = (rng.uniform(*scene.bounds, (300, 3)) - eye).astype(np.float32)
    toward[::37] = np.nan, 0.0, 1.0
    toward[::41, 1] = 0.0
    hits = [assert_same(scene, way, eye[:count], toward[:count], 1.5) for count in (1, WARP + 1, 300)]
    assert hits[2] > 10


@pytest.mark.parametrize("query", [CLOSEST, "any"])
@pytest.mark.parametrize("way", WAYS)
def test_compiles_for_cuda(way, query, tmp_path):
    """Boxes alone are tested by fused operations; votes are over the threads that began."""
    text = compile_to_ptx(make_kernel(way, query, 24, True).module, tmp_path)
    assert ".entry" in text
    assert "vote.sync.ballot" in text
    assert ".shared" in text
    assert_fuses_boxes_alone(text)


def test_study(device):
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), BVH, device=device)
    figures = compare_ways(scene, 16, 1)
    assert {one.way for one in figures} == {BASE, *WAYS}
    assert all(one.same for one in figures)
    assert all(one.ratio == 1.0 for one in figures if one.way == BASE)
