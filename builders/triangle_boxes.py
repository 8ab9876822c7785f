"""Bounding boxes of triangles: the input of every builder."""

from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.runtime.workspace import HostNumbers, Workspace, give_back, part_of, take

MAX_CORNER = 2.0**126
"""Largest absolute coordinate of a box. float32 ends at 2^128, and builders add and subtract two coordinates."""


CHUNK = 2048
"""Triangles that are worth a chunk of their own."""


@wp.struct
class Boxes:
    """Bounding boxes of triangles, component by component."""

    low: wp.array2d(dtype=float)
    """(3, triangles)"""
    high: wp.array2d(dtype=float)


@native.func_native("reference.h", "wrt::write_box((const float*)vertices.data, (const int*)faces.data, boxes, i);")
def store_box(vertices: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.vec3i), boxes: Boxes, i: int):
    """Writes the box of triangle i. Native, because Warp's indexing computes the address of each element anew.

    Adding 0 turns -0 into +0, so that equal positions have equal bits."""


@exact_kernel
def compute_boxes(first: int, vertices: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.vec3i), boxes: Boxes):
    """Item: a triangle. Writes its box."""
    store_box(vertices, faces, boxes, first + wp.tid())


ALIGNED = 64
"""Numbers of which the lower and the upper corners have a multiple, so that both begin as an allocation does."""

REDUCING = 1 << 14
"""Threads that find the bounds of triangles on CUDA."""

CORNERS = 6
"""Words of `reduce_corners` for the box; one more is for the largest coordinate."""


@native.func_native("corner_bounds.h", "wrt::reduce_corners(vertices.data, faces.data, faces.shape[0], items, i, found.data);")
def reduce_corners(
    vertices: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.vec3i), items: int, i: int, found: wp.array(dtype=int)
):
    """Share i of `items` of the minima of all corners' coordinates and of the negated ones, and of the largest absolute one."""


@exact_kernel
def find_corner_bounds(
    first: int, vertices: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.vec3i), items: int, found: wp.array(dtype=int)
):
    """Item: a share of the triangles; on CUDA, items fill whole warps."""
    reduce_corners(vertices, faces, items, first + wp.tid(), found)


@cache
def nothing_found(device: str) -> wp.array:
    """What `reduce_corners` begins with."""
    return wp.array([0x7FFFFFFF] * CORNERS + [0], dtype=int, device=device)


def corner_bounds(vertices: wp.array, faces: wp.array) -> tuple[np.ndarray, np.ndarray]:
    """(3,) float32 each: lower and upper corner of the box around all triangles, without negative zeros, found where they are.

    Args:
        vertices: (V,) vec3.
        faces: (F,) vec3i.

    Raises:
        ValueError: a vertex of a triangle is NaN or infinite.
    """
    return CornerSearch(vertices, faces).bounds()


