"""Packets against brute force, bit for bit: every culling, triangle test and size, with rays that do stay together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.algorithms import ENGINE_TESTS
from support.hits import assert_same_hits, brute_force, mixed_rays
from support.meshes import SCENES
from support.packet_rays import beams, packet_plan, ragged

import wrt
import wrt.engine.plan.planner
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core.packet_bvh import MAX_STEPS_PER_RAY
from wrt.kernels.triangle import TRIANGLE_TESTS

FITTING = [
    (c, t, own)
    for c, culling in CULLINGS.items()
    for t in ENGINE_TESTS
    for own in (False, True)
    if culling.holds_for(TRIANGLE_TESTS[t])
    and (t == "woop" or c not in ("none", "entry_exit"))
    and not (own and TRIANGLE_TESTS[t].needs_shared_origin)
]
"""Each culling with each test that it holds for, origins shared or not; with one test `none`, which does nothing, and
`entry_exit`, which tests triangles as `frustum` does."""

ANY_HIT = "frustum"
"""The culling with which every test looks for any hit, origins shared or not; with the others one test does, for rays with
origins of their own: what ends a search knows neither the culling nor the test."""

FEW_TRIANGLES = ("teapot", "random_triangles", "grid", "degenerate", "needles")
"""Scenes on which every culling meets every test, as brute force takes long in the others: in those it meets one test."""

OTHERS = [(tree, "vertex", "woop", own) for tree in TRAVERSALS["packet"].trees if tree != "bvh" for own in (False, True)]
"""Leaves are leaves: what culling and test do there, one tree shows for all."""

THIRD = (("interval", False), ("leaf_boxes", True))
"""Cullings, with origins of their own or shared, whose pairs with the second test and with the origins other cases have."""


def cases() -> list:
    """Trees with what fits. Of each culling with one test, own origins tell what the number of lanes does to it.

    Of the cullings with a second test, one culling has both shared origins and those of their own: the others have one of them.
    """
    marks = {("woop", True): [pytest.mark.width]}
    third = {("bvh", culling, "moeller_trumbore", own): [pytest.mark.exhaustive] for culling, own in THIRD}
    given = [("bvh", *fitting) for fitting in FITTING] + OTHERS
    return [pytest.param(*case, marks=marks.get(case[2:], []) + third.get(case, [])) for case in given]


@pytest.mark.parametrize(("tree", "culling", "triangle_test", "own_origins"), cases())
def test_culling_never_shows(tree, culling, triangle_test, own_origins, device):
    for name in SCENES if triangle_test == ENGINE_TESTS[0] else FEW_TRIANGLES:
        mesh = SCENES[name]()
        scene = wrt.Scene(mesh, tree, device=device)
        rays = ragged(*beams(mesh, 60, own_origins))
        expected = brute_force(scene, rays, triangle_test=triangle_test)
        assert expected.is_hit.mean() > 0.05
        plan = packet_plan(scene, rays, triangle_test, culling=culling)
        assert plan.shared_origin != own_origins
        assert_same_hits(scene.intersect(rays, traversal=plan), expected)
        if culling == ANY_HIT or (triangle_test == ENGINE_TESTS[0] and own_origins):
            np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("tree", "culling", "triangle_test", "own_origins"), [("bvh", *fitting) for fitting in FITTING] + OTHERS
)
def test_culling_never_shows_in_shadows(tree, culling, triangle_test, own_origins, device):
    """Any hit, by all that fits."""
    for make in SCENES.values():
        scene = wrt.Scene(make(), tree, device=device)
        rays = ragged(*beams(scene.meshes[0], 60, own_origins))
        expected = brute_force(scene, rays, triangle_test=triangle_test)
        plan = packet_plan(scene, rays, triangle_test, culling=culling)
        np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)


@pytest.mark.width
@pytest.mark.parametrize("scale", [1.0, 1e-35, 1e25])
@pytest.mark.parametrize("culling", CULLINGS)
def test_rays_that_meet_at_a_light(culling, scale, device):
    """Frusta that narrow to a point, some at a vertex; directions so short or long that reciprocals overflow or vanish. All are
    held against single rays, which `test_traversal.py` holds against brute force, and some of them against that here too."""
    mesh = SCENES["wood"]()
    scene = wrt.Scene(mesh, "bvh", device=device)
    rng = np.random.default_rng(4)
    low, high = mesh.bounds
    light = np.where(rng.random((100, 1, 1)) < 0.5, mesh.vertices[rng.integers(0, mesh.vertex_count, (100, 1))], high + 0.1)
    origins = rng.uniform(low, high, (100, 1, 3)) + rng.normal(size=(100, 64, 3)) * 0.03 * (high - low)
    directions = ((light - origins) * scale).astype(np.float32).reshape(-1, 3)
    origins = origins.astype(np.float32).reshape(-1, 3)
    expected = scene.intersect(origins, directions, traversal="single")
    assert 0.2 < expected.is_hit.mean() < 1.0
    plan = packet_plan(scene, wrt.Rays(origins, directions), "woop", culling=culling)
    assert_same_hits(scene.intersect(origins, directions, traversal=plan), expected)
    ends = np.where(rng.random(len(origins)) < 0.5, 1.0, rng.uniform(0.999, 1.001, len(origins))) / scale  # there or near there
    for t_min in (0.0, 0.1 / scale):
        shadow = wrt.Rays(origins, directions, t_min, ends.astype(np.float32))
        dark = scene.occluded(shadow, traversal="single")
        some = wrt.Rays(origins[::9], directions[::9], t_min, shadow.t_max[::9])
        np.testing.assert_array_equal(brute_force(scene, some).is_hit, dark[::9])
        assert 0.1 < dark.mean() < 0.9
        np.testing.assert_array_equal(scene.occluded(shadow, traversal=plan), dark)


@pytest.mark.width
@pytest.mark.parametrize(("tree", "vectors"), [("bvh", 1), ("bvh", 2), ("bvh", 16), ("kdtree", 1), ("kdtree", 8)])
def test_sizes_and_ranges(vectors, tree, device):
    """Packets of one vector to the largest; per-ray ranges that cut between hits, at hits, and empty ones."""
    mesh = SCENES["atrium"]()
    scene = wrt.Scene(mesh, tree, device=device)
    origins, directions = beams(mesh, 80, True, seed=1)
    first = brute_force(scene, wrt.Rays(origins, directions))
    rng = np.random.default_rng(2)
    shape = first.t.shape
    t_min = np.where(first.is_hit & (rng.random(shape) < 0.5), first.t, rng.random(shape)).astype(np.float32)
    t_max = np.where(rng.random(shape) < 0.3, t_min, t_min + rng.random(shape) - 0.1).clip(0).astype(np.float32)
    rays = wrt.Rays(origins, directions, t_min, t_max)
    expected = brute_force(scene, rays)
    plan = packet_plan(scene, rays, "woop")
    plan = replace(plan, packet=vectors * plan.width)
    assert_same_hits(scene.intersect(rays, traversal=plan), expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)


@pytest.mark.width
def test_what_hides_a_packet_is_where_the_next_one_begins_and_no_more(device):
    """A wall with holes between packets and their light: some are hidden by what hid the last one, some end before it, some go
    through. Large triangles, of which one hides packet after packet, and small ones, of which it takes many."""
    rng = np.random.default_rng(7)
    for cells in (2, 60):
        corners = np.stack(np.meshgrid(np.linspace(-1.0, 1.0, cells + 1), np.linspace(-1.0, 1.0, cells + 1)), -1).reshape(-1, 2)
        first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
        quads = np.stack([first, first + 1, first + cells + 2, first + cells + 1], 1)
        faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
        faces = faces[rng.random(len(faces)) < 0.8]
        floor = np.float64([[-3.0, -3.0, -0.5], [3.0, -3.0, -0.5], [0.0, 4.0, -0.5]])  # below all origins
        vertices = np.concatenate([np.column_stack([corners, np.full(len(corners), 1.0)]), floor])
        mesh = wrt.TriangleMesh(vertices, np.concatenate([faces, [np.arange(3) + len(corners)]]))
        scene = wrt.Scene(mesh, "bvh", device=device)
        origins = np.repeat(np.cumsum(rng.normal(size=(96, 1, 3)) * 0.1, axis=0) * (1.0, 1.0, 0.0), 64, axis=1)
        origins = (origins + rng.normal(size=origins.shape) * 0.02).clip(-0.9, 0.9).astype(np.float32).reshape(-1, 3)
        directions = np.float32([0.2, 0.1, 2.0]) - origins
        t_max = np.repeat(rng.choice([0.3, 1.0], 192), 32).astype(np.float32)  # in whole packets, half of them
        rays = wrt.Rays(origins, directions, 0.0, t_max)
        plan = packet_plan(scene, rays, "woop", culling="transient_frustum")
        expected = brute_force(scene, rays).is_hit
        assert 0.2 < expected.mean() < 0.8
        np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected)


@pytest.mark.width
def test_few_rays_at_a_leaf_are_tested_one_by_one():
    """Triangles as small as the gaps between rays: most leaves are met by few, for which fewer lanes are filled."""
    rng = np.random.default_rng(3)
    mesh = SCENES["wood"]()
    low, high = mesh.bounds
    scene = wrt.Scene(mesh, "bvh", device="cpu")
    origins = (rng.uniform(low, high, (60, 1, 3)) + rng.normal(size=(60, 64, 3)) * 0.1 * (high - low)).reshape(-1, 3)
    directions = np.repeat(rng.normal(size=(60, 3)), 64, axis=0)
    rays = wrt.Rays(origins.astype(np.float32), directions.astype(np.float32))
    plan = packet_plan(scene, rays, "woop", culling="transient_frustum")
    hits = scene.intersect(rays, traversal=plan, counters=True)
    assert_same_hits(hits, brute_force(scene, rays))
    work = {name: int(values.sum()) for name, values in hits.counters.items()}
    assert 0 < work["active"] <= work["lanes"] < 0.5 * plan.packet * work["triangles"]


def apart(mesh: wrt.TriangleMesh, places: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Packets of `size` rays to a light; those of packet i start in turn at, or near, `places[i]` places; some rays are bad."""
    rng = np.random.default_rng(0)
    low, high = mesh.bounds
    which = np.arange(size) % places[:, None]
    origins = np.take_along_axis(rng.uniform(low, high, (len(places), places.max(), 3)), which[..., None], axis=1)
    origins += rng.normal(size=origins.shape) * rng.choice([0.0, 1e-3], (len(places), 1, 1)) * (high - low)
    directions = high + (high - low) * (0.2, 0.1, 0.3) - origins
    directions[rng.random(which.shape) < 0.02] = np.nan
    return origins.astype(np.float32).reshape(-1, 3), directions.astype(np.float32).reshape(-1, 3)


