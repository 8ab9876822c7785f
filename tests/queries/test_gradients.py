"""Gradients of hits with respect to rays and vertices, against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.ptx import compile_to_ptx

import wrt
from wrt.kernels.query.hit_gradients import make_gradient_kernel

OUTPUTS = ("t", "uv", "position", "normal")

ARGUMENTS = ("origins", "directions", "vertices")


@pytest.fixture(scope="module")
def mesh() -> wrt.TriangleMesh:
    """A teapot; its vertices belong to several triangles each."""
    return wrt.scenes.build("teapot", level=3, ground=False)


@pytest.fixture(scope="module")
def values(mesh) -> dict[str, np.ndarray]:
    """Rays from around to points within, none of them grazing, one in eight turned away; and the vertices."""
    rng = np.random.default_rng(8)
    origins = rng.normal(size=(400, 3))
    origins = mesh.center + mesh.extent * origins / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = (mesh.center + 0.1 * mesh.extent * rng.normal(size=(400, 3)) - origins) * rng.uniform(0.3, 3.0, (400, 1))
    hits = wrt.Scene(mesh, device="cpu").intersect(origins, directions, precise=True)
    cosine = np.abs((hits.normal * directions).sum(axis=1)) / np.linalg.norm(directions, axis=1)
    kept = np.flatnonzero(cosine > 0.2)[:120]
    assert len(kept) == 120
    directions[kept[::8]] *= -1.0
    return {"origins": origins[kept], "directions": directions[kept], "vertices": mesh.vertices.astype(np.float64)}


@pytest.fixture(scope="module")
def weights() -> dict[str, np.ndarray]:
    """A weight for each component of each output: the gradient that comes in from above."""
    rng = np.random.default_rng(5)
    return {name: rng.normal(size=(120, *(() if name == "t" else (2 if name == "uv" else 3,)))) for name in OUTPUTS}


def differentiate(
    scene, hits, values, weights, output, dtype
) -> tuple[wrt.query.gradients.DifferentiableHits, dict[str, np.ndarray]]:
    """Outputs, and the gradient of one of them, weighted and summed up, with respect to each argument."""
    arrays = {name: wp.array(values[name], dtype=dtype, device=scene.device, requires_grad=True) for name in ARGUMENTS}
    with wp.Tape() as tape:
        found = wrt.device.differentiable_hits(scene, hits, **arrays)
    result = getattr(found, output)
    tape.backward(grads={result: wp.array(weights[output], dtype=result.dtype, device=scene.device)})
    return found, {name: array.grad.numpy() for name, array in arrays.items()}


def weighted(scene, hits, values, weights, output) -> float:
    """The number whose gradient that is; misses left out."""
    arrays = {name: values[name] for name in ARGUMENTS}
    result = getattr(wrt.device.differentiable_hits(scene, hits, **arrays), output).numpy()
    return float((result * weights[output])[hits.is_hit].sum())


@pytest.mark.parametrize("output", OUTPUTS)
def test_finite_differences(mesh, values, weights, output, device):
    """In 12 random directions in the space of all rays and vertices, and of each argument alone."""
    scene = wrt.Scene(mesh, device=device)
    hits = scene.intersect(values["origins"], values["directions"], precise=True)
    assert hits.is_hit.sum() == 105
    found, gradients = differentiate(scene, hits, values, weights, output, wp.vec3d)
    exact = getattr(hits, output)
    np.testing.assert_allclose(getattr(found, output).numpy(), exact, rtol=1e-10, atol=1e-10)
    rng = np.random.default_rng(1)
    for trial in range(12):
        moved = ARGUMENTS if trial >= 3 else ARGUMENTS[trial : trial + 1]
        steps = {name: rng.normal(size=values[name].shape) * (name in moved) for name in ARGUMENTS}
        step = 1e-6
        ends = [{name: values[name] + sign * step * steps[name] for name in ARGUMENTS} for sign in (1, -1)]
        above, below = (weighted(scene, hits, end, weights, output) for end in ends)
        slope = sum(float((gradients[name] * steps[name]).sum()) for name in ARGUMENTS)
        size = sum(float(np.abs(gradients[name] * steps[name]).sum()) for name in ARGUMENTS)
        assert abs((above - below) / (2 * step) - slope) <= 1e-6 * size
    for name in ARGUMENTS[:2]:
        assert not gradients[name][~hits.is_hit].any()
        if (output, name) != ("normal", name):
            assert gradients[name][hits.is_hit].any(axis=1).all()


def test_float32(mesh, values, weights, device):
    """As in float64, to the precision of the arrays; a fixed origin, vertices of the scene, rays in rows."""
    scene = wrt.Scene(mesh, device=device)
    hits = scene.intersect(values["origins"], values["directions"])
    _, expected = differentiate(scene, hits, values, weights, "t", wp.vec3d)
    found, gradients = differentiate(scene, hits, values, weights, "t", wp.vec3f)
    assert found.t.dtype is wp.float32
    np.testing.assert_array_equal(np.isinf(found.t.numpy()), ~hits.is_hit)
    for name in ARGUMENTS:
        np.testing.assert_allclose(gradients[name], expected[name], rtol=1e-4, atol=1e-5)


def test_shared_origin_and_shapes(mesh, values, device):
    """Rays in rows and columns, from one origin, whose gradient is the sum of all; vertices left to the scene."""
    scene = wrt.Scene(mesh, device=device)
    origin = values["origins"][:1]
    directions = values["vertices"][:120].reshape(10, 12, 3) - origin
    hits = scene.intersect(origin[0], directions)
    one = wp.array(origin, dtype=wp.vec3d, device=device, requires_grad=True)
    many = wp.array(np.tile(origin, (120, 1)).reshape(10, 12, 3), dtype=wp.float64, device=device, requires_grad=True)
    gradients = []
    for start in (one, many):
        with wp.Tape() as tape:
            found = wrt.device.differentiable_hits(scene, hits, start, directions)
        assert found.t.shape == found.position.shape == (10, 12)
        tape.backward(grads={found.t: wp.ones_like(found.t), found.position: wp.ones_like(found.position)})
        gradients.append(start.grad.numpy().reshape(-1, 3).sum(axis=0))
    assert np.abs(gradients[0]).max() > 0.1
    np.testing.assert_allclose(*gradients, rtol=1e-12)


def test_bad_arguments(mesh, values):
    scene = wrt.Scene(mesh, device="cpu")
    hits = scene.intersect(values["origins"], values["directions"])
    with pytest.raises(ValueError, match="vertices have the shape"):
        wrt.device.differentiable_hits(scene, hits, values["origins"], values["directions"], mesh.vertices[:-1])
    with pytest.raises(ValueError, match="directions have the leading shape"):
        wrt.device.differentiable_hits(scene, hits, values["origins"], values["directions"][:7])
    with pytest.raises(ValueError, match="hits belong to another scene"):
        wrt.device.differentiable_hits(wrt.Scene([mesh, mesh], device="cpu"), hits, values["origins"], values["directions"])
    with pytest.raises(TypeError, match="origins"):
        wrt.device.differentiable_hits(scene, hits, "here", values["directions"])


def test_cuda(tmp_path):
    text = compile_to_ptx(make_gradient_kernel(wp.vec3f, wp.vec3f, wp.vec3d, False).module, tmp_path)
    assert "backward" in text


def test_hits_of_another_scene_are_refused(mesh, values):
    """With or without instances; it was "'NoneType' object has no attribute 'shape'"."""
    plain, instanced = wrt.Scene(mesh, device="cpu"), wrt.Scene([wrt.Instance(mesh)], device="cpu")
    rays = values["origins"], values["directions"]
    for scene, other in ((plain, instanced), (instanced, plain)):
        with pytest.raises(ValueError, match="hits belong to another scene"):
            wrt.device.differentiable_hits(scene, other.intersect(*rays), *rays)


@pytest.mark.parametrize("name", ["intersect", "intersect_all"])
@pytest.mark.parametrize("argument", ["origins", "directions"])
def test_queries_do_not_lose_gradients_in_silence(mesh, values, name, argument, device):
    """Inside a tape the gradient of their distances was 0, without a word."""
    scene = wrt.Scene(mesh, device=device)
    rays = {key: wp.array(values[key], dtype=wp.vec3, device=device, requires_grad=key == argument) for key in ARGUMENTS[:2]}
    query = getattr(scene, name)
    query(**rays)
    with wp.Tape():
        with pytest.raises(ValueError, match=rf"{name} has no gradients, .* wrt\.device\.differentiable_hits"):
            query(**rays)
        query(**rays | {argument: wp.clone(rays[argument], requires_grad=False)})
        query(values["origins"], values["directions"])
        for harmless in (scene.occluded, scene.count):
            harmless(**rays)
        scene.contains(rays["origins"])


def test_tapes_take_no_notice_of_queries(mesh, values, weights, device):
    """They were recorded if they were short enough, and going back failed at structs without arrays."""
    scene = wrt.Scene(mesh, device=device)
    rays = {name: wp.array(values[name], dtype=wp.vec3, device=device) for name in ARGUMENTS[:2]}
    starts = wp.array(values["origins"], dtype=wp.vec3, device=device, requires_grad=True)
    with wp.Tape() as tape:
        hits = scene.intersect(**rays, traversal="single")
        scene.intersect_all(**rays)
        scene.visible(rays["origins"], rays["directions"])
        hits.position, hits.normal, hits.is_hit, hits.spawn(rays["directions"])
        assert [launch[0].key for launch in tape.launches if launch[0].module.name.startswith("wrt")] == []
        found = wrt.device.differentiable_hits(scene, hits, starts, rays["directions"])
        wrt.Scene(mesh, device=device)
    tape.backward(grads={found.t: wp.array(weights["t"], dtype=float, device=device)})
    assert starts.grad.numpy().any()
