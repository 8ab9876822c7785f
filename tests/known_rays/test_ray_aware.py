"""Trees of influence areas: no area is lost, every hit is that of brute force, whatever the rays and the top level."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.known_areas import areas_of, random_areas
from support.meshes import SCENES

import wrt
from wrt.builders.influence import area_octree as octree
from wrt.builders.influence.area_top_level import TopLevel, region_of
from wrt.builders.influence.regions import classify_boxes, contain_points
from wrt.engine.launch.area_trees import assign
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.influence.region_tests import DISJOINT
from wrt.kernels.influence.region_tests import Region as RegionStruct
from wrt.scene.scene import scene_of_state

MESHES = ("teapot", "random_triangles", "grid", "degenerate")


def affine_rays(mesh, count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Rays along those areas, forward and backward, from in and around their regions; some from the lamps themselves."""
    rng = np.random.default_rng(seed)
    low, high = mesh.bounds
    areas, size = areas_of(mesh), (high - low).max()
    origins = rng.uniform(low - 0.3 * size, high + 0.3 * size, (count, 3))
    kind = rng.integers(0, 4, count)
    poles = np.array([areas[k].position for k in (0, 1, 3)])[np.minimum(kind, 2)]
    directions = np.where((kind == 0)[:, None], [0, 0, -1], (origins - poles) / size) * rng.choice([-1.0, 1.0], (count, 1))
    from_pole = rng.random(count) < 0.1
    origins[from_pole & (kind > 0)] = poles[from_pole & (kind > 0)]
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count), 0]]
    on_vertex = rng.random(count) < 0.2  # starts, and ends of faces of the grid, on planes of the regions
    origins[on_vertex] = corners[on_vertex]
    return origins.astype(np.float32), directions.astype(np.float32)


def test_octree_loses_no_area():
    """Against all regions in float64: every area of a point is listed, and with depth fewer others are."""
    low, high = np.full(3, 10.0), np.full(3, 14.0)
    areas = random_areas(20, low, high)
    regions = [region_of(area, low, high) for area in areas]
    rng = np.random.default_rng(5)
    corners = np.concatenate([region.corners for region in regions])
    edges = corners[rng.integers(0, len(corners), 2000)] * 0.5 + corners[rng.integers(0, len(corners), 2000)] * 0.5
    points = np.concatenate([rng.uniform(low - 3, high + 3, (20000, 3)), corners, edges])
    inside = contain_points(regions, points)
    assert inside.any(axis=0).all()
    listed = []
    for depth in (0, 1, 3, 5):
        top = TopLevel(areas, regions, 1e-5, depth, 0.1, np.full(3, 12.0), wp.get_device("cpu"))
        candidates = top.candidates(points)
        assert (candidates | ~inside).all()
        assert top.cells <= (8 ** (depth + 1) - 1) // 7
        listed.append(candidates[:20000].sum() / inside[:20000].sum())
    assert listed[0] > listed[1] > listed[2] > listed[3]
    assert listed[3] < 2.5


