"""Arrays of other types, layouts and libraries: the right answer, or an error with the argument's name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import wrt

MESH = wrt.scenes.build("teapot", level=2)
ORIGINS = np.float32([[0, 0, 9], [4, 0, 8], [0, -9, 1]])
DIRECTIONS = np.float32([[0, 0, -1], [-1, 0, -2], [0, 1, 0]])


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(MESH, device="cpu")


class Tensor:
    """An array of another library, with as much of PyTorch's protocol as conversions use.

    PyTorch refuses to hand out a tensor that records gradients. It does hand out, through DLPack, the memory of a view that
    negates its numbers only when they are read (`z.conj().imag`).
    """

    def __init__(self, values: Any, requires_grad: bool = False, negated: bool = False) -> None:
        self.values, self.requires_grad, self.negated = np.array(values), requires_grad, negated
        self.shape, self.ndim = self.values.shape, self.values.ndim

    def __getitem__(self, rows: Any) -> Tensor:
        return Tensor(self.values[rows], self.requires_grad, self.negated)

    def is_neg(self) -> bool:
        return self.negated

    def resolve_neg(self) -> Tensor:
        return Tensor(-self.values if self.negated else self.values, self.requires_grad)

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        if self.requires_grad:
            raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.")
        if self.negated:
            raise RuntimeError(
                "Can't call numpy() on Tensor that has negative bit set. Use tensor.resolve_neg().numpy() instead."
            )
        return self.values if dtype is None else self.values.astype(dtype)

    def __dlpack__(self, **options: Any) -> Any:
        if self.requires_grad:
            raise BufferError("Can't export tensors that require gradient, use tensor.detach()")
        return self.values.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.values.__dlpack_device__()


TAKERS: dict[str, tuple[str, Callable[[wrt.Scene, Any], Any], Any]] = {
    "origins": ("origins", lambda scene, x: scene.intersect(x, DIRECTIONS), ORIGINS),
    "directions": ("directions", lambda scene, x: scene.intersect(ORIGINS, x), DIRECTIONS),
    "t_max": ("t_max", lambda scene, x: scene.occluded(ORIGINS, DIRECTIONS, 0.0, x), np.float32([1, 2, 3])),
    "points": ("points", lambda scene, x: scene.contains(x), ORIGINS),
    "points_a": ("points_a", lambda scene, x: scene.visible(x, ORIGINS), ORIGINS),
    "skip": ("skip", lambda scene, x: scene.occluded(ORIGINS, DIRECTIONS, skip=x), np.int32([1, 2, 3])),
    "vertices": ("vertices", lambda scene, x: wrt.TriangleMesh(x, MESH.faces), MESH.vertices),
    "faces": ("faces", lambda scene, x: wrt.TriangleMesh(MESH.vertices, x), MESH.faces),
    "moved vertices": ("vertices", lambda scene, x: scene.update(0, vertices=x), MESH.vertices),
    "transform": ("transform", lambda scene, x: wrt.Instance(MESH, x), np.eye(4)),
    "values": ("vertex_values", lambda scene, x: scene.intersect(ORIGINS, DIRECTIONS).interpolate(x), MESH.vertices[:, 0]),
    "blocks": ("origins", lambda scene, x: scene.occluded_blocks(x, DIRECTIONS).result(), ORIGINS),
    "spawn": ("directions", lambda scene, x: scene.intersect(ORIGINS, DIRECTIONS).spawn(x), DIRECTIONS),
    "position": ("position", lambda scene, x: wrt.lights.PointLight(x), ORIGINS[0]),
    "color": ("color", lambda scene, x: wrt.Material(color=x), np.array([0.5, 0.5, 0.5])),
    "fov": ("fov", lambda scene, x: wrt.PinholeCamera(2, 2, fov=x, position=(0, -9, 0), look_at=(0, 0, 0)), np.array(45.0)),
    "pose": ("pose", lambda scene, x: wrt.sensors.Camera(2, 2, LENS).capture(scene, x), np.eye(4)),
    "pixels": ("pixels", lambda scene, x: LENS.unproject(x), np.array([1.0, 2.0])),
    "image": ("image", lambda scene, x: wrt.Texture(x), np.ones((2, 2, 3))),
    "rays": ("rays", lambda scene, x: wrt.compat.RaycastingScene(device="cpu").cast_rays(x), np.ones((2, 6))),
    "ray_origins": ("ray_origins", lambda scene, x: wrt.compat.RayMeshIntersector(MESH).intersects_any(x, DIRECTIONS), ORIGINS),
}
"""The name of an argument that takes an array, a call with it, and an array that it takes."""

LENS = wrt.sensors.BrownConrady(4, 4, 2, 2)


@pytest.mark.parametrize("taker", TAKERS)
def test_tensors_that_record_gradients(scene, taker):
    """PyTorch's own error came through, which named no argument."""
    name, call, values = TAKERS[taker]
    with pytest.raises(TypeError, match=rf"{name} records gradients.*{name}\.detach\(\)"):
        call(scene, Tensor(values, requires_grad=True))


