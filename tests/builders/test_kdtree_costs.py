"""What a split of a kd-tree costs, and when dividing stops: worked out by hand, or from the finished trees."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.built_kdtrees import build

import wrt
from wrt.builders.cost import SplitCost, SurfaceAreaCost, axis_frame, plane_cost
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities
from wrt.builders.kdtree.kdtree_statistics import kdtree_statistics, unpack
from wrt.builders.kdtree.phases.in_place_levels import may_contain_best
from wrt.builders.tree import StopRules

MIN_COST = [name for name, entry in KDTREE_BUILDERS.items() if BuilderCapabilities.MIN_COST in entry.capabilities]


def test_builders_say_whether_they_search_by_cost():
    """A list of exceptions stood here, so that a new builder that splits by another rule failed the textbook's cost."""
    assert {"in_place", "binned", "streaming", "adaptive_sampling", "lazy", "sweep", "sorting_sweep", "naive"} <= set(MIN_COST)
    assert {"spatial_median", "object_median", "between_medians"}.isdisjoint(MIN_COST)


@pytest.mark.parametrize("builder", MIN_COST)
def test_surface_area_cost_of_a_known_split(builder):
    """Two far-apart clusters: the empty middle is cut off, and the cost is the textbook's, worked out by hand."""
    corners = np.array([[[0, 0, 0], [1, 1, 0], [1, 0, 1]], [[9, 0, 0], [10, 1, 0], [10, 0, 1]]], dtype=np.float32)
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(6).reshape(-1, 3))
    tree, config = build(mesh, builder, width=1, traversal_cost=1.0, block_cost=10.0, bad_splits=0, empty_factor=0.8)
    statistics = kdtree_statistics(tree, 2, config.cost)
    assert (statistics.leaves, statistics.empty_leaves, statistics.references) == (3, 1, 2)
    root, cluster = 1 * 1 + 2 * 10, 1 * 1 + 2 * 1  # half areas
    rest = 1 * 1 + 2 * 9
    assert statistics.sah_cost == pytest.approx(1 + rest / root + 2 * 10 * cluster / root)
    assert statistics.depth_histogram.tolist() == [0, 1, 2]
    assert statistics.leaf_size_histogram.tolist() == [1, 2]


def test_empty_space_bonus_cuts_more_empty_space():
    mesh = wrt.scenes.build("teapot", level=6)
    with_bonus = kdtree_statistics(*build_for_statistics(mesh, empty_factor=0.6))
    without = kdtree_statistics(*build_for_statistics(mesh, empty_factor=1.0))
    assert with_bonus.empty_leaves > without.empty_leaves


def build_for_statistics(mesh, **options):
    tree, config = build(mesh, **options)
    return tree, mesh.triangle_count, config.cost


def test_stop_rules():
    mesh = wrt.scenes.build("teapot", level=6)
    leaf, _ = build(mesh, max_depth=0)
    assert len(leaf.nodes) == 1
    shallow, _ = build(mesh, max_depth=3)
    assert unpack(shallow).depth.max() == 3
    none, some = (build_for_statistics(mesh, bad_splits=n) for n in (0, 3))
    assert kdtree_statistics(*some).nodes > kdtree_statistics(*none).nodes


def test_terminations():
    """Which splits are made, worked out from the finished trees."""
    mesh = wrt.scenes.build("teapot", level=6)
    fixed = unpack(build(mesh, termination="fixed", leaf_triangles=4, max_depth=40)[0])
    inner = ~fixed.is_leaf
    assert np.bincount(fixed.triangles[fixed.is_leaf])[: 4 + 1].sum() > 0.9 * fixed.is_leaf.sum()
    by_depth = unpack(build(mesh, termination="fixed", max_depth=5)[0])
    full = (by_depth.depth[by_depth.is_leaf] == 5) | (by_depth.triangles[by_depth.is_leaf] == 0)
    assert full.all()
    size = (fixed.high - fixed.low)[0].max()
    coarse = unpack(build(mesh, least_size=0.2)[0])
    longest = (coarse.high - coarse.low).max(axis=1)
    assert (longest[~coarse.is_leaf] > 0.2 * size * (1 - 1e-6)).all()
    assert ((fixed.high - fixed.low).max(axis=1)[inner] < 0.2 * size).any()
    count = mesh.triangle_count
    rules = StopRules(termination="automatic").limits(count)
    assert (rules.depth, rules.bad_splits) == (round(2 + 1.2 * np.log2(count)), 1 + rules.depth // 5)
    automatic = unpack(build(mesh, termination="automatic")[0])
    assert automatic.depth.max() <= rules.depth


def test_mailboxes_pay_for_straddlers():
    """One split of three triangles, one of which lies across it: its cost is Hunt's, worked out by hand."""
    corners = np.array(
        [[[0, 0, 0], [4, 1, 0], [4, 0, 1]], [[6, 0, 0], [10, 1, 0], [10, 0, 1]], [[3, 0, 0], [7, 1, 0], [7, 0, 1]]]
    )
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(9).reshape(-1, 3))
    root, face = 1 * 1 + 2 * 10, 1
    for mailbox in (False, True):
        for block, is_split in ((0.9, False), (60.0, True)):
            tree, _ = build(mesh, "naive", width=1, block_cost=block, bad_splits=0, empty_factor=1.0, mailbox=mailbox)
            assert unpack(tree).is_leaf[0] != is_split
    # at x = 4 or 6: 2 triangles on one side, 2 on the other, one of them on both; areas 1 + 2 * 4 and 1 + 2 * 6
    plain = (2 * 9 + 2 * 13) / root
    hunt = plain - 1 * face / root
    between = 1.0 / (3.0 - (plain + hunt) / 2)  # a block cost that pays for a step only with a mailbox
    for mailbox in (False, True):
        tree, _ = build(
            mesh, "naive", width=1, block_cost=between, bad_splits=0, empty_factor=1.0, mailbox=mailbox, max_depth=1
        )
        assert unpack(tree).is_leaf[0] != mailbox