def test_octree_in_slices_and_within_bounds(monkeypatch):
    """However few pairs are tested at a time, the octree is the same; one that outgrows the memory is refused."""
    low, high = np.full(3, 10.0), np.full(3, 14.0)
    structs = [region_of(area, low, high).struct(np.full(3, 12.0), 1e-5) for area in random_areas(30, low, high)]
    root = np.full(3, -9.0), np.full(3, 9.0)
    child, lists = octree.build_octree(structs, *root, 4)
    monkeypatch.setattr(octree, "SLICE_PAIRS", 100)
    again, same_lists = octree.build_octree(structs, *root, 4)
    np.testing.assert_array_equal(child, again)
    assert [one.tolist() for one in lists] == [one.tolist() for one in same_lists]
    shallow, its_lists = octree.build_octree(structs, *root, 3)
    assert len(shallow) < len(child)
    size = len(child) * octree.CELL_BYTES
    above = sum(its_lists[~word].nbytes for word in shallow[shallow < 0]) + sum(one.nbytes for one in its_lists)
    for bound in (size // 2, size + above):  # too many cells, and too many pairs in those of the last level
        monkeypatch.setattr(octree, "MAX_BYTES", bound)
        with pytest.raises(ValueError, match=r"octree over 30 influence areas .* pass depth=3 .* or top_level='array'"):
            octree.build_octree(structs, *root, 4)
    assert len(octree.build_octree(structs, *root, 3)[0]) == len(shallow)


def test_octree_whose_lists_have_the_same_hash(monkeypatch):
    """Lists are told apart by what is in them, whatever their hashes."""
    low, high = np.full(3, 10.0), np.full(3, 14.0)
    structs = [region_of(area, low, high).struct(np.full(3, 12.0), 1e-5) for area in random_areas(30, low, high)]
    root = np.full(3, -9.0), np.full(3, 9.0)
    child, lists = octree.build_octree(structs, *root, 4)
    for same in (lambda values: np.zeros(len(values), np.uint64), lambda values: values.astype(np.uint64) % np.uint64(3)):
        monkeypatch.setattr(octree, "hash64", same)
        again, same_lists = octree.build_octree(structs, *root, 4)
        np.testing.assert_array_equal(child, again)
        assert [one.tolist() for one in lists] == [one.tolist() for one in same_lists]


def test_what_regions_enclose_is_not_cut():
    """A cell is a leaf above the last level if all regions that touch it hold it whole."""
    low, high = np.full(3, 10.0), np.full(3, 14.0)
    structs = [region_of(area, low, high).struct(np.full(3, 12.0), 1e-5) for area in random_areas(30, low, high)]
    child, lists = octree.build_octree(structs, np.full(3, -9.0), np.full(3, 9.0), DEPTH := 6)
    level = np.zeros(len(child), dtype=int)
    for cell in np.flatnonzero(child >= 0):
        level[child[cell] : child[cell] + 8] = level[cell] + 1
    assert level.max() == DEPTH
    assert any(len(lists[~child[cell]]) for cell in np.flatnonzero((child < 0) & (level < DEPTH)))


@pytest.mark.parametrize("top_level", ["octree", "kdtree", "array"])
def test_areas_of_rays(device, top_level):
    """The first area in whose region a ray starts, and along whose rays it runs, by NumPy in float64."""
    mesh = SCENES["teapot"]()
    areas = areas_of(mesh)
    scene = wrt.Scene(
        mesh, wrt.known_rays.RayAwareBvh(areas=areas, tolerance=2.0, top_level=top_level, local=wrt.Bvh()), device=device
    )
    assert scene.state.area_trees.areas == (areas[0], areas[1], areas[3])
    assert all(0 < count <= mesh.triangle_count for count in scene.state.area_trees.triangles)
    assert scene.state.area_trees.bytes > sum(local.tree.bytes for local in scene.state.area_trees.scenes) > 0
    origins, directions = (np.concatenate(pair) for pair in zip(affine_rays(mesh, 3000), mixed_rays(mesh, 3000), strict=True))
    with np.errstate(all="ignore"):
        directions[::7] += np.float32(0.05) * np.abs(directions[::7]).max(axis=1, keepdims=True)  # some beyond the tolerance
    found = assign(scene.state, to_device(Rays(origins, directions), scene.device, scene.center).batch).area.numpy()
    regions = [region_of(area, *mesh.bounds) for area in scene.state.area_trees.areas]
    inside = contain_points(regions, origins)
    expected, clear = np.full(len(origins), len(regions)), np.ones(len(origins), dtype=bool)
    with np.errstate(all="ignore"):
        for number in reversed(range(len(regions))):
            area = scene.state.area_trees.areas[number]
            line = np.array(area.direction) if number == 0 else origins - np.array(area.position)
            cosine = (
                np.abs((line * directions).sum(axis=1)) / np.linalg.norm(line, axis=-1) / np.linalg.norm(directions, axis=1)
            )
            angle = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
            clear &= ~(np.abs(angle - 2.0) < 1e-3) & (np.linalg.norm(line, axis=-1) > 1e-5)
            expected[inside[:, number] & (angle <= 2.0)] = number
            normals = region_normals(regions[number])
            clear &= np.abs(normals[:, :3] @ origins.T.astype(np.float64) - normals[:, 3:]).min(axis=0) > 1e-4
    assert clear.mean() > 0.6
    assert set(expected[clear]) == {0, 1, 2, 3}
    leaves_at_once = (found == 3) & (expected < 3)
    assert (found == expected)[clear & ~leaves_at_once].all()
    assert leaves_at_once[clear].mean() < 0.01


def region_normals(region) -> np.ndarray:
    """(F, 4) unit normals and offsets of the faces."""
    spatial = pytest.importorskip("scipy.spatial", reason="scipy is not installed: pip install 'wrt[test-all]'")

    equations = spatial.ConvexHull(region.corners).equations
    return np.concatenate([equations[:, :3], -equations[:, 3:]], axis=1)


@pytest.mark.parametrize("name", MESHES)
def test_every_hit_is_brute_forces(device, name):
    mesh = SCENES[name]()
    origins, directions = (np.concatenate(pair) for pair in zip(affine_rays(mesh, 6000), mixed_rays(mesh, 2000), strict=True))
    order = np.random.default_rng(1).permutation(len(origins))
    origins, directions = origins[order], directions[order]
    rng = np.random.default_rng(2)
    t_min = np.where(rng.random(len(origins)) < 0.5, 0.0, rng.uniform(0, 1, len(origins)))
    t_max = np.where(rng.random(len(origins)) < 0.5, np.inf, t_min + rng.uniform(0, 2, len(origins)))
    plain = wrt.Scene(mesh, "bvh", device=device)
    expected = plain.intersect(origins, directions, t_min, t_max, traversal="brute")
    dark = plain.occluded(origins, directions, t_min, t_max, traversal="brute")
    for top_level in ("octree", "kdtree", "array"):
        scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas_of(mesh), top_level=top_level), device=device)
        for traversal in ("single", "auto"):
            hits = scene.intersect(origins, directions, t_min, t_max, traversal=traversal)
            assert_same_hits(hits, expected)
            np.testing.assert_array_equal(scene.occluded(origins, directions, t_min, t_max, traversal=traversal), dark)
    in_area = assign(scene.state, to_device(Rays(origins, directions), scene.device, scene.center).batch).area.numpy() < 3
    assert 0.15 < in_area.mean() < 0.95
    assert expected.is_hit[in_area].mean() > 0.1
    np.testing.assert_array_equal(scene.count(origins, directions), plain.count(origins, directions))
    np.testing.assert_array_equal(scene.intersect_all(origins, directions).t, plain.intersect_all(origins, directions).t)


