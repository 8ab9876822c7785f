"""Queries on tensors of PyTorch, with gradients: memory is shared, nothing is copied.

PyTorch is imported when a `TorchScene` is made, or a result is given as tensors; nothing else of wrt needs it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.query.gradients import differentiable_hits
from wrt.query.points.differentiable_points import differentiable_points

if TYPE_CHECKING:
    import torch

    from wrt.scene.scene import Scene

INF = float("inf")

RANGES = ("t_min", "t_max")
"""Arguments of which only float32 is read on a device."""

HIT_VALUES, POINT_VALUES = ("t", "uv", "position", "normal"), ("distance", "position")
"""What is differentiable of hits and of closest points, in the order of the fields there."""


def as_tensors(result: Any) -> Any:
    """A result of wrt with tensors of PyTorch in place of arrays, in the same memory.

        scan = wrt.compat.as_tensors(lidar.scan(scene, pose))
        scan.range  # a tensor

    Args:
        result: an array, which becomes a tensor; a tuple, list or dict, whose values do; or a result such as `wrt.Hits`,
            `wrt.AllHits`, `wrt.sensors.LidarScan` or `wrt.sensors.CameraImages`, whose attributes do when they are
            read. Anything else is returned as it is.

    Returns:
        Tensors on the device of the arrays. Vectors of Warp become a last axis. Arrays of NumPy types that PyTorch
        does not have, such as structured ones, stay.

    Raises:
        ModuleNotFoundError: PyTorch is not installed.
    """
    if isinstance(result, wp.array):
        return wp.to_torch(result, requires_grad=False)
    if isinstance(result, np.ndarray):
        return _of_numpy(result)
    if type(result) in (tuple, list):
        return type(result)(map(as_tensors, result))
    if type(result) is dict:
        return {name: as_tensors(value) for name, value in result.items()}
    is_own = type(result).__module__.split(".")[0] == "wrt" and not isinstance(result, TensorResult)
    return TensorResult(result) if is_own else result


def _of_numpy(values: np.ndarray) -> Any:
    """A tensor in the memory of an array; the array, if there are no such tensors. PyTorch warns of memory that may
    only be read."""
    torch = torch_module()
    try:
        return torch.from_numpy(values if values.flags.writeable else values.copy())
    except TypeError:
        return values


class TensorResult:
    """A result of a query whose attributes and methods give tensors of PyTorch.

    Args:
        result: what they are read from, with Warp or NumPy arrays; kept as an attribute.
        known: attributes that are tensors already.
    """

    def __init__(self, result: Any, known: dict[str, Any] | None = None) -> None:
        self.result = result
        self.__dict__ |= known or {}

    def __getattr__(self, name: str) -> Any:
        """An attribute of the result, or one of its methods that takes tensors."""
        if name.startswith("__"):
            raise AttributeError(name)
        value = getattr(self.result, name)
        return _on_tensors(value) if callable(value) else as_tensors(value)

    def __dir__(self) -> list[str]:
        return sorted({*object.__dir__(self), *dir(self.result)})

    def __len__(self) -> int:
        return len(self.result)

    def __repr__(self) -> str:
        return f"TensorResult({self.result!r})"


class TorchScene:
    """A scene whose queries take tensors of PyTorch and give tensors, on the CPU and on CUDA.

        tensors = wrt.compat.TorchScene(scene)
        hits = tensors.intersect(origins, directions)
        hits.t.sum().backward()  # where origins, directions or vertices require gradients

    Every query and property of `wrt.Scene` is here, with its arguments: tensors may be passed wherever arrays may, and arrays
    come out as tensors. They share memory with Warp's arrays. Results are `TensorResult`, whose attributes are those of the
    query's result.

    Gradients pass through `intersect` and `closest_point`. Other queries give booleans, integers or lists, which have none, and
    take tensors that require gradients as constants. The triangle that a ray hits, or that is nearest, is held fixed:
    silhouettes contribute none (`wrt.device.differentiable_hits`).

    On CUDA, Warp works on a stream of its own that waits for PyTorch's default stream and is waited for by it; on
    another stream, use `wp.ScopedStream(wp.stream_from_torch(...))`.

    Attributes:
        scene: the scene.
    """

    def __init__(self, scene: Scene) -> None:
        """A view of a scene.

        Args:
            scene: the scene; tensors must be on its device.

        Raises:
            ModuleNotFoundError: PyTorch is not installed.
        """
        torch_module()
        self.scene = scene

    def __getattr__(self, name: str) -> Any:
        """A property of the scene, or one of its queries on tensors."""
        if name.startswith("__") or name == "scene":
            raise AttributeError(name)
        value = getattr(self.scene, name)
        return _on_tensors(value) if callable(value) else value

    def __dir__(self) -> list[str]:
        return sorted({*object.__dir__(self), *dir(self.scene)})

    def __repr__(self) -> str:
        return f"TorchScene({self.scene!r})"

    def intersect(
        self,
        origins: torch.Tensor,
        directions: torch.Tensor,
        t_min: float | torch.Tensor = 0.0,
        t_max: float | torch.Tensor = INF,
        *,
        vertices: torch.Tensor | None = None,
        **options: Any,
    ) -> TensorResult:
        """Closest hits, as `wrt.Scene.intersect`.

        Args:
            origins, directions: (..., 3) tensors of float32 or float64; leading shapes broadcast.
            t_min, t_max: numbers, or (...) tensors.
            vertices: (V, 3) tensor of the vertices of all meshes, concatenated, which receives gradients; None for none. They
                should be where the scene has them: pass them to `update` too.
            options: as there.

        Returns:
            A `TensorResult` of `wrt.Hits`. If a tensor requires gradients, `t`, `uv`, `position` and `normal` are computed
            again from the triangle that was hit, as functions of the tensors, in float64 if one of them is; they are not those
            of the traversal in the last bits.

        Raises:
            TypeError, ValueError: as `wrt.Scene.intersect` and `wrt.device.differentiable_hits`.
        """
        origins, directions = _broadcast(origins, directions)
        given = {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}
        hits = self.scene.intersect(**_as_arguments(given), **_as_arguments(options))
        if not _wants_gradients(origins, directions, vertices):
            return TensorResult(hits)
        found = partial_hits(self.scene, hits)
        values = _gradient_function().apply(found, origins, directions, vertices)
        return TensorResult(hits, dict(zip(HIT_VALUES, values, strict=True)))

    def closest_point(self, points: torch.Tensor, *, vertices: torch.Tensor | None = None, **options: Any) -> TensorResult:
        """Closest points, as `wrt.Scene.closest_point`.

        Args:
            points: (..., 3) tensor of float32 or float64.
            vertices: as in `intersect`.
            options: as there.

        Returns:
            A `TensorResult` of `wrt.results.ClosestPoints`; if a tensor requires gradients, `distance` and `position`
            have them.

        Raises:
            TypeError, ValueError: as `wrt.Scene.closest_point` and `wrt.device.differentiable_points`.
        """
        found = self.scene.closest_point(_as_argument("points", points), **_as_arguments(options))
        if not _wants_gradients(points, vertices):
            return TensorResult(found)
        values = _gradient_function().apply(partial_points(self.scene, found), points, vertices)
        return TensorResult(found, dict(zip(POINT_VALUES, values, strict=True)))


def partial_hits(scene: Scene, hits: Any) -> Callable[..., tuple[wp.array, ...]]:
    """Hits as a function of Warp arrays."""

    def function(*given: wp.array) -> tuple[wp.array, ...]:
        found = differentiable_hits(scene, hits, *given)
        return tuple(getattr(found, name) for name in HIT_VALUES)

    return function


def partial_points(scene: Scene, nearest: Any) -> Callable[..., tuple[wp.array, ...]]:
    """Closest points likewise."""

    def function(*given: wp.array) -> tuple[wp.array, ...]:
        found = differentiable_points(scene, nearest, *given)
        return tuple(getattr(found, name) for name in POINT_VALUES)

    return function


def torch_module() -> Any:
    """PyTorch.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    try:
        import torch
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError('tensors need PyTorch: pip install "wrt[torch]"', name="torch") from error
    return torch