@pytest.mark.parametrize("taker", ["origins", "directions", "points", "vertices", "blocks"])
def test_tensors_that_are_negated_when_read(scene, taker):
    """Through DLPack, rays started at the negatives of their origins, without a word."""
    _, call, values = TAKERS[taker]
    found, expected = (call(scene, Tensor(given, negated=is_view)) for given, is_view in ((values, True), (-values, False)))
    if taker == "vertices":
        np.testing.assert_array_equal(found.vertices, expected.vertices)
    else:
        np.testing.assert_array_equal(*(np.array(getattr(one, "t", one)) for one in (found, expected)))


def test_tensors_of_pytorch(scene):
    torch = pytest.importorskip("torch")
    origins, directions = torch.tensor(ORIGINS), torch.tensor(DIRECTIONS)
    expected = scene.intersect(ORIGINS, DIRECTIONS).t
    np.testing.assert_array_equal(scene.intersect(origins, directions).t.numpy(), expected)
    view = torch.complex(origins, -origins).conj().imag
    assert view.is_neg()
    np.testing.assert_array_equal(scene.intersect(view, directions).t.numpy(), expected)
    np.testing.assert_array_equal(
        wrt.TriangleMesh(torch._neg_view(-torch.tensor(MESH.vertices)), MESH.faces).vertices, MESH.vertices
    )
    for bad in (origins.clone().requires_grad_(), origins.to_sparse(), origins.to("meta"), origins.half(), origins.int()):
        with pytest.raises(TypeError, match="origins"):
            scene.intersect(bad, directions)


def unaligned(values: np.ndarray) -> np.ndarray:
    """The same array at an odd address, as a field of a packed record has it."""
    return np.frombuffer(b"x" + values.tobytes(), dtype=values.dtype, offset=1).reshape(values.shape)


def frozen(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values.flags.writeable = False
    return values


SAME = {
    "list": np.ndarray.tolist,
    "float16": lambda x: x.astype(np.float16),
    "float64": lambda x: x.astype(np.float64),
    "longdouble": lambda x: x.astype(np.longdouble),
    "int8": lambda x: x.astype(np.int8),
    "int64": lambda x: x.astype(np.int64),
    "big-endian": lambda x: x.astype(">f4"),
    "big-endian float64": lambda x: x.astype(">f8"),
    "columns first": np.asfortranarray,
    "reversed": lambda x: x[::-1].copy()[::-1],
    "every other": lambda x: np.repeat(x, 2, axis=0)[::2],
    "read-only": frozen,
    "unaligned": unaligned,
    "matrix": np.matrix,
    "masked array without masked values": np.ma.array,
    "another library's": Tensor,
}

REFUSED = {
    "objects": lambda x: x.astype(object),
    "complex": lambda x: x.astype(complex),
    "text": lambda x: x.astype(str),
    "dates": lambda x: x.astype("datetime64[s]"),
    "times": lambda x: x.astype("timedelta64[s]"),
    "bool": lambda x: x.astype(bool),
    "records": lambda x: np.zeros(3, dtype=[("x", np.float32), ("y", np.float32), ("z", np.float32)]),
    "masked values": lambda x: np.ma.array(x, mask=x > 3),
    "rows of different lengths": lambda x: [[0, 0, 9], [4, 0]],
    "None": lambda x: [[0, 0, None]],
    "a set": lambda x: {0, 1, 2},
    "a generator": lambda x: (row for row in x),
}


@pytest.mark.parametrize("form", SAME)
def test_rays_and_vertices_in_arrays_of_any_form(scene, form):
    made, expected = SAME[form], scene.intersect(ORIGINS, DIRECTIONS)
    hits = scene.intersect(made(ORIGINS), made(DIRECTIONS))
    for name in ("t", "primitive_id", "uv"):
        np.testing.assert_array_equal(np.array(getattr(hits, name)), getattr(expected, name))
    if form == "big-endian":  # the width of numbers stays, and with it that of positions
        assert hits.position.dtype == expected.position.dtype == np.float32
    np.testing.assert_array_equal(np.array(scene.contains(made(ORIGINS))), scene.contains(ORIGINS))
    if form not in ("int8", "int64", "float16"):
        mesh = wrt.TriangleMesh(made(MESH.vertices.astype(np.float32)), MESH.faces)
        np.testing.assert_array_equal(mesh.vertices, MESH.vertices.astype(np.float32))
    assert wrt.TriangleMesh(MESH.vertices, MESH.faces.astype(">i8")).faces.dtype == np.int32


@pytest.mark.parametrize("form", REFUSED)
def test_arrays_that_mean_something_else(scene, form):
    """NumPy would drop masks, imaginary parts and units without a word."""
    bad = REFUSED[form](ORIGINS)
    calls = {
        "origins": lambda: scene.intersect(bad, DIRECTIONS),
        "directions": lambda: scene.occluded(ORIGINS, bad),
        "points": lambda: scene.contains(bad),
        "points_b": lambda: scene.visible(ORIGINS, bad),
        "vertices": lambda: wrt.TriangleMesh(bad, [[0, 1, 2]]),
        "position": lambda: wrt.lights.PointLight(bad),
        "positions": lambda: wrt.sensors.Trajectory([0, 1, 2], bad),
    }
    for name, call in calls.items():
        with pytest.raises((TypeError, ValueError), match=rf"\b{name}\b"):
            call()
