"""The kd-tree of influence areas: no area is lost, planes of least cost, bounds, and its cells as tables and boxes."""

from __future__ import annotations

import json

import numpy as np
import pytest
import warp as wp
from support.known_areas import areas_of, random_areas
from support.meshes import SCENES

import wrt
from wrt.builders.influence import area_octree as octree
from wrt.builders.influence.area_kdtree import SAVING, FacePlanes
from wrt.builders.influence.area_top_level import TopLevel, region_of
from wrt.builders.influence.regions import contain_points
from wrt.viewer.trees.area_boxes import octree_boxes

LOW, HIGH, CENTER = np.full(3, 10.0), np.full(3, 14.0), np.full(3, 12.0)


def top_level(areas, depth: int, is_kdtree: bool = True) -> TopLevel:
    regions = [region_of(area, LOW, HIGH) for area in areas]
    return TopLevel(areas, regions, 1e-5, depth, 0.1, CENTER, wp.get_device("cpu"), is_kdtree)


def upright_areas(count: int) -> list:
    """Rooms: areas along the axes, whose boxes are their regions."""
    rng = np.random.default_rng(3)
    return [
        wrt.known_rays.PlaneInfluenceArea(
            position=rng.uniform(LOW, HIGH), direction=(0, 0, -1), up=(0, 1, 0), width=w, height=h, depth=d
        )
        for w, h, d in rng.uniform(0.1, 0.8, (count, 3))
    ]


def test_no_area_is_lost():
    """Against all regions in float64, also at corners and on edges of regions; with depth, fewer others are listed."""
    areas = random_areas(20, LOW, HIGH) + upright_areas(5)
    regions = [region_of(area, LOW, HIGH) for area in areas]
    rng = np.random.default_rng(5)
    corners = np.concatenate([region.corners for region in regions])
    edges = corners[rng.integers(0, len(corners), 2000)] * 0.5 + corners[rng.integers(0, len(corners), 2000)] * 0.5
    points = np.concatenate([rng.uniform(LOW - 3, HIGH + 3, (20000, 3)), corners, edges])
    inside = contain_points(regions, points)
    assert inside.any(axis=0).all()
    listed = []
    for depth in (1, 3, 5):
        candidates = top_level(areas, depth).candidates(points)
        assert (candidates | ~inside).all()
        listed.append(candidates[:20000].sum() / inside[:20000].sum())
    assert listed[0] > listed[1] > listed[2]
    assert listed[2] < 2.5
    outside = np.concatenate([points + 1e3, np.full((1, 3), np.nan)])
    assert not top_level(areas, 2).candidates(outside).any()


def test_upright_areas_are_told_apart():
    """Planes at the faces of rooms tell all points apart exactly; octants never do."""
    areas = upright_areas(12)
    points = np.random.default_rng(0).uniform(LOW, HIGH, (5000, 3))
    inside = contain_points([region_of(area, LOW, HIGH) for area in areas], points)
    kdtree, octants = top_level(areas, 6), top_level(areas, 6, is_kdtree=False)
    np.testing.assert_array_equal(kdtree.candidates(points), inside)
    assert (octants.candidates(points) & ~inside).any()
    assert kdtree.cells < octants.cells / 4


def test_planes_cost_least():
    """The plane of each cell, against the cost of each face by the definition."""
    areas = upright_areas(12)
    structs = [region_of(area, LOW, HIGH).struct(CENTER, 0.0) for area in areas]
    low, high = (np.array([getattr(struct, name) for struct in structs]) for name in ("low", "high"))
    cells = octree.Cells(
        np.array([[-2.0, -2, -2], [-1.0, -2, 0]]),
        np.array([[2.0, 2, 2], [1.0, 0, 2]]),
        np.array([0, 12, 19]),
        np.concatenate([np.arange(12), np.arange(7)]).astype(np.int32),
        np.ones(2, dtype=bool),
    )
    axes, planes = FacePlanes(structs).choose(cells, np.array([0, 1]))
    for number in range(2):
        ids = cells.area[cells.begin[number] : cells.begin[number + 1]]
        start, size = cells.low[number], cells.high[number] - cells.low[number]

        def cost(axis: int, x: float, ids=ids, start=start, size=size) -> float:
            share = (x - start[axis]) / size[axis]
            return share * (low[ids, axis] < x).sum() + (1 - share) * (high[ids, axis] > x).sum()

        faces = [(axis, x) for axis in range(3) for x in np.concatenate([low[ids, axis] - 1e-9, high[ids, axis] + 1e-9])]
        best = min(cost(axis, x) for axis, x in faces if start[axis] < x < start[axis] + size[axis])
        assert best < (1 - SAVING) * len(ids)
        assert cost(axes[number], planes[number]) == pytest.approx(best, rel=1e-6)


def test_slices_and_bounds(monkeypatch):
    areas = random_areas(30, LOW, HIGH)
    top = top_level(areas, 4)
    monkeypatch.setattr(octree, "SLICE_PAIRS", 100)
    again = top_level(areas, 4)
    for name in ("child", "plane", "begin", "area"):
        np.testing.assert_array_equal(getattr(top.struct, name).numpy(), getattr(again.struct, name).numpy())
    monkeypatch.setattr(octree, "MAX_BYTES", 100_000)
    with pytest.raises(ValueError, match=r"kd-tree over 30 influence areas .* pass depth=\d to .* or top_level='array'"):
        top_level(areas, 8)


def test_cells_as_tables_and_boxes(tmp_path):
    """Every leaf lists what a look-up in its middle finds; leaves fill the root."""
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(
        mesh, wrt.known_rays.RayAwareBvh(areas=areas_of(mesh), top_level="kdtree", depth=3, local=wrt.Bvh()), device="cpu"
    )
    found, top = wrt.known_rays.analyse_octree(scene), scene.state.area_trees.top
    volume = np.prod(found.high - found.low, axis=1)
    assert volume[found.is_leaf].sum() == pytest.approx(volume[0])
    assert found.level.max() <= 9 < len(found.level)
    middle = (found.low + found.high)[found.is_leaf] / 2
    numbers = np.array(scene.state.area_trees.numbers)
    expected = [tuple(numbers[row]) for row in top.candidates(middle)]
    assert expected == [one for one in found.areas if one is not None]
    inner = np.arange(1, len(found.level))
    assert (found.low[inner] >= found.low[found.parent[inner]]).all()
    found.save_json(tmp_path / "tree.json")
    assert len(json.loads((tmp_path / "tree.json").read_text())["cells"]) == top.cells
    boxes = octree_boxes(top)
    assert len(boxes.low) == top.cells
    np.testing.assert_allclose(boxes.low + scene.center, found.low)
    np.testing.assert_array_equal(boxes.is_leaf, found.is_leaf)