def _is_tensor(value: Any) -> bool:
    return isinstance(value, torch_module().Tensor)


def _wants_gradients(*values: Any) -> bool:
    torch = torch_module()
    return torch.is_grad_enabled() and any(_is_tensor(value) and value.requires_grad for value in values)


def _broadcast(origins: Any, directions: Any) -> tuple[Any, Any]:
    """Tensors of one leading shape, where neither is a single vector: Warp's arrays broadcast from one alone."""
    both = _is_tensor(origins) and _is_tensor(directions) and min(origins.numel(), directions.numel()) > 3
    if both and origins.shape != directions.shape:
        origins, directions = torch_module().broadcast_tensors(origins, directions)
    return origins, directions


def _as_arguments(given: dict[str, Any]) -> dict[str, Any]:
    return {name: _as_argument(name, value) for name, value in given.items()}


def _as_argument(name: str, value: Any) -> Any:
    """An argument of a query: of a tensor, the Warp array in its memory; of a result, what it was made from."""
    if isinstance(value, TensorResult):
        return value.result
    if not _is_tensor(value):
        return value
    value = value.detach()
    if value.ndim == 0:
        return value.item()
    if name in RANGES:
        value = value.to(torch_module().float32)
    return wp.from_torch(value.resolve_neg().contiguous(), requires_grad=False)


