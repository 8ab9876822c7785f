"""Entry points, omnidirectional packets and mailboxes against brute force, bit for bit, with rays that do stay together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hits import assert_same_hits, brute_force
from support.meshes import SCENES
from support.packet_rays import beams, ragged

import wrt
from studies.kdtrees.entry_point_tiles import compare_levels, morton_view, tile_query
from studies.kdtrees.packet_widths import compare_widths
from studies.kdtrees.tree_coupling import coupled_query
from wrt.kernels.classics.traversal import entry_point
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.mailbox import MAILBOXES, NONE
from wrt.kernels.traversal.traversal_config import TileConfig

ENTRY_POINTS = ("mlrta", "aepsa")


def plan_of(scene: wrt.Scene, rays: wrt.Rays, traversal: str, **changes: object) -> wrt.results.Plan:
    """A plan with changes."""
    return replace(scene.explain(rays, traversal=traversal), **changes)


def wide_beams(mesh: wrt.TriangleMesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`beams` of 128 rays, as many as a small tile has, and among them a run, longer than a large tile, of rays that miss."""
    origins, directions = (np.repeat(vectors, 2, axis=0) for vectors in beams(mesh, count, True, seed=5))
    rng = np.random.default_rng(6)
    away = np.where(rng.random((24, 1, 1)) < 0.5, 1.0, -1.0) * rng.random((24, 128, 3))
    starts = np.where(away > 0, mesh.bounds[1] + 0.01, mesh.bounds[0] - 0.01)
    half = len(origins) // 2
    origins = np.concatenate([origins[:half], starts.reshape(-1, 3), origins[half:]])
    directions = np.concatenate([directions[:half], away.reshape(-1, 3), directions[half:]])
    return origins.astype(np.float32), directions.astype(np.float32)


def test_beams_equal_brute_force(scene_mesh, device):
    scene = wrt.Scene(scene_mesh, "kdtree", device=device)
    rays = ragged(*wide_beams(scene_mesh, 24))
    expected = brute_force(scene, rays)
    assert expected.is_hit.mean() > 0.02
    for traversal in (*ENTRY_POINTS, "omnidirectional"):
        assert_same_hits(scene.intersect(rays, traversal=traversal), expected)
        np.testing.assert_array_equal(scene.occluded(rays, traversal=traversal), expected.is_hit)


