"""Upper levels from a random subset: invariants, the hits of any tree, no trace of threads, depth, cost, bad shares."""

from __future__ import annotations

import numpy as np
import pytest
from support.built_bvhs import assert_same_tree, check
from support.built_bvhs import build as build_bvh
from support.hits import assert_same_hits, mixed_rays
from support.known_areas import area_of, build
from support.meshes import SCENES

import wrt
from wrt.builders.bvh import binned_bvh as binned
from wrt.builders.classics.bvh import subset_levels
from wrt.kernels.runtime.launch import use_threads

pytestmark = pytest.mark.classics


@pytest.fixture(autouse=True)
def small_subsets(monkeypatch):
    """Subsets of small meshes, too."""
    monkeypatch.setattr(subset_levels, "MIN_SUBSET", 20)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.99])
@pytest.mark.parametrize("name", ["wood", "degenerate", "random_triangles", "stadium"])
def test_invariants(name, share):
    mesh = SCENES[name]()
    for tree, config in (build_bvh(mesh, subset=share), build(mesh, area_of(mesh, "point"), "facing", subset=share)):
        check(tree, mesh.vertices, mesh.faces, getattr(config, "bvh", config))
        assert {"subset", "insertion"} <= tree.stats.seconds.keys() or mesh.triangle_count < 40


def test_every_ray_has_its_hit():
    mesh = SCENES["random_triangles"]()
    rays = mixed_rays(mesh, 400)
    expected = wrt.Scene(mesh, wrt.Bvh(width=8)).intersect(*rays, traversal="brute")
    area = area_of(mesh, "point inside")
    whole = wrt.Bvh(width=8, subset=0.1)
    for accelerator in (
        whole,
        wrt.known_rays.ProjectedBvh(areas=[area], width=8, subset=0.1),
        wrt.known_rays.RayAwareBvh(areas=[area], whole=whole, local=wrt.known_rays.ProjectedBvh(areas=[area], subset=0.1)),
    ):
        assert_same_hits(wrt.Scene(mesh, accelerator).intersect(*rays, traversal="single"), expected)


def test_threads_do_not_show(monkeypatch):
    mesh = SCENES["wood"]()
    area = area_of(mesh, "point")
    with use_threads(1):
        reference, _ = build(mesh, area, subset=0.2)
    monkeypatch.setattr(binned, "SLOTS_PER_THREAD", 5)
    monkeypatch.setattr(binned, "MIN_CHUNK", 64)
    monkeypatch.setattr(subset_levels, "CHUNK", 32)
    with use_threads(3):
        assert_same_tree(build(mesh, area, subset=0.2)[0], reference)
    plain, _ = build(mesh, area)
    assert plain.bounds.shape != reference.bounds.shape or (plain.bounds.numpy() != reference.bounds.numpy()).any()


def test_subsets_are_spread_and_drawn_again():
    chosen = subset_levels.choose(10_000, 0.1)
    assert len(chosen) == 1000
    np.testing.assert_array_equal(chosen // 10, np.arange(1000))
    assert len(np.unique(chosen % 10)) == 10
    np.testing.assert_array_equal(chosen, subset_levels.choose(10_000, 0.1))
    assert len(subset_levels.choose(10_000, 1.0)) == len(subset_levels.choose(39, 0.5)) == 0


def test_the_tree_costs_little_more():
    mesh = SCENES["wood"]()
    plain, some = (wrt.Scene(mesh, wrt.Bvh(width=8, subset=share)).statistics().tree.sah_cost for share in (1.0, 0.2))
    assert some < 1.15 * plain


def test_the_descent_ends_where_subtrees_still_fit(monkeypatch):
    """However many triangles are inserted into a node, its subtree is not too deep."""
    mesh, made, depth = SCENES["wood"](), [], 20
    insert = subset_levels.insert
    monkeypatch.setattr(subset_levels, "insert", lambda *arguments: made.append(insert(*arguments)) or made[-1])
    build_bvh(mesh, subset=0.3)
    monkeypatch.setattr(subset_levels, "MAX_WIDE_DEPTH", depth)
    tree, config = build_bvh(mesh, subset=0.3)
    check(tree, mesh.vertices, mesh.faces, config)
    free, bounded = (upper.tasks.numpy() for upper in made)
    limit = depth - int(mesh.triangle_count - 1).bit_length()
    assert free["depth"].max() > bounded["depth"].max() == limit > 0
    assert bounded["count"].sum() == mesh.triangle_count
    assert (bounded["depth"] + np.ceil(np.log2(bounded["count"])) <= depth).all()


@pytest.mark.parametrize("share", [0.0, -1.0, 1.5, float("nan")])
def test_bad_shares(share):
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 0), direction=(0, 0, 1), width=1, height=1, depth=1)
    for describe in (wrt.Bvh, lambda subset: wrt.known_rays.ProjectedBvh(areas=[area], subset=subset)):
        with pytest.raises(ValueError, match=r"subset is (nan|.* above 0 and at most 1)"):
            describe(subset=share)


def test_sweeps_have_no_subset():
    with pytest.raises(ValueError, match="builder 'sweep' does not support a subset; use 'binned'"):
        wrt.Bvh(builder="sweep", subset=0.5)
