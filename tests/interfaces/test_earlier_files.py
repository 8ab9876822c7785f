"""Files that wrt 0.1.0 wrote: scenes are read, with trees that are built again; samples and jobs are refused, and say why."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import wrt
from wrt.accelerators.tree_descriptions import Bvh, KdTree

FILES = Path(__file__).parent / "earlier" / "0.1.0"
"""What 0.1.0 made of `tetrahedron`, `camera` and `rays`."""


def tetrahedron() -> wrt.TriangleMesh:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return wrt.TriangleMesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], name="tetrahedron")


def scene() -> wrt.Scene:
    return wrt.Scene(tetrahedron(), device="cpu")


def rays() -> tuple[np.ndarray, np.ndarray]:
    return np.full((4, 2, 3), 2.0, np.float32), -np.ones((4, 2, 3), np.float32)


@pytest.fixture
def built(monkeypatch) -> list[type]:
    """Descriptions of the trees that are built."""
    kinds: list[type] = []
    for cls in (Bvh, KdTree):
        monkeypatch.setattr(cls, "build", lambda self, *args, _build=cls.build: kinds.append(type(self)) or _build(self, *args))
    return kinds


@pytest.mark.parametrize(("name", "kind", "t"), [("bvh", Bvh, 5 / 3), ("kdtree", KdTree, 5 / 3), ("instances", Bvh, 1.6)])
def test_scenes_are_read(built, name, kind, t):
    """0.1.0 had one key for all of its builders, so its trees may not be those that are built today."""
    loaded = wrt.Scene.load(FILES / f"{name}.npz", device="cpu")
    assert built == [kind]
    assert loaded.meshes[0].name == "tetrahedron"
    assert loaded.triangle_count == (8 if name == "instances" else 4)
    hits = loaded.intersect(*rays())
    np.testing.assert_allclose(hits.t, t, rtol=1e-6)  # the second instance is twice as high
    assert (hits.primitive_id == 2).all()
    assert (hits.instance_id == (1 if name == "instances" else 0)).all()


def test_partitioned_scenes_are_read(built, tmp_path):
    shutil.copytree(FILES / "parts", tmp_path / "parts")
    hits = wrt.disk.PartitionedScene(tmp_path / "parts", device="cpu").intersect(*rays())
    assert built
    assert set(built) == {Bvh}
    np.testing.assert_allclose(hits.t, 5 / 3, rtol=1e-6)
    assert (hits.primitive_id == 2).all()


def test_samples_are_refused():
    camera = wrt.PinholeCamera(4, 3, position=(3, 3, 3), look_at=(0.3, 0.3, 0.3))
    rendering = wrt.pictures.Rendering(scene(), camera, samples=4)
    with pytest.raises(ValueError, match=r"of another version of wrt.* \(revisions none, .*render from the start"):
        rendering.load_samples(FILES / "samples.npz")
    assert rendering.done == 0


def test_jobs_are_refused(tmp_path):
    shutil.copytree(FILES / "job", tmp_path / "job")
    reason = "format 2, and this version of wrt reads format 3.*choose another folder"
    with pytest.raises(ValueError, match=reason):
        wrt.cluster.Job(tmp_path / "job", scene().occluded_blocks(*rays()))
    with pytest.raises(ValueError, match=reason):
        wrt.cluster.job_status(tmp_path / "job")