def picture(mesh: wrt.TriangleMesh, size: int) -> wrt.Rays:
    """A view of the mesh whose pixels are in the order of Morton's curve, so that every tile is a square."""
    low, high = mesh.bounds
    rank = np.arange(size * size)
    bits = [(rank >> b & 1) << b // 2 for b in range(int(size).bit_length() * 2)]
    x, y = sum(bits[0::2]), sum(bits[1::2])
    targets = low + (high - low) * np.stack([(x + 0.5) / size, (y + 0.5) / size, np.zeros(len(rank))], axis=1)
    eye = (low + high) / 2 + (0.1, 0.2, 2.0) * (high - low)
    return wrt.Rays(eye.astype(np.float32), (targets - eye).astype(np.float32))


@pytest.mark.parametrize("traversal", ENTRY_POINTS)
def test_tiles_never_show(traversal, device):
    """Compact tiles, whose entry points are deep, of two sizes."""
    mesh = wrt.scenes.build("random_triangles", count=1500, size=0.1, seed=4)
    scene = wrt.Scene(mesh, "kdtree", device=device)
    rays = picture(mesh, 128)
    expected = scene.intersect(rays, traversal="single")
    assert 0.1 < expected.is_hit.mean() < 0.9
    for vectors in (1, 4):
        plan = plan_of(scene, rays, traversal)
        assert_same_hits(scene.intersect(rays, traversal=replace(plan, packet=vectors * plan.width)), expected)


def test_aepsa_visits_less_than_mlrta():
    """Its entry points are at least as deep, found in fewer steps, and more tiles turn out to see nothing."""
    mesh = wrt.scenes.build("random_triangles", count=1500, size=0.1, seed=4)
    scene = wrt.Scene(mesh, "kdtree", device="cpu")
    rays = picture(mesh, 128)
    work = {}
    for traversal in ("packet", *ENTRY_POINTS):
        work[traversal] = scene.intersect(rays, traversal=traversal, counters=True).counters
    assert work["aepsa"]["nodes"].sum() < work["mlrta"]["nodes"].sum() < 2 * work["packet"]["nodes"].sum()
    assert work["aepsa"]["triangles"].sum() <= work["mlrta"]["triangles"].sum() <= work["packet"]["triangles"].sum()


@pytest.mark.parametrize(("packets", "split", "levels"), [(1, 1, 2), (2, 64, 2), (1, 4, 3)])
def test_chosen_tiles_never_show(packets, split, levels):
    """Tiles of one packet, tiles of 128 packets in 64 parts, and tiles of three sizes."""
    mesh = SCENES["stadium"]()
    scene = wrt.Scene(mesh, "kdtree", device="cpu")
    rays = ragged(*wide_beams(mesh, 24))
    expected = brute_force(scene, rays)
    hits = tile_query(scene, rays, "aepsa", packets=packets, split=split, levels=levels)()
    np.testing.assert_array_equal(hits.t.numpy(), expected.t)
    np.testing.assert_array_equal(hits.primitive.numpy(), expected.primitive_id)
    with pytest.raises(ValueError, match="at least 1"):
        tile_query(scene, rays, "aepsa", packets=0, split=split)
    with pytest.raises(ValueError, match="levels 0"):
        tile_query(scene, rays, "aepsa", packets=packets, split=split, levels=0)


def test_levels_are_compared():
    """A row for packets, one for each kind of tile, and views whose runs are squares."""
    mesh = SCENES["stadium"]()
    rows = compare_levels(mesh, size=16, tilings=(TileConfig(1, 4, 3),), rounds=1)
    assert [row["levels"] for row in rows] == [0, 3]
    assert rows[0]["ratio"] == 1.0
    assert rows[1]["rays"] % 16 == 0
    way = morton_view(mesh, 8).directions.reshape(4, 16, 3)
    assert np.allclose(np.ptp(way, axis=1)[:, [0, 2]], 3 / 8), "sixteen rays are a square of four by four"


def test_widths_are_compared():
    """A row for single rays and one for each size of packets, through both trees."""
    rows = compare_widths(SCENES["stadium"](), size=16, widths=(32,), rounds=1)
    assert [row["packet"] for row in rows] == [1, 32]
    assert all(row["bvh"] > 0 and row["kdtree"] > 0 and row["ratio"] > 0 for row in rows)


@pytest.mark.parametrize("traversal", ENTRY_POINTS)
def test_a_tile_that_sees_nothing_traces_no_packet(traversal):
    """Rays between two clusters of triangles: all is known of a tile once its bounds have been through the tree."""
    cluster = wrt.scenes.build("random_triangles", count=300, size=0.1, seed=1)
    vertices = np.concatenate([cluster.vertices, cluster.vertices + np.array([5.0, 0.0, 0.0])])
    faces = np.concatenate([cluster.faces, cluster.faces + cluster.vertex_count])
    tree = wrt.KdTree(width=2, block_cost=4.0)  # so fine that it cuts the gap off
    scene = wrt.Scene(wrt.TriangleMesh(vertices, faces), tree, device="cpu")
    low, high = cluster.bounds
    middle = np.array([high[0] + 2.0, (low[1] + high[1]) / 2, low[2] - 3.0])
    spread = np.random.default_rng(0).normal(size=(5000, 3)) * 0.01
    rays = wrt.Rays(middle, np.array([0.0, 0.0, 1.0]) + spread)
    plan = plan_of(scene, rays, traversal)
    hits = scene.intersect(rays, traversal=plan, counters=True)
    assert not hits.is_hit.any()
    tile = entry_point.SPLIT * entry_point.PACKETS * plan.packet
    visited = np.flatnonzero(hits.counters["nodes"] + hits.counters["leaves"])
    assert len(visited)
    assert (visited % tile == 0).all()


def test_omnidirectional_packets_stay_together():
    """Rays from one point to all sides: a packet has all signs, and still does less than its rays alone."""
    mesh = wrt.scenes.build("atrium")
    scene = wrt.Scene(mesh, "kdtree", device="cpu")
    directions = np.random.default_rng(1).normal(size=(4096, 3))
    rays = wrt.Rays(mesh.bounds.mean(axis=0) * (1.0, 1.0, 0.9), directions)
    alone = scene.intersect(rays, traversal="single", counters=True)
    together = scene.intersect(rays, traversal="omnidirectional", counters=True)
    assert_same_hits(together, alone)
    assert together.counters["nodes"].sum() < 0.6 * alone.counters["nodes"].sum()


@pytest.mark.parametrize("traversal", ["single", "packet"])
@pytest.mark.parametrize("mailbox", [name for name in MAILBOXES if name != NONE])
def test_mailboxes_never_show(mailbox, traversal, device):
    """Fine trees of narrow blocks, in which triangles are in many leaves; what is remembered is not tested again."""
    avoided = 0
    for make in SCENES.values():
        mesh = make()
        scene = wrt.Scene(mesh, wrt.KdTree(width=2, block_cost=4.0), device=device)
        rays = ragged(*beams(mesh, 30, True))
        plan = plan_of(scene, rays, traversal)
        remembering = replace(plan, mailbox=mailbox)
        assert mailbox in str(remembering)
        hits = scene.intersect(rays, traversal=remembering, counters=True)
        assert_same_hits(hits, brute_force(scene, rays))
        without = scene.intersect(rays, traversal=plan, counters=True).counters
        work = {name: counts.sum() for name, counts in hits.counters.items()}
        assert not without["avoided"].any()
        assert work["leaves"] == without["leaves"].sum()
        assert work["triangles"] + work["avoided"] == without["triangles"].sum()
        avoided += work["avoided"]
    assert avoided > 1000


@pytest.mark.parametrize("traversal", ["single", "packet"])
def test_a_plain_mailbox_forgets_nothing(traversal):
    """It avoids at least what the others avoid; with a triangle a block and few of them, no ray tests one twice."""
    mesh = wrt.scenes.random_triangles(count=60, size=0.8)
    scene = wrt.Scene(mesh, wrt.KdTree(width=1 if traversal == "single" else 2, termination="fixed", max_depth=7), device="cpu")
    rays = ragged(*beams(mesh, 30, True))
    plan = plan_of(scene, rays, traversal)
    work = {}
    for mailbox in MAILBOXES:
        hits = scene.intersect(rays, traversal=replace(plan, mailbox=mailbox), counters=True)
        assert_same_hits(hits, brute_force(scene, rays))
        work[mailbox] = {name: counts.astype(np.int64) for name, counts in hits.counters.items()}
    avoided = {mailbox: counts["avoided"].sum() for mailbox, counts in work.items()}
    assert avoided["none"] == 0
    assert avoided["plain"] >= max(avoided["hashed"], avoided["inverse"])
    assert avoided["plain"] > avoided["inverse"]
    if traversal == "single":
        assert work["none"]["triangles"].max() > mesh.triangle_count >= work["plain"]["triangles"].max()


def test_mailboxes_that_do_not_fit():
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, "kdtree", device="cpu")
    rays = wrt.Rays(*beams(mesh, 8, True))
    plan = scene.explain(rays, traversal="single")
    with pytest.raises(ValueError, match=r"plan\.mailbox"):
        scene.intersect(rays, traversal=replace(plan, mailbox="no such"))
    with pytest.raises(ValueError, match="kdtree"):
        scene.intersect(rays, traversal=replace(plan, traversal="lockstep", mailbox="hashed"))
    other = wrt.Scene(mesh, "bvh", device="cpu")
    with pytest.raises(ValueError, match="kdtree"):
        other.intersect(rays, traversal=replace(other.explain(rays), mailbox="hashed"))
    assert all(TRAVERSALS[name].has_mailbox("kdtree") for name in ("single", "packet", *ENTRY_POINTS, "omnidirectional"))


