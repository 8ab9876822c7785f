"""Trees for known rays: the same hits as any tree, planes by Algorithm 5.1, invariants, mixtures, stop rules, bad input."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import warp as wp
from support.built_bvhs import assert_same_tree, check, mesh_of
from support.hits import assert_same_hits, mixed_rays
from support.known_areas import AREA_KINDS, area_of, build, picture, rays_of, window
from support.meshes import SCENES

import wrt
from wrt.builders.bvh import binned_bvh as binned
from wrt.builders.bvh.bvh_statistics import unpack
from wrt.builders.bvh.known_rays_config import ProjectedConfig
from wrt.builders.bvh.phases import collapse as collapse_phase
from wrt.builders.bvh.phases.bvh_bins import FEW
from wrt.builders.bvh.phases.split_axes import AxisChoice
from wrt.kernels.runtime.launch import use_threads

shapely = pytest.importorskip("shapely", reason="shapely is not installed: pip install 'wrt[test-all]'")


@functools.cache
def scene_and_rays(name: str):
    """A scene's mesh, rays of every kind, and their hits by brute force."""
    mesh = SCENES[name]()
    kinds = [mixed_rays(mesh, 150), *(rays_of(area_of(mesh, kind), 150) for kind in AREA_KINDS)]
    rays = [np.concatenate(part).astype(np.float32) for part in zip(*kinds, strict=True)]
    return mesh, rays, wrt.Scene(mesh, wrt.Bvh(width=8)).intersect(*rays, traversal="brute")


@pytest.mark.parametrize("kind", AREA_KINDS)
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("stadium", {"axes": "all"}),
        ("wood", {"axes": "facing", "others": 0.0}),
        ("degenerate", {"axes": "longest", "leaf_probability": 1e-3}),
        ("random_triangles", {"axes": "in_turn", "cost": "sah"}),
        ("teapot", {"axes": "facing", "triangle_cost": 1.2, "aware_depth": 4, "max_depth": 12}),
    ],
)
def test_every_ray_has_its_hit(name, options, kind):
    """Rays of the area, of others, and of no area at all: the same hits as brute force, to the bit."""
    mesh, rays, expected = scene_and_rays(name)
    scene = wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(areas=area_of(mesh, kind), width=8, **options))
    assert_same_hits(scene.intersect(*rays, traversal="single", counters=True), expected)


def test_far_from_the_origin():
    """Areas are told where they are relative to the scene's centre: a scene far away has the same tree."""
    mesh, away = SCENES["teapot"](), np.array([4096.0, -8192.0, 16384.0])
    area = area_of(mesh, "point")
    moved = wrt.known_rays.PointInfluenceArea(
        position=area.position + away, direction=area.direction, fov=area.fov, near=0.5, far=100.0
    )
    there = wrt.Scene(wrt.TriangleMesh(mesh.vertices + away, mesh.faces), wrt.known_rays.ProjectedBvh(areas=moved, width=8))
    area = wrt.known_rays.PointInfluenceArea(
        position=area.position, direction=area.direction, fov=area.fov, near=0.5, far=100.0
    )
    back = wrt.TriangleMesh(there.meshes[0].vertices.astype(np.float64) - away, mesh.faces)
    assert_same_tree(there.tree, wrt.Scene(back, wrt.known_rays.ProjectedBvh(areas=area, width=8)).tree)


@pytest.mark.parametrize(
    ("name", "axes", "width"),
    [
        ("teapot", "all", 2),
        ("stadium", "facing", 16),
        ("wood", "longest", 2),
        ("wood", "in_turn", 16),
        ("grid", "facing", 2),
        ("degenerate", "all", 16),
        ("degenerate", "facing", 4),
    ],
)
def test_invariants(name, axes, width):
    mesh = SCENES[name]()
    areas = [area_of(mesh, kind) for kind in ("plane", "point inside")]
    tree, config = build(mesh, areas, axes, width, others=0.0)
    check(tree, mesh.vertices, mesh.faces, config.bvh)


