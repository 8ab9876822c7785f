"""The viewer's trees on the host: the way of a ray, the boxes of levels, and their lines."""

import numpy as np
import pytest

import wrt
from wrt import scenes
from wrt.viewer.trees.box_lines import box_edges
from wrt.viewer.trees.tree_levels import MEASURES, tree_boxes
from wrt.viewer.trees.tree_walk import walk


@pytest.fixture(scope="module", params=["bvh", "kdtree"])
def scene(request):
    return wrt.Scene(scenes.build("teapot", level=4), request.param, device="cpu")


def test_way_is_that_of_the_kernel(scene):
    """The same hit, and as many inner nodes, leaves and triangle tests as the single-ray traversal counts."""
    rays = wrt.PinholeCamera(24, 18, **scenes.BUILTIN_SCENES["teapot"].camera).rays()
    hits = scene.intersect(rays, traversal="single", counters=True)
    origin, directions = rays.origins.reshape(3), rays.directions.reshape(-1, 3)
    differing = 0
    for number, direction in enumerate(directions):
        visits = walk(scene.state, origin, direction)
        found = [visit.hit for visit in visits if visit.hit >= 0]
        assert (found[-1] if found else -1) == hits.primitive_id.ravel()[number]
        entries = [visit.entry for visit in visits if visit.is_leaf]
        assert entries == sorted(entries) or scene.accelerator.kind == "bvh"
        counted = (
            sum(not visit.is_leaf for visit in visits),
            sum(visit.is_leaf for visit in visits),
            sum(len(visit.triangles) for visit in visits),
        )
        differing += counted != tuple(hits.counters[name].ravel()[number] for name in ("nodes", "leaves", "triangles"))
    assert differing <= 4  # of 432: boxes that a ray touches within rounding


def test_way_of_axis_parallel_rays(scene):
    """Directions with zeros divide by zero in every box."""
    low, high = scene.bounds
    for axis in range(3):
        for offset in (0.3137, 0.4713, 0.7129):  # not in the planes of symmetry, where several triangles tie
            origin = low + offset * (high - low)
            origin[axis] = high[axis] + 1.0
            direction = -np.eye(3)[axis]
            found = [visit.hit for visit in walk(scene.state, origin, direction) if visit.hit >= 0]
            assert (found[-1] if found else -1) == scene.intersect(origin, direction).primitive_id


def test_a_miss_visits_nothing(scene):
    assert walk(scene.state, scene.bounds[1] + 1.0, (1.0, 0.0, 0.0)) == []


def test_scenes_of_many_trees_are_refused():
    mesh = scenes.build("teapot", level=2)
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, np.diag([2.0, 2.0, 2.0, 1.0]))], device="cpu")
    with pytest.raises(ValueError, match="many trees"):
        walk(scene.state, (0, 0, 9), (0, 0, -1))


def test_boxes_are_those_of_the_tree(scene):
    boxes, figures = tree_boxes(scene.tree), scene.statistics().tree
    assert boxes.is_leaf.sum() == figures.leaves
    assert boxes.levels - 1 == figures.max_depth
    np.testing.assert_allclose(boxes.low[0] + scene.center, scene.bounds[0], atol=1e-5)
    least = scene.triangle_count
    assert boxes.triangles.sum() == (least if scene.accelerator.kind == "bvh" else figures.references)
    for name in MEASURES:
        values = boxes.measure(name)
        assert np.isfinite(values).all()
        assert (values >= 0.0).all()
    assert boxes.fill.max() <= 1.0
    assert boxes.empty_space.max() <= 1.0


def test_boxes_lie_in_those_above(scene):
    boxes = tree_boxes(scene.tree)
    assert (boxes.low >= boxes.low[0] - 1e-6).all()
    assert (boxes.high <= boxes.high[0] + 1e-6).all()


def test_a_level_with_leaves_above_holds_all_triangles(scene):
    boxes = tree_boxes(scene.tree)
    last = boxes.at_level(boxes.levels - 1, True, 10**9)
    assert boxes.triangles[last].sum() == boxes.triangles.sum()
    few = boxes.at_level(boxes.levels - 1, True, 3)
    assert len(few) == 3
    assert boxes.cost[few].min() >= np.sort(boxes.cost[last])[-3] - 1e-12


def test_overlap_of_siblings():
    """Two boxes of two unit cubes that share half of each."""
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = [[0, 3, 7], [0, 5, 7]]  # each spans the unit cube
    mesh = wrt.TriangleMesh(np.concatenate([cube, np.add(cube, (0.5, 0.0, 0.0))]), np.concatenate([faces, np.add(faces, 8)]))
    boxes = tree_boxes(wrt.Scene(mesh, wrt.Bvh(width=2, max_leaf_triangles=1), device="cpu").tree)
    leaves = boxes.is_leaf
    assert boxes.overlap[leaves].max() <= 1.0 + 1e-9
    assert boxes.overlap[leaves].max() > 0.4


def test_edges_of_a_box():
    edges = box_edges(np.zeros((1, 3)), np.array([[1.0, 2.0, 3.0]]))
    assert edges.shape == (12, 2, 3)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=-1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat([1.0, 2.0, 3.0], 4))
