"""Reinsertion by all nodes at once: gains against a float64 search of all places, moves that leave a tree, any mesh."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.built_bvhs import arrays_of, assert_same_tree, build, check, mesh_of
from support.hits import assert_same_hits, brute_force, mixed_rays

import wrt
from wrt.builders.bvh import hploc
from wrt.builders.bvh.bvh_statistics import bvh_statistics, half_area
from wrt.builders.bvh.phases.cluster_merging import MergedTree, empty_merged_tree, merge, sort_by_codes
from wrt.builders.bvh.phases.parallel_reinsertion import (
    Moves,
    choose_moves,
    empty_moves,
    find_moves,
    move_nodes,
    rebuild_tops,
    refit_nodes,
    reinsert,
)
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.runtime.workspace import Workspace

CPU = wp.get_device("cpu")

SMALL = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]], dtype=np.float64)


def unequal(count: int, seed: int = 3) -> wrt.TriangleMesh:
    """Triangles of all sizes, which lie across each other."""
    random = np.random.default_rng(seed)
    sizes = 2.0 ** random.uniform(-8.0, 0.0, (count, 1, 1))
    return mesh_of(random.uniform(-1.0, 1.0, (count, 1, 3)) + sizes * random.normal(size=(count, 3, 3)))


def even(count: int) -> wrt.TriangleMesh:
    """Small triangles all over a cube."""
    random = np.random.default_rng(count)
    return mesh_of(random.random((count, 1, 3)) + 0.02 * random.random((count, 3, 3)))


def merged_of(mesh: wrt.TriangleMesh, by_area: bool = True) -> MergedTree:
    """The binary tree of a mesh, by merging."""
    boxes, tree = triangle_boxes(*arrays_of(mesh)), empty_merged_tree(mesh.triangle_count, CPU)
    sort_by_codes(boxes, tree)
    merge(boxes, tree, by_area)
    return tree


def search(tree: MergedTree, count: int) -> Moves:
    """The moves that all nodes ask for."""
    moves = empty_moves(count, CPU)
    moves.owner.zero_()
    moves.arrived.zero_()
    launch(find_moves, 2 * count, [count, 0, 1, tree, moves], device=CPU)
    return moves


class HostTree:
    """A merged tree on the host, in float64. Nodes have the numbers that they have there."""

    def __init__(self, tree: MergedTree, count: int) -> None:
        words = tree.box.numpy().reshape(-1, 8)[: 2 * count]
        self.count, self.root = count, int(tree.root.numpy()[0])
        self.box = words[:, [0, 1, 2, 4, 5, 6]]
        self.child = dict(enumerate(words.view(np.int32)[:, [3, 7]].tolist()))
        self.link, self.size = tree.parent.numpy(), tree.size.numpy()
        self.parent = {child: node for node in self.nodes() if node >= count for child in self.child[node]}

    def nodes(self, top: int | None = None) -> list[int]:
        """A node, or the root, and all below."""
        found = [self.root if top is None else top]
        for node in found:
            if node >= self.count:
                found += self.child[node]
            assert len(found) < 2 * self.count  # a circle would not end
        return found

    def above(self, node: int) -> list[int]:
        """All above a node."""
        found = []
        while node in self.parent:
            node = self.parent[node]
            found.append(node)
        return found

    def area(self) -> float:
        """Sum of the areas of all inner nodes, their boxes put together from the triangles'."""
        total, boxes = 0.0, {}
        for node in reversed(self.nodes()):
            if node < self.count:
                boxes[node] = self.box[node].astype(float)
            else:
                boxes[node] = np.minimum(*(boxes[child] for child in self.child[node]))
                total += half_area(boxes[node][:3], -boxes[node][3:])
        return total

    def area_moved(self, node: int, beside: int) -> float:
        """The sum after a node has been put beside another one."""
        child, root = dict(self.child), self.root
        parent = self.parent[node]
        (sibling,) = (other for other in child[parent] if other != node)

        def put(new: int, old: int, above: int | None) -> None:
            if above is None:
                self.root = new
            else:
                self.child[above] = [new if one == old else one for one in self.child[above]]

        put(sibling, parent, self.parent.get(parent))
        put(parent, beside, self.parent.get(beside) if self.parent.get(beside) != parent else self.parent.get(parent))
        self.child[parent] = [node, beside]
        found, self.child, self.root = self.area(), child, root
        return found

    def check(self) -> None:
        """Links, sizes and boxes are right, and every triangle is there once."""
        nodes = self.nodes()
        assert sorted(nodes) == [*range(self.count), *range(self.count + 1, 2 * self.count)]
        assert self.link[self.root] == -1
        sizes = {}
        for node in reversed(nodes):
            sizes[node] = 1 if node < self.count else sum(sizes[child] for child in self.child[node])
            if node >= self.count:
                assert self.size[node - self.count] == sizes[node]
                for side, child in enumerate(self.child[node]):
                    assert self.link[child] == 2 * (node - self.count) + side
                np.testing.assert_array_equal(self.box[node], np.minimum(*(self.box[c] for c in self.child[node])))


