"""The viewer's trees on the host: the way of a ray, the boxes of levels, and their lines."""

import numpy as np
import pytest

import wrt
from wrt import scenes
from wrt.viewer.trees.area_boxes import octree_boxes, region_corners
from wrt.viewer.trees.box_lines import box_corners, box_edges
from wrt.viewer.trees.instance_walk import upper_tree
from wrt.viewer.trees.ray_way import walk
from wrt.viewer.trees.tree_levels import MEASURES, tree_boxes


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
    cloth = scenes.waving_cloth(frames=2)
    scene = wrt.moving.FuzzyScene(cloth.frames, cloth.faces, device="cpu")
    with pytest.raises(ValueError, match="many trees"):
        walk(scene.state, (0, 0, 9), (0, 0, -1))


@pytest.mark.parametrize("kind", ["bvh", "kdtree"])
def test_way_through_instances(kind):
    """Both levels: the same hit as the kernel's, and as many boxes and tests; instances lie across one another."""
    mesh, rng = scenes.build("teapot", level=4), np.random.default_rng(5)
    placed = [wrt.Instance(mesh)]
    for _ in range(5):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.4, 1.5, 3)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn, rng.uniform(-4.0, 4.0, 3)
        placed.append(wrt.Instance(mesh, matrix))
    placed.append(wrt.Instance(mesh, mask=0))  # seen by no ray
    scene = wrt.Scene(placed, kind, device="cpu")
    camera = wrt.PinholeCamera.framing(scene, 20, 15)
    rays = camera.rays()
    hits = scene.intersect(rays, traversal="single", counters=kind == "bvh")
    origin, directions, differing = rays.origins.reshape(3), rays.directions.reshape(-1, 3), 0
    for number, direction in enumerate(directions):
        visits = walk(scene.state, origin, direction)
        found = [visit for visit in visits if visit.hit >= 0]
        assert (found[-1].hit if found else -1) == hits.primitive_id.ravel()[number]
        assert (found[-1].instance if found else -1) == hits.instance_id.ravel()[number]
        if kind == "bvh":
            counted = (
                sum(not visit.is_leaf for visit in visits),
                sum(visit.is_leaf and not visit.is_instance for visit in visits),
                sum(len(visit.triangles) for visit in visits),
            )
            differing += counted != tuple(hits.counters[name].ravel()[number] for name in ("nodes", "leaves", "triangles"))
    assert hits.is_hit.sum() > 50
    upper = tree_boxes(upper_tree(scene.state))
    assert upper.triangles[upper.is_leaf].tolist() == [1] * len(placed)
    assert np.isfinite(upper.measure("empty space")).all()
    assert differing <= 6  # of 300: boxes that a ray touches within rounding
    boxes = [visit for visit in visits if visit.is_instance]
    assert all(visit.triangles.size == 0 for visit in boxes)


def test_boxes_below_an_instance_lie_where_it_is():
    """The triangles of a leaf lie in its box, turned as the instance is; and the ray meets the box at its entry."""
    mesh = scenes.build("teapot", level=4)
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    matrix[:3, 3] = 3.0, -2.0, 1.0
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, matrix)], device="cpu")
    target = (matrix @ (*mesh.bounds.mean(axis=0), 1.0))[:3]
    direction = np.array([0.3, -0.2, -1.0])
    visits = walk(scene.state, target - 9.0 * direction, direction)
    leaves = [visit for visit in visits if visit.instance == 1 and len(visit.triangles)]
    moved = mesh.transformed(matrix)
    assert leaves
    for visit in leaves:
        low, edges = visit.corners[0], visit.corners[[1, 2, 4]] - visit.corners[0]
        points = moved.vertices[moved.faces[visit.triangles]].reshape(-1, 3)
        shares = (points - low) @ edges.T / np.maximum((edges**2).sum(axis=1), 1e-12)
        assert shares.min() > -1e-3
        assert shares.max() < 1.0 + 1e-3
        met = (target - 9.0 * direction + visit.entry * direction - low) @ edges.T / np.maximum((edges**2).sum(axis=1), 1e-12)
        assert met.min() > -1e-3
        assert met.max() < 1.0 + 1e-3


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
    edges = box_edges(box_corners(np.zeros((1, 3)), np.array([[1.0, 2.0, 3.0]])))
    assert edges.shape == (12, 2, 3)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=-1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat([1.0, 2.0, 3.0], 4))


def test_octree_of_areas():
    """Cells cover the root without gaps, and a leaf lists the areas whose regions touch it: all those of points in it."""
    mesh = scenes.build("teapot", level=4)
    middle = mesh.bounds.mean(axis=0)
    view = {"direction": (0.0, 0.1, -1.0), "fov": (40.0, 30.0), "near": 0.1, "far": 5.0}
    lamps = [wrt.known_rays.PointInfluenceArea(position=tuple(middle + np.array((x, 0.3, 3.0))), **view) for x in (-1.0, 1.5)]
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=lamps, top_level="octree", depth=4), device="cpu")
    trees = scene.state.area_trees
    boxes = octree_boxes(trees.top)
    assert len(boxes.low) == trees.top.cells
    volume = np.prod(boxes.high - boxes.low, axis=1)
    assert volume[boxes.is_leaf].sum() == pytest.approx(volume[0])
    points = np.random.default_rng(4).uniform(boxes.low[0], boxes.high[0], (200, 3))
    listed = trees.top.candidates(points + scene.center).sum(axis=1)
    for point, count in zip(points, listed, strict=True):
        (leaf,) = np.flatnonzero(boxes.is_leaf & (point >= boxes.low).all(axis=1) & (point < boxes.high).all(axis=1))
        assert boxes.triangles[leaf] == count
    corners = region_corners(scene)
    assert corners.shape == (len(trees), 8, 3)
    for area, own in zip(trees.areas, corners, strict=True):
        assert (np.linalg.norm(own[:4] - area.position, axis=1) < 0.2).all()  # the near end is at the lamp
    array = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=lamps, top_level="array"), device="cpu").state.area_trees.top
    assert octree_boxes(array).triangles.tolist() == [len(trees)]
