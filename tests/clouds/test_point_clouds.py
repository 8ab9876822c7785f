"""Point clouds against brute force, an oracle in extended precision, closed forms, and sensors in rooms of points."""

from __future__ import annotations

import pickle
from copy import copy

import numpy as np
import pytest
import trimesh
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from support.selection import slow

import wrt
from wrt.engine.facts.facts import RayFacts
from wrt.engine.facts.query_kinds import QUERIES
from wrt.engine.plan import planner
from wrt.kernels.clouds.cloud_test import BOX
from wrt.sensors import PointCloud

UTM = np.array([691_000.0, 5_334_000.0, 500.0])
KINDS = ("spheres", "discs", "boxes")


def scattered(kind: str, count: int = 400, at: np.ndarray | float = 0.0, device: str = "cpu") -> PointCloud:
    """Points in a cube of 2, with radii of their own."""
    rng = np.random.default_rng(3)
    points, radius = rng.uniform(-1, 1, (count, 3)), rng.uniform(0.005, 0.2, count)
    if kind == "boxes":
        return PointCloud(points + at, rng.uniform(0.005, 0.1, (count, 3)), boxes=True, device=device)
    return PointCloud(points + at, radius, rng.normal(size=(count, 3)) if kind == "discs" else None, device=device)


def every_ray(cloud: PointCloud, count: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Rays from inside and outside, along axes, that graze spheres, of any length, and bad ones."""
    rng = np.random.default_rng(5)
    centre, size = cloud.center, np.ptp(cloud.bounds, axis=0)
    origins = centre + rng.uniform(-1, 1, (count, 3)) * size
    directions = centre + rng.uniform(-0.5, 0.5, (count, 3)) * size - origins
    kind = rng.integers(0, 6, count)
    directions[kind == 1] = np.eye(3)[rng.integers(0, 3, (kind == 1).sum())] * rng.choice([-1, 1], ((kind == 1).sum(), 1))
    grazed, radius = relative(cloud)[:2]
    which = rng.integers(0, len(cloud), count)
    across = np.cross(directions, rng.normal(size=(count, 3)))
    across *= radius[which, None] / np.linalg.norm(across, axis=1, keepdims=True)
    graze = kind == 2
    origins[graze] = (centre + grazed[which].astype(float) + across - rng.choice([1.0, 1e3], (count, 1)) * directions)[graze]
    directions[kind == 3] *= 10.0 ** rng.integers(-30, 30, ((kind == 3).sum(), 1))
    origins[kind == 4] = (centre + grazed[which])[kind == 4]
    directions[:5] = [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [1e-40, 0, 0], [0, -0.0, 1]]
    return origins, directions


def relative(cloud: PointCloud) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, radii and normals as the device holds them; of boxes half the edges for normals, and the least of them."""
    points = cloud.state.points
    if points.components == BOX:
        return points.centre.numpy(), points.normal.numpy().min(axis=1), points.normal.numpy()
    radius = np.broadcast_to(points.radius.numpy(), len(cloud))
    return points.centre.numpy(), radius, points.normal.numpy()


def roots(cloud: PointCloud, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rays, points) longdouble: where each line enters and leaves each sphere or disc, NaN for nowhere; of rays as the device
    has them, in float32 relative to the centre."""
    with np.errstate(all="ignore"):
        points, radius, normal = (array.astype(np.longdouble) for array in relative(cloud))
        x = points - (origins - cloud.center).astype(np.float32).astype(np.longdouble)[:, None]
        d = directions.astype(np.float32).astype(np.longdouble)[:, None]
        if cloud.state.points.components == BOX:
            sides = (x - normal) / d, (x + normal) / d
            enter, leave = np.minimum(*sides).max(axis=-1), np.maximum(*sides).min(axis=-1)
            return np.where(enter <= leave, enter, np.nan), np.where(enter <= leave, leave, np.nan)
        if len(normal):
            t = (x * normal).sum(-1) / (d * normal).sum(-1)
            met = ((t[..., None] * d - x) ** 2).sum(-1) <= radius**2
            return np.where(met, t, np.nan), np.where(met, t, np.nan)
        squared = (d * d).sum(-1)
        middle = (x * d).sum(-1) / squared
        half = np.sqrt((radius**2 - ((x - middle[..., None] * d) ** 2).sum(-1)) / squared)
        return middle - half, middle + half


@pytest.mark.parametrize("at", [0.0, UTM], ids=["near", "utm"])
@pytest.mark.parametrize("kind", KINDS)
def test_same_bits_as_brute_force(kind, at, device):
    """Through the tree and its filter, for every kind of ray and range."""
    cloud = scattered(kind, at=at, device=device)
    origins, directions = every_ray(cloud)
    for t_min, t_max in ((0.0, np.inf), (0.4, 0.9)):
        one = cloud.intersect(origins, directions, t_min, t_max)
        all_points = cloud.intersect(origins, directions, t_min, t_max, brute_force=True)
        for name in ("t", "primitive_id", "uv"):
            np.testing.assert_array_equal(getattr(one, name), getattr(all_points, name))
        assert 0.1 < one.is_hit.mean() < 0.95
        assert not one.is_hit[:4].any()


@pytest.mark.parametrize("at", [0.0, UTM], ids=["near", "utm"])
@pytest.mark.parametrize("kind", KINDS)
def test_oracle(kind, at):
    """t is that of longdouble, rounded; points that another precision might decide otherwise are few."""
    cloud = scattered(kind, at=at)
    origins, directions = every_ray(cloud)
    usable = slice(5, None)
    enter, leave = roots(cloud, origins[usable], directions[usable])
    for t_min in (0.0, 0.3):
        hits = cloud.intersect(origins[usable], directions[usable], t_min)
        first = np.where(enter.astype(np.float32) >= t_min, enter, leave)
        first = np.where(first.astype(np.float32) >= t_min, first, np.inf)
        expected = first.min(axis=1)
        assert (np.isfinite(expected) == hits.is_hit).mean() > 0.995
        both = np.isfinite(expected) & hits.is_hit
        assert (first.argmin(axis=1) == hits.primitive_id)[both].mean() > 0.995
        same = both & (first.argmin(axis=1) == hits.primitive_id)
        length = np.linalg.norm(directions[usable], axis=1)[same]
        assert (np.abs(hits.t[same] - expected[same]) * length <= 2.0**-23 * hits.t[same] * length + 1e-12).all()


@given(
    st.integers(-8, 12),
    st.integers(-6, 6),
    st.integers(-30, 30),
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    st.floats(0, 0.999),
)
@settings(max_examples=60, deadline=None)
def test_one_sphere(distance, radius, length, direction, aside):
    """From any distance, for any radius and length: where the line passes the centre at a part of the radius."""
    radius, far, direction = 4.0**radius, 4.0**distance, np.array(direction) * 2.0**length
    unit = direction / np.linalg.norm(direction)
    across = np.cross(unit, [0.6, -0.8, 0.0] if abs(unit[2]) > 0.5 else [0.0, 0.0, 1.0])
    cloud = PointCloud(UTM[None], radius, device="cpu")
    origin = UTM + aside * radius * across / np.linalg.norm(across) - (radius + far) * unit
    enter, leave = (float(root[0, 0]) for root in roots(cloud, origin[None], direction[None]))
    hits = cloud.intersect(origin, direction)
    if np.isnan(enter):  # float32 moved the origin
        assert not hits.is_hit
        return
    assert hits.t == pytest.approx(enter if np.float32(enter) >= 0 else leave, rel=2.0**-23)
    steps = 2.0 * np.spacing(UTM.max())  # of float64 there
    np.testing.assert_allclose(np.linalg.norm(hits.position - UTM), radius, rtol=1e-6, atol=steps)


@pytest.mark.parametrize(
    ("traversal", "kind"),
    [("interleaved", "discs"), *slow(("stream", "spheres"), ("interleaved", "boxes"))],
)
def test_every_traversal_gives_the_bits_of_brute_force(traversal, kind):
    """Closest and any hits, counts and lists, of rays from a point and from anywhere; of boxes closest hits alone."""
    cloud = scattered(kind, at=UTM)
    origins, directions = every_ray(cloud)
    for rays in ((origins, directions, 0.0, 0.9), (UTM, directions), (origins[:7], directions[:7])):
        closest, judge = (cloud.intersect(*rays, traversal=name) for name in (traversal, "brute"))
        assert (closest.plan.traversal, judge.plan.traversal) == (traversal, "brute")
        for name in ("t", "primitive_id", "uv"):
            np.testing.assert_array_equal(getattr(closest, name), getattr(judge, name))
        if kind == "boxes":
            continue
        np.testing.assert_array_equal(cloud.occluded(*rays, traversal=traversal), judge.is_hit)
        lists, all_points = (cloud.intersect_all(*rays, traversal=name) for name in (traversal, "brute"))
        for name in ("t", "primitive_id", "count"):
            np.testing.assert_array_equal(getattr(lists, name), getattr(all_points, name))
        np.testing.assert_array_equal(cloud.count(*rays, traversal=traversal), lists.count)


def test_auto_and_traversals_of_triangles():
    """Many rays take turns, few go one by one; what traces triangles alone is refused by name, before a kernel runs."""
    cloud = scattered("discs")
    rays = np.random.default_rng(7).uniform(-1, 1, (2, 3000, 3))
    assert cloud.intersect(*rays).plan.traversal in ("interleaved", "stream", "single")  # as measured
    plan = cloud.intersect(*rays[:, :100]).plan
    assert (plan.traversal, plan.triangle_test) == ("single", "discs")
    assert planner.choose_plan(cloud.state, RayFacts(3000, (3000,)), QUERIES["closest"]).traversal == "interleaved"
    for name in ("packet", "persistent", "queued"):
        with pytest.raises(ValueError, match=r"a point cloud has none; choose from auto, brute, single, stream, interleaved"):
            cloud.intersect(*rays[:, :9], traversal=name)
    with pytest.raises(ValueError, match="unknown; choose from"):
        cloud.count(*rays[:, :9], traversal="spheres")
    with pytest.raises(TypeError, match="must be a name, not Plan"):
        cloud.occluded(*rays[:, :9], traversal=plan)
    with pytest.raises(ValueError, match="no brute force"):
        cloud.intersect(*rays[:, :9], traversal="single", brute_force=True)
    with pytest.raises(ValueError, match="triangle_test 'spheres' is unknown"):
        wrt.Scene(trimesh.creation.box(), device="cpu").intersect(*rays[:, :9], triangle_test="spheres")


@pytest.mark.parametrize("rebuild", ["auto", "always", "never"])
def test_moving_points(rebuild, device):
    """The answers of an updated cloud are those of a new one; hits that were found before stay."""
    rng = np.random.default_rng(8)
    points, radius, normals = rng.uniform(-1, 1, (500, 3)) + UTM, rng.uniform(0.02, 0.2, 500), rng.normal(size=(500, 3))
    cloud = PointCloud(points, radius, device=device)
    rays = every_ray(cloud)
    before = cloud.intersect(*rays)
    place = before.position.copy()
    assert cloud.last_update is None

    def check(*made):
        other = PointCloud(*made, device=device)
        one, new = cloud.intersect(*rays), other.intersect(*rays)
        for name in ("t", "primitive_id", "uv", "normal"):
            np.testing.assert_array_equal(getattr(one, name), getattr(new, name))
        judge = cloud.intersect(*rays, brute_force=True)
        np.testing.assert_array_equal(judge.t, one.t)
        assert 0.1 < one.is_hit.mean() < 0.95

    for step in (0.01, 1.0):
        points = points + rng.normal(scale=step, size=points.shape)
        cloud.update(points, rebuild=rebuild)
        check(points, radius)
        assert cloud.last_update.action in {"auto": ("kept", "built"), "always": ("built",), "never": ("kept",)}[rebuild]
    cloud.update(radius=2.0 * radius, rebuild=rebuild)
    points = cloud.center + relative(cloud)[0].astype(float)
    check(points, np.float32(2.0 * radius))
    cloud.update(normals=normals, rebuild=rebuild)
    check(points, np.float32(2.0 * radius), normals)
    with pytest.raises(ValueError, match="one for each of 3 points"):
        cloud.update(points[:3])
    with pytest.raises(ValueError, match="not finite"):
        cloud.update(points * np.nan)
    check(points, np.float32(2.0 * radius), normals)
    cloud.update(points[:300], 0.1, normals[:300], rebuild=rebuild)
    check(points[:300], 0.1, normals[:300])
    np.testing.assert_array_equal(before.position, place)
    assert before.is_of(cloud.state)


def test_reflectance_of_points():
    """An intensity is that of a cloud of one reflectance, times that of the point that was met."""
    cloud, rng = scattered("discs", at=UTM), np.random.default_rng(9)
    values, pose = rng.uniform(0, 2, len(cloud)), np.eye(4)
    pose[:3, 3] = UTM + np.array([3.0, 0, 0])
    lidar = wrt.sensors.Lidar.preset("velodyne_vlp16").replace(min_range=0.0, threshold=0.0)
    one, each = (lidar.scan(cloud, pose, reflectance=value) for value in (1.0, values))
    seen = np.isfinite(one.range)
    assert seen.sum() > 50
    for name in ("range", "primitive_id", "geometry_id", "normal"):
        np.testing.assert_array_equal(getattr(each, name), getattr(one, name))
    np.testing.assert_allclose(each.intensity, one.intensity * np.where(seen, values[one.primitive_id], 0.0), rtol=1e-5)
    lidar = lidar.replace(bundle=3, divergence=0.002, returns=2)
    one, each = (lidar.scan(cloud, pose, reflectance=value) for value in (0.7, np.full(len(cloud), 0.7)))
    np.testing.assert_array_equal(each.intensity, one.intensity)
    assert (lidar.scan(cloud, pose, reflectance=values).intensity != one.intensity).any()
    with pytest.raises(ValueError, match=r"one for each of 400 points"):
        lidar.scan(cloud, pose, reflectance=np.ones(3))


def test_tables_of_points():
    table = np.zeros(3, dtype=[("x", "f8"), ("y", "f4"), ("z", "i4"), ("intensity", "u2")])
    table["x"], table["y"], table["z"] = [1, 2, 3], [4, 5, 6], [7, 8, 9]
    cloud = PointCloud(table, 0.5, device="cpu")
    np.testing.assert_allclose(cloud.bounds, [[0.5, 3.5, 6.5], [3.5, 6.5, 9.5]])
    with pytest.raises(ValueError, match="without x, y and z; its fields are y, z"):
        PointCloud(table[["y", "z"]], 0.5)


@pytest.mark.parametrize(
    ("name", "said"),
    [("closest_point", "cKDTree"), ("contains", "enclose nothing"), ("save", "pickle"), ("filtered", "keep"), ("other", "")],
)
def test_what_clouds_have_not(name, said):
    cloud = scattered("spheres", 5)
    with pytest.raises(AttributeError, match=f"a PointCloud has no '{name}'.*{said}"):
        getattr(cloud, name)
    for place in (wrt.Scene, wrt.Instance):
        with pytest.raises(TypeError, match="PointCloud"):
            place(cloud)


def test_sphere_closed_form(device):
    cloud = PointCloud([[3.0, 0, 0]], 1.0, device=device)
    ahead = [1.0, 0, 0]
    assert cloud.intersect([0.0, 0, 0], ahead).t == 2.0
    assert cloud.intersect([3.0, 0, 0], ahead).t == 1.0  # from inside, the far side
    assert cloud.intersect([0.0, 0, 0], ahead, t_min=2.5).t == 4.0
    assert not cloud.intersect([0.0, 0, 0], ahead, t_min=4.5).is_hit
    assert not cloud.intersect([0.0, 0, 0], ahead, t_max=1.9).is_hit
    assert not cloud.intersect([5.0, 0, 0], ahead).is_hit
    assert cloud.intersect([0.0, 1.0, 0], ahead).t == 3.0  # a tangent
    assert not cloud.intersect([0.0, np.nextafter(np.float32(1), np.float32(2)), 0], ahead).is_hit
    for hits in (cloud.intersect([0.0, 0, 0], ahead), cloud.intersect([2.5, 0, 0], [-2.0, 0, 0])):
        np.testing.assert_allclose(hits.normal, [-1, 0, 0], atol=1e-7)  # outward on both sides
        np.testing.assert_allclose(hits.position, [2, 0, 0], atol=1e-6)


def test_box_closed_form(device):
    """Sides, edges and corners; from inside, the far side; along a side."""
    cloud = PointCloud([[3.0, 0, 0]], [[1.0, 2.0, 3.0]], boxes=True, device=device)
    ahead = [1.0, 0, 0]
    np.testing.assert_allclose(cloud.bounds, [[2, -2, -3], [4, 2, 3]])
    begin = [[0.0, 0, 0], [3.0, 1, 1], [5.0, 0, 0], [0.0, 2, 3], [0.0, 2.001, 0]]
    np.testing.assert_array_equal(cloud.intersect(begin, ahead).t, np.float32([2, 1, np.inf, 2, np.inf]))
    hits = cloud.intersect([3.5, 0.5, 9.0], [0.0, 0, -2])
    assert hits.t == 3.0
    np.testing.assert_allclose(hits.normal, [0, 0, 1], atol=1e-7)
    np.testing.assert_allclose(hits.position, [3.5, 0.5, 3], atol=1e-6)
    np.testing.assert_allclose(cloud.intersect([3.0, 0, 0], [0.0, -1, 0]).normal, [0, -1, 0], atol=1e-7)  # outward, from inside
    assert repr(cloud).startswith("PointCloud(1 boxes")
    for half in (2.0**-126, 4e-23, 1e-19):  # their squares are not normal
        tiny = PointCloud([[0.0, 0, 0]], half, boxes=True, device=device)
        assert tiny.intersect([0.99 * half, 0.99 * half, -2.0], [0.0, 0, 1]).t == 2.0
        assert tiny.intersect([0.99 * half, 0.99 * half, -2 * half], [0.0, 0, 1]).is_hit
    cubes = PointCloud([[0.0, 0, 0], [1, 0, 0]], 0.5, boxes=True, device=device)
    assert cubes.intersect([0.5, 9.0, 0], [0.0, -1, 0]).primitive_id == 0  # they share a side
    cubes.update(radius=[0.25, 0.5])
    assert cubes.intersect([0.5, 9.0, 0], [0.0, -1, 0]).primitive_id == 1
    with pytest.raises(ValueError, match="no normals"):
        PointCloud([[0.0, 0, 0]], 0.5, [[0, 0, 1.0]], boxes=True)
    with pytest.raises(ValueError, match="radius has the shape"):
        PointCloud(np.zeros((4, 3)), np.ones((2, 3)), boxes=True)


def test_disc_closed_form(device):
    cloud = PointCloud([[0.0, 0, 2]], 0.5, [[0, 0, -7.0]], device=device)
    up = [0.0, 0, 1]
    hits = cloud.intersect([[0.0, 0, 0], [0.5, 0, 0], [0, 0.49, 4], [0.3, 0.41, 0]], [up, up, [0.0, 0, -1], up])
    np.testing.assert_array_equal(hits.t, np.float32([2, 2, 2, np.inf]))
    np.testing.assert_array_equal(hits.normal, [[0, 0, -1]] * 3 + [[0, 0, 0]])  # as given, from both sides
    np.testing.assert_allclose(hits.position[:3], [[0, 0, 2], [0.5, 0, 2], [0, 0.49, 2]], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(hits.uv, axis=1), [0, 1, 0.98, 0], atol=1e-6)
    assert not cloud.intersect([-3.0, 0, 2], [1.0, 0, 0]).is_hit  # edge-on
    assert cloud.intersect([-3.0, 0, 2.001], [3.0, 0, -0.001]).is_hit


def test_ties_go_to_the_smaller_number(device):
    points = np.repeat([[0.0, 0, 0], [3.0, 0, 0]], 40, axis=0)[::-1]
    cloud = PointCloud(points, 1.0, device=device)
    assert cloud.intersect([-5.0, 0, 0], [1.0, 0, 0]).primitive_id == 40
    assert cloud.intersect([9.0, 0, 0], [-1.0, 0, 0]).primitive_id == 0


def test_all_points_of_a_ray(device):
    """Each once, from where the ray is; `occluded` and `count` agree."""
    cloud = PointCloud(np.arange(30.0)[:, None] * [2.0, 0, 0], 0.5, device=device)
    begin = np.array([[-1.0, 0, 0], [4.0, 0, 0], [5.0, 0, 0], [0, 9.0, 0], [-1.0, 0.5, 0]])
    ahead = [1.0, 0, 0]
    np.testing.assert_array_equal(cloud.count(begin, ahead), [30, 28, 27, 0, 30])
    np.testing.assert_array_equal(cloud.count(begin, ahead, 0.0, 3.0), [2, 2, 2, 0, 2])
    np.testing.assert_array_equal(cloud.occluded(begin, ahead), [True, True, True, False, True])
    np.testing.assert_array_equal(cloud.occluded(begin, ahead, 0.6, 1.4), [False, False, False, False, True])
    lists = cloud.intersect_all(begin, ahead)
    np.testing.assert_array_equal(lists.count, [30, 28, 27, 0, 30])
    np.testing.assert_array_equal(lists.primitive_id[:58], [*range(30), *range(2, 30)])
    np.testing.assert_array_equal(lists.t[30:33], [0.5, 1.5, 3.5])  # it starts in the third
    np.testing.assert_allclose(lists.position[:30, 0], 2.0 * np.arange(30) - 0.5, atol=1e-5)
    np.testing.assert_array_equal(cloud.intersect_all(begin, ahead, max_hits=2).count, [2, 2, 2, 0, 2])
    scattering = scattered("spheres", device=device)
    rays = every_ray(scattering)
    np.testing.assert_array_equal(scattering.occluded(*rays), scattering.intersect(*rays).is_hit)
    assert (scattering.count(*rays) == scattering.intersect_all(*rays).count).all()


@pytest.mark.parametrize("kind", KINDS)
def test_hits(kind):
    """Positions are on the points and on the rays; rays from there do not meet the same point; hits can be pickled."""
    cloud = scattered(kind, at=UTM)
    origins, directions = every_ray(cloud)
    hits = cloud.intersect(origins[200:], directions[200:])
    met = hits.is_hit & (np.linalg.norm(directions[200:], axis=1) > 1e-3)
    points, radius, normals = relative(cloud)
    ids = hits.primitive_id[met]
    centre = cloud.center + points[ids]
    assert hits.position.dtype == np.float64
    if kind == "spheres":
        across = (hits.position[met] - centre) / radius[ids, None]
        np.testing.assert_allclose(hits.normal[met], across, atol=1e-4)
    elif kind == "boxes":
        cube = (hits.position[met] - centre) / normals[ids]
        np.testing.assert_allclose(np.abs(cube).max(axis=1), 1, atol=2e-4)  # positions are in float32 near UTM
        np.testing.assert_allclose((cube * hits.normal[met]).sum(axis=1), 1, atol=2e-4)
        assert set(np.unique(np.abs(hits.normal[met]).round(6))) == {0.0, 1.0}
    else:
        np.testing.assert_allclose(hits.normal[met], normals[ids], atol=1e-6)
        assert (np.linalg.norm(hits.position[met] - centre, axis=1) <= radius[ids] + 1e-6).all()
    out = hits.normal * np.where(hits.faces(-directions[200:]), 1.0, -1.0)[:, None]
    again = cloud.intersect(hits.spawn(out)[met], out[met], t_max=np.inf)
    behind = (
        np.zeros(len(ids), dtype=bool) if kind == "discs" else ~hits.faces(-directions[200:])[met]
    )  # leaves a sphere inward
    assert (again.primitive_id != ids)[~behind].all()
    other = pickle.loads(pickle.dumps(hits))
    for name in ("t", "primitive_id", "uv", "position", "normal", "geometry_id", "instance_id"):
        np.testing.assert_array_equal(getattr(other, name), getattr(hits, name))
    for read in (hits.smooth_normal, hits.uv_at, lambda: hits.interpolate(np.zeros(3))):
        with pytest.raises(ValueError, match="primitive_id"):
            read()


def test_warp_arrays(device):
    cloud = scattered("spheres", device=device)
    origins, directions = (array[5:].astype(np.float32) for array in every_ray(cloud))
    rays = [wp.array(array, dtype=wp.vec3, device=device) for array in (origins, directions)]
    hits = cloud.intersect(*rays)
    assert isinstance(hits.normal, wp.array)
    np.testing.assert_array_equal(hits.t.numpy(), cloud.intersect(origins, directions).t)


def test_pickles_and_copies():
    cloud = scattered("discs", at=UTM)
    rays = every_ray(cloud)
    for other in (pickle.loads(pickle.dumps(cloud)), copy(cloud)):
        assert len(other) == len(cloud)
        hits = other.intersect(*rays)
        assert hits.is_of(cloud.state)
        np.testing.assert_array_equal(hits.t, cloud.intersect(*rays).t)
    assert copy(cloud).state is cloud.state


def room(step: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the six walls of a room of 10."""
    along = np.arange(-5, 5 + step / 2, step)
    flat = np.stack([np.zeros(len(along) ** 2), *(a.ravel() for a in np.meshgrid(along, along))], axis=1)
    walls = [(np.roll(flat, axis, axis=1), side * np.eye(3)[axis]) for axis in range(3) for side in (-1.0, 1.0)]
    points = [wall + 5.0 * normal for wall, normal in walls]
    return np.concatenate(points), np.concatenate([np.tile(normal, (len(flat), 1)) for _, normal in walls])


def test_lidar_in_a_room_of_points():
    """Discs that cover walls are the walls: ranges, intensities and normals of a scan are those of a box of triangles."""
    points, normals = room(0.25)
    cloud = PointCloud(points + UTM, 0.2, normals, device="cpu")
    box = wrt.Scene(trimesh.creation.box((10.0, 10.0, 10.0)).apply_translation(UTM), device="cpu")
    lidar, pose = wrt.sensors.Lidar.preset("velodyne_vlp16"), np.eye(4)
    pose[:3, 3] = UTM
    scan, expected = (lidar.scan(each, pose, labels=[7], reflectance=0.5) for each in (cloud, box))
    np.testing.assert_allclose(scan.range, expected.range, rtol=1e-6)
    np.testing.assert_allclose(scan.intensity, expected.intensity, rtol=1e-5)
    np.testing.assert_allclose(scan.position, expected.position, atol=1e-5)
    at_edges = np.abs(np.abs(scan.normal) - np.abs(expected.normal)).max(axis=-1) > 1e-6  # two walls are equally near
    assert at_edges.mean() < 1e-3
    assert (np.linalg.norm(points[scan.primitive_id] + UTM - scan.position, axis=-1) <= 0.2001).all()
    assert set(np.unique(scan.instance_id)) == set(np.unique(scan.geometry_id)) == {0}
    assert set(np.unique(scan.semantic_id)) == {7}
    table = lidar.replace(bundle=4, returns=2).scan(cloud, pose, seed=1).to_structured()
    assert len(table) >= scan.range.size


def test_camera_in_a_room_of_points():
    points, normals = room(0.25)
    cloud = PointCloud(points, 0.2, normals, device="cpu")
    lens = wrt.sensors.BrownConrady(fx=20.0, fy=20.0, cx=7.5, cy=5.5)
    camera, pose = wrt.sensors.Camera(16, 12, lens), np.eye(4)  # looks along z
    images = camera.capture(cloud, pose)
    np.testing.assert_allclose(images.depth, 5.0, rtol=1e-6)
    np.testing.assert_allclose(images.normal, np.broadcast_to([0, 0, 1], (12, 16, 3)), atol=1e-6)
    np.testing.assert_array_equal(images.camera_normal, images.normal)
    np.testing.assert_allclose(images.position[..., 2], 5.0, rtol=1e-6)
    with pytest.raises(ValueError, match="albedo needs materials"):
        camera.capture(cloud, pose, albedo=True)
    with pytest.raises(TypeError, match=r"scene must be a wrt\.Scene"):
        camera.render(cloud, pose)
    for options in ({"mask": 1}, {"environment": 0}, {"traversal": "single"}):
        with pytest.raises(ValueError, match="leave them out"):
            camera.capture(cloud, pose, **options)


def test_clouds_of_trimesh():
    points = np.random.default_rng(1).uniform(size=(20, 3))
    cloud = PointCloud(trimesh.PointCloud(points), 0.1, device="cpu")
    assert len(cloud) == 20
    assert repr(cloud) == "PointCloud(20 spheres, device='cpu')"
    np.testing.assert_allclose(cloud.bounds, [points.min(axis=0) - 0.1, points.max(axis=0) + 0.1], atol=1e-6)
    assert cloud.bytes > 20 * 32


@pytest.mark.parametrize(
    ("error", "said", "make"),
    [
        (ValueError, "at least one point", lambda: PointCloud(np.zeros((0, 3)), 1.0)),
        (ValueError, "points", lambda: PointCloud(np.zeros((4, 2)), 1.0)),
        (TypeError, "points", lambda: PointCloud([["a", "b", "c"]], 1.0)),
        (TypeError, "not TriangleMesh; pass its vertices", lambda: PointCloud(wrt.scenes.build("teapot", level=2), 1.0)),
        (
            ValueError,
            r"1 points that are not finite, the first of them number 1",
            lambda: PointCloud([[0, 0, 0], [0, np.nan, 0]], 1),
        ),
        (ValueError, "radius must be positive", lambda: PointCloud(np.zeros((4, 3)), 0.0)),
        (ValueError, "that of point 2 is -1", lambda: PointCloud(np.zeros((4, 3)), [1, 1, -1, 1])),
        (ValueError, "radius must be positive", lambda: PointCloud(np.zeros((4, 3)), np.inf)),
        (ValueError, "radius must be positive", lambda: PointCloud(np.zeros((4, 3)), np.nan)),
        (ValueError, "one for each of 4 points", lambda: PointCloud(np.zeros((4, 3)), [1.0, 2.0])),
        (ValueError, "normals", lambda: PointCloud(np.zeros((4, 3)), 1.0, np.ones((3, 3)))),
        (ValueError, "1 zero vectors, the first of them number 3", lambda: PointCloud(np.zeros((4, 3)), 1.0, np.eye(4, 3))),
        (ValueError, "cloud may be", lambda: PointCloud([[0, 0, 0], [1e12, 0, 0]], 1.0)),
        (TypeError, "its options are .*brute_force", lambda: scattered("spheres").intersect([0, 0, 0], [1, 0, 0], mask=1)),
        (TypeError, "directions is missing", lambda: scattered("spheres").occluded([0, 0, 0])),
    ],
)
def test_bad_input(error, said, make):
    with pytest.raises(error, match=said):
        make()
