"""Pictures by materials and lights against closed forms: energy, irradiance, absorption, lenses, motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
from wrt.scenes.shapes import boxes, plane

DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
WHITE = wrt.Material(color=1.0)


def from_above(size, pixels=8, height=5.0):
    """An orthographic camera that looks straight down."""
    return wrt.OrthographicCamera(pixels, pixels, view_height=size, position=(0, 0, height), look_at=(0, 0, 0), up=(0, 1, 0))


def sphere(subdivisions=3, radius=1.0, center=(0, 0, 0)):
    return wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions, radius).apply_translation(center))


def linear(scene, camera, **options):
    return wrt.pictures.Rendering(scene, camera, **options).advance().linear


# -- energy ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    "material",
    [
        WHITE,
        wrt.Material(color=1.0, translucency=0.4),
        wrt.Material("mirror", color=1.0),
        wrt.Material("dielectric", color=1.0, index=1.5),
        wrt.Material("dielectric", color=1.0, index=1.3),
    ],
    ids=["diffuse", "translucent", "mirror", "glass", "water"],
)
def test_white_furnace(device, material):
    """In a room of constant light, surfaces that absorb nothing cannot be seen. Bodies that overlap and a floor scatter light
    many times; all that is missing is what is left after 500 rays."""
    bodies = [sphere(2, 1.0, (0, 0, 1.2)), sphere(2, 0.6, (1.3, 0.2, 0.8)), boxes((-3, -3, -0.5), (3, 3, 0.0))]
    scene = wrt.Scene([wrt.TriangleMesh.concatenate(bodies)], device=device)
    camera = wrt.PinholeCamera(48, 48, fov=40, position=(1, -7, 4), look_at=(0.3, 0, 0.8))
    options = {"lights": [wrt.lights.Sky(1.0)], "materials": material, "smooth": False, "depth": 500}
    found = linear(scene, camera, integrator="path", samples=64, **options)
    assert abs(found.mean() - 1.0) < 1e-3
    only_scattering = linear(scene, camera, integrator="path", samples=4, sample_lights=False, roulette=False, **options)
    np.testing.assert_allclose(only_scattering, 1.0, atol=2e-3)  # each path alone ends in the sky with the weight 1


def test_smooth_normals_lose_little():
    """Directions that a smooth normal sends into the triangle are lost: less than a per cent for a sphere of 1280 triangles."""
    camera = wrt.PinholeCamera.framing(sphere(3), 32, 32)
    found = linear(wrt.Scene(sphere(3)), camera, integrator="path", samples=64, lights=[wrt.lights.Sky(1.0)], materials=WHITE)
    assert 0.985 < found.mean() < 1.002


def test_glossy_surfaces_add_no_energy():
    scene = wrt.Scene([sphere(3), plane((-4, -4), (4, 4), z=-1.0)])
    camera = wrt.PinholeCamera(32, 32, position=(0, -5, 2), look_at=(0, 0, 0))
    for metallic in (0.0, 1.0):
        for roughness in (0.1, 0.5, 1.0):
            material = wrt.Material("glossy", color=1.0, metallic=metallic, roughness=roughness)
            options = {"lights": [wrt.lights.Sky(1.0)], "materials": material, "smooth": False}
            found = linear(scene, camera, integrator="path", samples=64, depth=40, **options)
            assert 0.4 < found.mean() < 1.001


def test_both_ways_to_find_light_agree():
    """Asking lamps, with weights, and only following scattered rays have the same mean, for lamps of each form."""
    scene = wrt.Scene([plane((-4, -4), (4, 4)), boxes((-0.5, -0.5, 0.2), (0.5, 0.5, 0.6))])
    camera = wrt.PinholeCamera(24, 24, position=(0, -6, 5), look_at=(0, 0, 0))
    lamp = plane((-1, -1), (1, 1), z=3.0).with_materials(wrt.Material(color=0.0, emission=4.0))
    ground = wrt.Material("glossy", color=0.7, roughness=0.4)
    shaded = [mesh.with_materials(ground) for mesh in scene.meshes]
    image = np.zeros((16, 32, 3), np.float32)
    image[3, 20:23] = 30.0
    standing = wrt.lights.AreaLight.triangle((-2, 0, 2), (-2, 2, 2), (-2, 1, 3), 5.0, two_sided=True)
    for lights, bodies in (
        ([wrt.lights.AreaLight.rectangle((-1, -1, 3), (0, 2, 0), (2, 0, 0), 4.0)], shaded),
        ([wrt.lights.AreaLight.sphere((1, 0, 3), 0.8, 6.0), standing], shaded),
        ([], [*shaded, lamp]),
        ([wrt.lights.Sky.image(image)], shaded),
        ([wrt.lights.Sky.gradient(0.3, 2.0)], shaded),
    ):  # fmt: skip
        room = wrt.Scene(bodies)
        found = [
            linear(room, camera, integrator="path", samples=256, depth=3, lights=lights, sample_lights=asks)
            for asks in (True, False)
        ]
        np.testing.assert_allclose(found[0].mean(), found[1].mean(), rtol=0.03)
        assert found[0].mean() > 0.01


# -- irradiance --------------------------------------------------------------------------------------------------------


def received(lights, device="cpu", samples=256, integrator="path", at=(0.0, 0.0), size=1e-3):
    """Irradiance at a point of the floor, from the radiance that a white floor sends back."""
    scene = wrt.Scene(plane((-50, -50), (50, 50)), device=device)
    camera = wrt.OrthographicCamera(8, 8, view_height=size, position=(*at, 0.5), look_at=(*at, 0), up=(0, 1, 0))
    options = {"depth": 2, "lights": lights, "materials": WHITE}
    return np.pi * linear(scene, camera, integrator=integrator, samples=samples, **options).mean()


def parallel_rectangle(a, b, height):
    """Form factor of a rectangle a x b from a point under its corner, both horizontal (Siegel and Howell)."""
    x, y = a / height, b / height
    p, q = np.hypot(1, x), np.hypot(1, y)
    return (x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2 * np.pi)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("integrator", ["path", "distribution"])
def test_area_lights_by_form_factors(device, integrator):
    lamp = wrt.lights.AreaLight.rectangle((0, 0, 2), (0, 3, 0), (1.5, 0, 0), 5.0)
    expected = np.pi * 5.0 * parallel_rectangle(1.5, 3.0, 2.0)
    np.testing.assert_allclose(received([lamp], device, integrator=integrator), expected, rtol=2e-3)
    ball = wrt.lights.AreaLight.sphere((2.0, 0.0, 3.0), 1.2, 3.0)  # wholly above the horizon: pi L sin^2 cos
    distance = np.hypot(2, 3)
    expected = np.pi * 3.0 * (1.2 / distance) ** 2 * 3 / distance
    np.testing.assert_allclose(received([ball], device, integrator=integrator), expected, rtol=2e-3)
    halves = [
        wrt.lights.AreaLight.triangle((0, 0, 2), (0, 3, 2), (1.5, 0, 2), 5.0),
        wrt.lights.AreaLight.triangle((1.5, 3, 2), (1.5, 0, 2), (0, 3, 2), 5.0),
    ]
    expected = np.pi * 5.0 * parallel_rectangle(1.5, 3.0, 2.0)
    np.testing.assert_allclose(received(halves, device, integrator=integrator), expected, rtol=4e-3)
    assert received([wrt.lights.AreaLight.rectangle((0, 0, 2), (1.5, 0, 0), (0, 3, 0), 5.0)], device, 4) == 0.0  # its back


def test_emissive_triangles_light_like_lamps():
    """A mesh of many emissive triangles of different sizes is the lamp that they form."""
    rng = np.random.default_rng(0)
    x, y = np.sort(rng.random((2, 9)), axis=1) * [[1.5], [3.0]]
    x[[0, -1]], y[[0, -1]] = (0, 1.5), (0, 3.0)
    lamps = [boxes((a, b, 2.0), (c, d, 2.001)) for a, c in pairwise(x) for b, d in pairwise(y)]
    lamp = wrt.TriangleMesh.concatenate(lamps).with_materials(wrt.Material(color=0.0, emission=5.0, two_sided=False))
    floor = plane((-50, -50), (50, 50)).with_materials(WHITE)
    camera = wrt.OrthographicCamera(8, 8, view_height=1e-3, position=(0, 0, 0.5), look_at=(0, 0, 0), up=(0, 1, 0))
    found = np.pi * linear(wrt.Scene([floor, lamp]), camera, integrator="path", samples=256, depth=2).mean()
    np.testing.assert_allclose(found, np.pi * 5.0 * parallel_rectangle(1.5, 3.0, 2.0), rtol=5e-3)
    moved = np.eye(4)
    moved[:3, 3] = (0.0, 0.0, 1.0)
    placed = wrt.Scene([wrt.Instance(floor), wrt.Instance(lamp, moved)])
    found = np.pi * linear(placed, camera, integrator="path", samples=256, depth=2).mean()
    np.testing.assert_allclose(found, np.pi * 5.0 * parallel_rectangle(1.5, 3.0, 3.0), rtol=5e-3)


@pytest.mark.parametrize("integrator", ["path", "whitted", "distribution"])
def test_lamps_at_points(integrator):
    height, across = 3.0, 2.0
    distance = np.hypot(height, across)
    expected = 10.0 / distance**2 * height / distance
    lamp = wrt.lights.PointLight((across, 0, height), 10.0)
    np.testing.assert_allclose(received([lamp], samples=4, integrator=integrator), expected, rtol=1e-3)
    sun = wrt.lights.DirectionalLight((1, 0, -2), 7.0)
    np.testing.assert_allclose(received([sun], samples=4, integrator=integrator), 7.0 * 2 / np.sqrt(5), rtol=1e-5)
    inside = wrt.lights.SpotLight((across, 0, height), (0, 0, 0), 10.0, angle=20)
    np.testing.assert_allclose(received([inside], samples=4, integrator=integrator), expected, rtol=1e-3)
    outside = wrt.lights.SpotLight((across, 0, height), (across, 0, 0), 10.0, angle=30)
    assert received([outside], samples=4, integrator=integrator) == 0.0
    two = [lamp, sun]
    np.testing.assert_allclose(
        received(two, samples=4096, integrator=integrator, size=1e-4), expected + 7.0 * 2 / np.sqrt(5), rtol=5e-3
    )


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (1, 2, 2)])
def test_skies_by_quadrature(up):
    """Irradiance of an image with one bright spot, and of a gradient, by sums over a fine grid of directions."""
    rng = np.random.default_rng(3)
    image = rng.random((24, 48, 3)).astype(np.float32)
    image[6, 30] = 400.0
    upward = np.array(up) / np.linalg.norm(up)
    for sky in (wrt.lights.Sky.image(image, up=up), wrt.lights.Sky.gradient(0.4, 3.0, 0.1, up=up), wrt.lights.Sky(0.7)):
        height = 1.0 - (np.arange(1000) + 0.5) / 1000
        angle = 2 * np.pi * (np.arange(2000) + 0.5) / 2000
        h, a = (grid.ravel() for grid in np.meshgrid(height, angle, indexing="ij"))
        r = np.sqrt(1 - h * h)
        toward = np.stack([r * np.cos(a), r * np.sin(a), h], -1)
        texels = sky.texels.astype(float).mean(axis=2)
        rows, columns = texels.shape
        x = (0.5 + np.arctan2(toward @ sky.north, toward @ sky.east) / (2 * np.pi)) * columns - 0.5
        y = np.clip(np.arccos(np.clip(toward @ upward, -1, 1)) / np.pi * rows - 0.5, 0, rows - 1)
        if rows == 1:
            upward = np.array([0.0, 0.0, 1.0])
        c, q = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), max(rows - 2, 0))
        f, g = x - c, y - q
        low = np.minimum(q + 1, rows - 1)
        radiance = (1 - g) * ((1 - f) * texels[q, c % columns] + f * texels[q, (c + 1) % columns]) + g * (
            (1 - f) * texels[low, c % columns] + f * texels[low, (c + 1) % columns]
        )
        expected = (radiance * h).mean() * 2 * np.pi
        np.testing.assert_allclose(received([sky], samples=1024), expected, rtol=0.01)


# -- glass -------------------------------------------------------------------------------------------------------------


def slab_radiance(index, absorption, thickness):
    """Light that a slab in a room of constant light sends to the eye, at normal incidence: what it lets through and reflects,
    over all internal reflections."""
    r = ((index - 1) / (index + 1)) ** 2
    a = np.exp(-absorption * thickness)
    through = (1 - r) ** 2 * a / (1 - (r * a) ** 2)
    back = r + r * (1 - r) ** 2 * a**2 / (1 - (r * a) ** 2)
    return through + back


@pytest.mark.parametrize("device", DEVICES)
def test_a_slab_of_coloured_glass(device):
    scene = wrt.Scene(boxes((-5, -5, 0), (5, 5, 0.7)), device=device)
    glass = wrt.Material("dielectric", color=1.0, index=1.6, absorption=(0.0, 0.5, 2.0))
    options = {"lights": [wrt.lights.Sky(1.0)], "materials": glass, "depth": 30}
    expected = [slab_radiance(1.6, a, 0.7) for a in (0.0, 0.5, 2.0)]
    found = linear(scene, from_above(1.0), integrator="whitted", threshold=0.0, **options)
    np.testing.assert_allclose(found.reshape(-1, 3), np.tile(expected, (64, 1)), rtol=1e-4)
    paths = linear(scene, from_above(1.0), integrator="path", samples=1024, **options)
    np.testing.assert_allclose(paths.mean(axis=(0, 1)), expected, rtol=3e-3)


def reflected_share(cosine, index=1.5):
    """Fresnel's equations for unpolarised light that enters glass."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return (across**2 + along**2) / 2


