"""Open3D, a scene of it, and wrt's form of the same scene, for the tests that hold one against the other."""

from __future__ import annotations

import pytest
from support.open3d_scene import PARTS

import wrt


@pytest.fixture(scope="module")
def scene() -> wrt.compat.RaycastingScene:
    ours = wrt.compat.RaycastingScene()
    assert [ours.add_triangles(*part) for part in PARTS] == [0, 1]
    return ours


@pytest.fixture(scope="module")
def open3d():
    return pytest.importorskip("open3d")


@pytest.fixture(scope="module")
def theirs(open3d):
    peer = open3d.t.geometry.RaycastingScene()
    for vertices, faces in PARTS:
        peer.add_triangles(open3d.core.Tensor(vertices), open3d.core.Tensor(faces))
    return peer
