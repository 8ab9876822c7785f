"""Reinsertion: gains against a float64 search of all places, moves against the areas they leave, trees and hits as ever."""

from __future__ import annotations

import functools
from copy import copy

import numpy as np
import pytest
import warp as wp
from support.built_bvhs import assert_same_tree, build, check, mesh_of

import wrt
from wrt.builders.bvh.binned_bvh import BinnedBuilder
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.bvh_statistics import bvh_statistics, half_area, unpack
from wrt.builders.bvh.phases.binary_tree import LEAF
from wrt.builders.classics.bvh.reinsertion import Reinsertion
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import use_threads

pytestmark = pytest.mark.classics

WIDTH = 8
ROUNDS = 4


@functools.cache
def atrium() -> wrt.TriangleMesh:
    return wrt.scenes.build("atrium", bays=(2, 1), detail=2)


def unequal(count: int, seed: int = 3) -> wrt.TriangleMesh:
    """Triangles of all sizes, which lie across each other: no split from the root down does them justice."""
    random = np.random.default_rng(seed)
    sizes = 2.0 ** random.uniform(-8.0, 0.0, (count, 1, 1))
    return mesh_of(random.uniform(-1.0, 1.0, (count, 1, 3)) + sizes * random.normal(size=(count, 3, 3)))


def binary_of(mesh: wrt.TriangleMesh) -> Reinsertion:
    """The binary tree that the binned builder makes of a mesh, ready for nodes to move."""
    vertices = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
    faces = wp.array(mesh.faces, dtype=wp.vec3i, device="cpu")
    config = BvhConfig(SurfaceAreaCost(width=WIDTH), reinsertion=1)
    builder = BinnedBuilder(triangle_boxes(vertices, faces), config)
    builder.make_references()
    builder.build_levels()
    builder.build_subtrees()
    return Reinsertion.of(builder.result(), mesh.triangle_count)


class HostTree:
    """A binary tree on the host, in float64: nodes by number, as on the device."""

    def __init__(self, work: Reinsertion) -> None:
        nodes = 2 * work.end
        self.pair = work.binary.tree.pair.numpy()[:nodes].tolist()
        self.box = work.binary.tree.box.numpy().reshape(-1, 8)[:nodes, [0, 1, 2, 4, 5, 6]].astype(float)
        self.parent = {p: node for node, p in enumerate(self.pair) if node != 1 and p != LEAF}

    def area(self) -> float:
        """Sum of the areas of all inner nodes, their boxes put together from the leaves."""
        return sum(half_area(box[:3], -box[3:]) for box in self._inner(0)[1])

    def _inner(self, node: int) -> tuple[np.ndarray, list[np.ndarray]]:
        if self.pair[node] == LEAF:
            return self.box[node], []
        (a, left), (b, right) = (self._inner(2 * self.pair[node] + side) for side in range(2))
        box = np.minimum(a, b)
        return box, [*left, *right, box]

    def below(self, node: int) -> list[int]:
        """A node and all below it."""
        if self.pair[node] == LEAF:
            return [node]
        return [node, *self.below(2 * self.pair[node]), *self.below(2 * self.pair[node] + 1)]

    def above(self, node: int) -> list[int]:
        """All above a node."""
        return [self.parent[node >> 1], *self.above(self.parent[node >> 1])] if node else []

    def moved(self, node: int, place: int) -> HostTree:
        """Another tree, in which a node has been put beside another one."""
        other = copy(self)
        other.pair, other.box, other.parent = self.pair.copy(), self.box.copy(), self.parent.copy()
        parent = self.parent[node >> 1]
        for source, to in ((node ^ 1, parent), (place, node ^ 1)):
            other.pair[to], other.box[to] = other.pair[source], other.box[source]
            if other.pair[to] != LEAF:
                other.parent[other.pair[to]] = to
        other.pair[place] = node >> 1
        other.parent[node >> 1] = place
        return other


def test_places_are_the_best_of_all():
    """Every node tries every place, each tree that comes of it is measured anew."""
    work = binary_of(unequal(40))
    places, tree = work.search(), HostTree(work)
    gain, place = places.gain.numpy(), places.place.numpy()
    before, gaining = tree.area(), 0
    for node in range(2, 2 * work.end):
        forbidden = {1, node ^ 1, *tree.below(node), *tree.above(node)}
        gains = {to: before - tree.moved(node, to).area() for to in range(2, 2 * work.end) if to not in forbidden}
        best = max(gains.values(), default=0.0)
        assert gain[node] == pytest.approx(max(best, 0.0), abs=1e-5 * before)
        if gain[node] > 0.0:
            gaining += 1
            assert gains[place[node]] == pytest.approx(best, abs=1e-5 * before)
    assert gaining > 3