@pytest.mark.width
def test_packets_part_where_their_origins_do():
    """Rays from two places make two packets; those from more than a packet is made into go alone at last."""
    mesh = wrt.scenes.build("atrium")
    scene = wrt.Scene(mesh, "bvh", device="cpu")
    places = np.repeat([1, 2, 3, 16], 20)
    plan = packet_plan(scene, wrt.Rays(*apart(mesh, places, 16)), "woop", packet=scene.state.width)
    rays = wrt.Rays(*apart(mesh, places, plan.packet), 0.0, 1.0)
    expected = brute_force(scene, rays)
    assert 0.2 < expected.is_hit.mean() < 1.0
    hits = scene.intersect(rays, traversal=plan, counters=True)
    assert_same_hits(hits, expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)
    steps = (hits.counters["nodes"] + hits.counters["leaves"]).reshape(-1, plan.packet)
    parted = steps[:, 0] > MAX_STEPS_PER_RAY * plan.packet
    alone = (steps[:, 1:] > 0).sum(axis=1)
    assert not parted[places == 1].any()
    assert parted[places > 1].any()
    assert not alone[places < 16].any()
    assert alone[places == 16].any()


@pytest.mark.width
@pytest.mark.parametrize(("tree", "otherwise"), [("bvh", "stream"), ("kdtree", "wide_stream")])
def test_a_camera_gets_packets_and_random_rays_do_not(tree, otherwise):
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, tree, device="cpu")
    camera = wrt.PinholeCamera(96, 80, position=(0.0, -9.0, 4.0), look_at=(0.0, 0.0, 1.0))
    plan = scene.explain(camera.rays())
    assert plan.traversal == "packet"
    assert plan.shared_origin
    hits = scene.intersect(camera.rays())
    assert hits.plan == plan
    assert_same_hits(hits, scene.intersect(camera.rays(), traversal="single"))
    directions = np.random.default_rng(0).normal(size=(9000, 3))
    assert scene.explain(np.zeros(3), directions).traversal == otherwise
    assert "incoherent" in str(scene.explain(np.zeros(3), directions))