def through_pane(cosine):
    """Share of light that a clear pane lets through, over all internal reflections."""
    share = reflected_share(cosine)
    return (1 - share) / (1 + share)


@pytest.mark.parametrize("degrees", [0, 60])
def test_a_lamp_seen_through_a_pane(degrees):
    """4 % are reflected at each side at normal incidence, 8.9 % at 60 degrees; nothing else shines."""
    pane = boxes((-50, -50, 0), (50, 50, 0.02)).with_materials(wrt.Material("dielectric", color=1.0, index=1.5))
    lamp = plane((-50, -50), (50, 50), z=-0.5).with_materials(wrt.Material(color=0.0, emission=2.0))
    angle = np.radians(degrees)
    camera = wrt.OrthographicCamera(
        8, 8, view_height=0.1, position=(4 * np.sin(angle), 0, 4 * np.cos(angle)), look_at=(0, 0, 0), up=(0, 1, 0)
    )
    found = linear(wrt.Scene([pane, lamp]), camera, integrator="path", samples=1024, depth=20, lights=[])
    np.testing.assert_allclose(found.mean(), 2.0 * through_pane(np.cos(angle)), rtol=4e-3)


@pytest.mark.parametrize("asks", [True, False])
def test_light_of_the_sky_through_a_pane(asks):
    """A floor under a pane: shadow rays are blocked by it, and paths that pass it have the whole light of the sky."""
    albedo, sky = 0.5, 3.0
    pane = boxes((-500, -500, 1.0), (500, 500, 1.1)).with_materials(wrt.Material("dielectric", color=1.0, index=1.5))
    floor = plane((-500, -500), (500, 500)).with_materials(wrt.Material(color=albedo))
    camera = wrt.OrthographicCamera(8, 8, view_height=1, position=(0, 0, 0.5), look_at=(0, 0, 0), up=(0, 1, 0))
    options = {"lights": [wrt.lights.Sky(sky)], "samples": 1024, "depth": 60, "sample_lights": asks}
    found = linear(wrt.Scene([pane, floor]), camera, integrator="path", **options)
    cosines = (np.arange(4000) + 0.5) / 4000
    passes = (2 * cosines * through_pane(cosines)).mean()
    np.testing.assert_allclose(found.mean(), albedo * sky * passes / (1 - albedo * (1 - passes)), rtol=6e-3)