def test_every_move_gains():
    """The first mover gains what its search promised; whoever moves later, the sum never grows."""
    work = binary_of(unequal(900))
    places, area = work.search(), HostTree(work).area()
    gain = places.gain.numpy()
    alone = places.gain.numpy().copy()
    alone[np.arange(len(alone)) != np.argmax(gain)] = 0.0
    places.gain.assign(alone)
    assert work.move(places) == 1
    assert HostTree(work).area() == pytest.approx(area - gain.max(), rel=1e-5)
    movers = []
    while not movers or movers[-1]:
        before = HostTree(work).area()
        movers.append(work.move(work.search()))
        assert HostTree(work).area() <= before * (1.0 - 1e-9 if movers[-1] else 1.0)
    assert movers[0] > 20
    assert HostTree(work).area() < 0.97 * area


def test_boxes_and_heights_follow():
    """After a round, boxes are the exact unions of their leaves' and heights are right."""
    work = binary_of(unequal(900))
    assert work.move(work.search()) > 20
    tree, height = HostTree(work), work.links.height.numpy()

    def visit(node: int) -> tuple[np.ndarray, int]:
        if tree.pair[node] == LEAF:
            box, levels = tree.box[node], 0
        else:
            assert tree.parent[tree.pair[node]] == work.links.parent.numpy()[tree.pair[node]] == node
            (a, m), (b, n) = (visit(2 * tree.pair[node] + side) for side in range(2))
            box, levels = np.minimum(a, b), 1 + max(m, n)
        np.testing.assert_array_equal(tree.box[node], box)
        assert height[node] == levels
        return box, levels

    visit(0)


@pytest.mark.parametrize("count", [1, 5, 9, 70])
def test_small_trees(count):
    mesh = unequal(count)
    tree, config = build(mesh, width=WIDTH, reinsertion=ROUNDS)
    check(tree, mesh.vertices, mesh.faces, config)


def test_deep_and_flat_trees():
    """Chains as deep as a tree may be, triangles that are one point, and areas that are too large for a float."""
    chain = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]]) * 2.0 ** np.arange(-60, 60)[:, None, None]
    for corners in (chain, np.repeat(chain, 3, axis=0), np.ones((90, 3, 3)), 1e19 * chain[:100]):
        mesh = mesh_of(corners)
        tree, config = build(mesh, width=2, bins=2, max_leaf_triangles=1, reinsertion=ROUNDS)
        check(tree, mesh.vertices, mesh.faces, config)
        assert tree.depth <= MAX_WIDE_DEPTH


@pytest.mark.parametrize("builder", ["binned", "sweep"])
def test_the_atrium_gets_cheaper(builder):
    mesh, costs = atrium(), []
    for rounds in (0, ROUNDS):
        tree, config = build(mesh, builder, width=WIDTH, reinsertion=rounds)
        check(tree, mesh.vertices, mesh.faces, config)
        costs.append(bvh_statistics(tree, mesh.triangle_count, config.cost).sah_cost)
        assert ("reinsertion" in tree.stats.seconds) == (rounds > 0)
    assert costs[1] < 0.96 * costs[0]


def test_what_gains_nothing_stays_as_it_is():
    """A tree whose nodes have nowhere better to go has the boxes and leaves of one that was built without."""
    mesh = wrt.scenes.build("teapot", level=12)
    plain, tried = (unpack(build(mesh, width=16, reinsertion=rounds)[0]) for rounds in (0, ROUNDS))
    for name in ("child", "low", "high"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(tried, name))


def test_threads_do_not_show():
    trees = []
    for threads in (1, 3):
        with use_threads(threads):
            trees.append(build(atrium(), width=WIDTH, reinsertion=ROUNDS)[0])
    assert_same_tree(*trees)


def test_hits_are_the_same():
    mesh = atrium()
    random = np.random.default_rng(1)
    origins, directions = random.uniform(*mesh.bounds, (1000, 3)), random.normal(size=(1000, 3))
    plain, moved = (wrt.Scene(mesh, wrt.Bvh(reinsertion=rounds), device="cpu") for rounds in (0, ROUNDS))
    one, other = (scene.intersect(origins, directions) for scene in (plain, moved))
    assert one.is_hit.sum() > 300
    np.testing.assert_array_equal(one.t, other.t)
    np.testing.assert_array_equal(one.primitive_id, other.primitive_id)
    assert (plain.tree.child.numpy().shape != moved.tree.child.numpy().shape) or (
        plain.tree.primitive.numpy() != moved.tree.primitive.numpy()
    ).any()


@pytest.mark.parametrize(
    ("rounds", "error", "words"),
    [(-1, ValueError, "from 0 to 1000"), (1001, ValueError, "from 0 to 1000")]
    + [(rounds, TypeError, "must be an int") for rounds in (2.0, True)],
)
def test_rounds_must_be_a_number_in_range(rounds, error, words):
    with pytest.raises(error, match=f"reinsertion .*{words}"):
        wrt.Bvh(reinsertion=rounds)
