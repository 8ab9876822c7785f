"""Properties of a batch of rays that a plan depends on, by `wrt.kernels.query.ordering.coherence_detection`."""

from __future__ import annotations

import ctypes
from collections import deque
from typing import Any, NamedTuple

import warp as wp

from wrt.engine.host_arrays import point_at
from wrt.kernels.query.ordering.coherence_detection import PAIRS, measure_coherence
from wrt.kernels.runtime.recorded_launch import record

MIN_IMAGE_RAYS = 4096
"""Smallest flat list that is tested for being the pixels of an image: for fewer rays there is nothing to gain."""


class Coherence(NamedTuple):
    """Result of coherence detection.

    Attributes:
        coherent: whether neighbouring rays are similar: for most pairs of a sample, directions differ by less than about 15
            degrees and, unless origins are shared, the distance of origins is small against that of rays far apart.
        scattered: whether neighbouring rays start far apart.
        columns: columns of the image whose pixels, row by row, a flat list of rays belongs to; 0 if it does not, or was not
            tested.
    """

    coherent: bool
    scattered: bool
    columns: int


class CoherenceDetector:
    """The detection kernel with its packed arguments, for one thread at a time.

    The native kernel is called directly, not through Warp: the result is needed at once, also while a graph is captured.
    """

    def __init__(self) -> None:
        device = wp.get_device("cpu")
        none = wp.empty(0, dtype=wp.vec3, device=device)
        self.results = wp.zeros(3, dtype=int, device=device)
        self.launch = record(measure_coherence, [none, none, 0, 0, self.results], device)
        names = [argument.label for argument in measure_coherence.adj.args]
        values = self.launch.params[1:]
        fields = [(name, type(value)) for name, value in zip(names, values, strict=True)]
        self.arguments = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*values)
        self.found = self.results.numpy()

    def detect(self, rays: Any, sampled: bool, listed: bool) -> Coherence:
        """Tests pairs of neighbours if `sampled`, and for an image if `listed`."""
        arguments = self.arguments
        point_at(arguments.origins, rays.origins)
        point_at(arguments.directions, rays.directions)
        arguments.sampled, arguments.listed = sampled, listed
        self.launch.hooks.forward(ctypes.byref(self.launch.bounds), ctypes.byref(arguments))
        coherent, scattered, columns = self.found.tolist()
        return Coherence(bool(coherent), bool(scattered), columns)


_free: deque[CoherenceDetector] = deque()


def detect_coherence(rays: Any, device: wp.Device, is_list: bool = False) -> Coherence:
    """The coherence of a `RayBatch` or a `RayArrays`.

    On CUDA, detection would cost more than it gains: all rays count as coherent.

    Args:
        is_list: whether the rays are a flat list, which may contain the pixels of an image.
    """
    count = rays.directions.size
    sampled = count >= 2 * PAIRS
    listed = is_list and count >= MIN_IMAGE_RAYS and rays.origin_stride == 0 and rays.direction_stride == 1
    if device.is_cuda or not (sampled or listed):
        return Coherence(True, False, 0)
    try:
        detector = _free.pop()
    except IndexError:
        detector = CoherenceDetector()
    result = detector.detect(rays, sampled, listed)
    _free.append(detector)
    return result