@pytest.mark.parametrize(
    "make",
    [
        lambda: SurfaceAreaCost(width=3),
        lambda: SurfaceAreaCost(block=0.0),
        lambda: SurfaceAreaCost(traversal=-1.0),
        lambda: SurfaceAreaCost(traversal=float("nan")),
        lambda: SurfaceAreaCost(empty_factor=0.0),
        lambda: SurfaceAreaCost(empty_factor=1.5),
        lambda: StopRules(max_depth=65),
        lambda: StopRules(max_depth=-1),
        lambda: StopRules(bad_splits=-1),
        lambda: StopRules(termination="none such"),
        lambda: StopRules(leaf_triangles=-1),
        lambda: StopRules(least_size=1.0),
        lambda: StopRules(least_size=float("nan")),
        lambda: wrt.KdTree(builder="none such"),
        lambda: wrt.KdTree(width=5),
        lambda: wrt.KdTree(builder="spatial_median", axis="shortest"),
        lambda: wrt.KdTree(builder="adaptive_sampling", searched_axes="shortest"),
        lambda: wrt.KdTree(builder="sweep", searched_axes="longest"),
    ],
)
def test_bad_configurations(make):
    with pytest.raises(ValueError, match=r"must|choose from"):
        make()


@wp.kernel(enable_backward=False, module_options={"fuse_fp": False}, module="unique")
def check_chunks(
    cost: SplitCost,
    high: wp.array(dtype=wp.vec3),
    share: wp.array(dtype=wp.vec3),
    counts: wp.array2d(dtype=int),
    answers: wp.array2d(dtype=bool),
):
    """Item: a node from (0, 0, 0) to `high`, a plane of it, and a chunk around that: share[0] .. share[2] of the axis.

    counts: triangles of the node, left and right of the plane, before and behind the chunk."""
    i = wp.tid()
    axis = i % 3
    at = share[i] * high[i][axis]
    along = axis_frame(cost, axis, wp.vec3(), high[i], counts[i, 0])
    plane = plane_cost(cost, along, at[1], counts[i, 1], counts[i, 2])
    answers[i, 0] = may_contain_best(cost, along, at[0], at[2], counts[i, 3], counts[i, 4], plane)
    answers[i, 1] = may_contain_best(cost, along, at[1], at[1], counts[i, 1], counts[i, 2], plane)
    answers[i, 2] = may_contain_best(cost, along, at[1], at[1], counts[i, 1], counts[i, 2], plane * 0.999)


@pytest.mark.parametrize("mailbox", [False, True])
def test_chunks_without_hope_are_those_that_cost_more(mailbox):
    """A chunk with a plane that is as cheap as the cheapest known is searched; of a single plane, the bound is its cost."""
    count, rng = 20_000, np.random.default_rng(5)
    high = np.float32(10 ** rng.uniform(-2, 2, (count, 3)))
    share = np.sort(np.float32(rng.uniform(0.01, 0.99, (count, 3))), axis=1)
    left, right = rng.integers(0, 40, (2, count)) * rng.integers(0, 500, (2, count))
    fewer = rng.uniform(0, 1, (2, count)) * rng.integers(0, 2, (2, count))
    total = np.maximum(left, right) + rng.integers(0, 100, count)
    counts = np.stack([total, left, right, left - fewer[0] * left, right - fewer[1] * right], axis=1).astype(np.int32)
    cost = SurfaceAreaCost(width=16, mailbox=mailbox).struct()
    answers = wp.empty((count, 3), dtype=bool, device="cpu")
    inputs = [wp.array(a, dtype=wp.vec3, device="cpu") for a in (high, share)] + [wp.array(counts, dtype=int, device="cpu")]
    wp.launch(check_chunks, count, [cost, *inputs, answers], device="cpu")
    around, alone, dearer = answers.numpy().T
    assert around.all()
    assert alone.all()
    assert not dearer[left + right > 0].any()
