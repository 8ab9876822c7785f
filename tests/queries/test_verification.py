"""`Scene.verify` and `wrt verify`: nothing wrong where nothing is, and planted faults are found."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import trimesh
import warp as wp
from click.testing import CliRunner
from support.bodies import BODIES, PLACES, placed

import wrt
from wrt.cli import main
from wrt.query import verification

TEAPOT = wrt.scenes.build("teapot", level=4, ground=False)


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
def test_nothing_is_wrong(scene_mesh, tree, device):
    report = wrt.Scene(scene_mesh, tree, device=device).verify(400)
    assert report.ok, str(report)
    assert report.rays == dict.fromkeys(verification.KINDS, 100)
    assert sum(report.hits.values()) > 100
    assert 0.0 < report.t_error < 1e-5
    assert not report.faults
    assert sum(report.undecided.values()) < 100


@pytest.mark.parametrize("place", PLACES)
def test_scales_and_places(place):
    for body in ("box", "ellipsoid", "slab"):
        report = wrt.Scene(placed(BODIES[body], place)).verify(200, seed=2)
        assert report.ok, f"{body}: {report}"


def test_reference_by_hand():
    """On a square of two triangles: inside, on the diagonal, at a corner, beside, behind, along the plane."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    origins = np.array([[0.75, 0.25, 2], [0.5, 0.5, 2], [1, 1, 2], [1.01, 0.5, 2], [0.2, 0.8, -2], [-1, 0.5, 0]])
    directions = np.array([[0, 0, -1.0]] * 5 + [[1.0, 0, 0]])
    triangle, t = verification.nearest64(vertices, faces, origins, directions)
    np.testing.assert_array_equal(triangle, [0, 0, 0, -1, -1, -1])
    np.testing.assert_array_equal(t, [2, 2, 2, np.inf, np.inf, np.inf])


def test_finds_a_node_that_is_too_small():
    """The box of one of the root's children shrinks to a third."""
    scene = wrt.Scene(TEAPOT, device="cpu")
    width = scene.tree.width
    bounds = scene.tree.bounds.numpy().reshape(-1, 6, width)
    lane = np.argmax(np.where(np.isfinite(bounds[0, 0]), (bounds[0, 3:] - bounds[0, :3]).prod(axis=0), -1))
    low, high = bounds[0, :3, lane].copy(), bounds[0, 3:, lane].copy()
    assert (low < high).all()
    bounds[0, :3, lane] = (2 * low + high) / 3
    bounds[0, 3:, lane] = (low + 2 * high) / 3
    scene.tree.bounds.assign(bounds.ravel())
    report = scene.verify(400)
    assert not report.ok
    assert sum(report.misses.values()) > 3
    assert sum(report.false_hits.values()) == 0
    fault = report.faults[0]
    assert fault.kind == "miss"
    hits = wrt.Scene(TEAPOT, device="cpu").intersect(fault.origin, fault.direction)  # to be looked at
    assert hits.primitive_id == fault.expected != fault.triangle
    assert "WRONG" in str(report)
    assert "miss: triangle" in str(report)


def test_finds_records_that_are_wrong():
    """Triangles that the records place a little beside where the mesh has them: false hits, and misses beside."""
    scene = wrt.Scene(TEAPOT, device="cpu")
    scene.verify(4)  # makes the records
    for _, blocks in scene.state.cache.records.values():
        records = blocks.records.numpy().copy()
        records += np.float32(0.01)
        blocks.records.assign(records)
    report = scene.verify(400)
    assert sum(report.false_hits.values()) > 10
    assert sum(report.misses.values()) > 0