def test_a_lamp_behind_a_ball_of_glass():
    """Light that a ball gathers on a floor is found by scattering only, whether lamps are sampled or not: the means agree
    within their standard errors."""
    ball = sphere(3, 0.6, (0, 0, 1.2)).with_materials(wrt.Material("dielectric", color=1.0, index=1.5))
    floor = plane((-20, -20), (20, 20)).with_materials(wrt.Material(color=0.5))
    lamp = wrt.lights.AreaLight.rectangle((-1, -1, 3), (0, 2, 0), (2, 0, 0), 4.0)
    camera = wrt.OrthographicCamera(12, 12, view_height=1, position=(0, 0, 0.4), look_at=(0, 0, 0), up=(0, 1, 0))
    options = {"lights": [lamp], "samples": 512, "sampler": "random", "depth": 12}
    means = [
        linear(wrt.Scene([ball, floor]), camera, integrator="path", seed=seed, sample_lights=asks, **options).mean(axis=-1)
        for asks, seed in ((True, 0), (False, 10_000))
    ]
    difference = means[0] - means[1]
    error = difference.std() / np.sqrt(difference.size)
    assert abs(difference.mean()) < 4 * error < 0.1 * means[0].mean()


def test_lights_that_glass_blocks_are_named(recwarn):
    """Of the integrator that finds all other light; not of default lights, nor without glass, nor of lamps that are hit."""
    glass = [sphere(1).with_materials(wrt.Material("dielectric")), plane((-4, -4), (4, 4), z=-1.0)]
    camera = wrt.PinholeCamera(4, 4, position=(0, -5, 2), look_at=(0, 0, 0))
    point, lamp = wrt.lights.PointLight((0, 0, 5)), wrt.lights.AreaLight.sphere((0, 0, 5), 0.5)
    for bodies, lights, integrator in (
        (glass, None, "path"),
        (glass, [lamp, wrt.lights.Sky(1.0)], "path"),
        (glass, [point], "whitted"),
        (glass[1:], [point], "path"),
    ):
        wrt.pictures.Rendering(wrt.Scene(bodies), camera, integrator=integrator, lights=lights)
    assert not recwarn.list
    for light in (point, wrt.lights.SpotLight((0, 0, 5), (0, 0, 0)), wrt.lights.DirectionalLight((0, 0, -1))):
        with pytest.warns(UserWarning, match=f"no path hits a {type(light).__name__}.*AreaLight"):
            wrt.pictures.Rendering(wrt.Scene(glass), camera, integrator="path", lights=[wrt.lights.Sky(1.0), light])


