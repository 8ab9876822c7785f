"""What is looked for in rays before a plan is made for them: see `wrt.kernels.query.coherence_detection`."""

from __future__ import annotations

import ctypes
from collections import deque
from typing import Any, NamedTuple

import warp as wp

from wrt.kernels.query.coherence_detection import PAIRS, look_at_rays
from wrt.kernels.runtime.launch import record

LEAST_RAYS = 4096
"""Flat lists of fewer rays are not taken for pictures: there is no time to win."""


class Look(NamedTuple):
    """What was found.

    Attributes:
        coherent: whether neighbouring rays look alike: if most pairs of a sample have directions that differ by less than some
            15 degrees and, where origins are not shared, a distance that is small against that between rays far apart.
        scattered: whether neighbouring rays start far apart.
        columns: of the picture whose pixels a flat list of rays is, row by row; 0 if it is none, or was not looked at.
    """

    coherent: bool
    scattered: bool
    columns: int


class Looker:
    """The kernel with its arguments packed, for one thread at a time.

    It is called as Warp calls it, and not by Warp: the answer is needed now, also while a graph is captured.
    """

    def __init__(self) -> None:
        device = wp.get_device("cpu")
        none = wp.empty(0, dtype=wp.vec3, device=device)
        self.answers = wp.zeros(3, dtype=int, device=device)
        self.launch = record(look_at_rays, [none, none, 0, 0, self.answers], device)
        names = [argument.label for argument in look_at_rays.adj.args]
        values = self.launch.params[1:]
        fields = [(name, type(value)) for name, value in zip(names, values, strict=True)]
        self.arguments = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*values)
        self.found = self.answers.numpy()

    def look(self, rays: Any, sampled: bool, listed: bool) -> Look:
        """Looks at pairs of neighbours if `sampled`, and for a picture if `listed`."""
        arguments = self.arguments
        arguments.origins, arguments.directions = rays.origins.__ctype__(), rays.directions.__ctype__()
        arguments.sampled, arguments.listed = sampled, listed
        self.launch.hooks.forward(ctypes.byref(self.launch.bounds), ctypes.byref(arguments))
        coherent, scattered, columns = self.found.tolist()
        return Look(bool(coherent), bool(scattered), columns)


_free: deque[Looker] = deque()


def look_at(rays: Any, device: wp.Device, is_list: bool = False) -> Look:
    """What the numbers of rays (a `RayBatch` or a `RayArrays`) say.

    On CUDA to look would cost more than it gives, and all rays count as coherent.

    Args:
        is_list: whether the rays have no shape that says what is a row.
    """
    count = len(rays.directions)
    sampled = count >= 2 * PAIRS
    listed = is_list and count >= LEAST_RAYS and rays.origin_stride == 0 and rays.direction_stride == 1
    if device.is_cuda or not (sampled or listed):
        return Look(True, False, 0)
    try:
        looker = _free.pop()
    except IndexError:
        looker = Looker()
    look = looker.look(rays, sampled, listed)
    _free.append(looker)
    return look
