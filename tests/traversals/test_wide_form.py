"""Kd-trees in nodes of W children: what the form holds, its hits, and when a scene makes one."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.phases.binary_tree import empty_tree
from wrt.builders.convert import wide_kdtree
from wrt.builders.convert.wide_kdtree import MAX_UNDIVIDED_BLOCKS, to_wide_bvh
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import TriangleBoxes, triangle_boxes
from wrt.engine.facts.wide_trees import wide_tree
from wrt.kernels.layout.kdtree_nodes import LEAF
from wrt.kernels.runtime.launch import use_threads

pytestmark = pytest.mark.width

WIDTH = 4
CONFIG = BvhConfig(SurfaceAreaCost(width=WIDTH))
BINNED = wrt.KdTree(builder="binned")

TREES = {
    "default": wrt.KdTree(builder="binned", width=WIDTH),
    "fine": wrt.KdTree(builder="binned", width=WIDTH, block_cost=20.0),
    "clipped": wrt.KdTree(builder="binned", split_clipping=True),
    "one leaf": wrt.KdTree(builder="binned", width=WIDTH, max_depth=0),
    "width 1": wrt.KdTree(builder="binned", width=1, block_cost=0.3),
}


@pytest.fixture(scope="module")
def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=4)


def boxes_of(scene: wrt.Scene) -> TriangleBoxes:
    return triangle_boxes(scene.state.device_mesh.vertices, scene.state.device_mesh.faces, scene.center)


def lists(form: Bvh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of all leaves of a form, for each reference: its triangle, the number of its leaf, and the leaf's box."""
    child, bounds = form.child.numpy(), form.bounds.numpy().reshape(-1, 6, form.width)
    lanes = np.flatnonzero((child < 0) & (~child & 63 > 0))
    sizes, first = ~child[lanes] & 63, (~child[lanes] >> 6) * form.width
    slots = np.repeat(first - np.cumsum(sizes) + sizes, sizes) + np.arange(sizes.sum())
    box = bounds[lanes // form.width, :, lanes % form.width]
    number = np.repeat(np.arange(len(lanes)), sizes)
    return form.primitive.numpy()[slots], number, box[:, :3], box[:, 3:]


@pytest.mark.parametrize("undivided_blocks", [0, 3, MAX_UNDIVIDED_BLOCKS])
@pytest.mark.parametrize("name", TREES)
def test_boxes_hold_what_is_below(teapot, name, undivided_blocks):
    scene = wrt.Scene(teapot, TREES[name], device="cpu")
    triangles = boxes_of(scene)
    form = to_wide_bvh(scene.tree, triangles, CONFIG, undivided_blocks)
    triangle, leaf, low, high = lists(form)
    assert set(triangle) == set(range(teapot.triangle_count))
    assert len(np.unique(np.stack([leaf, triangle]), axis=1).T) == len(triangle)  # a leaf lists nothing twice
    of_low, of_high = triangles.boxes.low.numpy().T[triangle], triangles.boxes.high.numpy().T[triangle]
    assert ((of_low <= high[leaf]) & (low[leaf] <= of_high)).all()
    child, bounds = form.child.numpy().reshape(-1, WIDTH), form.bounds.numpy().reshape(-1, 6, WIDTH)
    node, lane = np.nonzero(child >= 0)
    below = bounds[child[node, lane]]
    np.testing.assert_array_equal(below[:, :3].min(axis=2), bounds[node, :3, lane])
    np.testing.assert_array_equal(below[:, 3:].max(axis=2), bounds[node, 3:, lane])
    assert sorted(child[node, lane]) == list(range(1, len(child)))


def test_the_form_does_not_depend_on_what_is_in_memory(monkeypatch):
    """Nodes are divided by their share of the root, whose box must be known before it is computed from theirs."""
    scene = wrt.Scene(wrt.scenes.build("cornell_box"), TREES["default"], device="cpu")
    forms = []
    for value in (0.0, 1e18):

        def filled(triangles: int, device: wp.Device, value: float = value):
            tree = empty_tree(triangles, device)
            tree.box.assign(np.tile(np.repeat(np.float32([value, -2 * value]), 4), 2 * triangles))
            return tree

        monkeypatch.setattr(wide_kdtree, "empty_tree", filled)
        forms.append(to_wide_bvh(scene.tree, boxes_of(scene), CONFIG))
    for name in ("bounds", "child", "primitive"):
        np.testing.assert_array_equal(getattr(forms[0], name).numpy(), getattr(forms[1], name).numpy())


def test_boxes_lie_in_cells(teapot):
    """Followed to its leaves, the tree's cells bound the boxes: each is in that of a leaf which lists all its triangles."""
    scene = wrt.Scene(teapot, wrt.KdTree(builder="binned", width=WIDTH, block_cost=20.0), device="cpu")
    config = BvhConfig(SurfaceAreaCost(width=WIDTH, block=20.0), max_leaf_triangles=WIDTH)
    triangle, leaf, low, high = lists(to_wide_bvh(scene.tree, boxes_of(scene), config, undivided_blocks=0))
    flat, primitive = unpack(scene.tree), scene.tree.primitive.numpy()
    cells = [
        (flat.low[at], flat.high[at], {*primitive[flat.first_block[at] * WIDTH :][: flat.triangles[at]].tolist()})
        for at in np.flatnonzero(flat.is_leaf & (flat.triangles > 0))
    ]
    for number in range(len(low)):
        own = {*triangle[leaf == number].tolist()}
        assert any(own <= listed and (a <= low[number]).all() and (high[number] <= b).all() for a, b, listed in cells)


def test_what_is_listed_together_is_listed_once(teapot):
    scene = wrt.Scene(teapot, wrt.KdTree(builder="binned", width=WIDTH, block_cost=20.0), device="cpu")
    few = wrt.Scene(
        wrt.scenes.build("random_triangles", count=40, size=0.15),
        wrt.KdTree(builder="binned", width=WIDTH, block_cost=20.0),
        device="cpu",
    )
    references = [
        len(lists(to_wide_bvh(scene.tree, boxes_of(scene), CONFIG, undivided_blocks))[0]) for undivided_blocks in (0, 8, 32)
    ]
    assert references[0] == unpack(scene.tree).triangles.sum()
    assert references[0] > references[1] > references[2] > teapot.triangle_count
    assert 40 < unpack(few.tree).triangles.sum() <= MAX_UNDIVIDED_BLOCKS * WIDTH
    assert sorted(lists(to_wide_bvh(few.tree, boxes_of(few), CONFIG))[0]) == list(range(40))


def test_more_together_than_there_is_room_for(teapot):
    scene = wrt.Scene(teapot, BINNED, device="cpu")
    with pytest.raises(ValueError, match="undivided_blocks is 1000; it must be from 0 to 128"):
        to_wide_bvh(scene.tree, boxes_of(scene), BvhConfig(SurfaceAreaCost(width=8)), 1000)


def test_threads_do_not_show(teapot):
    scene = wrt.Scene(teapot, wrt.KdTree(builder="binned", width=WIDTH), device="cpu")
    forms = []
    for threads in (1, 3):
        with use_threads(threads):
            forms.append(to_wide_bvh(scene.tree, boxes_of(scene), CONFIG))
    for name in ("bounds", "child", "primitive"):
        np.testing.assert_array_equal(*(getattr(form, name).numpy() for form in forms))


def test_no_triangles():
    """Of leaves that are all empty; no mesh gives such a tree."""
    mesh = same_triangle(1)
    scene = wrt.Scene(mesh, BINNED, device="cpu")
    scene.tree.nodes.assign(np.array([[0, LEAF]] * len(scene.tree.nodes), dtype=np.int32))
    assert not scene.intersect(*mixed_rays(mesh, 2000), traversal="wide_stream").is_hit.any()


def same_triangle(count: int) -> wrt.TriangleMesh:
    return wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]], np.tile([0, 1, 2], (count, 1)))