def test_open_bodies_of_glass_are_named(recwarn):
    """By the index of the mesh, whatever the integrator; not other surfaces, nor what another material replaces."""
    ball, glass = sphere(1), wrt.Material("dielectric")
    cup = wrt.TriangleMesh(ball.vertices, ball.faces[1:])
    camera = wrt.PinholeCamera(4, 4, position=(0, -5, 2), look_at=(0, 0, 0))
    half = np.arange(ball.triangle_count) % 2
    closed = [ball.with_materials([glass, wrt.Material()], of_face=half), cup.with_materials(wrt.Material("mirror"))]
    wrt.pictures.Rendering(wrt.Scene(closed), camera, integrator="path", lights=[wrt.lights.Sky(1.0)])
    assert not recwarn.list
    for integrator in ("whitted", "distribution", "path"):
        scene = wrt.Scene([*closed, cup.with_materials([wrt.Material(), glass], of_face=half[1:])])
        with pytest.warns(UserWarning, match="mesh 2 has glass and is not closed"):
            wrt.pictures.Rendering(scene, camera, integrator=integrator, lights=[wrt.lights.Sky(1.0)])


def stack_radiance(indices, thicknesses, absorptions):
    """The same for layers, by adding them one by one from below."""

    def share(a, b):
        return ((a - b) / (a + b)) ** 2

    levels = [1.0, *indices, 1.0]
    through, back_down, back_up = 1.0, 0.0, 0.0  # of what is added so far, for light from above and from below
    for i in range(len(levels) - 1, 0, -1):
        r = share(levels[i - 1], levels[i])
        a = np.exp(-absorptions[i - 1] * thicknesses[i - 1]) if i <= len(indices) else 1.0
        below_back, below_through, below_up = back_down * a * a, through * a, back_up
        loop = 1 - r * below_back
        back_down = r + (1 - r) ** 2 * below_back / loop
        back_up = below_up + below_through**2 * r / loop
        through = (1 - r) * below_through / loop
    return through + back_down