@pytest.mark.parametrize("count", [1, 2, 9, 49])
def test_tiny_and_flat_meshes(count):
    """One triangle, a few, all in one plane seen edge-on, on one line, in one point, too large for areas."""
    corners = np.random.default_rng(count).random((count, 3, 3))
    flat, line, point = corners.copy(), corners.copy(), np.full_like(corners, 0.5)
    flat[:, :, 1] = 0.25
    line[:, :, :2] = 0.75
    area = wrt.known_rays.PlaneInfluenceArea(position=(0.5, 0.5, -1), direction=(0, 0, 1), width=1, height=1, depth=3)
    for shaped in (corners, flat, line, point, corners * 1e37, -corners):
        tree, config = build(mesh_of(shaped), [area], others=0.0)
        check(tree, mesh_of(shaped).vertices, mesh_of(shaped).faces, config.bvh)


def test_threads_and_tasks_do_not_show(monkeypatch):
    mesh = SCENES["wood"]()
    area = area_of(mesh, "point")
    with use_threads(1):
        reference, _ = build(mesh, area, "facing")
    monkeypatch.setattr(binned, "MIN_LARGE", 200)
    monkeypatch.setattr(binned, "TASKS_PER_THREAD", mesh.triangle_count // 200)
    monkeypatch.setattr(binned, "MIN_CHUNK", 64)
    with use_threads(3):
        tree, _ = build(mesh, area, "facing")
    assert_same_tree(tree, reference)


# -- the search, worked out again ----------------------------------------------------------------------------------------


class Reference:
    """The search for a plane in one node, by the text of Algorithm 5.1, in float64 and with the polygon library."""

    def __init__(self, low: np.ndarray, high: np.ndarray, area, config: ProjectedConfig, depth: int) -> None:
        self.low, self.high, self.area, self.config, self.depth = low, high, area, config, depth
        half = window(area)
        self.window = shapely.box(-half[0], -half[1], half[0], half[1])
        self.weight = self.weigh(low.min(axis=0), high.max(axis=0))

    def weigh(self, low: np.ndarray, high: np.ndarray) -> float:
        return picture(self.area, low, high).intersection(self.window).area

    def qualities(self) -> np.ndarray:
        low, high = self.low.min(axis=0), self.high.max(axis=0)
        order = self.config.axes.order
        if order == "longest":
            return (high - low) / (high - low).max()
        if order == "in_turn":
            return np.eye(3)[self.depth % 3]
        if order == "all":
            return np.ones(3)
        along = np.abs(self.area.frame[2])
        if isinstance(self.area, wrt.known_rays.PointInfluenceArea):
            along = np.abs((low.astype(np.float64) + high) / 2 - self.area.position)
        return 1 - along / along.sum()

    def planes(self, axis: int):
        """(cost, hits, triangles on the left) of each plane of an axis."""
        centers, bins = self.low + self.high, self.config.bvh.bins
        first, extent = centers[:, axis].min(), np.ptp(centers[:, axis])
        bin_of = np.minimum((centers[:, axis] - first) * (np.float32(bins) / extent), np.float32(bins - 1)).astype(int)
        for plane in range(1, bins):
            left = bin_of < plane
            if left.any() and not left.all():
                weights = [self.weigh(self.low[side].min(axis=0), self.high[side].max(axis=0)) for side in (left, ~left)]
                costs = self.config.cost.of_leaf(np.array([left.sum(), (~left).sum()]))
                yield float(costs @ weights), sum(weights) / self.weight, int(left.sum())

    def best(self) -> float:
        """Price of the plane that Algorithm 5.1 takes."""
        choice, quality = self.config.axes, self.qualities()
        longest = int((self.high.max(axis=0) - self.low.min(axis=0)).argmax())
        best = (np.inf, np.inf, 0)
        for axis in np.argsort(-quality, kind="stable"):
            if best[1] <= choice.excellent:
                break
            if quality[axis] < choice.least_quality:
                if best[1] > choice.acceptable:
                    best = min([best, *self.planes(longest)])
                break
            best = min([best, *self.planes(axis)])
        return best[0]


@pytest.mark.parametrize(
    ("axes", "kind"),
    [
        ("all", "point"),
        ("facing", "plane along an axis"),
        ("facing", "point"),
        ("longest", "point inside"),
        ("in_turn", "plane"),
        (AxisChoice("facing", 0.5, 1.05, 0.99), "plane"),
        (AxisChoice("facing", 0.5, 1.05, 0.99), "point inside"),
    ],
)
def test_planes_are_those_of_the_published_algorithm(axes, kind, monkeypatch):
    """The cost of the plane taken, in the large nodes of the first levels, is that of the algorithm written out again."""
    mesh = SCENES["random_triangles"]()
    area = area_of(mesh, kind)
    binary = []
    collapse = collapse_phase.collapse
    monkeypatch.setattr(collapse_phase, "collapse", lambda *args: binary.append(args[0]) or collapse(*args))
    _, config = build(mesh, area, axes, others=0.0)
    tree = binary[0].tree
    order, ranges, pairs = tree.order.numpy(), tree.range.numpy(), tree.pair.numpy()
    corners = mesh.vertices.astype(np.float32)[mesh.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    nodes, checked = [(0, 0)], 0
    for node, depth in nodes:
        first, count = ranges[node]
        ids = order[first : first + count]
        reference = Reference(low[ids], high[ids], area, config, depth)
        if count <= 2 * FEW or depth > 2 or reference.weight == 0.0:
            continue
        sides = [order[ranges[child][0] :][: ranges[child][1]] for child in (2 * pairs[node], 2 * pairs[node] + 1)]
        weights = [reference.weigh(low[side].min(axis=0), high[side].max(axis=0)) for side in sides]
        cost = config.cost.of_leaf(np.array([len(side) for side in sides])) @ weights
        assert cost == pytest.approx(reference.best(), rel=1e-3)
        nodes += [(2 * pairs[node], depth + 1), (2 * pairs[node] + 1, depth + 1)]
        checked += 1
    assert checked >= 2


# -- distributions -------------------------------------------------------------------------------------------------------


def test_no_rays_known_is_the_surface_area_tree():
    """With all rays in all directions, and all axes, the tree is as good as that of `wrt.Bvh`, costs by costs."""
    mesh = SCENES["wood"]()
    trees = wrt.Bvh(width=8), wrt.known_rays.ProjectedBvh(areas=area_of(mesh, "plane"), others=1.0, width=8)
    costs = [wrt.Scene(mesh, tree).statistics().tree.sah_cost for tree in trees]
    assert costs[1] == pytest.approx(costs[0], rel=0.01)


def work(scene: wrt.Scene, rays) -> float:
    """Boxes and triangles tested, a ray."""
    counters = scene.intersect(*rays, traversal="single", counters=True).counters
    return float(counters["boxes"].mean() + 1.2 * counters["triangles"].mean())


def test_known_rays_do_less_work():
    """A wall of slats, seen along them: surface area takes their long sides for large; and a mixture serves both areas. By
    much against the same builder without that knowledge; the default one, which also divides by size, does more work, too."""
    rng = np.random.default_rng(4)
    start = rng.uniform(0, 1, (3000, 1, 3)) * [4, 4, 1]
    mesh = mesh_of(start + np.array([[0, 0, 0], [0.03, 0.01, 0], [0, 0.03, 3.0]]) + rng.normal(0, 0.01, (3000, 3, 3)))
    along = wrt.known_rays.PlaneInfluenceArea(position=(2, 2, -3), direction=(0, 0, 1), width=4, height=4, depth=9)
    across = wrt.known_rays.PlaneInfluenceArea(
        position=(-3, 2, 2), direction=(1, 0, 0), width=4, height=4, depth=9, up=(0, 0, 1)
    )
    trees = {"sah": wrt.known_rays.ProjectedBvh(areas=along, width=8, cost="sah"), "default": wrt.Bvh(width=8)}
    trees |= {name: wrt.known_rays.ProjectedBvh(areas=a, width=8) for name, a in (("along", along), ("across", across))}
    trees["both"] = wrt.known_rays.ProjectedBvh(areas=[along, across], width=8)
    scenes = {name: wrt.Scene(mesh, tree) for name, tree in trees.items()}
    found = {name: [work(scene, rays_of(a, 2000)) for a in (along, across)] for name, scene in scenes.items()}
    assert found["along"][0] < 0.9 * found["sah"][0]
    assert found["across"][1] < found["sah"][1]
    assert found["along"][0] < found["default"][0]
    assert found["across"][1] < found["default"][1]
    assert found["along"][0] < found["across"][0]
    assert found["across"][1] < found["along"][1]
    assert found["both"][0] < found["across"][0]
    assert found["both"][1] < found["along"][1]


def test_shares_weigh_the_areas():
    """A share of nearly all makes the tree of that area alone."""
    mesh = SCENES["wood"]()
    one, other = area_of(mesh, "plane along an axis"), area_of(mesh, "point")
    alone, _ = build(mesh, [one])
    nearly, _ = build(mesh, [one, other], shares=(1.0, 1e-30))
    half, _ = build(mesh, [one, other])
    assert_same_tree(nearly, alone)
    assert half.bounds.shape != alone.bounds.shape or (half.bounds.numpy() != alone.bounds.numpy()).any()


def test_an_area_that_sees_nothing_counts_for_nothing():
    mesh = SCENES["wood"]()
    one = area_of(mesh, "plane")
    away = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 1e3), direction=(0, 0, 1), width=1, height=1, depth=1)
    assert_same_tree(build(mesh, [one, away])[0], build(mesh, [one])[0])
    assert_same_tree(build(mesh, [away])[0], build(mesh, [one], others=1.0)[0])


