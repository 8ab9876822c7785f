"""Pictures of one value of each pixel: distances, normals, the numbers of what is hit, and the work for its ray or packet.

Counters of single rays are each pixel's own. A packet counts its work at its first ray; so the pixels are put in the order of
tiles, each of which is a packet, and all pixels of a tile show the work of their packet.
"""

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

__all__ = [
    "Depth",
    "Ids",
    "Layer",
    "Normals",
    "PacketWork",
    "PacketsTakenApart",
    "RayWork",
    "Scale",
    "as_bytes",
    "packet_plan",
    "scale_of",
    "tile_order",
]

COLUMNS, ROWS = 8, 4
"""Pixels of a packet."""


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


class Work(Layer):
    """Values in colours from black over red and yellow to white, from 0 to the largest."""

    def _show(self, values: np.ndarray, unit: str) -> None:
        self.values = values.reshape(self._camera.height, self._camera.width)
        self.scale = scale_of(unit, values, from_zero=True)
        flat = wp.array(np.ascontiguousarray(values, dtype=np.float32), dtype=float, device=self._scene.device)
        self._color(false_color.color_values, flat, self.scale.low, self.scale.high)


class RayWork(Work):
    """A counter of single rays.

    Args:
        counter: a field of `wrt.kernels.traversal.leaf.Counters`.
        unit: in words.
        scene, request, camera: as in `Layer`.
    """

    def __init__(self, counter: str, unit: str, scene: Scene, request: ViewRequest, camera: PinholeCamera) -> None:
        super().__init__(scene, request, camera)
        self._counter, self._unit = counter, unit

    def _draw(self, rays: Rays) -> None:
        hits = self._scene.intersect(rays, traversal="single", triangle_test=self._request.triangle_test, counters=True)
        self._show(hits.counters[self._counter].ravel(), self._unit)


class PacketWork(Work):
    """The inner nodes that each packet visits."""

    unit = "inner nodes a packet"

    def _draw(self, rays: Rays) -> None:
        order = tile_order(self._camera.width, self._camera.height)
        tiled = Rays(rays.origins.numpy()[0], rays.directions.numpy()[order])
        plan = replace(packet_plan(self._scene, tiled, self._request), packet=COLUMNS * ROWS, reorder="none")
        counters = self._scene.intersect(tiled, traversal=plan, counters=True).counters
        work = self._of_packets({name: values[:: COLUMNS * ROWS] for name, values in counters.items()})
        values = np.empty(len(order), np.float32)
        values[order] = np.repeat(work, COLUMNS * ROWS)[: len(order)]
        self._show(values, self.unit)

    def _of_packets(self, counters: dict[str, np.ndarray]) -> np.ndarray:
        return counters["nodes"]


class PacketsTakenApart(PacketWork):
    """How far the rays of each packet have parted: the share of idle lanes in the tests of its rays with triangles."""

    unit = "% of lanes idle in triangle tests"

    def _of_packets(self, counters: dict[str, np.ndarray]) -> np.ndarray:
        lanes, active = counters["lanes"].astype(np.float64), counters["active"]
        return np.where(lanes > 0, 100.0 * (1.0 - active / np.maximum(lanes, 1.0)), np.nan)


def tile_order(width: int, height: int) -> np.ndarray:
    """(height * width,) numbers of pixels, tile by tile; tiles at the right and lower edge are cut."""
    row, column = np.divmod(np.arange(width * height), width)
    tile = (row // ROWS) * -(-width // COLUMNS) + column // COLUMNS
    return np.argsort(tile, kind="stable")