@pytest.mark.width
@pytest.mark.parametrize("tree", TRAVERSALS["packet"].trees)
def test_packets_do_less_work_than_rays(tree):
    mesh = wrt.scenes.build("teapot", level=5)
    scene = wrt.Scene(mesh, tree, device="cpu")
    camera = wrt.PinholeCamera(128, 128, position=(0.0, -9.0, 4.0), look_at=(0.0, 0.0, 1.0))
    one = scene.intersect(camera.rays(), traversal="single", counters=True).counters
    many = scene.intersect(camera.rays(), traversal="packet", counters=True).counters
    assert many["nodes"].sum() < 0.25 * one["nodes"].sum()
    assert many["leaves"].sum() < 0.5 * one["leaves"].sum()


@pytest.mark.width
def test_cullings_save_tests():
    """Counted: what each culling leaves of the ray-triangle tests, and how many lanes of those are of use."""
    mesh = wrt.scenes.build("teapot", level=5)
    scene = wrt.Scene(mesh, "bvh", device="cpu")
    rays = wrt.PinholeCamera(128, 128, position=(0.0, -9.0, 4.0), look_at=(0.0, 0.0, 1.0)).rays()
    work = {}
    chosen = ("none", "interval", "frustum", "transient_frustum")
    for culling in chosen:
        plan = packet_plan(scene, rays, "woop", culling=culling)
        work[culling] = {k: int(v.sum()) for k, v in scene.intersect(rays, traversal=plan, counters=True).counters.items()}
        assert 0 < work[culling]["active"] <= work[culling]["lanes"]
    assert work["none"]["culled"] == 0
    assert work["none"]["lanes"] == work["none"]["triangles"] * plan.packet
    assert work["none"]["boxes"] == work["none"]["nodes"] * plan.width * plan.packet
    assert work["interval"]["boxes"] == work["interval"]["nodes"] * plan.width
    for culling in chosen[1:]:
        assert work[culling]["culled"] > 0
        assert work[culling]["lanes"] < work["none"]["lanes"]
    assert work["transient_frustum"]["lanes"] < work["interval"]["lanes"]
    # what every ray decides for itself visits the fewest leaves; what is decided for all of them visits more
    assert all(work["none"]["leaves"] <= work[culling]["leaves"] for culling in chosen[1:])