def test_a_picture_within_one_area_stays_one(device):
    """All rays of one area, in tiles; work is counted in area and rest; few rays, none, and rays on the device."""
    mesh = SCENES["random_triangles"]()
    low, high = mesh.bounds
    eye = low + (high - low) * [0.5, -1.0, 0.6]
    camera = wrt.PinholeCamera(32, 24, position=eye, look_at=(low + high) / 2)
    whole, half = (
        wrt.known_rays.PointInfluenceArea(position=eye, direction=(low + high) / 2 - eye, fov=(90, 90), near=0.01, far=far)
        for far in (np.inf, 1.15 * float(high[1] - low[1]))
    )
    plain = wrt.Scene(mesh, "bvh", device=device)
    rays = camera.rays()
    expected = plain.intersect(rays, traversal="packet")
    for area, complete in ((whole, True), (half, False)):
        scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[area]), device=device)
        cuts = assign(scene.state, to_device(rays, scene.device, scene.center).batch)
        assert (cuts.area.numpy() == 0).all()
        assert np.isinf(cuts.rest.numpy()).all() == complete
        hits = scene.intersect(rays, traversal="packet", counters=True)
        assert hits.plan.reorder == "tiles"
        local = scene_of_state(scene.state.area_trees.scenes[0])
        assert (local.tree.low, local.tree.high) == (scene.tree.low, scene.tree.high)  # or rounding would show
        assert_same_hits(hits, expected)
        area_alone = local.intersect(
            Rays(eye, rays.directions, 0.0, cuts.cut.numpy().reshape(24, 32)), traversal="packet", counters=True
        )
        nodes, in_area = hits.counters["nodes"].sum(), area_alone.counters["nodes"].sum()
        assert nodes == in_area > 0 if complete else nodes > in_area > 0
    assert_same_hits(scene.intersect(Rays(eye, rays.directions[3, :5])), plain.intersect(Rays(eye, rays.directions[3, :5])))
    assert scene.intersect(np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)
    origins = wp.array(np.broadcast_to(eye, (24, 32, 3)).reshape(-1, 3), dtype=wp.vec3d, device=scene.device)
    directions = wp.array(rays.directions.reshape(-1, 3), dtype=wp.vec3, device=scene.device)
    found = scene.intersect(origins, directions).primitive_id
    np.testing.assert_array_equal(found.numpy().reshape(24, 32), expected.primitive_id)


