"""`wrt.pictures.Rendering` and `wrt.render`: the same picture by any way to make it, layers, interruption, and bad input."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
from wrt.imaging.integrators import path_chain
from wrt.imaging.integrators.wavefront import Wave
from wrt.scenes.shapes import boxes, plane

DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
GLASS = wrt.Material("dielectric", index=1.5, absorption=(0.1, 0.5, 0.9))
LIGHTS = [
    wrt.lights.AreaLight.sphere((-3, -3, 5), 0.7, 8.0),
    wrt.lights.Sky.gradient(0.4, 0.8),
    wrt.lights.PointLight((3, -2, 4), 5.0),
]
CAMERA = wrt.PinholeCamera(40, 30, position=(0.3, -6, 2.5), look_at=(0.3, 0, 0.6))
INTEGRATORS = ("whitted", "distribution", "path")


def bodies():
    ball = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(3, 1.0).apply_translation((0, 0, 1.05)))
    block = boxes((1.2, -0.5, 0.05), (2.0, 0.5, 1.5)).with_materials(
        wrt.Material("glossy", color=(0.9, 0.5, 0.2), roughness=0.4)
    )
    return [ball.with_materials(GLASS), block, plane((-5, -5), (5, 5))]


@pytest.fixture(scope="module")
def scene():
    return wrt.Scene(bodies(), device="cpu")


def made(scene, integrator, **options):
    return wrt.pictures.Rendering(scene, CAMERA, integrator=integrator, **({"samples": 6, "lights": LIGHTS} | options))


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("sampler", ["sobol", "jittered"])
def test_threads_waves_and_steps_do_not_show(scene, integrator, sampler):
    reference = made(scene, integrator, sampler=sampler).advance().linear
    assert reference.min() >= 0.0
    assert 0.1 < reference.mean() < 2.0
    for options in ({"wave": 37}, {"wave": 3000}, {"wave": 1 << 20}):
        np.testing.assert_array_equal(made(scene, integrator, sampler=sampler, **options).advance().linear, reference)
    in_steps = made(scene, integrator, sampler=sampler)
    for samples in (1, 3, 5):
        in_steps.advance(samples)
    assert in_steps.done == 6
    np.testing.assert_array_equal(in_steps.linear, reference)
    alone = wrt.Scene(bodies(), device="cpu", num_threads=1)
    np.testing.assert_array_equal(made(alone, integrator, sampler=sampler).advance().linear, reference)
    other = made(scene, integrator, sampler=sampler, seed=1).advance().linear
    assert np.abs(other - reference).max() > 0.0


@pytest.mark.parametrize("sample_lights", [True, False])
@pytest.mark.parametrize("lights", [LIGHTS, LIGHTS[1:], [wrt.lights.Sky(1.0)]])
def test_tiles_of_paths_do_not_show(scene, sample_lights, lights, monkeypatch):
    """Tile by tile or generation by generation: the same picture and as many rays. Tiles once read the origin of all camera
    rays where the first tile had written that of its next ray."""
    monkeypatch.setattr(path_chain, "TILE", 512)
    monkeypatch.setattr(path_chain, "FIRST_SAMPLES", 1024)
    options = {"sample_lights": sample_lights, "lights": lights, "depth": 4, "wave": 3000}
    in_tiles = made(scene, "path", **options).advance()
    assert in_tiles._wave._chain is not None
    monkeypatch.setattr(Wave, "follow_in_tiles", lambda *_: False)
    by_generations = made(scene, "path", **options).advance()
    np.testing.assert_array_equal(in_tiles.linear, by_generations.linear)
    assert in_tiles.rays == by_generations.rays


def test_memory_of_paths_is_that_of_a_tile_for_each_thread():
    """Waves may be large: what is known of the paths of a tile is forgotten when the next one begins."""
    rendering = made(wrt.Scene(bodies(), device="cpu", num_threads=2), "path", samples=16).advance()
    chain = rendering._wave._chain
    assert rendering.settings.wave >= rendering.pixels * 16 > 4 * len(chain._hits.t)
    assert rendering.rays > len(chain._hits.t)


@pytest.mark.parametrize("tree", ["kdtree", "bvh"])
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_trees_and_traversals_do_not_show(scene, integrator, tree):
    reference = made(scene, integrator).advance().linear
    other = wrt.Scene(bodies(), tree, device="cpu")
    np.testing.assert_array_equal(made(other, integrator, traversal="single").advance().linear, reference)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_instances_are_meshes_that_were_moved(integrator):
    """A body and its instance in the same place give the same picture up to rounding, emission and normals included."""
    turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0.3, 0.2, 0.1)) @ np.diag([1.2, 0.8, 1.0, 1.0])
    meshes = [*bodies(), boxes((-2, -1, 2), (-1, 0, 2.2)).with_materials(wrt.Material(color=0.2, emission=3.0))]
    inverse = np.linalg.inv(turn)
    placed = wrt.Scene([wrt.Instance(mesh.transformed(inverse), turn) for mesh in meshes], device="cpu")
    pair = [made(one, integrator, samples=16).advance().linear for one in (wrt.Scene(meshes, device="cpu"), placed)]
    assert (np.abs(pair[0] - pair[1]).max(axis=2) > 0.02 * pair[0].max(axis=2)).mean() < 0.08  # single paths part at edges
    np.testing.assert_allclose(pair[0].mean(), pair[1].mean(), rtol=0.01)


def test_a_far_scene_is_as_sharp_as_a_near_one():
    """Everything is relative to the scene's centre: 1e6 from the origin, the picture is the same up to rounding."""
    shift = np.array([1e6, -2e6, 5e5])
    far = wrt.Scene([wrt.TriangleMesh(m.vertices.astype(float) + shift, m.faces) for m in bodies()], device="cpu")
    near = wrt.Scene([wrt.TriangleMesh(m.vertices.astype(float), m.faces) for m in bodies()], device="cpu")
    pictures = []
    for scene, offset in ((near, 0.0), (far, shift)):
        camera = wrt.PinholeCamera(40, 30, position=offset + CAMERA.position, look_at=offset + CAMERA.look_at)
        lights = [wrt.lights.PointLight(offset + np.array([-3, -3, 5]), 60.0), wrt.lights.Sky(0.3)]
        pictures.append(wrt.pictures.Rendering(scene, camera, integrator="path", lights=lights, samples=8).advance().linear)
    assert np.median(np.abs(pictures[0] - pictures[1])) < 1e-4
    np.testing.assert_allclose(pictures[0].mean(), pictures[1].mean(), rtol=0.01)