def test_finds_a_single_wrong_record():
    """One triangle of a box is moved away: rays through it miss, and hit it where it is not."""
    scene = wrt.Scene(BODIES["box"], device="cpu")
    scene.verify(4)
    for _, blocks in scene.state.cache.records.values():
        width = scene.tree.width
        records = blocks.records.numpy().reshape(-1, 9, width).copy()
        lane = int(np.flatnonzero(blocks.primitive.numpy()[:width] == 3)[0])
        records[0, :, lane] = records[0, :, lane] * 0.5
        blocks.records.assign(records.ravel())
    report = scene.verify(400)
    assert sum(report.misses.values()) > 0
    assert sum(report.false_hits.values()) > 0
    assert {fault.expected for fault in report.faults if fault.kind == "miss"} <= {3}


def test_finds_a_test_that_leaks(monkeypatch):
    """Rays at vertices are lost: as by a test that is not watertight."""
    scene = wrt.Scene(BODIES["icosphere"], device="cpu")
    truth = verification.closest_hits

    def leaky(state, rays, query):
        hits = truth(state, rays, query)
        weights = np.column_stack([1 - hits.uv.sum(axis=1), hits.uv])
        lost = (weights > 0.99999).any(axis=1) & hits.is_hit
        assert lost.any()
        hits.batch.primitive.numpy()[lost] = -1
        hits.t[lost] = np.inf
        return hits

    monkeypatch.setattr(verification, "closest_hits", leaky)
    report = scene.verify(400)
    assert report.misses["vertices"] > 10
    assert report.misses["random"] == report.misses["edges"] == 0


def test_finds_that_moeller_and_trumbore_leak():
    """A test that is not watertight, on a body whose edges it loses; the default one holds on the same rays."""
    report = wrt.Scene(BODIES["ellipsoid"], triangle_test="moeller_trumbore", device="cpu").verify(1000)
    assert report.misses["vertices"] > 5
    assert report.misses["edges"] > 5
    assert report.misses["random"] == 0
    assert wrt.Scene(BODIES["ellipsoid"], device="cpu").verify(4000).ok


def test_finds_occlusion_that_disagrees(monkeypatch):
    scene = wrt.Scene(BODIES["icosphere"], device="cpu")
    truth = verification.ray_values
    monkeypatch.setattr(verification, "ray_values", lambda *asked: np.zeros_like(truth(*asked)))
    assert scene.verify(40).misses["random"] > 3
    monkeypatch.setattr(verification, "ray_values", lambda *asked: np.ones_like(truth(*asked)))
    assert scene.verify(400).false_hits["random"] > 3


def test_any_wrong_answer_is_not_ok():
    """Misses and false hits of each kind of rays count: without the false hits, no test failed."""
    right = wrt.Scene(TEAPOT, device="cpu").verify(4)
    assert right.ok
    for name in ("misses", "false_hits"):
        for kind in right.rays:
            wrong = dataclasses.replace(right, **{name: getattr(right, name) | {kind: 1}})
            assert not wrong.ok
            assert "answers are WRONG" in str(wrong)


def test_what_is_in_the_mesh():
    """Each sort of triangle that rays may stumble over, one at a time."""
    box = BODIES["box"]

    def sorts(vertices, faces):
        return {
            sort: (number, marked.sum())
            for sort, (number, marked) in verification.triangle_defects(wrt.TriangleMesh(vertices, faces)).items()
        }

    names = list(sorts(box.vertices, box.faces))
    assert set(sorts(box.vertices, box.faces).values()) == {(0, 0)}
    assert sorts(box.vertices, box.faces[1:])[names[0]] == (3, 3)
    fin = np.concatenate([box.vertices, [[9, 9, 9]]])
    assert sorts(fin, np.concatenate([box.faces, [[*box.faces[0, :2], 8]]]))[names[1]] == (1, 3)
    assert sorts(box.vertices, np.concatenate([box.faces, box.faces[:2, ::-1]]))[names[2]] == (2, 4)
    assert sorts(box.vertices, np.concatenate([box.faces, [[0, 0, 1]]]))[names[3]] == (1, 1)
    assert sorts([[0, 0, 0], [1, 0, 0], [0.5, 1e-4, 0]], [[0, 1, 2]])[names[4]] == (1, 1)