def test_trees_have_what_rays_of_their_regions_can_meet():
    """Far from the origin, where coordinates are rounded by much, regions are widened by as much, and so is what they hold."""
    near = SCENES["grid"]()
    mesh = wrt.TriangleMesh(near.vertices.astype(np.float64) + np.array([3e4, -7e4, 100.0]), near.faces)
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=random_areas(6, *mesh.bounds), local=wrt.Bvh()), device="cpu")
    low, high = (f(mesh.vertices[mesh.faces], axis=1) - scene.center for f in (np.min, np.max))
    structs = [region_struct(row) for row in scene.state.area_trees.top.struct.regions.numpy()]
    met = classify_boxes(structs, low, high) != DISJOINT
    for number, local in enumerate(scene.state.area_trees.scenes):
        assert set(np.flatnonzero(met[:, number])) <= set(local.tree.primitive.numpy().tolist())
    assert 0.05 < met.mean() < 0.95
    plain = wrt.Scene(mesh, "bvh", device="cpu")
    for rays in (mixed_rays(mesh, 2000), affine_rays(mesh, 2000)):
        assert_same_hits(scene.intersect(*rays), plain.intersect(*rays))


def region_struct(row) -> RegionStruct:
    """A region as the look-up has it."""
    region = RegionStruct()
    for name in row.dtype.names:
        setattr(region, name, wp.vec3d(*row[name]) if np.ndim(row[name]) else float(row[name]))
    return region


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_rays_among_those_of_an_only_area(share):
    """Few rays without an area stay where they are and miss in its tree; many are taken apart. Either way hits are right."""
    mesh = SCENES["random_triangles"]()
    low, high = mesh.bounds
    sun = wrt.known_rays.PlaneInfluenceArea(
        position=[*(low + high)[:2] / 2, high[2] + 1], direction=(0, 0, -1), width=9, height=9, depth=9
    )
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[sun], local=wrt.Bvh()), device="cpu")
    whole, local = scene.tree, scene.state.area_trees.scenes[0].tree
    for name in ("bounds", "child", "primitive"):  # the area has all triangles: its tree is the scene's
        np.testing.assert_array_equal(getattr(local, name).numpy(), getattr(whole, name).numpy())
    rng = np.random.default_rng(0)
    origins = rng.uniform(low, high, (2000, 3))
    directions = np.where(rng.random((2000, 1)) < share, rng.normal(size=(2000, 3)), [0, 0, -1.0])
    assert (
        abs(
            assign(scene.state, to_device(Rays(origins, directions), scene.device, scene.center).batch).unassigned / 2000
            - share
        )
        < 0.05
    )
    plain = wrt.Scene(mesh, "bvh", device="cpu")
    assert_same_hits(scene.intersect(origins, directions), plain.intersect(origins, directions))
    np.testing.assert_array_equal(scene.occluded(origins, directions), plain.occluded(origins, directions))