@pytest.mark.width
def test_plans_of_fine_and_rough_views():
    """The fewer rays a triangle, the more is looked at at each leaf, and then of each ray."""
    mesh = wrt.scenes.build("teapot")
    scene = wrt.Scene(mesh, device="cpu")
    for share, traversal, culling in ((0.1, "stream", ""), (2.0, "packet", "leaf_boxes"), (16.0, "packet", "interval")):
        size = int((share * mesh.triangle_count) ** 0.5)
        plan = scene.explain(wrt.PinholeCamera(size, size, position=(0.0, 2.0, 8.0), look_at=(0.0, 0.0, 0.0)).rays())
        assert (plan.traversal, plan.culling) == (traversal, culling)


@pytest.mark.width
def test_plans_that_do_not_fit():
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, "bvh", device="cpu")
    origins, directions = beams(mesh, 10, True)
    plan = packet_plan(scene, wrt.Rays(origins, directions), "woop", culling="vertex")
    for change, name in (
        ({"packet": plan.width + 1}, "packet"),
        ({"packet": 100 * plan.width}, "packet"),
        ({"culling": "no such"}, "culling"),
        ({"triangle_test": "moeller_trumbore"}, "culling"),
        ({"traversal": "no such"}, "traversal"),
        ({"accelerator": "kdtree"}, "accelerator"),
        ({"shared_origin": True}, "shared_origin"),
        ({"width": 1}, "width"),
    ):
        with pytest.raises(ValueError, match=name):
            scene.intersect(origins, directions, traversal=replace(plan, **change))
    with pytest.raises(ValueError, match="does not walk a bvh"):
        scene.intersect(origins, directions, traversal="lockstep")