def test_nested_dielectrics_by_priority():
    """Water reaches into the glass below it, because surfaces that only touch would leave gaps: with the higher priority, the
    glass is there, and the picture is that of two layers that touch."""
    assert np.isclose(stack_radiance([1.6], [0.7], [0.5]), slab_radiance(1.6, 0.5, 0.7))
    glass = wrt.Material("dielectric", color=1.0, index=1.6, absorption=0.4, priority=2)
    water = wrt.Material("dielectric", color=1.0, index=1.33, absorption=0.9, priority=1)
    scene = wrt.Scene([boxes((-5, -5, 0), (5, 5, 1)), boxes((-5, -5, 0.8), (5, 5, 2))])
    options = {"lights": [wrt.lights.Sky(1.0)], "materials": [glass, water], "depth": 24}  # more changes no digit
    found = linear(scene, from_above(1.0), integrator="whitted", threshold=0.0, **options)
    expected = stack_radiance([1.33, 1.6], [1.0, 1.0], [0.9, 0.4])
    np.testing.assert_allclose(found, expected, rtol=2e-4)
    swapped = [wrt.Material("dielectric", color=1.0, index=1.6, absorption=0.4, priority=0), water]
    found = linear(scene, from_above(1.0), integrator="whitted", threshold=0.0, **(options | {"materials": swapped}))
    np.testing.assert_allclose(found, stack_radiance([1.33, 1.6], [1.2, 0.8], [0.9, 0.4]), rtol=2e-4)


