"""Plain rays are shaded in lanes, with the bits of the scalar step.

The scalar step is the judge. Groups of one ray have no plain rays, so the same kernel gives both pictures.
"""

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
from wrt.imaging.integrators import wavefront
from wrt.kernels.shading.sampling import direction_of
from wrt.scenes.shapes import plane

CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)

LIGHTS = {
    "point": lambda: [wrt.lights.PointLight((0.5, -1.0, 2.0), 4.0)],
    "directional": lambda: [wrt.lights.DirectionalLight((0.3, 0.2, -1.0), 2.0)],
    "rectangle": lambda: [wrt.lights.AreaLight.rectangle((-1, -1, 2), (1, 0, 0), (0, 1, 0), 5.0, two_sided=True)],
    "triangle": lambda: [wrt.lights.AreaLight.triangle((-1, -1, 2), (-1, 1, 2), (1, -1, 2), 5.0, two_sided=True)],
    "sphere": lambda: [wrt.lights.AreaLight.sphere((0.2, -1.0, 1.5), 0.4, 8.0)],
    "one color": lambda: [wrt.lights.Sky((0.5, 0.8, 1.0))],
    "gradient": lambda: [wrt.lights.Sky.gradient(0.8, (0.2, 0.4, 0.9), 0.2)],
    "many": lambda: (
        [light for name in list(LIGHTS)[:6] for light in LIGHTS[name]()] + [wrt.lights.SpotLight((0, 0, 3), (0, 0, -1), 9.0)]
    ),
    "too many": lambda: [wrt.lights.PointLight((x, -1.0, 2.0), 0.5) for x in range(9)],
    "emissive triangles": lambda: [],
}


PLACES = ((0.3, 0.1, 0.3), (-0.4, 0.5, 0.3), (0.8, 0.5, 0.3), (-0.6, -0.5, 0.3), (0.7, -0.7, 0.3), (0.4, 0.2, 0.4))
"""The last two balls meet: one body of glass within another."""


def matte_room(emits: bool, reach: float = 0.0) -> wrt.Scene:
    """A floor, a wall, a textured tile, and balls: of glass, smooth, translucent, mirrors. Rays of all kinds side by side. With
    a reach, something is as far away."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.25)
    places = [np.asarray(ball.vertices) + at for at in PLACES]
    checks = wrt.Texture(np.indices((4, 4)).sum(axis=0) % 2 * 0.6 + 0.2)
    tile = plane((-0.8, -0.8), (-0.2, -0.2), z=0.02)
    parts = [
        plane((-2, -2), (2, 2), z=0.0).with_materials(wrt.Material(color=(0.7, 0.6, 0.5))),
        plane((-0.4, 0.9), (0.4, 1.4), z=0.6).with_materials(wrt.Material(color=0.4, emission=3.0 * emits)),
        tile.with_materials(wrt.Material(color_texture=checks), uv=CORNERS[np.arange(len(tile.vertices)) % 4]),
        wrt.TriangleMesh(places[0], ball.faces).with_materials(wrt.Material("dielectric", index=1.5, color=1.0)),
        wrt.TriangleMesh(places[1], ball.faces).with_materials(wrt.Material(color=0.9)),
        wrt.TriangleMesh(places[2], ball.faces).with_materials(wrt.Material(translucency=0.5)),
        wrt.TriangleMesh(places[3], ball.faces).with_materials(wrt.Material("mirror", color=(0.9, 0.8, 0.7))),
        wrt.TriangleMesh(places[4], ball.faces).with_materials(wrt.Material("dielectric", absorption=(0.2, 1.0, 2.0))),
        wrt.TriangleMesh(places[5], ball.faces).with_materials(wrt.Material("dielectric", index=1.3, color=0.9)),
    ]
    if reach > 0.0:
        parts.append(plane((reach, reach), (reach + 1, reach + 1), z=0.0).with_materials(wrt.Material()))
    return wrt.Scene(parts)


@pytest.mark.parametrize("light", [pytest.param(name, marks=[pytest.mark.width] * (name == "many")) for name in LIGHTS])
@pytest.mark.parametrize("sampler", ["sobol", "random"])
def test_lanes_and_scalar_steps_make_the_same_picture(light, sampler, monkeypatch):
    scene = matte_room(emits=light == "emissive triangles")
    camera = wrt.PinholeCamera(37, 23, fov=60, position=(0, -2.5, 1.8), look_at=(0, 0, 0.2), up=(0, 0, 1))
    options = {"lights": LIGHTS[light](), "integrator": "path", "samples": 2, "depth": 5, "sampler": sampler}
    in_lanes = wrt.pictures.Rendering(scene, camera, **options).advance().linear
    monkeypatch.setattr(wavefront, "GROUP", 1)
    one_by_one = wrt.pictures.Rendering(scene, camera, **options).advance().linear
    assert in_lanes.mean() > 0.01
    np.testing.assert_array_equal(in_lanes, one_by_one)


def test_lanes_near_edges(monkeypatch):
    """In a scene 10 km wide, rounding is so coarse that nearly all points are moved away from the edges of their triangles."""
    camera = wrt.PinholeCamera(37, 23, fov=60, position=(0, -2.5, 1.8), look_at=(0, 0, 0.2), up=(0, 0, 1))
    options = {"lights": LIGHTS["sphere"](), "integrator": "path", "samples": 2, "depth": 5, "sampler": "sobol"}
    scene = matte_room(emits=False, reach=1e4)
    in_lanes = wrt.pictures.Rendering(scene, camera, **options).advance().linear
    monkeypatch.setattr(wavefront, "GROUP", 1)
    np.testing.assert_array_equal(in_lanes, wrt.pictures.Rendering(scene, camera, **options).advance().linear)
    near = wrt.pictures.Rendering(matte_room(emits=False), camera, **options).advance().linear
    assert (in_lanes != near).mean() > 0.1


@wp.kernel
def list_turned(turns: wp.array(dtype=float), out: wp.array(dtype=wp.vec2)):
    i = wp.tid()
    out[i] = direction_of(turns[i])


def test_turned_is_cosine_and_sine():
    """Moshier's polynomials, against float64."""
    turns = np.linspace(-1.0, 1.0, 4097, dtype=np.float32)
    out = wp.empty(len(turns), dtype=wp.vec2, device="cpu")
    wp.launch(list_turned, len(turns), [wp.array(turns, dtype=float, device="cpu"), out], device="cpu")
    angle = 2.0 * np.pi * turns.astype(np.float64)
    np.testing.assert_allclose(out.numpy(), np.column_stack([np.cos(angle), np.sin(angle)]), atol=2e-7)