def test_an_interrupted_picture_keeps_its_samples_and_goes_on(scene):
    reference = made(scene, "path", wave=1200).advance()
    rendering, calls = made(scene, "path", wave=500), []

    def stop(done, total):
        calls.append((done, total))
        if len(calls) == 8:  # in the middle of a pass
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rendering.advance(progress=stop)
    assert rendering.done == 2
    np.testing.assert_array_equal(rendering.linear, made(scene, "path").advance(2).linear)
    np.testing.assert_array_equal(rendering.advance().linear, reference.linear)
    assert calls[0][0] > 0
    assert [total for _, total in calls] == [40 * 30 * 6] * 8
    assert sorted(done for done, _ in calls) == [done for done, _ in calls]


def test_layers_are_what_the_camera_sees(scene):
    rendering = made(scene, "path", samples=1).advance()
    layers, hits = rendering.layers, scene.intersect(CAMERA.rays())
    np.testing.assert_allclose(layers["depth"], hits.t, rtol=1e-5)
    np.testing.assert_array_equal(layers["primitive_id"], hits.primitive_id)
    np.testing.assert_array_equal(layers["geometry_id"], hits.geometry_id)
    np.testing.assert_array_equal(layers["instance_id"], hits.instance_id)
    toward = CAMERA.rays().directions
    assert ((layers["normal"] * toward).sum(-1)[hits.is_hit] < 0.0).all()
    flat = made(scene, "path", samples=1, smooth=False).advance().layers["normal"]
    np.testing.assert_allclose(np.abs((flat * hits.normal).sum(-1)), hits.is_hit, atol=1e-5)
    block = hits.geometry_id == 1
    np.testing.assert_allclose(
        layers["albedo"][block], np.broadcast_to(np.float32([0.9, 0.5, 0.2]), (block.sum(), 3)), rtol=1e-6
    )
    np.testing.assert_array_equal(layers["material_id"], np.where(hits.is_hit, hits.geometry_id, -1))


