"""Pictures of cost: the work that the tree causes for the ray of each pixel, or for each packet.

Counters of single rays are each pixel's own. A packet counts its work at its first ray; so the pixels are put in the order of
tiles, each of which is a packet, and all pixels of a tile show the work of their packet.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from wrt.engine.rays.rays import Rays
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.shading import false_color
from wrt.scene.scene import Scene
from wrt.viewer.pictures.layers import Layer, packet_plan, scale_of
from wrt.viewer.pictures.view_request import ViewRequest

__all__ = ["PacketWork", "PacketsTakenApart", "RayWork", "tile_order"]

COLUMNS, ROWS = 8, 4
"""Pixels of a packet."""


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
