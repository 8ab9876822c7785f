"""Pictures of one value of each pixel: distances, normals, and the numbers of what is hit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from wrt.engine.plan.plan import Plan
from wrt.engine.rays.rays import Rays
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import get_num_threads, launch, use_threads
from wrt.kernels.shading import false_color
from wrt.query.hits import Hits
from wrt.scene.scene import Scene
from wrt.viewer.pictures.view_request import ViewRequest

__all__ = ["Depth", "Ids", "Layer", "Normals", "Scale", "as_bytes", "packet_plan", "scale_of"]


@dataclass(frozen=True)
class Scale:
    """What the colours of a picture mean: values from `low` to `high`, and their mean."""

    unit: str
    low: float
    high: float
    mean: float


def scale_of(unit: str, values: np.ndarray, from_zero: bool = False) -> Scale:
    """The scale of the finite values: from their least, or 0, to their largest."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return Scale(unit, 0.0, 1.0, 0.0)
    low = 0.0 if from_zero else float(finite.min())
    return Scale(unit, low, float(finite.max()), float(finite.mean(dtype=np.float64)))


class Layer:
    """A picture of one value of each pixel (`wrt.viewer.frame_loop.Picture`).

    Args:
        scene, request, camera: what to show, from where.

    Attributes:
        rays: number of rays traced so far.
        is_complete: whether the picture is made.
        scale: what the colours mean, once it is made; None for colours without order.
    """

    def __init__(self, scene: Scene, request: ViewRequest, camera: PinholeCamera) -> None:
        self._scene, self._request, self._camera = scene, request, camera
        self._threads = get_num_threads()
        self.rays, self.is_complete = 0, False
        self.scale: Scale | None = None
        self._image: wp.array | None = None

    def advance(self, check: Callable[..., None]) -> None:
        """Makes the picture, which takes some milliseconds: `check` is not called."""
        scene, camera = self._scene, self._camera
        count = camera.width * camera.height
        with use_threads(self._threads):
            self._image = wp.empty(count, dtype=wp.vec3, device=scene.device)
            self._draw(camera.rays_on(scene.device, 0, count))
        self.rays, self.is_complete = count, True

    def _draw(self, rays: Rays) -> None:
        """Writes the colours of the image."""
        raise NotImplementedError

    def _hits(self, rays: Rays) -> Hits:
        request = self._request
        traversal: str | Plan = request.traversal
        packets = traces_packets(request.traversal)
        if request.culling != "auto" and (packets or request.traversal == "auto"):
            traversal = packet_plan(self._scene, rays, request)
        return self._scene.intersect(rays, traversal=traversal, triangle_test=request.triangle_test)

    def _color(self, kernel: wp.Kernel, *inputs: Any) -> None:
        launch(kernel, len(self._image), [*inputs, self._image], device=self._scene.device, chunk=4096)

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8."""
        return as_bytes(self._image, self._camera, self._scene)


class Depth(Layer):
    """Distances from the camera: light ones are near."""

    def _draw(self, rays: Rays) -> None:
        t = self._hits(rays).t
        self.scale = scale_of("distance", t.numpy())
        self._color(false_color.color_depths, t, self.scale.low, self.scale.high)


class Normals(Layer):
    """Unit normals by the winding of triangles: x, y, z from -1 to 1 as red, green, blue."""

    def _draw(self, rays: Rays) -> None:
        normals = self._hits(rays).normal
        single = normals if normals.dtype is wp.vec3 else wp.empty(normals.shape, dtype=wp.vec3, device=normals.device)
        if single is not normals:
            wp.utils.array_cast(normals, single)
        self._color(false_color.color_normals, single)


class Ids(Layer):
    """A colour for each number of what is hit.

    Args:
        name: "primitive_id", "geometry_id" or "instance_id".
        scene, request, camera: as in `Layer`.
    """

    def __init__(self, name: str, scene: Scene, request: ViewRequest, camera: PinholeCamera) -> None:
        super().__init__(scene, request, camera)
        self._name = name

    def _draw(self, rays: Rays) -> None:
        self._color(false_color.color_ids, getattr(self._hits(rays), self._name))


def traces_packets(traversal: str) -> bool:
    """Whether a named traversal, not "auto", traces packets."""
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.traversal.capabilities import Capabilities

    return traversal != "auto" and Capabilities.PACKETS in TRAVERSALS[traversal].capabilities


def packet_plan(scene: Scene, rays: Rays, request: ViewRequest) -> Plan:
    """The plan that traces camera rays in packets, with the request's traversal if that has packets, its test and its culling.

    Raises:
        ValueError: they do not fit together, or the scene's tree.
    """
    traversal = request.traversal if traces_packets(request.traversal) else "packet"
    plan = scene.explain(rays, traversal=traversal, triangle_test=request.triangle_test)
    return plan if request.culling == "auto" else replace(plan, culling=request.culling)


def as_bytes(image: wp.array, camera: PinholeCamera, scene: Scene) -> np.ndarray:
    """(H, W, 3) uint8 of display colours on the scene's device."""
    count = camera.width * camera.height
    pixels = wp.empty(3 * count, dtype=wp.uint8, device=scene.device)
    launch(false_color.to_bytes, count, [image.flatten(), pixels], device=scene.device, chunk=4096)
    return pixels.numpy().reshape(camera.height, camera.width, 3)