def test_coupled_trees_equal_brute_force():
    """Packets of more than eight active rays walk the BVH, smaller ones and parts the kd-tree, single rays the kd-tree. The
    kd-tree's packets once took the culling of the BVH, whose frustum is that of a leaf's box, and lost hits."""
    mesh = SCENES["stadium"]()
    bvh, kdtree = (wrt.Scene(mesh, tree, device="cpu") for tree in ("bvh", "kdtree"))
    origins, directions = wide_beams(mesh, 24)
    scattered = np.random.default_rng(7)
    for row in range(64):  # the first packets keep one ray each of two packets in three, or rays of all directions
        if row % 3:
            directions[32 * row + 1 : 32 * row + 32 - 8 * (row % 2)] = 0.0
        else:
            directions[32 * row : 32 * row + 32] = scattered.normal(size=(32, 3))
    rays = ragged(origins, directions)
    expected = brute_force(bvh, rays)
    assert expected.is_hit.mean() > 0.02
    hits = coupled_query(bvh, kdtree, rays, small=8, kdtree_singles=True)()
    np.testing.assert_array_equal(hits.t.numpy(), expected.t)
    np.testing.assert_array_equal(hits.primitive.numpy(), expected.primitive_id)
    with pytest.raises(ValueError, match="small is -1"):
        coupled_query(bvh, kdtree, rays, small=-1, kdtree_singles=True)
    other = wrt.Scene(SCENES["random_triangles"](), "kdtree", device="cpu")
    with pytest.raises(ValueError, match="same mesh"):
        coupled_query(bvh, other, rays, small=8, kdtree_singles=True)