def gains_of(moves: Moves) -> np.ndarray:
    """(2 n,) the gains of moves; 0 of none."""
    gain = (moves.key.numpy() >> np.uint64(32)).astype(np.uint32).view(np.float32)
    return np.where(moves.place.numpy()[:, 0] >= 0, gain, 0.0)


def test_places_are_the_best_of_all():
    """Every node tries every place; each tree that comes of it is measured anew. In a poor tree many gain."""
    count = 24
    tree = merged_of(unequal(count), by_area=False)
    moves, host = search(tree, count), HostTree(tree, count)
    gain, place = gains_of(moves), moves.place.numpy()
    before, upward, gaining = host.area(), 0, 0
    for node in set(host.nodes()) - {host.root}:
        parent = host.parent[node]
        forbidden = {*host.nodes(node), *host.child[parent], parent}
        gains = {to: before - host.area_moved(node, to) for to in set(host.nodes()) - forbidden}
        best = max(gains.values(), default=0.0)
        assert gain[node] == pytest.approx(max(best, 0.0), abs=1e-5 * before)
        if gain[node] > 0.0:
            gaining += 1
            beside, pivot = place[node]
            upward += beside in host.above(node)
            assert gains[beside] == pytest.approx(best, abs=1e-5 * before)
            common = [one for one in host.above(beside) if one in host.above(node)]
            assert pivot == (common[0] if common else -1)
    assert gaining > 5
    assert upward > 0


def test_a_move_gains_what_it_promises():
    count = 300
    tree = merged_of(unequal(count))
    moves, before = search(tree, count), HostTree(tree, count).area()
    gain, place = gains_of(moves), moves.place.numpy()
    place[np.arange(2 * count) != np.argmax(gain), 0] = -1
    moves.place.assign(place)
    launch(move_nodes, 2 * count, [count, 0, 1, tree, moves], device=CPU)
    launch(refit_nodes, count, [count, tree, moves], device=CPU)
    after = HostTree(tree, count)
    after.check()
    assert after.area() == pytest.approx(before - gain.max(), rel=1e-5)
    assert not moves.owner.numpy().any()


def test_rounds_leave_a_cheaper_tree():
    """Moves that share no link are made together, and most of the gain is that of the first rounds."""
    count = 3000
    tree, work = merged_of(unequal(count)), Workspace(CPU)
    areas = [HostTree(tree, count).area()]
    for _ in range(4):
        reinsert(work, tree, count, 1)
        host = HostTree(tree, count)
        host.check()
        areas.append(host.area())
    assert areas[4] < areas[2] < areas[1] < 0.99 * areas[0]


def test_no_two_nodes_move_below_each_other():
    """Of moves that would make a circle together, that of the greater key is made, by whatever way they are asked for."""
    count = 8
    tree = merged_of(mesh_of(np.array([SMALL + np.array([10.0 * i, 0.0, 0.0]) for i in range(count)])))
    host = HostTree(tree, count)
    one, other = host.child[host.root]  # of four triangles each
    for first, second in ((host.child[one][0], host.child[other][0]), (host.child[other][1], host.child[one][0])):
        moves = empty_moves(count, CPU)
        place, key = np.full((2 * count, 2), -1, dtype=np.int32), np.zeros(2 * count, dtype=np.uint64)
        owner = key.copy()
        for node, beside, gain in ((first, host.child[second][0], 2), (second, host.child[first][1], 1)):
            place[node], key[node] = (beside, host.root), gain << 32 | node
            (sibling,) = (c for c in host.child[host.parent[node]] if c != node)
            owner[[node, host.parent[node], sibling, beside]] = key[node]
        for name, values in (("place", place), ("key", key), ("owner", owner)):
            getattr(moves, name).assign(values)
        moves.arrived.zero_()
        launch(choose_moves, 2 * count, [count, 0, 1, tree, moves], device=CPU)
        assert np.flatnonzero(moves.place.numpy()[:, 0] >= 0).tolist() == [first]


@pytest.mark.parametrize("leaf", [1, 2])
def test_trees_of_any_mesh_are_whole_and_not_dearer(leaf):
    """One triangle, a few, many that are one, flat ones, points, chains, and areas that are too large for a float."""
    chain = SMALL * 2.0 ** np.arange(-60, 60)[:, None, None]
    random = np.random.default_rng(5).random((200, 3, 3))
    meshes = [unequal(count) for count in (1, 2, 3, 4, 9, 700)]
    meshes += [mesh_of(c) for c in (np.repeat(SMALL[None], 1000, 0), np.ones((90, 3, 3)), 1e19 * random, random * [1, 0, 1])]
    for mesh in [*meshes, mesh_of(chain), mesh_of(1e19 * chain[:100]), mesh_of(np.repeat(chain[:40], 3, axis=0))]:
        costs = []
        for rounds in (0, 3):
            tree, config = build(mesh, "hploc", 2, max_leaf_triangles=leaf, reinsertion=rounds)
            check(tree, mesh.vertices, mesh.faces, config)
            costs.append(bvh_statistics(tree, mesh.triangle_count, config.cost).sah_cost)
        assert not costs[1] > costs[0] * (1.00001 if leaf == 1 else 1.05)  # which two share a leaf, moves do not see


