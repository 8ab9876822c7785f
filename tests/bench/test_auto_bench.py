"""`wrt bench auto`: its cases, and the table of choices."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

import wrt
from wrt.bench.commands.benchmark import bench
from wrt.bench.comparisons import auto_choices
from wrt.bench.comparisons.auto_cases import BEAMS, KINDS, cases, city, scene_of
from wrt.kernels.traversal.packet import CULLINGS


@pytest.fixture(scope="module")
def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=2)


def test_cases(teapot):
    found = {case.kind: case for case in cases(teapot, sizes=(16,))}
    assert tuple(found) == KINDS
    assert found["scan"].rays.directions.shape == (BEAMS, 4, 3)
    assert found["scan"].rays_count == 256
    assert found["view"].rays_count == found["random"].rays_count == 256
    assert 0 < found["shadow"].rays_count == found["ao"].rays_count < 256
    assert [kind for kind, case in found.items() if case.is_occlusion] == ["shadow", "ao"]


def test_a_city_is_of_closed_houses_on_a_ground():
    mesh = city(3)
    assert mesh.triangle_count == 9 * 12 + 2
    houses = wrt.TriangleMesh(mesh.vertices[:-4], mesh.faces[:-2])
    assert houses.is_closed
    assert houses.to_trimesh().volume > 0.0


def test_world_and_instances_are_the_same_triangles(teapot):
    (one, mesh), (many, flat) = scene_of("world", teapot), scene_of("instances", teapot)
    assert len(many.instances) == 11
    assert not one.instances
    assert mesh.triangle_count == flat.triangle_count == one.triangle_count == many.triangle_count


def test_command(tmp_path, monkeypatch):
    """One culling, so that few kernels are compiled; the best engine is at most as slow as the one that was chosen."""
    monkeypatch.setattr(auto_choices, "CULLINGS", {"transient_frustum": CULLINGS["transient_frustum"]})
    target = tmp_path / "auto.json"
    arguments = ["auto", "teapot", "--scene", "model", "--kind", "view", "--size", "64", "--rounds", "1", "--json", target]
    done = CliRunner().invoke(bench, [*map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert "1 cases: " in done.output
    (row,) = json.loads(target.read_text())["choices"]
    assert row["rays"] == 4096
    assert row["ratio"] >= 1.0
    assert row["best"] in row["milliseconds"]
    assert row["auto"] in row["milliseconds"]


def test_sizes_divide_into_tiles():
    done = CliRunner().invoke(bench, ["auto", "teapot", "--size", "18"])
    assert done.exit_code == 2
    assert "multiple of 4" in done.output
