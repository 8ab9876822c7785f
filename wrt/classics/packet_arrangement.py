"""Rays of a generation arranged into packets by a named order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.engine.rays.device_rays import lay_out
from wrt.engine.rays.rays import Rays
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.query.ordering.packet_orders import PACKET_ORDERS, RayTags, fill_places, find_places
from wrt.kernels.runtime.launch import as_device, launch
from wrt.tables import lookup

MAX_TAG = (1 << 31) - 1
"""Greatest type, property or number of a camera ray."""


@dataclass(frozen=True)
class ArrangedRays:
    """Rays in the places of packets.

    Attributes:
        rays: (M,) rays; a place without a ray has no direction, and misses. Warp arrays.
        places: (M,) int32 number of the ray in each place; -1 without one.
        count: number of rays that were arranged.
    """

    rays: Rays
    places: np.ndarray
    count: int

    @property
    def usage(self) -> float:
        """Share of the places that hold a ray; 1 without rays."""
        return self.count / len(self.places) if len(self.places) else 1.0

    def restore(self, values: Any) -> np.ndarray:
        """Values of the places, such as `hits.t`, in the order of the rays: (M, ...) -> (count, ...)."""
        values = values.numpy() if isinstance(values, wp.array) else np.asarray(values)
        if values.shape[:1] != self.places.shape:
            raise ValueError(f"values have the shape {values.shape}, but the rays have {len(self.places)} places")
        taken = self.places >= 0
        result = np.empty((self.count, *values.shape[1:]), dtype=values.dtype)
        result[self.places[taken]] = values[taken]
        return result


def arrange_rays(
    rays: Rays,
    order: str,
    packet: int,
    *,
    kinds: Any = None,
    groups: Any = None,
    sources: Any = None,
    device: str | wp.Device | None = None,
) -> ArrangedRays:
    """Puts the rays of a generation into packets. The hits do not depend on it; how much the rays of a packet share does.

    Origins in float64 are rounded to float32.

    Args:
        rays: N rays.
        order: key in `wrt.kernels.query.ordering.packet_orders.PACKET_ORDERS`.
        packet: rays of a packet, that of the plan with which they are traced.
        kinds: (N,) integers, types of the rays; None: all are of one type.
        groups: (N,) integers, the property that they share, such as the material that their parents met; None: all share it.
        sources: (N,) integers, numbers of their camera rays; None: their own numbers.
        device: None for the CPU.

    Raises:
        TypeError: tags are no integers.
        ValueError: unknown order, a packet of less than one ray, tags that are negative or not one for each ray.
    """
    entry = lookup(PACKET_ORDERS, order, "order")
    if packet < 1:
        raise ValueError(f"packet is {packet}; it must be at least 1")
    device = as_device("cpu" if device is None else device)
    given = lay_out(rays, device, np.zeros(3))
    count, tags = given.count, RayTags()
    tags.kind, tags.group = (_tag(values, name, count, device) for values, name in ((kinds, "kinds"), (groups, "groups")))
    tags.source = _tag(np.arange(count) if sources is None else sources, "sources", count, device)
    places = find_places(entry, tags, count, packet, device)
    batch, arranged = given.batch, RayBatch()
    room: dict[str, tuple[Any, int]] = {"origins": (wp.vec3, batch.origin_stride), "directions": (wp.vec3, 1)}
    room |= {"t_min": (wp.float32, batch.t_min_stride), "t_max": (wp.float32, batch.t_max_stride)}
    for name, (dtype, stride) in room.items():
        setattr(arranged, name, wp.zeros(len(places), dtype=dtype, device=device) if stride else getattr(batch, name))
    launch(fill_places, len(places), [batch, places, arranged], device=device, chunk=4096)
    own = Rays(arranged.origins, arranged.directions, arranged.t_min, arranged.t_max)
    return ArrangedRays(own, places.numpy(), count)


def _tag(values: Any, name: str, count: int, device: wp.Device) -> wp.array:
    """One int32 for each ray, on the device."""
    if values is None:
        return wp.zeros(count, dtype=int, device=device)
    values = np.asarray(values.numpy() if isinstance(values, wp.array) else values)
    if values.dtype.kind not in "iu":
        raise TypeError(f"{name} must be integers, not {values.dtype}")
    if values.shape != (count,):
        raise ValueError(f"{name} has the shape {values.shape}; it must have one value for each of {count} rays")
    if count and not 0 <= int(values.min()) <= int(values.max()) <= MAX_TAG:
        raise ValueError(f"{name} must be from 0 to {MAX_TAG}, but ranges from {values.min()} to {values.max()}")
    return wp.array(values.astype(np.int32), dtype=int, device=device)
