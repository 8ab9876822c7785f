"""Queued traversal: where a tree is cut, and that the cut never shows in an answer."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import assert_same_hits, brute_force, mixed_rays

import wrt
from wrt.builders.convert.queue_points import child_bytes, find_queue_points
from wrt.engine.launch import queued_tracing
from wrt.kernels.compilation.cache_size import USUAL_L2, USUAL_L3, l2_bytes, l3_bytes

NAME = "queued"


@pytest.fixture(scope="module")
def mesh() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=5)


@pytest.fixture(scope="module")
def rays(mesh):
    return mixed_rays(mesh, 5000)


@pytest.mark.parametrize("cache_bytes", [1, 3000, 50_000, 1 << 40])
@pytest.mark.parametrize("threads", [1, 3])
def test_answers_do_not_depend_on_the_cache(mesh, rays, cache_bytes, threads, monkeypatch):
    """Every leaf a queue, subtrees of some leaves, and the whole tree one subtree."""
    monkeypatch.setattr(queued_tracing, "l2_bytes", lambda: cache_bytes)
    scene = wrt.Scene(mesh, "bvh", device="cpu", num_threads=threads)
    expected = brute_force(scene, wrt.Rays(*rays))
    hits = scene.intersect(*rays, traversal=NAME, counters=True)
    assert_same_hits(hits, expected)
    np.testing.assert_array_equal(scene.occluded(*rays, traversal=NAME), expected.is_hit)
    np.testing.assert_array_equal(scene.count(*rays, traversal=NAME), scene.count(*rays, traversal="single"))
    front = scene.intersect(*rays, traversal="single", cull_backfaces=True)
    assert_same_hits(scene.intersect(*rays, traversal=NAME, cull_backfaces=True), front)
    work, single = hits.counters, scene.intersect(*rays, traversal="single", counters=True).counters
    assert (work["leaves"][expected.is_hit] > 0).all()
    assert work["triangles"].sum() <= 1.01 * single["triangles"].sum(), "front to back, as a single ray"
    assert work["nodes"].sum() >= 0.99 * single["nodes"].sum()


@pytest.mark.parametrize("cache_bytes", [1, 3000, 50_000, 1 << 40])
def test_queue_points_cover_the_tree(mesh, cache_bytes):
    tree = wrt.Scene(mesh, "bvh", device="cpu").tree
    width, block_bytes = tree.width, 40 * tree.width
    cut = find_queue_points(tree, block_bytes, cache_bytes, 65_534)
    child = tree.child.numpy().reshape(-1, width)
    found, sizes = [], []
    for root in cut.roots:  # all leaves below, and their bytes
        waiting, size = [root], 0
        while waiting:
            word = waiting.pop()
            if word >= 0:
                waiting.extend(one for one in child[word].tolist() if one >= 0 or ~one & 63)
                size += 28 * width
            else:
                found.append(word)
                size += -(-(~word & 63) // width) * block_bytes
        sizes.append(size)
    leaves = child[(child < 0) & ((~child & 63) > 0)]
    assert sorted(found) == sorted(leaves.tolist()), "every leaf is below one queue point"
    np.testing.assert_array_equal(cut.bytes, sizes)
    inner = cut.roots >= 0
    assert (cut.bytes[inner] <= cache_bytes).all()
    upper = cut.child.reshape(-1, width)
    numbers = (~upper[(upper < 0) & ((~upper & 63) > 0)]) >> 6
    assert numbers.tolist() == list(range(len(cut.roots)))
    above = 0 if cut.roots.tolist() == [0] else len(upper)  # nodes of the tree
    assert child_bytes(tree, block_bytes)[0].sum() + 28 * width == sum(sizes) + 28 * width * above
    assert (len(cut.roots) == 1) == (cache_bytes == 1 << 40)
    few = find_queue_points(tree, block_bytes, cache_bytes, 20)
    assert len(few.roots) <= 20


def test_size_of_the_cache(tmp_path):
    assert l2_bytes() >= 1 << 16
    assert l2_bytes(tmp_path) == USUAL_L2, "the system does not say"
    for number, (level, size) in enumerate([("1", "32K"), ("2", "512K"), ("3", "16M")]):
        folder = tmp_path / "some" / f"index{number}"
        folder.mkdir(parents=True)
        (folder / "level").write_text(level + "\n")
        (folder / "size").write_text(size + "\n")
    assert l2_bytes(tmp_path / "some") == 512 << 10
    assert l3_bytes(tmp_path / "some") == 16 << 20
    assert l3_bytes(tmp_path) == USUAL_L3, "the system does not say"
    (tmp_path / "some" / "index1" / "size").write_text("large")
    l2_bytes.cache_clear()
    assert l2_bytes(tmp_path / "some") == USUAL_L2
