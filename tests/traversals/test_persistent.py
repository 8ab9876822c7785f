"""Persistent threads: the hits of brute force, to the bit, on every device. On the CPU the kernel's steps are the
same, with one ray an item; on CUDA the launch, its counter and its votes are tested besides."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp
from support import hostile_rays
from support.environment import DEVICES
from support.hits import assert_same_hits, brute_force, mixed_rays
from support.hostile_rays import KINDS, MESHES, HostileRays
from support.meshes import SCENES
from support.selection import slow

import wrt
from wrt.accelerators.cuda_trees import LEAF_TRIANGLES, ROUNDS, for_device
from wrt.engine.executor import on_device
from wrt.engine.facts.query_kinds import Query
from wrt.engine.plan.choices import find_plan
from wrt.kernels.answers import ANSWERS
from wrt.kernels.layout import binary_nodes
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.persistent.persistent_bvh import BLOCK
from wrt.kernels.traversal.traversal_scores import Situation
from wrt.query import exact_hits
from wrt.query.inside import RULES
from wrt.query.skip import skipped_triangles, trace_skipping

NAME = "persistent"
CUDA = [name for name in DEVICES if name != "cpu"]
on_cuda = pytest.mark.skipif(not CUDA, reason="there is no CUDA device here")

_scenes: dict[tuple[str, str, int], wrt.Scene] = {}


def scene_of(name: str, device: str, leaf: int = LEAF_TRIANGLES) -> wrt.Scene:
    """A scene of width 2, made once."""
    key = name, device, leaf
    if key not in _scenes:
        mesh = (MESHES | SCENES)[name]()
        _scenes[key] = wrt.Scene(mesh, wrt.Bvh(width=2, max_leaf_triangles=leaf), device=device)
    return _scenes[key]


def assert_same_lists(found: wrt.AllHits, expected: wrt.AllHits) -> None:
    """Equal to the bit."""
    for name in ("offsets", "t", "primitive_id", "instance_id", "uv"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", MESHES)
def test_hostile_rays_have_the_hits_of_brute_force(name, kind, device):
    scene = scene_of(name, device)
    with np.errstate(over="ignore"):
        rays = wrt.Rays(*KINDS[kind](HostileRays(scene.meshes[0], 1500)))
    expected = brute_force(scene, rays)
    assert_same_hits(scene.intersect(rays, traversal=NAME), expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=NAME), expected.is_hit)
    listed = scene.intersect_all(rays, traversal="brute")
    np.testing.assert_array_equal(scene.count(rays, traversal=NAME), listed.count)
    assert_same_lists(scene.intersect_all(rays, traversal=NAME), listed)
    if device != "cpu":  # the bits of the CPU
        assert_same_hits(scene.intersect(rays), scene_of(name, "cpu").intersect(rays, traversal=NAME))


def test_hostile_rays_hit_something():
    """Each kind meets a mesh often enough to say something."""
    scene = scene_of("hills", "cpu")
    for kind in KINDS:
        with np.errstate(over="ignore"):
            hits = scene.intersect(*KINDS[kind](HostileRays(scene.meshes[0], 500)), traversal=NAME)
        assert hits.is_hit.mean() > 0.2, kind


@pytest.mark.parametrize("leaf", [1, LEAF_TRIANGLES, 63])
@pytest.mark.parametrize("name", ["grid", "degenerate", "needles"])
def test_leaves_of_any_size(name, leaf, device):
    scene = scene_of(name, device, leaf)
    rays = wrt.Rays(*mixed_rays(scene.meshes[0], 2000, seed=7))
    assert_same_hits(scene.intersect(rays, traversal=NAME), brute_force(scene, rays))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_triangles(count, device):
    """The root alone, with lanes that hold no child."""
    mesh = hostile_rays.coincident_mesh(count)
    scene = wrt.Scene(mesh, wrt.Bvh(width=2), device=device)
    rays = wrt.Rays(*HostileRays(mesh, 200).to_edges())
    assert_same_hits(scene.intersect(rays, traversal=NAME), scene.intersect(rays, traversal="brute"))


@pytest.mark.parametrize("most", [1, 3, None])
def test_lists_of_all_hits(most, device):
    """Long lists and short ones, and the nearest hits of each."""
    mesh = MESHES["coincident"]()
    scene = scene_of("coincident", device)
    origins, directions = HostileRays(mesh, 200).to_edges()
    rays = wrt.Rays(origins, directions, 0.0, np.where(np.arange(200) % 3, np.inf, 0.0).astype(np.float32))
    expected = scene.intersect_all(rays, traversal="brute", max_hits=most)
    assert len(expected) > 50
    assert_same_lists(scene.intersect_all(rays, traversal=NAME, max_hits=most), expected)
    few = wrt.Rays(np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(scene.intersect_all(few, traversal=NAME)) == 0


@pytest.mark.parametrize("rule", RULES)
def test_points_inside(rule, device):
    scene = scene_of("hills", device)
    points = np.random.default_rng(2).uniform(*scene.bounds, (3000, 3))
    inside = scene.contains(points, traversal="brute", rule=rule)
    np.testing.assert_array_equal(scene.contains(points, traversal=NAME, rule=rule), inside)


@pytest.mark.parametrize("placed", [False, *slow(True)], ids=["one mesh", "instances"])
def test_rays_skip_a_triangle(placed, device):
    """Closest hits, occlusion and counts, of rays that start on triangles, by the same plan on every device."""
    mesh = MESHES["hills"]()
    scene = instances_of(7, device)[0] if placed else scene_of("hills", device)
    rays = wrt.Rays(*HostileRays(mesh, 1000).from_vertices())
    starts = scene.intersect(rays)
    assert starts.is_hit.mean() > 0.3
    for kind in ("closest", "any", "count"):
        query = Query(kind, skip=starts)
        brought = on_device(scene.state, rays, query)
        skipped = skipped_triangles(starts, scene.state, brought)
        found = []
        for name in (NAME, "single"):
            plan = find_plan(scene.state, brought.facts, Query(kind, name)).plan
            hits = trace_skipping(scene.state, plan, brought.batch, kind, skipped)
            found.append([getattr(hits, column).numpy() for column in ANSWERS[kind].stored.columns])
        for ours, theirs in zip(*found, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    if not placed:
        kept = scene.intersect(rays, skip=starts)
        assert not (kept.is_hit & (kept.primitive_id == starts.primitive_id)).any()


def instances_of(count: int, device: str) -> tuple[wrt.Scene, wrt.Rays]:
    """Three meshes under maps of every kind, mirrored ones too, with masks and environments, and rays at them."""
    rng = np.random.default_rng(count)
    meshes = [MESHES[name]() for name in ("hills", "flat", "coincident")]
    placed = []
    for number in range(count):
        across, _, along = np.linalg.svd(rng.normal(size=(3, 3)))
        place = np.eye(4)
        place[:3, :3] = across @ along * rng.uniform(0.5, 2.0, 3) * rng.choice([-1.0, 1.0])
        place[:3, 3] = rng.uniform(-3.0, 3.0, 3)
        sight = {"mask": int(rng.integers(1, 8)), "environment": int(rng.integers(-1, 3))}
        placed.append(wrt.Instance(meshes[number % 3], place, **sight))
    scene = wrt.Scene(placed, wrt.Bvh(width=2, max_leaf_triangles=LEAF_TRIANGLES), device=device)
    low, high = scene.bounds
    flat = scene.state.flattened().vertices
    origins, towards = rng.uniform(low - 1.0, high + 1.0, (2000, 3)), flat[rng.integers(0, len(flat), 2000)]
    origins[::11] = towards[::11]
    directions = towards - origins
    directions[::3] = rng.normal(size=directions[::3].shape)
    directions[1::7] *= 2.0**40
    directions[2::7] *= 2.0**-40
    ends = np.where(np.arange(2000) % 2, np.inf, 1.0).astype(np.float32)
    return scene, wrt.Rays(origins.astype(np.float32), directions.astype(np.float32), 0.0, ends)


@pytest.mark.parametrize("count", [7, *slow(1, 2, 60)])
def test_through_instances(count, device):
    """The hits of single rays, with masks, environments and back faces left out."""
    scene, rays = instances_of(count, device)
    rng = np.random.default_rng(0)
    masks, environments = rng.integers(0, 8, 2000).astype(np.uint32), rng.integers(-1, 4, 2000)
    for sight in ({}, {"mask": masks}, {"environment": environments}, {"mask": 3, "environment": 1}):
        expected = scene.intersect(rays, traversal="single", **sight)
        found = scene.intersect(rays, traversal=NAME, **sight)
        assert_same_hits(found, expected)
        np.testing.assert_array_equal(found.instance_id, expected.instance_id)
        np.testing.assert_array_equal(scene.occluded(rays, traversal=NAME, **sight), expected.is_hit)
        counts = scene.count(rays, traversal="single", **sight)
        np.testing.assert_array_equal(scene.count(rays, traversal=NAME, **sight), counts)
        fronts = scene.intersect(rays, traversal="single", cull_backfaces=True, **sight)
        assert_same_hits(scene.intersect(rays, traversal=NAME, cull_backfaces=True, **sight), fronts)
    lists = scene.intersect_all(rays, traversal="single")
    assert lists.count.max() > 2
    assert_same_lists(scene.intersect_all(rays, traversal=NAME), lists)


def plan_of(find: Callable, traversal: str, scene: Any, rays: Any, query: Query) -> Any:
    """What `find` finds for a traversal."""
    return find(scene, rays, query._replace(traversal=traversal))


@pytest.mark.parametrize("name", ["hills", *slow("instances", *(name for name in MESHES if name != "hills"))])
def test_hits_in_float64(name, device, monkeypatch):
    """Those of single rays, to the bit."""
    if name == "instances":
        scene, rays = instances_of(7, device)
    else:
        scene = scene_of(name, device)
        parts = [kind(HostileRays(scene.meshes[0], 200)) for kind in KINDS.values()]
        rays = wrt.Rays(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    ends = np.where(np.arange(len(rays.origins)) % 5, np.inf, 0.7)
    given = wrt.Rays(np.float64(rays.origins) + 1e-9, np.float64(rays.directions), 0.0, ends)
    find, found = exact_hits.find_plan, []
    for way in (NAME, "single"):
        monkeypatch.setattr(exact_hits, "find_plan", partial(plan_of, find, way))
        hits = scene.intersect(given, precise=True)
        assert hits.is_hit.mean() > 0.1
        found.append([hits.t, hits.uv, hits.primitive_id, hits.instance_id])
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_no_t_is_negative_zero(device):
    """Rays that start on the surface hit it at 0."""
    scene = scene_of("hills", device)
    rays = wrt.Rays(*HostileRays(scene.meshes[0], 1000).from_vertices())
    for traversal in (NAME, "single", "brute"):
        t = scene.intersect(rays, traversal=traversal).t
        assert (t == 0).sum() > 50
        assert not np.signbit(t).any()
    assert not np.signbit(scene.intersect(rays, precise=True).t).any()


def test_instances_move(device):
    """A prepared query serves the next state, and gets a longer path where there are more instances."""
    scene, rays = instances_of(7, device)
    scene.intersect(rays, traversal=NAME)
    for step in range(3):
        place = np.array(scene.instances[step].transform)
        place[:3, 3] += 0.7
        scene.update(step, transform=place)
        assert_same_hits(scene.intersect(rays, traversal=NAME), scene.intersect(rays, traversal="single"))
        np.testing.assert_array_equal(scene.count(rays, traversal=NAME), scene.count(rays, traversal="single"))


def test_back_faces_are_culled(device):
    scene = scene_of("teapot", device)
    rays = wrt.Rays(*mixed_rays(scene.meshes[0], 2000, seed=3))
    expected = scene.intersect(rays, traversal="brute", cull_backfaces=True)
    assert 0.05 < expected.is_hit.mean() < brute_force(scene, rays).is_hit.mean()
    assert_same_hits(scene.intersect(rays, traversal=NAME, cull_backfaces=True), expected)
    dark = scene.occluded(rays, traversal=NAME, cull_backfaces=True)
    np.testing.assert_array_equal(dark, expected.is_hit)


def test_shared_origins_and_ranges(device):
    """One origin or direction for all, and bounds of t that end at hits, as kernels get them by strides of 0."""
    scene = scene_of("hills", device)
    origins, directions = HostileRays(scene.meshes[0], 900).to_vertices()
    for rays in (wrt.Rays(origins[0], directions), wrt.Rays(origins, directions[3])):
        assert_same_hits(scene.intersect(rays, traversal=NAME), brute_force(scene, rays))
    first = brute_force(scene, wrt.Rays(origins, directions))
    ends = np.where(first.is_hit, first.t, 1).astype(np.float32)
    for rays in (wrt.Rays(origins, directions, 0.0, ends), wrt.Rays(origins, directions, ends, 10.0)):
        expected = brute_force(scene, rays)
        assert expected.is_hit.any()
        assert_same_hits(scene.intersect(rays, traversal=NAME), expected)


def test_work_is_counted(device):
    """Fused boxes are a little larger, so that a few more are entered than by `single`, and never fewer."""
    scene = scene_of("teapot", device)
    rays = mixed_rays(scene.meshes[0], 2000)
    ours, theirs = (scene.intersect(*rays, traversal=name, counters=True).counters for name in (NAME, "single"))
    for kind in ("nodes", "leaves", "triangles"):
        assert theirs[kind].mean() <= ours[kind].mean() <= 1.2 * theirs[kind].mean()


def test_bytes_of_the_layout():
    """The bounds that the layout promises."""
    for name, leaf in (("teapot", 2), ("degenerate", 2), ("hills", 1), ("grid", 63)):
        scene = scene_of(name, "cpu", leaf)
        scene.intersect([[0, 0, 0]] * 2, [[1, 1, 1]] * 2, traversal=NAME)
        nodes, triangles = scene.state.cache.binary
        count = scene.state.triangle_count
        assert 16 * nodes.nodes.size <= 64 * (count - 1)
        assert 16 * triangles.corners.size <= 96 * count
        assert scene.state.record_bytes >= 16 * (nodes.nodes.size + triangles.corners.size)


def test_nodes_are_those_of_the_tree():
    scene = scene_of("hills", "cpu")
    tree, mesh = scene.state.tree, scene.meshes[0]
    packed = binary_nodes.pack_tree(tree.struct()).nodes.numpy().reshape(-1, 16)
    bounds, child = tree.bounds.numpy().reshape(-1, 6, 2), tree.child.numpy().reshape(-1, 2)
    np.testing.assert_array_equal(packed[:, [0, 2, 8, 1, 3, 9]], bounds[:, :, 0])
    np.testing.assert_array_equal(packed[:, [4, 6, 10, 5, 7, 11]], bounds[:, :, 1])
    np.testing.assert_array_equal(packed[:, 12:14].copy().view(np.int32), child)
    device_mesh = scene.state.device_mesh
    slots = binary_nodes.pack_triangles(device_mesh.vertices, device_mesh.faces, tree.primitive).corners.numpy()
    ids = slots.reshape(-1, 12)[:, 3].copy().view(np.int32)
    np.testing.assert_array_equal(ids, tree.primitive.numpy())
    used = ids >= 0
    corners = device_mesh.vertices.numpy()[mesh.faces[ids[used]]]
    np.testing.assert_array_equal(slots.reshape(-1, 3, 4)[used][:, :, :3], corners)


def test_scenes_that_it_does_not_walk():
    mesh = MESHES["flat"]()
    rays = HostileRays(mesh, 10).to_vertices()
    with pytest.raises(ValueError, match=r"persistent.*width 2.*wrt\.Bvh\(width=2\)"):
        wrt.Scene(mesh, wrt.Bvh(width=4), device="cpu").intersect(*rays, traversal=NAME)
    scene = scene_of("flat", "cpu")
    with pytest.raises(ValueError, match=r"persistent.*moeller_trumbore.*woop"):
        scene.intersect(*rays, traversal=NAME, triangle_test="moeller_trumbore")


def test_auto_chooses_it_on_cuda():
    score = TRAVERSALS[NAME].score
    usual = {
        "query": "closest",
        "cull_backfaces": False,
        "is_cuda": True,
        "tree": "bvh",
        "lanes": 2,
        "triangles": 1000,
        "instances": 0,
        "own_spaces": False,
        "has_wide_form": False,
        "rays": 10**6,
        "few": False,
        "coherent": True,
        "shared_origin": False,
    }
    assert score(Situation(**usual))[0] > TRAVERSALS["single"].score(Situation(**usual))[0]
    for change in ({"is_cuda": False}, {"own_spaces": True}):
        assert score(Situation(**usual | change)) is None


def test_what_descriptions_leave_open_on_cuda():
    cuda, cpu = SimpleNamespace(is_cuda=True), SimpleNamespace(is_cuda=False)
    assert for_device(wrt.Bvh(), cuda) == wrt.Bvh(max_leaf_triangles=LEAF_TRIANGLES)
    for given, device in (
        (wrt.Bvh(), cpu),
        (wrt.Bvh(max_leaf_triangles=5), cuda),
        (wrt.Bvh(width=8), cuda),
        (wrt.KdTree(), cuda),
        (wrt.Bvh(builder="hploc"), cpu),
        (wrt.Bvh(builder="hploc", reinsertion=0, max_leaf_triangles=5), cuda),
    ):
        assert for_device(given, device) is given
    built = [for_device(wrt.Bvh(builder="hploc"), cuda, moves=moves) for moves in (False, True)]
    assert [one.reinsertion for one in built] == [ROUNDS, None]


@pytest.mark.cuda
@on_cuda
@pytest.mark.parametrize("count", [2, 31, 33, BLOCK + 1, 1000, 300_000])
def test_every_ray_is_answered_once(count):
    """Numbers of rays around those of warps and blocks, and more than the device holds threads."""
    scene = scene_of("hills", CUDA[0])
    origins, directions = HostileRays(scene.meshes[0], count, seed=count).to_edges()
    expected = scene.intersect(origins, directions, traversal="single")
    assert scene.explain(origins, directions).traversal == NAME
    for _ in range(3):
        assert_same_hits(scene.intersect(origins, directions), expected)


@pytest.mark.cuda
@on_cuda
def test_streams_have_counters_of_their_own():
    """Two streams trace at the same time, by prepared queries of one scene."""
    device, scene = CUDA[0], scene_of("teapot", CUDA[0])
    origins, directions = mixed_rays(scene.meshes[0], 200_000, seed=9)
    rays = [wp.array(values, dtype=wp.vec3, device=device) for values in (origins, directions)]
    expected = scene.intersect(*rays, traversal="single").t.numpy()
    wp.synchronize()
    found = []
    streams = [wp.Stream(device), wp.Stream(device)]
    for turn in range(20):
        with wp.ScopedStream(streams[turn % 2], sync_enter=False):
            found.append(scene.intersect(*rays).t)
    wp.synchronize()
    for t in found:
        np.testing.assert_array_equal(t.numpy(), expected)


@pytest.mark.cuda
@on_cuda
def test_a_graph_replays():
    device, scene = CUDA[0], scene_of("teapot", CUDA[0])
    origins, directions = mixed_rays(scene.meshes[0], 50_000, seed=4)
    other, _ = mixed_rays(scene.meshes[0], 50_000, seed=5)
    rays = [wp.array(values, dtype=wp.vec3, device=device) for values in (origins, directions)]
    scene.intersect(*rays)
    scene.occluded(*rays)
    with wp.ScopedCapture(device) as capture:
        hits, dark = scene.intersect(*rays), scene.occluded(*rays)
    for place in (origins, other, origins):
        rays[0].assign(place)
        wp.capture_launch(capture.graph)
        expected = scene.intersect(place, directions, traversal="single")
        np.testing.assert_array_equal(hits.t.numpy(), expected.t)
        np.testing.assert_array_equal(hits.primitive_id.numpy(), expected.primitive_id)
        np.testing.assert_array_equal(dark.numpy(), expected.is_hit)


@pytest.mark.cuda
@on_cuda
def test_usual_calls_take_the_short_way():
    """Warp arrays on the device: the second call finds what the first one kept, and answers other rays rightly."""
    device, scene = CUDA[0], wrt.Scene(MESHES["teapot"](), device=CUDA[0])
    for seed in range(3):
        origins, directions = mixed_rays(scene.meshes[0], 2000 + seed, seed)
        rays = [wp.array(values, dtype=wp.vec3, device=device) for values in (origins, directions)]
        hits, dark = scene.intersect(*rays), scene.occluded(*rays, t_max=0.5)
        expected = scene.intersect(origins, directions, traversal="brute")
        np.testing.assert_array_equal(hits.t.numpy(), expected.t)
        np.testing.assert_array_equal(hits.uv.numpy(), expected.uv)
        short = scene.occluded(origins, directions, t_max=0.5, traversal="brute")
        np.testing.assert_array_equal(dark.numpy(), short)
    assert scene.state.cache.calls.keys() == {("closest", 0.0, float("inf")), ("any", 0.0, 0.5)}