def test_equal_triangles_stay_where_they_are():
    """No place is better, and no upper levels are."""
    mesh = mesh_of(np.repeat(SMALL[None], 500, axis=0))
    assert_same_tree(*(build(mesh, "hploc", 2, max_leaf_triangles=2, reinsertion=rounds)[0] for rounds in (0, 5)))


@pytest.mark.parametrize("count", [2, 3, 50, 128])
def test_upper_levels_are_those_of_a_sweep(count):
    """Every node is divided by the best plane of all axes, in float64; the subtrees of few triangles are the triangles."""
    tree, moves = merged_of(even(count), by_area=False), empty_moves(count, CPU)
    moves.owner.zero_()
    moves.arrived.zero_()
    launch(rebuild_tops, 1, [count, tree, moves], device=CPU)
    launch(refit_nodes, count, [count, tree, moves], device=CPU)
    host = HostTree(tree, count)
    host.check()

    def cost(sides) -> float:
        boxes = [host.box[list(side)].astype(float).min(axis=0) for side in sides]
        return sum(len(side) * half_area(box[:3], -box[3:]) for side, box in zip(sides, boxes, strict=True))

    for node in host.nodes():
        if node >= count:
            sides = [[one for one in host.nodes(child) if one < count] for child in host.child[node]]
            held = np.concatenate(sides)
            best = np.inf
            for axis in range(3):
                order = held[np.argsort(host.box[held, axis] - host.box[held, 3 + axis], kind="stable")]
                best = min(best, *(cost((order[:k], order[k:])) for k in range(1, len(order))))
            assert cost(sides) <= best * (1.0 + 1e-4)


def test_upper_levels_end_at_subtrees():
    """What is below stays as it is: 128 subtrees of the tree of before, with 127 nodes above."""
    count = 3000
    tree = merged_of(even(count))
    before, moves = HostTree(tree, count), empty_moves(count, CPU)
    moves.owner.zero_()
    moves.arrived.zero_()
    launch(rebuild_tops, 1, [count, tree, moves], device=CPU)
    launch(refit_nodes, count, [count, tree, moves], device=CPU)
    after = HostTree(tree, count)
    after.check()
    held = [
        {node: frozenset(one for one in host.nodes(node) if one < count) for node in host.nodes()} for host in (before, after)
    ]
    new = set(held[1].values()) - set(held[0].values())
    assert 60 < len(new) <= 126
    assert after.area() < before.area()


def test_a_tree_that_gets_too_deep_is_made_without(monkeypatch):
    """The next one is without reinsertion, and only the last one by neighbourhood alone."""
    corners = SMALL * 2.0 ** np.arange(-60, 60)[:, None, None]
    ways, rounds = [], []
    original, moving = hploc.merge, hploc.reinsert
    monkeypatch.setattr(hploc, "merge", lambda *given: ways.append(given[2]) or original(*given))
    monkeypatch.setattr(hploc, "reinsert", lambda *given: rounds.append(given[3]) or moving(*given))
    for width in (2, 16):
        tree, config = build(mesh_of(corners), "hploc", width, max_leaf_triangles=2, reinsertion=2)
        check(tree, mesh_of(corners).vertices, mesh_of(corners).faces, config)
    assert ways == [True, True, False] * 2
    assert rounds == [2, 2]


@pytest.mark.parametrize("width", [2, 8])
def test_threads_do_not_show(width):
    mesh = wrt.scenes.build("atrium", bays=(2, 1), detail=2)
    with use_threads(1):
        plain, expected = (build(mesh, "hploc", width, reinsertion=rounds)[0] for rounds in (0, 3))
    for threads in (2, 5, 2):
        with use_threads(threads):
            tree, config = build(mesh, "hploc", width, reinsertion=3)
            assert_same_tree(tree, expected)
    costs = [bvh_statistics(one, mesh.triangle_count, config.cost).sah_cost for one in (plain, expected)]
    assert costs[1] < 0.97 * costs[0]
    assert {"merging", "reinsertion", "layout"} < set(expected.stats.seconds)


def test_hits_are_those_of_brute_force():
    mesh = unequal(2000)
    scene = wrt.Scene(mesh, wrt.Bvh(builder="hploc", reinsertion=3), device="cpu")
    rays = wrt.Rays(*mixed_rays(mesh, 2000, seed=2))
    assert_same_hits(scene.intersect(rays), brute_force(scene, rays))
