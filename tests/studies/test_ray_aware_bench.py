"""`python -m studies ray-aware` and the experiments on known rays: complete, and consistent. Times are not checked."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from studies.__main__ import studies
from studies.known_rays import ray_aware_comparison as ray_aware
from studies.known_rays import ray_distribution
from studies.known_rays.affinity import compare_work
from studies.known_rays.node_searches import AxisOrders, Searches
from studies.known_rays.ray_cases import DIRECTIONS, SCENES, TREES, Case, cases
from wrt.builders.bvh.phases.split_axes import AxisChoice

SMALL = wrt.scenes.random_triangles(count=300, size=0.2)


@pytest.mark.parametrize("kind", ["plane", "point"])
def test_rays_of_a_case_are_of_its_area(kind):
    """They leave the window evenly, and all that belong to a wall hit it."""
    for way in DIRECTIONS:
        case = Case("walls", SCENES["walls"](), kind, way)
        rays = case.rays(256)
        assert wrt.Scene(case.mesh).intersect(rays, traversal="single").is_hit.all()
        scene = wrt.Scene(case.mesh, wrt.known_rays.RayAwareBvh(areas=[case.area]))
        assert wrt.known_rays.break_even(scene, rays).unassigned_share == 0.0


def test_scenes():
    meshes = {name: make() for name, make in SCENES.items()}
    assert meshes["random 100"].triangle_count == 100
    assert all(np.isfinite(mesh.vertices).all() and mesh.face_normals.any(axis=1).all() for mesh in meshes.values())
    assert len([*cases(("cottage",))]) == 8


def test_measure():
    """Projected areas foresee the cost of these rays and surface areas do not; the reference is as fast as itself."""
    case = Case("random", SMALL, "plane", "parallel")
    rows = ray_distribution.measure([case], rays=512)
    assert [row["tree"] for row in rows] == [*TREES]
    errors = ray_distribution.average(rows, "error", "tree")
    assert errors["PAH + SPFH",] < 0.03 < errors["SAH + LSPH",]
    assert errors["PAH + SPFH",] < ray_distribution.average(rows, "error_unclipped", "tree")["PAH + SPFH",]
    key = ("random", "plane", "parallel")
    assert ray_distribution.faster(rows, "SAH + LSPH") == {key: 0.0}
    assert ray_distribution.faster(rows, "PAH + SPFH")[key] > 0.0
    for row in rows:
        assert row["cost"] == pytest.approx(row["boxes"] + 1.2 * row["triangles"])
        assert row["stopping"] <= row["cost"]
        assert 0.0 <= row["overlap"] <= 1.0
        assert len(row["overlaps"]) == row["depth"] + 1


def test_axis_tries():
    """All three are tried if all are asked for; with the strictest thresholds, those of enough quality and the longest."""
    case = Case("random", SMALL, "plane", "oblique")
    tries = {}
    for name, axes in {"all": "all", "strict": AxisChoice("facing", 1.0, 0.0, 0.0)}.items():
        tries[name] = ray_distribution.axis_tries(wrt.Scene(SMALL, wrt.known_rays.ProjectedBvh.published(case.area, axes=axes)))
    assert tries["all"] == (3.0, 0.0)
    assert tries["strict"] == pytest.approx((1.0, 1.0), rel=1e-12)
    rows = ray_distribution.sweep([Case("random", SMALL, "plane", "15 degrees")], rays=64)
    assert rows[1]["tried"] > rows[0]["tried"] > rows[2]["tried"]
    assert rows[1]["fallback"] < rows[0]["fallback"] < rows[2]["fallback"]


def test_balances():
    """An area pays by the count if it settles more than the break-even share, whatever share it settles."""
    rows = ray_distribution.balances([Case("random", SMALL, "point", "15 degrees")], rays=256)
    assert len(rows) > 2
    assert rows[0]["settled"] < rows[-1]["settled"] == 1.0
    for row in rows:
        assert (row["saved"] > 0.0) == (row["settled"] > row["break_even"])


def test_top_levels():
    """Octrees list too many areas, less so the deeper they are, and rays find the same ones."""
    rows = ray_distribution.top_levels((6,), (0, 2, 4), rays=512, rounds=1)
    errors = [row["error"] for row in rows]
    assert errors[0] > errors[1] > errors[2] > 0.0
    assert rows[0]["cells"] == 1 < rows[1]["cells"] < rows[2]["cells"]
    areas = ray_distribution.random_areas(6)
    found = [ray_distribution.Finder(areas, depth, 512).find() for depth in (0, 4)]
    np.testing.assert_array_equal(*found)
    assert (found[0] < 6).any()


def test_memory():
    one, many = ray_distribution.memory([Case("random", SMALL, "plane", "oblique")], (1, 4), depth=2)
    assert one["whole"] == many["whole"]
    assert one["ratio"] > 1.0
    assert many["local"] > 0 < many["top"]


def test_outlines_are_in_the_window():
    """The root's outline, of a scene that is wholly in the window, is twelve edges within it."""
    case = Case("random", SMALL, "point", "parallel")
    found = wrt.known_rays.analyse(ray_distribution.scene_of(case, "PAH + SPFH"), ray_distribution.unclipped(case.area))
    edges = ray_distribution.outlines(found, case.area, 0)
    assert edges.shape == (12, 2, 2)
    assert 1.0 < (np.abs(edges) / ray_distribution.half_window(case.area)).max() < 2.0  # the window shows nine tenths of it
    seen = ray_distribution.picture(case, 16)
    assert np.isfinite(seen).any()
    assert np.nanmax(seen) <= 1.0 + 1e-6