@pytest.mark.parametrize(
    "mesh",
    [same_triangle(1), same_triangle(700), wrt.scenes.build("random_triangles", count=900, size=0.9, seed=3)],
    ids=["one", "all the same", "crossing"],
)
def test_hits_equal_brute_force(mesh):
    """Leaves from one triangle to hundreds, boxes without a volume, and triangles that are nearly everywhere."""
    scene = wrt.Scene(mesh, BINNED, device="cpu")
    origins, directions = mixed_rays(mesh, 3000)
    expected = scene.intersect(origins, directions, traversal="brute")
    assert expected.is_hit.mean() > 0.05
    assert_same_hits(scene.intersect(origins, directions, traversal="wide_stream"), expected)


def test_lists_of_clipped_triangles(teapot):
    scene = wrt.Scene(teapot, TREES["clipped"], device="cpu")
    origins, directions = mixed_rays(teapot, 3000)
    hits = scene.intersect(origins, directions, traversal="wide_stream")
    assert_same_hits(hits, scene.intersect(origins, directions, traversal="brute"))


def test_nodes_have_two_children_at_least(teapot):
    scene = wrt.Scene(teapot, TREES["width 1"], device="cpu")
    plan = scene.explain(*mixed_rays(teapot, 3000), traversal="wide_packet")
    assert (scene.state.width, plan.width, plan.packet, wide_tree(scene.state).width) == (1, 2, 32, 2)


