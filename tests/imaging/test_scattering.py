"""Scattering against closed forms and quadrature: Fresnel, Snell, GGX, and the samples of each kind of material."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.bsdf.fresnel import fresnel_exact, fresnel_schlick, refracted
from wrt.kernels.shading.bsdf.interior import leading_medium, with_medium, without_medium
from wrt.kernels.shading.bsdf.material_table import MaterialAtHit
from wrt.kernels.shading.bsdf.scattering import sample_scattering, scattering_value

DIFFUSE, MIRROR, DIELECTRIC, GLOSSY = range(4)


@wp.kernel(enable_backward=False)
def boundary(first: int, cosines: wp.array(dtype=float), ratio: float, out: wp.array2d(dtype=float)):
    i = first + wp.tid()
    cosine = cosines[i]
    sine = wp.sqrt(1.0 - cosine * cosine)
    beyond = refracted(wp.vec3(sine, 0.0, cosine), wp.vec3(0.0, 0.0, 1.0), ratio)
    out[i, 0] = fresnel_exact(cosine, ratio)
    out[i, 1] = fresnel_schlick(cosine, ratio)
    out[i, 2] = beyond[0]
    out[i, 3] = beyond[2]


@wp.kernel(enable_backward=False)
def values(
    first: int,
    look: MaterialAtHit,
    normal: wp.vec3,
    out: wp.vec3,
    toward: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=wp.vec4),
):
    i = first + wp.tid()
    found[i] = scattering_value(look, normal, out, toward[i])


@wp.kernel(enable_backward=False)
def samples(
    first: int,
    look: MaterialAtHit,
    normal: wp.vec3,
    out: wp.vec3,
    points: wp.array(dtype=wp.vec3),
    toward: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=wp.vec4),
):
    i = first + wp.tid()
    p = points[i]
    s = sample_scattering(look, normal, out, wp.vec2(p[0], p[1]), p[2])
    toward[i] = s.direction
    found[i] = wp.vec4(s.weight[0], s.weight[1], s.weight[2], s.density)


def make_look(kind, alpha=0.0, metallic=0.0, ratio=1.0, translucency=0.0, color=(1.0, 1.0, 1.0)):
    look = MaterialAtHit()
    look.kind, look.alpha, look.metallic, look.index = kind, alpha, metallic, 1.5
    look.ratio, look.translucency, look.color = ratio, translucency, wp.vec3(*color)
    return look


def on_device(array, dtype):
    return wp.array(np.ascontiguousarray(array, dtype=np.float32), dtype=dtype, device="cpu")


def value_of(look, normal, out, toward):
    found = wp.empty(len(toward), dtype=wp.vec4, device="cpu")
    inputs = [look, wp.vec3(*normal), wp.vec3(*out), on_device(toward, wp.vec3), found]
    launch(values, len(toward), inputs, device=wp.get_device("cpu"))
    return found.numpy().astype(float)


def sample_of(look, normal, out, count, seed=0):
    points = np.random.default_rng(seed).random((count, 3))
    toward, found = wp.empty(count, dtype=wp.vec3, device="cpu"), wp.empty(count, dtype=wp.vec4, device="cpu")
    inputs = [look, wp.vec3(*normal), wp.vec3(*out), on_device(points, wp.vec3), toward, found]
    launch(samples, count, inputs, device=wp.get_device("cpu"))
    return toward.numpy().astype(float), found.numpy().astype(float)


def sphere_grid(rows=1200, columns=2400):
    """Directions of cells of equal solid angle, and that angle."""
    height = 1.0 - 2.0 * (np.arange(rows) + 0.5) / rows
    angle = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    height, angle = (grid.ravel() for grid in np.meshgrid(height, angle, indexing="ij"))
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1), 4.0 * np.pi / (rows * columns)


def unit(v):
    return np.asarray(v, dtype=float) / np.linalg.norm(v)


# -- boundaries --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [1 / 1.5, 1.5, 1 / 2.4, 1.0])
def test_boundaries_by_closed_forms(ratio):
    """Snell's law; Fresnel's equations in the form of tangents and sines; total internal reflection."""
    cosines = np.linspace(0.01, 0.999, 400)
    out = wp.empty((400, 4), dtype=float, device="cpu")
    launch(boundary, 400, [on_device(cosines, float), float(ratio), out], device=wp.get_device("cpu"))
    exact, schlick, across, down = out.numpy().astype(float).T
    angle = np.arccos(cosines)
    total = ratio * np.sin(angle) > 1.0
    assert total.any() == (ratio > 1.0)
    np.testing.assert_array_equal(exact[total], 1.0)
    np.testing.assert_array_equal(schlick[total], 1.0)
    np.testing.assert_array_equal(down[total], 0.0)
    a, b = angle[~total], np.arcsin(ratio * np.sin(angle[~total]))
    np.testing.assert_allclose(across[~total], -np.sin(b), atol=1e-5)
    np.testing.assert_allclose(down[~total], -np.cos(b), atol=2e-3)  # near the critical angle, cosines lose digits
    if ratio == 1.0:
        np.testing.assert_allclose(exact, 0.0, atol=1e-6)
        return
    expected = 0.5 * ((np.tan(a - b) / np.tan(a + b)) ** 2 + (np.sin(a - b) / np.sin(a + b)) ** 2)
    np.testing.assert_allclose(exact[~total], expected, atol=2e-3)
    assert np.abs(schlick[~total] - expected).max() < 0.09
    normal_incidence = ((ratio - 1) / (ratio + 1)) ** 2
    np.testing.assert_allclose([exact[-1], schlick[-1]], normal_incidence, rtol=1e-3)


@wp.kernel(enable_backward=False)
def media_lists(first: int, priority: wp.array(dtype=int), found: wp.array(dtype=int)):
    media = with_medium(with_medium(wp.uint64(0), 2), 1)
    found[0] = leading_medium(wp.uint64(0), priority)
    found[1] = leading_medium(media, priority)
    found[2] = leading_medium(without_medium(media, 1), priority)
    found[3] = leading_medium(without_medium(without_medium(media, 1), 2), priority)
    found[4] = leading_medium(without_medium(media, 7), priority)
    for _ in range(8):
        media = with_medium(media, 0)  # full: what does not fit is not noted
    found[5] = leading_medium(without_medium(without_medium(media, 0), 0), priority)


def test_media_of_a_ray():
    found = wp.zeros(6, dtype=int, device="cpu")
    priority = wp.array(np.int32([0, 5, 3]), dtype=int, device="cpu")
    launch(media_lists, 1, [priority, found], device=wp.get_device("cpu"))
    assert found.numpy().tolist() == [-1, 1, 2, -1, 1, 1]


# -- lobes -------------------------------------------------------------------------------------------------------------

LOOKS = {
    "diffuse": make_look(DIFFUSE, color=(0.9, 0.5, 0.2)),
    "translucent": make_look(DIFFUSE, translucency=0.3),
    "metal": make_look(GLOSSY, alpha=0.25, metallic=1.0),
    "rough metal": make_look(GLOSSY, alpha=0.8, metallic=1.0),
    "plastic": make_look(GLOSSY, alpha=0.1, color=(0.8, 0.3, 0.3)),
    "frosted, entering": make_look(DIELECTRIC, alpha=0.3, ratio=1 / 1.5),
    "frosted, leaving": make_look(DIELECTRIC, alpha=0.3, ratio=1.5),
}


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("tilt", [0.95, 0.4])
def test_samples_follow_their_density(name, tilt):
    """The density sums up to the share of samples that succeed, and the mean weight is the integral of the value."""
    look, normal = LOOKS[name], unit((0.3, -0.2, 0.9))
    side = unit(np.cross(normal, (1.0, 0.0, 0.0)))
    out = tilt * normal + np.sqrt(1.0 - tilt**2) * side
    grid, cell = sphere_grid()
    value = value_of(look, normal, out, grid)
    toward, drawn = sample_of(look, normal, out, 200_000)
    succeeded = drawn[:, 3] > 0.0
    np.testing.assert_allclose(value[:, 3].sum() * cell, succeeded.mean(), atol=5e-3)
    np.testing.assert_allclose(
        value[:, :3].sum(axis=0) * cell, np.where(succeeded[:, None], drawn[:, :3], 0).mean(axis=0), rtol=0.01
    )
    again = value_of(look, normal, out, toward[succeeded])
    np.testing.assert_allclose(again[:, 3], drawn[succeeded, 3], rtol=2e-3)
    np.testing.assert_allclose(again[:, :3] / again[:, 3:], drawn[succeeded, :3], rtol=2e-3, atol=1e-6)
    # the samples fall where the density says: shares of the eight octants
    octant = (toward[succeeded] > 0.0) @ (1, 2, 4)
    expected = np.bincount((grid > 0.0) @ (1, 2, 4), weights=value[:, 3] * cell, minlength=8)
    np.testing.assert_allclose(np.bincount(octant, minlength=8) / len(toward), expected, atol=5e-3)


@pytest.mark.parametrize("name", ["diffuse", "metal", "rough metal", "plastic"])
def test_reflection_is_reciprocal(name):
    look, normal = LOOKS[name], np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(1)
    a, b = (np.array([unit(v) for v in np.abs(rng.normal(size=(50, 3))) * (1, 1, 0.5)]) for _ in range(2))
    there = np.array([value_of(look, normal, x, y[None])[0, :3] / y[2] for x, y in zip(a, b, strict=True)])
    back = np.array([value_of(look, normal, y, x[None])[0, :3] / x[2] for x, y in zip(a, b, strict=True)])
    assert (there > 0.0).all()
    np.testing.assert_allclose(there, back, rtol=1e-3)


def test_refraction_is_reciprocal_up_to_the_compression_of_radiance():
    """f(a, b) / n_b^2 = f(b, a) / n_a^2 (Veach 1997, section 5.2)."""
    normal = np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(2)
    above = np.array([unit(v) for v in rng.normal(size=(60, 3)) * (0.4, 0.4, 0) + (0, 0, 1)])
    below = np.array([unit(v) for v in rng.normal(size=(60, 3)) * (0.3, 0.3, 0) - (0, 0, 1)])
    for x, y in zip(above, below, strict=True):
        enters = value_of(LOOKS["frosted, entering"], normal, x, y[None])[0, 0] / -y[2]
        leaves = value_of(LOOKS["frosted, leaving"], -normal, y, x[None])[0, 0] / x[2]
        np.testing.assert_allclose(enters * 1.5**2, leaves, rtol=2e-3, atol=1e-6)


def test_white_facets_lose_what_they_scatter_twice():
    """Light that is scattered twice among facets is not counted: smooth surfaces lose almost nothing, rough ones more. The
    reference is the integral of D G2 / 4 cos in float64, where G2 = 1 / (1 + lambda(a) + lambda(b))."""
    normal = np.array([0.0, 0.0, 1.0])
    grid, cell = sphere_grid(4000, 4)
    toward = grid[grid[:, 2] > 0.0]
    facet = toward + normal
    cosine = facet[:, 2] / np.linalg.norm(facet, axis=1)
    for alpha in (0.1, 0.3, 1.0):
        density = alpha**2 / (np.pi * (cosine**2 * (alpha**2 - 1) + 1) ** 2)
        hidden = 0.5 * (np.sqrt(1 + alpha**2 * (1 / toward[:, 2] ** 2 - 1)) - 1)
        expected = (density / (1 + hidden) / 4).sum() * cell
        _, drawn = sample_of(make_look(GLOSSY, alpha=alpha, metallic=1.0), normal, normal, 200_000)
        np.testing.assert_allclose(drawn[:, 0].mean(), expected, atol=2e-3)
        assert expected < 1.0
