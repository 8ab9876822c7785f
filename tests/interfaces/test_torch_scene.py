"""Tensors of PyTorch: the answers of arrays in shared memory, and gradients. PyTorch is no dependency: without it, all
but the first tests are skipped."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays

import wrt

MESH = wrt.scenes.build("teapot", level=3, ground=False)


def torch_or_skip():
    return pytest.importorskip("torch", reason="PyTorch is not installed")


@pytest.fixture(scope="module")
def scenes() -> dict[str, wrt.Scene]:
    return {}


@pytest.fixture
def given(device, scenes):
    """PyTorch, a scene, and rays as NumPy arrays and as tensors on the scene's device."""
    torch = torch_or_skip()
    if device != "cpu" and not torch.cuda.is_available():
        pytest.skip("this PyTorch has no CUDA")
    scene = scenes.setdefault(device, wrt.Scene(MESH, device=device))
    rays = [np.asarray(values, dtype=np.float32) for values in mixed_rays(MESH, 500)]
    return torch, scene, rays, [torch.tensor(values, device=device) for values in rays]


def test_pytorch_is_not_imported():
    """By no query, and not by the module that has the class."""
    code = (
        "import sys, wrt, wrt.compat.torch_scene; scene = wrt.Scene(wrt.scenes.build('teapot', level=2), device='cpu'); "
        "scene.intersect([0, 0, 9], [0, 0, -1]); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


def test_without_pytorch(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "wrt\[torch\]"'):
        wrt.compat.TorchScene(wrt.Scene(MESH, device="cpu"))


def test_queries(given):
    """Each has the bits of NumPy's, as a tensor where the scene is."""
    torch, scene, rays, rays_there = given
    tensors = wrt.compat.TorchScene(scene)
    hits, expected = tensors.intersect(*rays_there), scene.intersect(*rays)
    assert 0.1 < expected.is_hit.mean() < 0.95
    pairs = [(getattr(hits, name), getattr(expected, name)) for name in ("t", "uv", "primitive_id", "is_hit", "normal")]
    ends = torch.full((500,), 0.5, device=rays_there[0].device)
    pairs.append((tensors.occluded(*rays_there, t_max=ends), scene.occluded(*rays, t_max=0.5)))
    pairs.append((tensors.count(*rays_there), scene.count(*rays)))
    pairs.append((tensors.contains(rays_there[0]), scene.contains(rays[0])))
    pairs.append((tensors.visible(*rays_there), scene.visible(*rays)))
    pairs.append((hits.spawn(rays_there[1]), expected.spawn(rays[1])))
    pairs.append((tensors.count(*rays_there, skip=hits), scene.count(*rays, skip=expected)))
    found, near = tensors.closest_point(rays_there[0], k=2), scene.closest_point(rays[0], k=2)
    lists, listed = tensors.intersect_all(*rays_there), scene.intersect_all(*rays)
    assert len(lists) == len(listed) > 500
    pairs += [(found.distance, near.distance), (found.position, near.position)]
    pairs += [(getattr(lists, name), getattr(listed, name)) for name in ("t", "primitive_id")]
    distance = wrt.analysis.signed_distance(scene, rays_there[0])
    pairs.append((wrt.compat.as_tensors(distance), wrt.analysis.signed_distance(scene, rays[0])))
    for tensor, array in pairs:
        assert isinstance(tensor, torch.Tensor)
        assert tensor.device.type == scene.device.alias.split(":")[0]
        np.testing.assert_array_equal(tensor.cpu().numpy(), array)
    assert hits.t.data_ptr() == hits.result.t.ptr


def test_shapes(given):
    """Leading shapes broadcast, also where Warp's arrays do not; a view that PyTorch negates when it is read is read so."""
    torch, scene, rays, (origins, directions) = given
    tensors = wrt.compat.TorchScene(scene)
    fan = tensors.intersect(origins[:4, None], directions[None, :5])
    assert fan.t.shape == (4, 5)
    expected = scene.intersect(rays[0][:4, None], rays[1][None, :5])
    np.testing.assert_array_equal(fan.t.cpu().numpy(), expected.t)
    turned = torch._neg_view(-directions)
    np.testing.assert_array_equal(tensors.intersect(origins, turned).t.cpu(), tensors.intersect(origins, directions).t.cpu())
    doubled = tensors.intersect(origins.double(), directions.double())
    assert doubled.position.dtype == torch.float64


def test_gradients(given):
    """Of distances, positions, normals and closest points, in float64: central differences."""
    torch, scene, _, rays = given
    tensors = wrt.compat.TorchScene(scene)
    rng = np.random.default_rng(0)  # of the others some go through edges, where distances have no derivative
    start = rng.normal(size=(40, 3)) * 8.0
    rays = [torch.tensor(values, device=rays[0].device) for values in (start, rng.normal(size=(40, 3)) - start)]
    hit = torch.nonzero(tensors.intersect(*rays).is_hit)[:5, 0]
    origins, directions = (values[hit].requires_grad_() for values in rays)
    vertices = torch.tensor(MESH.vertices, dtype=torch.float64, device=rays[0].device, requires_grad=True)

    def hits(*given):
        found = tensors.intersect(*given)
        return found.t, found.position, found.uv

    def points(given):
        found = tensors.closest_point(given)
        return found.distance, found.position

    check = partial(torch.autograd.gradcheck, eps=1e-7, atol=1e-4)
    assert check(hits, (origins, directions))
    assert check(points, (origins,))
    found = tensors.intersect(origins, directions, vertices=vertices)
    found.t.sum().backward()
    row = int(MESH.faces[int(found.primitive_id[0]), 0])
    step, slope = 1e-6, float(vertices.grad[row, 0])
    with torch.no_grad():
        moved = [vertices.clone() for _ in range(2)]
        moved[0][row, 0] -= step
        moved[1][row, 0] += step
    low, high = (tensors.intersect(origins, directions, vertices=one.requires_grad_()).t.sum().item() for one in moved)
    assert slope == pytest.approx((high - low) / (2 * step), rel=1e-4, abs=1e-7)
    near = tensors.closest_point(origins, vertices=vertices)
    (gradient,) = torch.autograd.grad(near.distance.sum(), vertices)
    assert gradient.abs().sum() > 0.1


def test_misses_and_constants(given):
    """Misses contribute nothing; queries without gradients, and code that asks for none, take such tensors as constants."""
    torch, scene, _, (origins, directions) = given
    tensors = wrt.compat.TorchScene(scene)
    start = origins.clone().requires_grad_()
    found = tensors.intersect(start, directions)
    assert found.t.isinf().any()
    found.t.sum().backward()
    assert start.grad.isfinite().all()
    assert not start.grad[~found.is_hit].any()
    assert tensors.occluded(start, directions).dtype == torch.bool
    with torch.no_grad():
        assert not tensors.intersect(start, directions).t.requires_grad


def test_results_of_every_kind():
    """Scans, dicts, tuples; what has no tensor stays."""
    torch = torch_or_skip()
    scene = wrt.Scene(MESH, device="cpu")
    scan = wrt.sensors.Lidar.preset("ouster_os1_64", columns=16).scan(scene, np.eye(4))
    taken = wrt.compat.as_tensors(scan)
    np.testing.assert_array_equal(taken.range.numpy(), scan.range)
    mixed = wrt.compat.as_tensors({"a": (np.arange(3), 1.5), "b": [wp.zeros(2, dtype=wp.vec3, device="cpu")], "c": "text"})
    assert mixed["a"][0].dtype == torch.int64
    assert mixed["b"][0].shape == (2, 3)
    assert (mixed["a"][1], mixed["c"]) == (1.5, "text")
    table = np.zeros(2, dtype=[("x", np.float32)])
    assert wrt.compat.as_tensors(table) is table
    assert "TensorResult" in repr(taken)
    assert "range" in dir(taken)