def test_mirrors_between_each_other():
    """Two mirrors that face each other, of albedo a: what a ray sees after n reflections has the weight a^n."""
    lamp = plane((-5, -5), (5, 5), z=0.0).with_materials(wrt.Material(color=0.0, emission=1.0))
    scene = wrt.Scene([lamp, boxes((0, -5, 0.1), (0.01, 5, 9)), boxes((1, -5, 0.1), (1.01, 5, 9))])
    mirror = wrt.Material("mirror", color=0.9)
    materials = [lamp.materials.materials[0], mirror, mirror]
    direction = np.array([1.0, 0.0, -2.0])
    eye = np.array([0.505, 0.0, 8.1])
    camera = wrt.OrthographicCamera(1, 1, view_height=1e-3, position=eye, look_at=eye + direction, up=(0, 1, 0))
    reflections = int(round((eye[2] - 0.0) / 2 + eye[0] - 0.5))
    found = linear(scene, camera, integrator="whitted", threshold=0.0, depth=12, lights=[], materials=materials)
    np.testing.assert_allclose(found, 0.9**reflections, rtol=1e-4)


def test_adaptive_depth():
    """Fewer rays, with an error below the threshold times the number of rays that end; with roulette, the mean is kept."""
    scene = wrt.Scene([sphere(3, 1.0), sphere(3, 0.7, (1.5, 0.4, 0.3)), plane((-5, -5), (5, 5), z=-1.0)])
    glass = wrt.Material("dielectric", color=1.0, index=1.5)
    options = {"lights": [wrt.lights.Sky.gradient(0.5, 1.0)], "materials": [glass, glass, wrt.Material()], "depth": 12}
    camera = wrt.PinholeCamera(48, 48, position=(0, -6, 2), look_at=(0.4, 0, 0))

    def made(**more):
        rendering = wrt.pictures.Rendering(scene, camera, integrator="whitted", samples=16, **options, **more).advance()
        return rendering.linear.mean(), rendering.rays

    full, cut, lucky = made(threshold=0.0), made(threshold=0.05, roulette=False), made(threshold=0.05, roulette=True)
    assert cut[1] < 0.6 * full[1]
    assert cut[1] < lucky[1] < 0.8 * full[1]
    assert full[0] - cut[0] > 1e-3
    assert abs(lucky[0] - full[0]) < 0.25 * (full[0] - cut[0])


# -- effects -----------------------------------------------------------------------------------------------------------


def test_a_point_out_of_focus_is_a_disc():
    """A far point at depth z is, in the plane of focus, a disc of radius r |z - f| / z (thin lens)."""
    size, depth, focus, radius = 0.02, 12.0, 6.0, 0.3
    lamp = boxes((-size, -size, depth), (size, size, depth + 0.01)).with_materials(wrt.Material(color=0.0, emission=100.0))
    camera = wrt.PinholeCamera(64, 64, fov=8, position=(0, 0, 0), look_at=(0, 0, 1), up=(0, 1, 0))
    options = {"lens_radius": radius, "focus_distance": focus, "samples": 256, "depth": 1}
    found = linear(wrt.Scene(lamp), camera, integrator="distribution", **options)[..., 0]
    pixel = 2 * focus * np.tan(np.radians(4)) / 64  # in the plane of focus
    y, x = (np.indices(found.shape) - 31.5) * pixel
    spread = (found * (x**2 + y**2)).sum() / found.sum()
    expected = radius * (depth - focus) / depth
    np.testing.assert_allclose(np.sqrt(2 * spread), expected, rtol=0.03)  # of a disc, the mean square is r^2 / 2
    assert found[np.hypot(x, y) > expected + 3 * pixel].max() == 0.0
    sharp = linear(wrt.Scene(lamp), camera, integrator="distribution", **(options | {"focus_distance": depth}))[..., 0]
    assert (sharp > 0).sum() < 16
    np.testing.assert_allclose(sharp.sum(), found.sum(), rtol=0.1)


