"""What is detected in rays: coherence, images, and a shared origin.

Interfaces that pass rays as (N, 3), and callers that repeat the camera position N times, would lose a third to half of the
speed: packets with a shared origin are culled better, and tiles of an image are more coherent than its rows. Results do not
depend on what is detected, only speed does.
"""

from __future__ import annotations

import ctypes

import numpy as np
import warp as wp

from wrt.engine.free_list import FreeList
from wrt.engine.host_arrays import HostArray, address_of, point_at
from wrt.kernels.query.ordering.coherence_detection import BLOCK, MIN_ROWS, PAIRS, compare_neighbours, measure_coherence
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch
from wrt.kernels.runtime.recorded_launch import record

Vectors = wp.array | HostArray

MIN_IMAGE_RAYS = 4096
"""Smallest flat list that is tested for being the pixels of an image: for fewer rays there is nothing to gain."""


Coherence = tuple[bool, bool, int]
"""Whether neighbouring rays are similar: for most pairs of a sample, directions differ by less than about 15 degrees and,
unless origins are shared, the distance of origins is small against that of rays far apart. Whether neighbouring rays start far
apart. Columns of the image whose pixels, row by row, a flat list of rays belongs to; 0 if it does not, or was not tested."""


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

    def detect(self, origins: Vectors, directions: Vectors, sampled: bool, listed: bool) -> Coherence:
        """Tests pairs of neighbours if `sampled`, and for an image if `listed`."""
        arguments = self.arguments
        for field, values in ((arguments.origins, origins), (arguments.directions, directions)):  # as `point_at`
            field.data, field.shape[0] = values.ptr or 0, values.size
        arguments.sampled, arguments.listed = sampled, listed
        self.launch.hooks.forward(ctypes.byref(self.launch.bounds), ctypes.byref(arguments))
        coherent, scattered, columns = self.found.tolist()
        return bool(coherent), bool(scattered), columns


_detectors: FreeList[CoherenceDetector] = FreeList()


def detect_coherence(origins: Vectors, directions: Vectors, device: wp.Device, may_be_image: bool = False) -> Coherence:
    """The coherence of rays on the device.

    On CUDA, detection would cost more than it gains: all rays count as coherent.

    Args:
        origins, directions: (N,) or (1,) vec3.
        device: where they are.
        may_be_image: whether the rays are a flat list from one point, each with its own direction, which may hold the pixels of
            an image.
    """
    count = directions.size
    sampled, listed = count >= 2 * PAIRS, may_be_image and count >= MIN_IMAGE_RAYS
    if device.is_cuda or not (sampled or listed):
        return True, False, 0
    detector = _detectors.take() or CoherenceDetector()
    result = detector.detect(origins, directions, sampled, listed)
    _detectors.give_back(detector)
    return result


PART = 1 << 30
"""Words that are compared in one launch: kernels number them with 32 bits."""


class NeighbourComparison:
    """The kernel that compares neighbours, with its packed arguments, for one thread at a time."""

    def __init__(self) -> None:
        device = wp.get_device("cpu")
        found = wp.zeros(1, dtype=int, device=device)
        self._found, self._step = found.numpy(), 0
        self._launch = PreparedLaunch(compare_neighbours, [found, 3, found], device)
        self._words = self._launch.argument(1)

    def all_equal(self, values: np.ndarray) -> bool:
        """Whether all vectors (N, 3) have the same bits."""
        step, count = 3 * values.itemsize // 4, 3 * len(values) * (values.itemsize // 4)
        begin = address_of(values)
        self._found[0] = 0
        self._launch.set_value(2, step)
        for first in range(0, count - step, PART):
            size = min(PART + step, count - first)
            point_at(self._words, HostArray(begin + 4 * first, size, wp.int32, values))
            self._launch.run(-(-(size - step) // BLOCK), COMPARED, values)
        return self._found[0] == 0


COMPARED = Chunks(chunk=4)

_comparisons: FreeList[NeighbourComparison] = FreeList()


def detect_shared_origin(origins: np.ndarray) -> np.ndarray:
    """Origins (..., 3) that are all equal, as a view of the first; others, and those with a NaN, unchanged."""
    size = origins.size
    if size < 3 * MIN_IMAGE_RAYS or not origins.flags.c_contiguous or origins.item(0) != origins.item(size - 3):
        return origins
    rows = origins.reshape(-1, 3)
    first = rows[0]
    if not (rows[:: len(rows) // 64] == first).all():
        return origins
    comparison = _comparisons.take() or NeighbourComparison()
    equal = comparison.all_equal(rows)
    _comparisons.give_back(comparison)
    return np.broadcast_to(first, origins.shape) if equal else origins


def columns_of_shape(shape: tuple[int, ...]) -> int:
    """Columns of the image whose pixels two-dimensional rays are; 0 for other shapes."""
    return shape[1] if len(shape) == 2 and min(shape) >= MIN_ROWS else 0