class CornerSearch:
    """`corner_bounds` under way: the host need not wait for it before it gives the device more to do.

    Attributes:
        found: (`CORNERS` + 1,) what `reduce_corners` found, on the device.
    """

    def __init__(self, vertices: wp.array, faces: wp.array) -> None:
        device = vertices.device
        items = REDUCING if device.is_cuda else 1
        self._kind = CornerSearch, device.alias, device.stream.cuda_stream if device.is_cuda else None
        self._work = take(self._kind) or Workspace(device, is_kept=True)
        self._read = self._work.make("read", 1, lambda _: HostNumbers(CORNERS + 1, int, device))
        self._is_read = self._work.make("is read", 1, lambda _: wp.Event(device)) if device.is_cuda else None
        self.found = self._work.empty("found", CORNERS + 1, int)
        wp.copy(self.found, nothing_found(device.alias), count=CORNERS + 1)
        launch(find_corner_bounds, items, [vertices, faces, items, self.found], device=device)
        wp.copy(self._read.own, self.found, count=CORNERS + 1)
        if self._is_read is not None:
            device.stream.record_event(self._is_read)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The two corners; called once. Errors as those of `corner_bounds`."""
        if self._is_read is not None:
            wp.synchronize_event(self._is_read)
        bits = self._read.values.copy()
        give_back(self._kind, self._work)
        if not np.isfinite(bits[CORNERS:].view(np.float32)).all():
            raise ValueError("vertices holds NaN or infinite numbers; repair or remove them")
        ends = (bits[:CORNERS] ^ ((bits[:CORNERS] >> 31) & 0x7FFFFFFF)).view(np.float32)
        return ends[:3] + np.float32(0.0), np.float32(0.0) - ends[3:]


@dataclass
class TriangleBoxes:
    """Boxes of all triangles, and the box around all of them.

    Attributes:
        boxes: the box of each triangle.
        count: number of triangles.
        low, high: (3,) float32, the box around all triangles.
        center: (3,) the point that positions are relative to.
        vertices, faces: the triangles themselves, for builders that clip them; None if the boxes are not those of triangles.
        of_size: longest side of the box of the scene that the triangles are a part of; None if they are the whole scene.

    Raises:
        ValueError: a box is NaN, or so large that sums and differences of two corners are not finite. (Areas may overflow:
            without a finite cost, nodes are split in the middle.) The check reads the outer box: NumPy's minimum propagates
            NaN.
    """

    boxes: Boxes
    count: int
    low: np.ndarray
    high: np.ndarray
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    vertices: wp.array | None = None
    faces: wp.array | None = None
    of_size: float | None = None

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raises what the class does."""
        largest = np.abs([self.low, self.high]).max()
        if not largest <= MAX_CORNER:
            raise ValueError(f"boxes extend to {largest:.3g}; trees can be built for coordinates up to {MAX_CORNER:.3g}")

    @property
    def size(self) -> float:
        """Longest side of the box of all triangles."""
        return float((self.high - self.low).max())

    @property
    def scene_size(self) -> float:
        """Longest side of the box of the scene, on which the rounding of rays depends."""
        return self.size if self.of_size is None else self.of_size

    @property
    def mean_area(self) -> float:
        """Mean area of the triangles, in float64; 0 if there are none.

        Raises:
            ValueError: the boxes are not those of triangles.
        """
        if self.vertices is None or self.faces is None:
            raise ValueError("areas need triangles, and these boxes have none; build with cost_model='surface_area'")
        a, b, c = (self.vertices.numpy()[self.faces.numpy()[:, k]].astype(np.float64) for k in range(3))
        return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).mean()) if self.count else 0.0


class AwaitedBoxes(TriangleBoxes):
    """Boxes whose corners are being searched for on their device: `low` and `high` wait for it.

    Args:
        boxes, count, center, vertices, faces: as in the class.
        search: the search.
    """

    def __init__(
        self, boxes: Boxes, count: int, center: np.ndarray, vertices: wp.array, faces: wp.array, search: CornerSearch
    ) -> None:
        known = {"boxes": boxes, "count": count, "center": center, "vertices": vertices, "faces": faces}
        self.__dict__.update(known, of_size=None, search=search)

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.search.bounds()  # type: ignore[attr-defined]

    @property
    def low(self) -> np.ndarray:  # type: ignore[override]  # in place of the constructor's
        return self._bounds[0]

    @property
    def high(self) -> np.ndarray:  # type: ignore[override]
        return self._bounds[1]


def triangle_boxes(
    vertices: wp.array,
    faces: wp.array,
    center: np.ndarray | None = None,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
) -> TriangleBoxes:
    """Bounding boxes of the triangles.

    Args:
        vertices: (V,) vec3.
        faces: (F,) vec3i.
        center: (3,) the point that vertices are relative to; None for the origin.
        bounds: (3,) float32 each, without negative zeros: the box around all triangles; None if it is not known.
    """
    device, count = vertices.device, len(faces)
    boxes = Boxes()
    size = -(-3 * count // ALIGNED) * ALIGNED
    memory = wp.empty(2 * size, dtype=float, device=device)
    boxes.low, boxes.high = (part_of(memory, begin, (3, count), float) for begin in (0, 4 * size))
    launch(compute_boxes, count, [vertices, faces, boxes], device=device, chunk=CHUNK)
    center = np.zeros(3) if center is None else center
    if bounds is None and searches_bounds(device):
        return AwaitedBoxes(boxes, count, center, vertices, faces, CornerSearch(vertices, faces))
    low, high = bounds or (boxes.low.numpy().min(axis=1), boxes.high.numpy().max(axis=1))
    return TriangleBoxes(boxes, count, low, high, center, vertices, faces)


def searches_bounds(device: wp.Device) -> bool:
    """Whether the device looks for the box around all triangles: where the host would have to fetch their boxes."""
    return device.is_cuda


def boxes_of(low: np.ndarray, high: np.ndarray) -> TriangleBoxes:
    """Given boxes, on the CPU.

    Args:
        low, high: (N, 3) corners, rounded to float32.
    """
    boxes = Boxes()
    boxes.low, boxes.high = (
        wp.array(np.ascontiguousarray(corner.T, dtype=np.float32), dtype=float, device="cpu") for corner in (low, high)
    )
    return TriangleBoxes(boxes, len(low), boxes.low.numpy().min(axis=1), boxes.high.numpy().max(axis=1))