def test_a_moving_square_is_a_trapezoid():
    """Motion blur: the share of time for which a pixel is covered. All ways to move give the same picture."""
    lamp = plane((-1, -1), (1, 1)).with_materials(wrt.Material(color=0.0, emission=1.0))
    camera = from_above(8.0, 64)
    shift = np.array([2.0, 0.0, 0.0])
    motion = wrt.moving.Motion(vertices={0: (lamp.vertices - shift / 2, lamp.vertices + shift / 2)})
    scene = wrt.Scene(lamp)
    before = scene.bounds.copy()
    found = linear(scene, camera, integrator="distribution", samples=64, depth=1, motion=motion)[32, :, 0]
    np.testing.assert_array_equal(scene.bounds, before)  # the caller's scene stays
    x = (np.arange(64) - 31.5) / 8
    covered = np.clip(np.minimum(x + 2, 2 - x) / 2, 0, 1)
    np.testing.assert_allclose(found, covered, atol=0.05)
    keys = [np.eye(4), np.eye(4)]
    keys[0][:3, 3], keys[1][:3, 3] = -shift / 2, shift / 2
    placed = wrt.Scene(wrt.Instance(lamp))
    again = linear(
        placed, camera, integrator="path", samples=64, depth=1, motion=wrt.moving.Motion(transforms={0: tuple(keys)})
    )
    np.testing.assert_allclose(again[32, :, 0], found, atol=0.02)


@pytest.mark.parametrize("name", ["box", "tent", "gaussian"])
def test_pixel_filters(name):
    """An edge through the middle of a pixel spreads as the filter's integral says."""
    half = wrt.TriangleMesh([[0, -9, 0], [9, -9, 0], [9, 9, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    lamp = half.with_materials(wrt.Material(color=0.0, emission=1.0))
    camera = wrt.OrthographicCamera(9, 9, view_height=9.0, position=(0, 0, 5), look_at=(0, 0, 0), up=(0, 1, 0))
    found = linear(wrt.Scene(lamp), camera, integrator="path", samples=1024, depth=1, pixel_filter=name).mean(axis=0)[:, 0]
    t = np.linspace(-3, 3, 60001)
    density = {
        "box": (np.abs(t) <= 0.5) * 1.0,
        "tent": np.maximum(0, 1 - np.abs(t)),
        "gaussian": np.exp(-2 * t**2) * (np.abs(t) < 1.5),
    }[name]
    expected = [density[t >= -offset].sum() / density.sum() for offset in range(-4, 5)]
    np.testing.assert_allclose(found, expected, atol=0.012)
    assert found[4] == pytest.approx(0.5, abs=0.01)


def test_sixteen_jittered_rays_beat_sixteen_random_ones():
    """Penumbrae with 16 rays a pixel (Cook 1984): errors of the samplers against 1024 rays, in order of what theory says."""
    scene = wrt.Scene([plane((-4, -4), (4, 4)), sphere(3, 0.7, (0, 0, 1.2))])
    camera = from_above(6.0, 32, 8.0)
    lamp = [wrt.lights.AreaLight.rectangle((-1, -1, 4), (0, 2, 0), (2, 0, 0), 5.0)]
    options = {"integrator": "distribution", "lights": lamp, "depth": 2}
    reference = linear(scene, camera, samples=1024, **options)
    errors = {
        sampler: np.sqrt(((linear(scene, camera, samples=16, sampler=sampler, seed=3, **options) - reference) ** 2).mean())
        for sampler in ("random", "jittered", "halton", "sobol")
    }
    assert errors["jittered"] < 0.75 * errors["random"]
    assert errors["halton"] < errors["random"]
    assert errors["sobol"] < 0.75 * errors["random"]