def _on_tensors(method: Callable[..., Any]) -> Callable[..., Any]:
    """A method that takes and gives tensors."""

    def on_tensors(*given: Any, **options: Any) -> Any:
        return as_tensors(method(*(_as_argument("", value) for value in given), **_as_arguments(options)))

    on_tensors.__doc__ = method.__doc__
    return on_tensors


def _vectors(value: Any) -> Any:
    """What `function` of the class below takes: vectors that receive gradients if the tensor does, or None."""
    if not _is_tensor(value):
        return value
    torch = torch_module()
    double = value.dtype is torch.float64
    kept = value.detach().to(torch.float64 if double else torch.float32).resolve_neg().contiguous()
    return wp.from_torch(kept, dtype=wp.vec3d if double else wp.vec3f, requires_grad=value.requires_grad)


@cache
def _gradient_function() -> Any:
    """The class through which PyTorch goes back; made when it is first needed, as it inherits from PyTorch's."""
    torch = torch_module()

    class Through(torch.autograd.Function):  # type: ignore[name-defined, misc]
        """A function of Warp arrays, by a tape of Warp."""

        @staticmethod
        def forward(ctx: Any, function: Callable[..., tuple[wp.array, ...]], *tensors: Any) -> tuple[Any, ...]:
            ctx.arrays = [_vectors(tensor) for tensor in tensors]
            ctx.tape = wp.Tape()
            with ctx.tape:
                ctx.outputs = function(*ctx.arrays)
            return tuple(wp.to_torch(one, requires_grad=False) for one in ctx.outputs)

        @staticmethod
        def backward(ctx: Any, *gradients: Any) -> tuple[Any, ...]:
            ctx.tape.zero()
            seeds = {}
            for output, gradient in zip(ctx.outputs, gradients, strict=True):
                seeds[output] = wp.from_torch(gradient.contiguous(), dtype=output.dtype, requires_grad=False)
            ctx.tape.backward(grads=seeds)
            found: list[Any] = [None]
            for array, wanted in zip(ctx.arrays, ctx.needs_input_grad[1:], strict=True):
                found.append(wp.to_torch(array.grad).clone() if wanted else None)
            return tuple(found)

    return Through