def test_searches_find_what_the_build_finds():
    """The same planes again, and by projected areas others than by surface areas."""
    area = Case("random", SMALL, "plane", "oblique").area
    for accelerator in (wrt.Bvh(), wrt.known_rays.ProjectedBvh(areas=area)):
        nodes = Searches(SMALL, 75, accelerator)
        np.testing.assert_array_equal(nodes.run(), nodes.nodes.numpy()["plane"]["cost"])
        assert nodes.count == 4
        assert np.isfinite(nodes.run()).all()


@pytest.mark.parametrize("kind", ["plane", "point"])
def test_axis_orders_are_those_of_the_thesis(kind):
    """By the sides of boxes, and by the rays at their centres, against float64; the times are those of a node each."""
    area = Case("random", SMALL, kind, "oblique").area
    boxes = wrt.known_rays.analyse(wrt.Scene(SMALL, wrt.Bvh(width=2), device="cpu")).boxes
    expected = {"longest": np.argsort(-(boxes.high - boxes.low), axis=1, kind="stable")}
    rays = 0.5 * (boxes.low + boxes.high) - np.array(area.position) if kind == "point" else np.array([area.direction])
    shares = np.abs(rays) / np.abs(rays).sum(axis=1, keepdims=True)
    expected["facing"] = np.broadcast_to(np.argsort(shares, axis=1, kind="stable"), boxes.low.shape)
    for order, axes in expected.items():
        found = AxisOrders(SMALL, area, order, repeats=2).run()
        assert (found == axes).all(axis=1).mean() > 0.99, "but for ties"
        assert len(np.unique(found, axis=0)) > (1 if order == "longest" or kind == "point" else 0)
    figures = ray_aware.compare_axis_orders(SMALL, area, "random", rounds=1)
    assert [(figure.question, figure.contender) for figure in figures] == [("axes", "longest"), ("axes", "facing")]
    assert figures[0].items % len(boxes.low) == 0


def test_work_of_trees():
    """A row for each workload, tree and way; packets of a camera share what they test."""
    rows = compare_work(wrt.scenes.build("teapot", level=4, ground=False), size=32)
    work = {(row["rays"], row["traversal"], row["tree"]): row["boxes"] + row["triangles"] for row in rows}
    assert len(work) == len(rows) == 6 * 2 * 2
    assert all(amount > 0.0 for amount in work.values())
    for tree in ("Bvh", "ProjectedBvh"):
        assert work["camera", "packet", tree] < 0.5 * work["camera", "single", tree]


def test_command(tmp_path):
    file = tmp_path / "figures.json"
    options = ["--size", "8", "--rounds", "1", "--threads", "1", "--traversal", "single", "--json", str(file)]
    result = CliRunner().invoke(studies, ["ray-aware", "random_triangles", *options])
    assert result.exit_code == 0, result.output
    figures = json.loads(file.read_text())["figures"]
    assert {figure["question"] for figure in figures} == {"search", "build", "trace", "affinity"}
    traced = [figure for figure in figures if figure["question"] == "trace"]
    assert len(traced) == 24
    assert len({figure["subject"] for figure in traced}) == 6
    for figure in figures:
        assert (figure["work"] is None) == (figure["question"] != "trace")
        assert figure["seconds"] > 0.0
        if figure["contender"] == "Bvh":
            assert figure["ratio"] == 1.0
            assert figure["work"] in (None, 1.0)