def test_areas_without_triangles_are_left_out():
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas_of(mesh)[2:3]), device="cpu")
    assert scene.state.area_trees is None
    assert_same_hits(scene.intersect(*mixed_rays(mesh, 100)), wrt.Scene(mesh, device="cpu").intersect(*mixed_rays(mesh, 100)))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"areas": []}, ValueError, "area"),
        ({"areas": ["sun"]}, TypeError, "area"),
        ({"local": wrt.KdTree()}, TypeError, "local must be a wrt.Bvh"),
        ({"tolerance": 90.0}, ValueError, "tolerance is 90"),
        ({"top_level": "list"}, ValueError, "top_level 'list' is unknown; choose from auto, octree, kdtree, array"),
        ({"depth": 0}, ValueError, "depth is 0"),
    ],
)
def test_bad_options(options, error, message):
    area = wrt.known_rays.PointInfluenceArea(position=(0, 0, 0), direction=(1, 1, 1), fov=(9, 9), near=1.0, far=2.0)
    with pytest.raises(error, match=message):
        wrt.known_rays.RayAwareBvh(**{"areas": [area], **options})


@pytest.mark.parametrize("count", [300, 4000])
def test_given_areas(device, count):
    """Areas that come with the rays, right and wrong ones, of all triangles and of some, change no hit."""
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas_of(mesh)), device=device)
    trees = scene.state.area_trees
    assert trees.numbers == (0, 1, 3), "no triangle is in the third"
    assert trees.triangles[1] == mesh.triangle_count > trees.triangles[0] > trees.triangles[2]
    rays = affine_rays(mesh, count)
    rays[1][:3] = [[np.nan, 0, 1], [0, 0, 0], [np.inf, 0, 0]]
    plain = wrt.Scene(mesh, device=device)
    expected, dark = plain.intersect(*rays), plain.occluded(*rays)
    assert 0.2 * count < expected.is_hit.sum() < 0.9 * count
    for areas in (0, 1, 2, np.int64(3), -1, np.random.default_rng(2).integers(-1, 4, count), np.arange(count) * 4 // count):
        assert_same_hits(scene.intersect(*rays, areas=areas), expected)
        np.testing.assert_array_equal(scene.occluded(*rays, areas=areas), dark)
    several = Rays(rays[0].reshape(2, -1, 3), rays[1].reshape(2, -1, 3))
    np.testing.assert_array_equal(scene.occluded(several, areas=np.array([[1], [3]])), dark.reshape(2, -1))
    own = wp.array(np.zeros(count, dtype=np.int32), dtype=int, device=device)
    np.testing.assert_array_equal(scene.occluded(*rays, areas=own), dark)


def test_given_areas_are_used(device):
    """Work is that of the area's tree: for a ray that begins outside of its area, that of the scene's."""
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas_of(mesh)), device=device)
    rays = affine_rays(mesh, 2000)
    work = {}
    for areas in (None, -1, 0, 1):
        hits = scene.intersect(*rays, areas=areas, traversal="single", counters=True)
        work[areas] = hits.counters["nodes"].astype(int)
    whole = wrt.Scene(mesh, device=device).intersect(*rays, traversal="single", counters=True).counters["nodes"].astype(int)
    np.testing.assert_array_equal(work[-1], whole)
    local = scene_of_state(scene.state.area_trees.scenes[1])
    np.testing.assert_array_equal(work[1], local.intersect(*rays, traversal="single", counters=True).counters["nodes"])
    outside = ~contain_points([region_of(areas_of(mesh)[0], *mesh.bounds)], rays[0].astype(np.float64))[:, 0]
    assert 200 < outside.sum() < 1800
    assert (work[0][outside] == whole[outside]).mean() > 0.99, "but for origins on the region's faces"
    assert (work[0][~outside] != whole[~outside]).mean() > 0.3


def test_given_areas_are_checked(device):
    mesh = SCENES["teapot"]()
    scene, rays = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas_of(mesh)), device=device), mixed_rays(mesh, 40)
    with pytest.raises(ValueError, match=r"wrt\.known_rays\.RayAwareBvh"):
        wrt.Scene(mesh, device=device).occluded(*rays, areas=0)
    with pytest.raises(ValueError, match="from -1 to 3"):
        scene.intersect(*rays, areas=4)
    with pytest.raises(TypeError, match="integers"):
        scene.intersect(*rays, areas=0.0)
    with pytest.raises(ValueError, match="does not broadcast"):
        scene.intersect(*rays, areas=np.zeros(3, dtype=int))
    away = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[areas_of(mesh)[2]]), device=device)
    assert away.state.area_trees is None
    assert_same_hits(away.intersect(*rays, areas=0), scene.intersect(*rays))