def test_noise_is_the_error(scene):
    """The standard error tells how far pictures of 16 random samples are from the mean of many."""
    reference = made(scene, "path", samples=1024).advance().linear @ [0.2126, 0.7152, 0.0722]
    rendering = made(scene, "path", samples=16, sampler="random", max_radiance=4.0).advance()
    error = np.abs(rendering.linear @ [0.2126, 0.7152, 0.0722] - reference)
    ratio = np.median(error[rendering.noise > 1e-3] / rendering.noise[rendering.noise > 1e-3])
    assert 0.4 < ratio < 1.1  # of a normal distribution 0.67


def test_tone_mappings(scene):
    rendering = made(scene, "whitted", samples=1).advance()
    linear = rendering.linear.astype(float)

    def encoded(x):
        x = np.clip(x, 0, 1)
        return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)

    np.testing.assert_allclose(rendering.image("linear", exposure=2.0), 2 * linear, rtol=1e-6)
    np.testing.assert_allclose(rendering.image(), encoded(linear), atol=1e-5)
    np.testing.assert_allclose(rendering.image("reinhard"), encoded(linear / (1 + linear)), atol=1e-5)
    assert rendering.image("aces").max() <= 1.0
    with pytest.raises(ValueError, match="tone_mapping"):
        rendering.image("filmic")


def test_render_is_the_same_in_one_call(scene):
    image = wrt.render(scene, CAMERA, integrator="path", samples=6, lights=LIGHTS)
    np.testing.assert_array_equal(image, made(scene, "path").advance().image())
    settings = wrt.pictures.RenderSettings(samples=6, depth=3)
    image = wrt.render(scene, CAMERA, integrator="path", settings=settings, lights=LIGHTS, depth=8)
    np.testing.assert_array_equal(image, made(scene, "path").advance().image())
    assert wrt.render(scene, CAMERA).shape == (30, 40, 3)


def test_a_scene_without_lights_or_materials_is_lit():
    scene = wrt.Scene(boxes((-1, -1, -1), (1, 1, 1)))
    for integrator in INTEGRATORS:
        image = wrt.render(scene, wrt.PinholeCamera.framing(scene, 24, 24), integrator=integrator)
        assert 0.2 < image.mean() < 0.95


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_bad_rays_and_degenerate_triangles_do_no_harm(integrator):
    """Triangles without area, and needles: no NaN in the picture."""
    from support.meshes import degenerate_soup, needles

    for mesh in (degenerate_soup(), needles(40)):
        scene = wrt.Scene(mesh)
        for material in (GLASS, wrt.Material("glossy", roughness=0.0), wrt.Material("mirror")):
            image = (
                wrt.pictures.Rendering(
                    scene, wrt.PinholeCamera.framing(scene, 24, 24), integrator=integrator, materials=material, samples=4
                )
                .advance()
                .linear
            )
            assert np.isfinite(image).all()
            assert image.min() >= 0.0


