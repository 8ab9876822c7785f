"""Measures of trees: expected cost against counted cost, overlap against a polygon library, tables and files, bad input."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.known_areas import AREA_KINDS, area_of, picture, rays_of, window
from support.meshes import SCENES

import wrt
from studies.known_rays.ray_distribution import random_areas, stretched
from wrt.builders.bvh.bvh_statistics import unpack

shapely = pytest.importorskip("shapely", reason="shapely is not installed: pip install 'wrt[test-all]'")


@pytest.mark.parametrize("kind", AREA_KINDS)
@pytest.mark.parametrize(("name", "width"), [("atrium", 8), ("wood", 8), ("random_triangles", 8)])
def test_expected_cost_is_what_is_counted(name, width, kind):
    """Rays of the area, followed through all they meet, cost what projected areas say, on a tree built for them or not."""
    mesh = SCENES[name]()
    area = area_of(mesh, kind)
    rays = wrt.Rays(*rays_of(area, 60_000))
    for tree in (wrt.Bvh(width=width), wrt.known_rays.ProjectedBvh(areas=area, width=width)):
        found = wrt.known_rays.analyse(wrt.Scene(mesh, tree), area, rays)
        assert found.passing.rays > 1000
        assert found.error <= 0.02
        assert found.expected_boxes == pytest.approx(found.passing.boxes, rel=0.03)
        assert found.expected_triangles == pytest.approx(found.passing.triangles, rel=0.06)
        assert found.stopping.cost <= found.passing.cost
        assert 0.0 < found.hit_share <= found.passing.share


def test_surface_areas_expect_lines_in_all_directions():
    """Without an area: rays through the scene from all sides, spread evenly over lines, cost what surface areas say."""
    mesh = SCENES["random_triangles"]()
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    aside = rng.normal(size=directions.shape)
    aside -= (aside * directions).sum(axis=1, keepdims=True) * directions
    aside *= np.sqrt(rng.random((20_000, 1))) / np.linalg.norm(aside, axis=1, keepdims=True)
    radius = np.linalg.norm(np.ptp(mesh.bounds, axis=0)) / 2
    rays = wrt.Rays(mesh.bounds.mean(axis=0) + radius * (aside - 2 * directions), directions)
    scene = wrt.Scene(mesh, wrt.Bvh(width=8))
    found = wrt.known_rays.analyse(scene, rays=rays, box_cost=1 / 8, triangle_cost=0.0)
    assert found.error <= 0.02


@pytest.mark.parametrize("kind", ["plane", "point inside"])
@pytest.mark.parametrize("width", [2, 8])
def test_boxes_and_overlaps(kind, width):
    """Every row, worked out again with the polygon library: areas, parents, levels, what pictures of siblings share."""
    mesh = wrt.scenes.build("random_triangles", count=120, size=0.3, seed=8)
    area = area_of(mesh, kind)
    scene = wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(areas=area, width=width))
    boxes = wrt.known_rays.analyse(scene, area).boxes
    half = window(area)
    frame = shapely.box(-half[0], -half[1], half[0], half[1])
    shown = [picture(area, a, b).intersection(frame) for a, b in zip(boxes.low, boxes.high, strict=True)]
    scale = max(p.area for p in shown)
    np.testing.assert_allclose(boxes.area, [p.area for p in shown], rtol=1e-3, atol=1e-4 * scale)
    np.testing.assert_allclose(boxes.hit_probability, boxes.area / boxes.area[0])
    assert boxes.triangles.sum() == mesh.triangle_count
    assert len(boxes.level) == 1 + (unpack(scene.tree).is_leaf | unpack(scene.tree).is_inner).sum()
    for i in range(1, len(boxes.level)):
        parent = boxes.parent[i]
        assert boxes.level[i] == boxes.level[parent] + 1
        assert (boxes.low[i] >= boxes.low[parent]).all()
        assert (boxes.high[i] <= boxes.high[parent]).all()
    sums = np.zeros((boxes.level.max() + 1, 2))
    for node in np.flatnonzero(~boxes.is_leaf):
        children = np.flatnonzero(boxes.parent == node)
        for n, i in enumerate(children):
            for j in children[:n]:
                sums[boxes.level[i]] += shown[i].intersection(shown[j]).area, min(shown[i].area, shown[j].area)
    expected = [shared / smaller if smaller > 0 else np.nan for shared, smaller in sums]
    np.testing.assert_allclose(boxes.overlap_by_level(), expected, rtol=5e-3, atol=1e-3)
    assert np.nanmax(boxes.overlap) <= 1.0


def test_costs_add_up():
    mesh = SCENES["teapot"]()
    area = area_of(mesh, "point")
    found = wrt.known_rays.analyse(wrt.Scene(mesh, wrt.Bvh(width=4)), area, box_cost=0.5, triangle_cost=2.0)
    assert found.expected_cost == pytest.approx(0.5 * found.expected_boxes + 2.0 * found.expected_triangles)
    assert found.expected_cost == pytest.approx(sum(level["expected cost"] for level in found.levels))
    assert (found.passing, found.error, found.hit_share) == (None, None, None)


def test_an_area_that_sees_nothing():
    """Every box is as likely as the root, and no siblings overlap."""
    mesh = SCENES["teapot"]()
    away = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 1e3), direction=(0, 0, 1), width=1, height=1, depth=1)
    found = wrt.known_rays.analyse(wrt.Scene(mesh), away)
    assert (found.boxes.hit_probability == 1.0).all()
    assert found.summary()["sibling overlap"] is None


def test_files(tmp_path):
    """What is written is what is told, in JSON and in CSV."""
    mesh = SCENES["teapot"]()
    area = area_of(mesh, "plane")
    found = wrt.known_rays.analyse(
        wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(areas=area, width=8)), area, wrt.Rays(*rays_of(area, 500))
    )
    found.save_json(tmp_path / "tree.json")
    read = json.loads((tmp_path / "tree.json").read_text())
    assert read == found.to_dict()
    assert list(read) == ["tree", "levels", "boxes"]
    assert read["tree"]["nodes"] == sum(level["nodes"] for level in read["levels"])
    assert read["tree"]["passing"]["rays"] <= 500
    found.save_csv(tmp_path / "tree.csv")
    with (tmp_path / "tree.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.boxes.level) == len(read["boxes"])
    np.testing.assert_array_equal([float(row["hit_probability"]) for row in rows], found.boxes.hit_probability)
    assert rows[0]["parent"] == "-1"
    assert {row["overlap"] == "" for row in rows if row["leaf"] == "True"} == {True}


def volume(boxes) -> np.ndarray:
    return (boxes.high - boxes.low).prod(axis=1)


def test_statistics_of_ones_own(tmp_path):
    """They stand in rows, levels and files beside the others."""
    scene = wrt.Scene(SCENES["teapot"](), wrt.Bvh(width=4))
    found = wrt.known_rays.analyse(scene, statistics={"volume": volume, "level twice": lambda boxes: 2 * boxes.level})
    np.testing.assert_array_equal(found.statistics["volume"], volume(found.boxes))
    assert [row["level twice"] for row in found.rows()] == [2 * row["level"] for row in found.rows()]
    assert found.levels[0]["volume"] == found.rows()[0]["volume"]
    assert sum(level["volume"] for level in found.levels) == pytest.approx(sum(row["volume"] for row in found.rows()))
    found.save_csv(tmp_path / "tree.csv")
    assert (tmp_path / "tree.csv").read_text().splitlines()[0].endswith(",volume,level twice")
    with pytest.raises(ValueError, match="choose another name"):
        wrt.known_rays.analyse(scene, statistics={"cost": volume})
    with pytest.raises(ValueError, match=r"statistics\['all'\] returned the shape \(\); it must return"):
        wrt.known_rays.analyse(scene, statistics={"all": lambda boxes: boxes.cost.sum()})


def test_trees_of_areas():
    """Each area's tree is measured for the area's rays; the work is that which the break-even analysis counts."""
    mesh = SCENES["atrium"]()
    areas = [area_of(mesh, "plane"), area_of(mesh, "point")]
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas))
    parts = [rays_of(area, 2000) for area in areas]
    rays = wrt.Rays(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    found = wrt.known_rays.analyse_areas(scene, rays, statistics={"volume": volume})
    assert len(found) == len(scene.state.area_trees) == 2
    for analysis, state, area in zip(found, scene.state.area_trees.scenes, areas, strict=True):
        assert analysis.bytes == state.tree.bytes
        assert analysis.statistics["volume"][0] > 0.0
        assert 0 < analysis.passing.rays <= 4000
        assert analysis.stopping.cost <= analysis.passing.cost
        alone = wrt.known_rays.analyse(wrt.Scene(mesh, wrt.known_rays.ProjectedBvh(areas=area)), area)
        assert analysis.boxes.hit_probability[0] == alone.boxes.hit_probability[0] == 1.0
    assert sum(round(a.passing.rays / a.passing.share) for a in found) <= 4000
    assert all(a.passing is None and a.expected_cost > 0.0 for a in wrt.known_rays.analyse_areas(scene))
    with pytest.raises(ValueError, match="no influence areas"):
        wrt.known_rays.analyse_areas(wrt.Scene(mesh))
    with pytest.raises(TypeError, match=r"rays must be a wrt\.Rays"):
        wrt.known_rays.analyse_areas(scene, rays=(0, 0, 0))


def test_bad_input():
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh)
    with pytest.raises(ValueError, match="scene has a kdtree"):
        wrt.known_rays.analyse(SimpleNamespace(tree=None, accelerator=wrt.KdTree()))
    with pytest.raises(TypeError, match=r"rays must be a wrt\.Rays, not tuple"):
        wrt.known_rays.analyse(scene, rays=((0, 0, 0), (0, 0, 1)))
    with pytest.raises(TypeError, match=r"area must be .* not str"):
        wrt.known_rays.analyse(scene, "sun")
    with pytest.raises(ValueError, match="rays is empty"):
        wrt.known_rays.analyse(scene, rays=wrt.Rays(np.zeros((0, 3)), np.zeros((0, 3))))
    for name in ("box_cost", "triangle_cost"):
        with pytest.raises(ValueError, match=f"{name} is -1"):
            wrt.known_rays.analyse(scene, **{name: -1})


def test_octree_cell_by_cell(tmp_path):
    """Cells tile the root, leaves list what a look-up finds at any point, and files hold the same."""
    mesh = wrt.scenes.build("teapot", level=3)
    areas = random_areas(9)
    low, high = mesh.bounds
    areas = [stretched(area, low, high) for area in areas]
    nowhere = replace(areas[0], position=high + 50.0 * (high - low))
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[nowhere, *areas], top_level="octree", depth=3))
    found, top = wrt.known_rays.analyse_octree(scene), scene.state.area_trees.top
    assert len(found.level) == top.cells
    assert 0 not in {number for one in found.areas if one for number in one}, "no triangle is in the first area"
    volume = (found.high - found.low).prod(axis=1)
    assert volume[found.is_leaf].sum() == pytest.approx(volume[0])
    inner = np.flatnonzero(found.parent >= 0)
    assert (found.low[inner] >= found.low[found.parent[inner]] - 1e-9).all()
    assert (found.level[inner] == found.level[found.parent[inner]] + 1).all()
    leaves = np.flatnonzero(found.is_leaf)
    listed = top.candidates(0.5 * (found.low + found.high)[leaves])
    for leaf, row in zip(leaves, listed, strict=True):
        assert found.areas[leaf] == tuple(scene.state.area_trees.numbers[place] for place in np.flatnonzero(row))
    assert [row["cells"] for row in found.levels] == np.bincount(found.level).tolist()
    rectangles, counts = found.cut(2, float(found.low[0, 2] + 0.4 * (found.high - found.low)[0, 2]))
    area = (rectangles[:, 1] - rectangles[:, 0]).prod(axis=1)
    assert area.sum() == pytest.approx((found.high - found.low)[0, :2].prod())
    assert counts.max() > 1
    found.save_json(tmp_path / "octree.json")
    written = json.loads((tmp_path / "octree.json").read_text())
    assert written == found.to_dict()
    assert len(written["cells"]) == top.cells
    array = wrt.known_rays.analyse_octree(wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=areas, top_level="array")))
    assert array.areas == (tuple(range(9)),)
    with pytest.raises(ValueError, match="axis is 3"):
        found.cut(3, 0.0)
    with pytest.raises(ValueError, match="no influence areas"):
        wrt.known_rays.analyse_octree(wrt.Scene(mesh))