def test_when_there_is_one():
    """Made when rays have come that pay for it, at once or by and by, then kept for few; never for a tree that is lazy."""
    mesh = wrt.scenes.build("random_triangles", count=3000, size=0.1)
    rng = np.random.default_rng(0)
    origins, directions = rng.uniform(*mesh.bounds, (3000, 3)), rng.normal(size=(3000, 3))
    many, some = wrt.Rays(origins, directions), wrt.Rays(origins[:1200], directions[:1200])
    scene, lazy = (wrt.Scene(mesh, wrt.KdTree(builder=builder), device="cpu") for builder in ("binned", "lazy"))
    assert [scene.explain(rays).traversal for rays in (some, many)] == ["lockstep", "wide_stream"]
    assert scene.state.cache.wide is None
    by_and_by = wrt.Scene(mesh, BINNED, device="cpu")
    for traversal in ("lockstep", "lockstep", "wide_stream"):
        assert by_and_by.explain(some).traversal == traversal
        by_and_by.intersect(some, traversal="brute")
    by_and_by.update(0, vertices=mesh.vertices)
    assert by_and_by.explain(some).traversal == "lockstep"
    hits = scene.intersect(many)
    assert hits.plan.traversal == "wide_stream"
    assert scene.explain(some).traversal == "wide_stream"
    assert scene.explain(some.origins[0], some.directions[:1]).traversal == "single"
    assert lazy.explain(many).traversal == "lockstep"
    with pytest.raises(ValueError, match="'wide_packet' walks the wide form of a complete kd-tree"):
        lazy.intersect(many, traversal="wide_packet")
    with pytest.raises(ValueError, match="does not answer the query 'count'"):
        scene.count(many, traversal="wide_stream")


def test_moved_triangles_have_another(teapot):
    scene = wrt.Scene(teapot, BINNED, device="cpu")
    origins, directions = mixed_rays(teapot, 3000)
    scene.intersect(origins, directions, traversal="wide_stream")
    form = wide_tree(scene.state)
    assert wide_tree(scene.state) is form
    scene.update(0, vertices=teapot.vertices * [1.0, 1.3, 0.8])
    assert scene.state.cache.wide is None
    hits = scene.intersect(origins, directions, traversal="wide_stream")
    assert wide_tree(scene.state) is not form
    assert_same_hits(hits, scene.intersect(origins, directions, traversal="brute"))
    records = scene.state.record_bytes
    scene.state = scene.state.over(wrt.Scene(scene.meshes, BINNED, device="cpu").tree)
    assert_same_hits(scene.intersect(origins, directions, traversal="wide_stream"), hits)
    assert 0 < scene.state.record_bytes < 1.3 * records  # those of the form before are let go
    assert wp.get_device("cpu") == wide_tree(scene.state).child.device