def test_reports_say_what_explains_faults():
    """A hole in the mesh, and a triangle at its rim that no ray finds."""
    mesh = trimesh.creation.icosphere(subdivisions=0)
    scene = wrt.Scene(wrt.TriangleMesh(mesh.vertices, mesh.faces[1:]), device="cpu")
    scene.verify(4)
    rim = int(np.flatnonzero(np.isin(mesh.faces[1:], mesh.faces[0]).sum(axis=1) == 2)[0])
    for _, blocks in scene.state.cache.records.values():
        records = blocks.records.numpy().reshape(-1, 9, scene.tree.width).copy()
        block, lane = divmod(int(np.flatnonzero(blocks.primitive.numpy() == rim)[0]), scene.tree.width)
        records[block, :, lane] = np.nan
        blocks.records.assign(records.ravel())
    report = scene.verify(400)
    faults = sum(report.misses.values())
    assert faults > 3
    assert report.mesh["open edges"] == 3
    assert report.explained["open edges"] >= faults - 2  # at edges, the reference may name its neighbour
    assert report.explained["slivers"] == 0


def test_same_seed_same_report():
    scene = wrt.Scene(TEAPOT)
    assert scene.verify(40, seed=3) == scene.verify(40, seed=3)
    assert scene.verify(40, seed=3).t_error != scene.verify(40, seed=4).t_error


def test_several_meshes():
    report = wrt.Scene([BODIES["box"], BODIES["icosphere"]]).verify(200)
    assert report.ok, str(report)
    assert report.mesh["open edges"] == 0


def test_bad_arguments():
    scene = wrt.Scene(BODIES["box"])
    with pytest.raises(ValueError, match="samples is 3"):
        scene.verify(3)
    with pytest.raises(TypeError, match="samples must be an int"):
        scene.verify(100.0)
    with pytest.raises(ValueError, match="seed is -1"):
        scene.verify(100, seed=-1)


def test_command(tmp_path, monkeypatch):
    path = tmp_path / "box.ply"
    BODIES["box"].export(path)
    good = CliRunner().invoke(main, ["verify", str(path), "--samples", "40"])
    assert good.exit_code == 0, good.output
    assert "no answer is wrong" in good.stdout
    assert "slivers" in good.stdout
    as_json = json.loads(CliRunner().invoke(main, ["verify", str(path), "--samples", "40", "--json"]).stdout)
    assert as_json["ok"]
    assert as_json["rays"] == dict.fromkeys(verification.KINDS, 10)
    monkeypatch.setattr(verification, "ray_values", lambda scene, rays, *asked: np.zeros(len(rays), dtype=bool))
    bad = CliRunner().invoke(main, ["verify", str(path), "--samples", "40"])
    assert bad.exit_code == 1
    assert "WRONG" in bad.stdout


def test_command_with_another_triangle_test(tmp_path):
    path = tmp_path / "body.ply"
    BODIES["ellipsoid"].export(path)
    arguments = ["verify", str(path), "--samples", "1000", "--json", "--device", "cpu", "--triangle-test"]
    leaks = CliRunner().invoke(main, [*arguments, "moeller_trumbore"])
    assert leaks.exit_code == 1
    assert sum(json.loads(leaks.stdout)["misses"].values()) > 0
    for name, message in (("komatsu", "needs rays that share their origin; choose from auto, woop"), ("nothing", "is unknown")):
        refused = CliRunner().invoke(main, [*arguments, name])
        assert refused.exit_code == 2
        assert message in refused.stderr


def test_warp_is_not_needed_to_read_a_report():
    """Reports are plain data."""
    import pickle

    report = wrt.Scene(BODIES["box"]).verify(4)
    assert pickle.loads(pickle.dumps(report)) == report
    assert not any(isinstance(value, wp.array) for value in vars(report).values())
