"""Errors name the value that is wrong, and where in an array it is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import wrt
from wrt.kernels.validation import as_numbers, first_bad
from wrt.moving.skinned_scene import check_weights
from wrt.shadows.area_light_visibility import check_samples

TRIANGLE = wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
BONES = np.zeros((2, 3)), np.zeros((2, 3, 2))
NAN, INF = float("nan"), float("inf")

CASES = {
    "numbers": (lambda: as_numbers("edges", [0.0, NAN]), r"edges\[1\] is nan; all must be finite"),
    "joints": (
        lambda: wrt.moving.Skeleton([-1, 0], [[0, 0, 0], [0, INF, 0]], BONES[1]),
        r"joints\[1, 1\] is inf; all must be finite",
    ),
    "limits": (lambda: wrt.moving.Skeleton([-1, 0], BONES[0], BONES[1] + [1, 0]), r"limits\[0, 0\] is \[1.0, 0.0\]: the least"),
    "parents": (lambda: wrt.moving.Skeleton([-1, 1], *BONES), r"parents\[1\] is 1; parents must come before"),
    "weights": (lambda: check_weights([[1.5, -0.5]], 1, 2), r"weights\[0, 1\] is -0.5; weights must be at least 0"),
    "sums": (lambda: check_weights([[0.5, 0.5], [0.5, 0.25]], 2, 2), r"the sum of weights\[1\] is 0.75; weights must sum to 1"),
    "samples": (lambda: check_samples([[0, 0, INF]]), r"positions\[0, 0, 2\] is inf"),
    "times": (lambda: wrt.sensors.Trajectory([0.0, 2.0, 1.0], np.zeros((3, 3))), r"must ascend, but times\[2\] is 1.0"),
    "no times": (lambda: wrt.sensors.Trajectory([], np.zeros((0, 3))), "times is empty"),
    "rotations": (
        lambda: wrt.sensors.Trajectory([0.0], np.zeros((1, 3)), np.zeros((1, 4))),
        r"rotations\[0\] is \[0.0, 0.0, 0.0, 0.0\], a quaternion of length 0",
    ),
    "sky": (lambda: wrt.lights.Sky.image([[[0, 0, 0], [0, -1, 0]]]), r"image times scale\[0, 1, 1\] is -1.0"),
    "edges": (lambda: wrt.batches.Histogram([1.0, 0.0]), r"edges must be at least two increasing numbers, not \[1.0, 0.0\]"),
    "colours": (
        lambda: TRIANGLE.with_materials(wrt.Material(), colors=[[0, 0, 0], [0, 0, NAN], [0, 0, 0]]),
        r"\[0, 1\] is \[0.0, 0.0, nan\]",
    ),
    "heights": (lambda: wrt.TriangleMesh.from_heightmap([[0.0, NAN], [1.0, 2.0]]), r"\(2, 2\), 3 of them finite"),
    "light": (lambda: wrt.lights.AreaLight.rectangle((0, 0, 0), (1, 0, 0), (2, 0, 0), 1.0), r"\[2.0, 0.0, 0.0\] are parallel"),
    "f_theta": (lambda: wrt.sensors.FTheta(4.0, 4.0, (-1.0,)), r"coefficients are \[-1.0\]"),
    "pattern": (lambda: wrt.sensors.LidarPattern(np.zeros((0, 3))), r"one leading axis, not \(0, 3\)"),
    "vertex": (
        lambda: wrt.compat.ProximityQuery(trimesh.creation.box()).vertex([[0, 0, 0], [0, NAN, 0]]),
        r"points\[1\] is \[0.0, nan, 0.0\], which is near no vertex",
    ),
}


def test_place_and_value():
    values = np.array([[1.0, 2.0], [3.0, -4.0]])
    assert first_bad(values < 0.0, values) == "[1, 1] is -4.0"
    assert first_bad((values < 0.0).any(axis=1), values) == "[1] is [3.0, -4.0]"
    assert first_bad(values > 5.0, values) == ""
    assert first_bad(np.array(True), np.array(7)) == " is 7"


@pytest.mark.parametrize("name", CASES)
def test_the_value_is_named(name):
    call, message = CASES[name]
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("file", "text", "word"),
    [
        ("a.obj", "v 0 0 zero\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a vertex holds 'zero'"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 three\n", "a face holds 'three'"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 zero\n0 1 0\n3 0 1 2\n", "the file holds 'zero'"),
    ],
)
def test_files_name_the_word(tmp_path, file, text, word):
    path = tmp_path / file
    path.write_text(text)
    with pytest.raises(ValueError, match=word):
        wrt.TriangleMesh.load(path)