def test_bad_input(scene):
    camera = wrt.PinholeCamera(8, 8, position=(0, -4, 0), look_at=(0, 0, 0))
    for error, match, options in (
        (ValueError, "integrator .photon. is unknown", {"integrator": "photon"}),
        (TypeError, "no option 'ambient_samples'", {"integrator": "path", "ambient_samples": 4}),
        (TypeError, "no option 'sample_lights'", {"integrator": "whitted", "sample_lights": False}),
        (TypeError, "'ambient' has no lights", {"lights": [wrt.lights.Sky()]}),
        (TypeError, "lights must be", {"integrator": "path", "lights": [1]}),
        (ValueError, r"more than one wrt\.lights\.Sky", {"integrator": "path", "lights": [wrt.lights.Sky(), wrt.lights.Sky()]}),
        (ValueError, "materials has 1 entries", {"integrator": "path", "materials": [GLASS]}),
        (TypeError, "materials must be", {"integrator": "path", "materials": "glass"}),
        (ValueError, "sampler .blue. is unknown", {"integrator": "path", "sampler": "blue"}),
        (ValueError, "depth is 0", {"integrator": "path", "depth": 0}),
        (TypeError, "samples must be", {"integrator": "path", "samples": 1.5}),
        (ValueError, "focus_distance", {"integrator": "path", "focus_distance": -1.0}),
        (TypeError, "settings must be", {"integrator": "path", "settings": {}}),
    ):
        with pytest.raises(error, match=match):
            wrt.render(scene, camera, **options)
    flat = wrt.OrthographicCamera(8, 8, view_height=1, position=(0, -4, 0), look_at=(0, 0, 0))
    with pytest.raises(ValueError, match="lens_radius needs"):
        wrt.render(scene, flat, integrator="path", lens_radius=0.1)
    with pytest.raises(TypeError, match=r"wrt\.Scene"):
        wrt.render("scene", camera, integrator="path")
    with pytest.raises(ValueError, match="no samples yet"):
        _ = wrt.pictures.Rendering(scene, camera).linear
    for call in (
        lambda: wrt.lights.Sky(-1.0),
        lambda: wrt.lights.Sky.image(np.zeros((4, 4))),
        lambda: wrt.lights.AreaLight.rectangle((0, 0, 0), (1, 0, 0), (2, 0, 0)),
        lambda: wrt.lights.AreaLight.sphere((0, 0, 0), 0.0),
        lambda: wrt.lights.SpotLight((0, 0, 0), (0, 0, 1), angle=90),
        lambda: wrt.lights.DirectionalLight((0, 0, 0)),
        lambda: wrt.lights.PointLight((0, 0, np.nan)),
        lambda: wrt.lights.PointLight((0, 0, 1e39)),
        lambda: wrt.lights.AreaLight.sphere((0, 1e39, 0), 1.0),
        lambda: wrt.Material("plastic"),
        lambda: wrt.Material(color=1.5),
        lambda: wrt.Material(roughness=2.0),
        lambda: wrt.Material("dielectric", index=0.0),
        lambda: wrt.Texture(np.full((2, 2), 1.5)),
        lambda: wrt.moving.Motion(vertices={0: (np.zeros((3, 3)),)}),
    ):
        with pytest.raises(ValueError):  # noqa: PT011 - each names its own argument
            call()


def test_exr_files(scene, tmp_path):
    exr = pytest.importorskip("OpenEXR", reason="the extra wrt[exr]")
    rendering = made(scene, "whitted", samples=1).advance()
    rendering.save(tmp_path / "a.exr")
    with exr.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    np.testing.assert_array_equal(np.stack([channels[c] for c in "RGB"], -1), rendering.linear)
    np.testing.assert_array_equal(channels["Z"], rendering.layers["depth"])
    np.testing.assert_array_equal(channels["geometry_id"].view(np.int32), rendering.layers["geometry_id"])


def test_pictures_are_saved(scene, tmp_path):
    rendering = made(scene, "whitted", samples=1).advance()
    rendering.save(tmp_path / "a.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), rendering.linear)
    rendering.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 500