@pytest.mark.width
def test_an_axis_with_both_signs_bounds_a_kdtree_too():
    """Beams along z that spread to both sides of x and y: few cells are visited although no sign is shared but z's."""
    mesh = wrt.scenes.build("random_triangles", count=3000, size=0.05, seed=2)
    scene = wrt.Scene(mesh, "kdtree", device="cpu")
    rng = np.random.default_rng(3)
    low, high = mesh.bounds
    starts = np.repeat(rng.uniform(low, high, (40, 3)), 64, axis=0)
    starts[:, 2] = low[2] - 1.0
    directions = np.concatenate([rng.normal(size=(2560, 2)) * 0.002, np.ones((2560, 1))], axis=1)
    rays = wrt.Rays(starts, directions)
    plan = packet_plan(scene, rays, "woop")
    expected = scene.intersect(rays, traversal="single", counters=True)
    together = scene.intersect(rays, traversal=replace(plan, packet=64 // plan.width * plan.width), counters=True)
    assert_same_hits(together, expected)
    assert together.counters["nodes"].sum() < 0.1 * expected.counters["nodes"].sum()


@pytest.mark.width
@pytest.mark.parametrize("traversal", ["single", "stream"])
def test_reordering_never_shows(traversal, device):
    """Any order of tracing, with all that a ray can have of its own, or share."""
    mesh = wrt.scenes.build("wood", trees=3)
    scene = wrt.Scene(mesh, "bvh", device=device)
    origins, directions = mixed_rays(mesh, 5000)
    t_max = np.linspace(0.1, 3.0, 5000, dtype=np.float32)
    for rays in (wrt.Rays(origins, directions, 0.0, t_max), wrt.Rays(origins[:1], directions, t_max / 2)):
        plan = scene.explain(rays, traversal=traversal)
        expected = scene.intersect(rays, traversal=plan, counters=True)
        hits = scene.intersect(rays, traversal=replace(plan, reorder="cells"), counters=True)
        assert_same_hits(hits, expected)
        if traversal == "single":  # the work of a stream stands at its first ray
            np.testing.assert_array_equal(hits.counters["nodes"], expected.counters["nodes"])
        dark = scene.occluded(rays, traversal=replace(plan, reorder="cells"))
        np.testing.assert_array_equal(dark, expected.is_hit)


@pytest.mark.width
def test_large_scattered_batches_are_reordered(monkeypatch):
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, "bvh", device="cpu")
    rng = np.random.default_rng(0)
    origins, directions = rng.normal(size=(2, 70_000, 3)).astype(np.float32)
    assert scene.explain(origins, directions).reorder == "none"
    monkeypatch.setattr(wrt.engine.plan.planner, "CACHED_BYTES", 1)
    scene.state.cache.clear()  # which rays like these have
    assert scene.explain(origins, directions).reorder == "cells"
    assert scene.explain(origins[:1], directions).reorder == "none"


@pytest.mark.width
@pytest.mark.parametrize("size", [(8, 8), (33, 70), (64, 31), (9, 200)])
def test_pictures_are_traced_in_tiles(size, device):
    """Every pixel once and in its place, whatever the tiles at the edges; work stands at the first ray of each tile."""
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, "bvh", device=device)
    camera = wrt.PinholeCamera(*size, position=(0.0, -9.0, 4.0), look_at=(0.0, 0.0, 1.0))
    expected = scene.intersect(camera.rays(), traversal="single")
    plan = replace(scene.explain(camera.rays(), traversal="packet"), reorder="tiles")
    hits = scene.intersect(camera.rays(), traversal=plan, counters=True)
    assert_same_hits(hits, expected)
    assert hits.counters["nodes"].shape == size[::-1]
    np.testing.assert_array_equal(scene.occluded(camera.rays(), traversal=plan), expected.is_hit)
    with pytest.raises(ValueError, match="not the pixels of an image"):
        scene.intersect(np.zeros(3), np.ones((64, 3)), traversal=plan)


@pytest.mark.width
@pytest.mark.parametrize("own_origins", [True, False])
def test_repacked_packets(own_origins, device):
    """Packets made again below half use, down to one vector, give the hits of single rays; their work shows that they are.

    Every child is tested against each ray of its packet: P tests, or P / 2, or P / 4.
    """
    work = []
    for name in ("wood", "grid", "needles", "degenerate"):
        mesh = SCENES[name]()
        scene = wrt.Scene(mesh, "bvh", device=device)
        near, scattered = ragged(*beams(mesh, 60, own_origins)), mixed_rays(mesh, 3000)
        spread = wrt.Rays(scattered[0] if own_origins else scattered[0][0], scattered[1])
        for rays, scale in ((near, 1.0), (spread, 1.0), (near, 1e-35), (spread, 1e25)):
            scaled = wrt.Rays(rays.origins, (rays.directions * np.float32(scale)).astype(np.float32))
            plan = scene.explain(scaled, traversal="repacked_packet")
            plan = replace(plan, culling="interval", packet=4 * plan.width)
            assert plan.shared_origin != own_origins
            hits = scene.intersect(scaled, traversal=plan, counters=True)
            assert_same_hits(hits, scene.intersect(scaled, traversal="single"))
            work.append(hits.counters["boxes"] - plan.width * hits.counters["nodes"])
    by_rays = np.concatenate(work)
    children = 2 if plan.width == 2 else 1  # a node of two has no empty lane, so tests come in twos
    assert not (by_rays % (children * plan.packet // 4)).any()
    assert (by_rays % (children * plan.packet // 2)).any()