# -- stop rules ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", [{"leaf_probability": 0.3}, {"leaf_area": 0.3}, {"leaf_cost": 5.0}])
def test_early_leaves(rule):
    """Rarely met nodes become leaves as soon as they have few enough triangles."""
    mesh = SCENES["random_triangles"]()
    options = {"areas": area_of(mesh, "plane"), "width": 2, "triangle_cost": 1.2, "max_leaf_triangles": 40}
    plain = unpack(wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(**options)).tree)
    early = unpack(wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(**options, **rule)).tree)
    assert early.triangles.sum() == plain.triangles.sum() == mesh.triangle_count
    assert early.is_leaf.sum() < 0.8 * plain.is_leaf.sum()


def test_depths():
    mesh = SCENES["random_triangles"]()
    area = area_of(mesh, "plane")
    deep, _ = build(mesh, area, width=2, max_leaf_triangles=1)
    flat, _ = build(mesh, area, width=2, max_leaf_triangles=1, max_depth=10)
    assert flat.depth <= 10 < deep.depth
    unaware, _ = build(mesh, area, width=2, aware_depth=0)
    surface, _ = build(mesh, area, AxisChoice("longest", 1.0, 9.0, 0.0), width=2, others=1.0)
    np.testing.assert_array_equal(unaware.primitive.numpy()[:2], surface.primitive.numpy()[:2])


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"areas": ()}, ValueError, "areas is empty"),
        ({"areas": ("sun",)}, TypeError, "areas must hold wrt.known_rays.PlaneInfluenceArea"),
        ({"shares": (1.0, 2.0)}, ValueError, "shares is .* 1 numbers above 0"),
        ({"shares": (0.0,)}, ValueError, "shares"),
        ({"others": 1.5}, ValueError, "others is 1.5"),
        ({"others": float("nan")}, ValueError, "others"),
        ({"cost": "pha"}, ValueError, "cost 'pha' is unknown; choose from pah, sah"),
        ({"axes": "x"}, ValueError, "axes 'x' is unknown; choose from all, longest, facing, in_turn"),
        ({"triangle_cost": 1.0, "block_cost": 1.0}, ValueError, "leave one out"),
        ({"triangle_cost": -1.0}, ValueError, "costs must be finite"),
        ({"leaf_area": -1.0}, ValueError, "leaf_area is -1.0"),
        ({"max_depth": 0}, ValueError, "max_depth is 0"),
        ({"aware_depth": -1}, ValueError, "aware_depth is -1"),
        ({"bins": 41}, ValueError, "bins is 41"),
        ({"width": 3}, ValueError, "width is 3"),
    ],
)
def test_bad_descriptions(change, error, message):
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 0), direction=(0, 0, 1), width=1, height=1, depth=1)
    with pytest.raises(error, match=message):
        wrt.known_rays.ProjectedBvh(**{"areas": (area,)} | change)


@pytest.mark.parametrize(
    "change", [{"order": "first"}, {"least_quality": 2.0}, {"acceptable": -1.0}, {"excellent": float("nan")}]
)
def test_bad_axis_choices(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        AxisChoice(**change)


def test_the_published_description():
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, wrt.known_rays.ProjectedBvh.published(area_of(mesh, "plane"), aware_depth=20))
    assert scene.tree.width == 2
    assert unpack(scene.tree).triangles.max() <= 2
    assert scene.accelerator.aware_depth == 20
    assert scene.accelerator.config(8).axes == AxisChoice("facing", 0.4, 1.3, 0.9)
    assert scene.statistics().tree.nodes > 100
    assert wp.get_device("cpu") == scene.tree.bounds.device or scene.device.is_cuda
