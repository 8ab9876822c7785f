"""How much of the sky surfaces see in pictures, against closed forms: streets of long triangles, slopes, closed wedges.

Points of long triangles were once moved along them, by metres, to be away from their sharp corners: streets were too bright.
"""

from __future__ import annotations

import numpy as np
import pytest

import wrt

WHITE, BLACK = wrt.Material(color=1.0), wrt.Material(color=0.0)


def quad(a, b, c, d, material):
    """Two triangles."""
    return wrt.TriangleMesh(np.array([a, b, c, d], dtype=float), [[0, 1, 2], [0, 2, 3]]).with_materials(material)


def street(length, width, height):
    """A white floor between black walls."""
    x, y = length / 2, width / 2
    floor = quad((-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0), WHITE)
    walls = [quad((-x, s, 0), (x, s, 0), (x, s, height), (-x, s, height), BLACK) for s in (-y, y)]
    return wrt.Scene([floor, *walls])


def from_above(width, pixels):
    return wrt.OrthographicCamera(
        pixels, pixels, view_height=0.999 * width, position=(0, 0, 50), look_at=(0, 0, 0), up=(0, 1, 0)
    )


@pytest.mark.parametrize("integrator", ["path", "distribution"])
def test_a_street(integrator):
    """Hottel's crossed strings: the floor of a long street sees the sky by sqrt(1 + (H/W)^2) - H/W."""
    for length, width, height in ((100.0, 1.0, 0.9), (1000.0, 1.0, 1.5)):
        options = {"lights": [wrt.lights.Sky(1.0)], "smooth": False, "depth": 2, "samples": 64}
        found = wrt.pictures.Rendering(
            street(length, width, height), from_above(width, 32), integrator=integrator, **options
        ).advance()
        expected = np.hypot(1, height / width) - height / width
        assert abs(found.linear.mean() - expected) < 0.008, (found.linear.mean(), expected)


@pytest.mark.parametrize("integrator", ["path", "distribution"])
def test_a_slope(integrator):
    """A free slope of 45 degrees has a sky view factor of (1 + cos 45) / 2, with nothing but darkness below the horizon."""
    tilt = np.sqrt(0.5)
    slope = quad((-50, -tilt, -tilt), (50, -tilt, -tilt), (50, tilt, tilt), (-50, tilt, tilt), WHITE)
    ground = quad((-1e4, -1e4, -2), (1e4, -1e4, -2), (1e4, 1e4, -2), (-1e4, 1e4, -2), BLACK)
    options = {"lights": [wrt.lights.Sky(1.0)], "smooth": False, "depth": 2, "samples": 64}
    found = wrt.pictures.Rendering(wrt.Scene([slope, ground]), from_above(1.0, 32), integrator=integrator, **options).advance()
    assert abs(found.linear.mean() - (1 + tilt) / 2) < 0.008


@pytest.mark.parametrize("degrees", [90, 10])
def test_no_light_gets_into_a_closed_wedge(degrees):
    """Its long edge is looked along from within: black, however bright the sky outside."""
    x, z = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    section = [(0, 0), (1, 0), (x, z)]
    near, far = ([(a, y, b) for a, b in section] for y in (-20.0, 20.0))
    sides = [quad(near[i], far[i], far[(i + 1) % 3], near[(i + 1) % 3], WHITE) for i in range(3)]
    ends = [wrt.TriangleMesh(np.array(end), [[0, 1, 2]]).with_materials(WHITE) for end in (near, far)]
    middle = np.radians(degrees / 2)
    aim = np.array([np.cos(middle), 0, np.sin(middle)])
    camera = wrt.PinholeCamera(64, 64, fov=2, position=tuple(0.5 * aim), look_at=(0, 0.02, 0), up=(0, 0, 1))
    options = {"lights": [wrt.lights.Sky(1000.0)], "smooth": False, "depth": 8, "samples": 32, "roulette": False}
    found = wrt.pictures.Rendering(wrt.Scene([*sides, *ends]), camera, integrator="path", **options).advance()
    assert found.linear.max() == 0.0
