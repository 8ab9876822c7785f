"""Builds a light buffer: count, scan, fill, sort, each on all cores.

**Steps.** Triangles are rasterised three times (`wrt.builders.lights.light_raster`). The first finds for each cell the depth
behind which a triangle covers it; the second counts the triangles in front of that; a scan turns counts into places; the third
writes the lists. Each list is then sorted, so that it does not depend on the order in which threads wrote it.

**Improvements** of Haines and Greenberg. A triangle that covers a cell ends its list and marks the cell. A list of one triangle
is not tested by rays that start on it, if they say so (`skip`). Their third one, back faces are in shadow, holds for closed
bodies only, and leaves out the triangles that turn their back to the light. Here the others can be left out, those that turn
their front to the light, exactly as `occluded` does with `cull_backfaces`: closed bodies cast the same shadow with the half of
their triangles, and none on the points of their own lit side.

**Memory.** 16 bytes a cell and 8 bytes an entry; while it is built nothing more.

References: haines-greenberg-1986; rahikainen-2013 (section 2.3).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.builders.lights.light_raster import COUNT, COVER, FILL, INFINITY_BITS, make_rasteriser
from wrt.kernels.layout.light_cells import CELL_BYTES, CELL_WORDS, ENTRY_BYTES, FACES, LightCells
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

REACH = 4.0
"""Rays are answered from lists if their reach is at most this many times the extent of the scene."""

TRIANGLE_CHUNK = 256
CELL_CHUNK = 4096

LARGEST, SMALLEST = 1e11, 1e-9
"""Extents of scenes between which no product of the watertight test overflows or underflows, so that triangles cover cells."""


@exact_kernel
def clear_cells(first: int, words: wp.array(dtype=int)):
    """Item: a cell."""
    at = 4 * (first + wp.tid())
    words[at] = 0
    words[at + 1] = 0
    words[at + 2] = wp.static(INFINITY_BITS)
    words[at + 3] = wp.static(INFINITY_BITS)


@exact_kernel
def take_counts(first: int, words: wp.array(dtype=int), counts: wp.array(dtype=int)):
    """Item: a cell."""
    cell = first + wp.tid()
    counts[cell] = words[4 * cell + 1]


@exact_kernel
def put_begins(first: int, begins: wp.array(dtype=int), words: wp.array(dtype=int)):
    """Item: a cell."""
    cell = first + wp.tid()
    words[4 * cell] = begins[cell]


@native.func_native("light_raster.h", "wrt::sort_entries((unsigned long long*)entries.data + begin, count);")
def sort_entries(entries: wp.array(dtype=wp.uint64), begin: int, count: int):
    """Sorts a list in place: by insertion, long ones by heapsort."""


@exact_kernel
def sort_lists(first: int, words: wp.array(dtype=int), entries: wp.array(dtype=wp.uint64)):
    """Moves `begin` back to the first entry, sorts the list, and writes its least depth. Item: a cell."""
    cell = first + wp.tid()
    count = words[4 * cell + 1]
    begin = words[4 * cell] - count
    words[4 * cell] = begin
    if count > 1:
        sort_entries(entries, begin, count)
    if count > 0:
        words[4 * cell + 3] = int(wp.uint32(entries[begin] >> wp.uint64(32)))


def slack_of(extent: float, light_reach: float) -> float:
    """Greatest distance of a hit from the exact line between light and point, plus that from its triangle.

    Args:
        extent: of the scene, along its longest axis.
        light_reach: greatest distance along an axis between the light and a corner of the scene's box.
    """
    reach = REACH * extent
    return 2.0**-19 * reach + 2.0**-22 * (2.0 * reach + light_reach) + 1e-37


class LitMesh(NamedTuple):
    """The triangles of a scene.

    Attributes:
        vertices: (V,) vec3, relative to the scene's centre.
        faces: (F,) vec3i.
        low, high: bounds of the scene, relative to its centre.
    """

    vertices: wp.array
    faces: wp.array
    low: wp.vec3
    high: wp.vec3


def build_light_buffer(
    mesh: LitMesh,
    light: np.ndarray,
    resolution: int,
    *,
    accurate: bool,
    watertight: bool,
    cull_backfaces: bool = False,
    max_bytes: int,
    allocate: Callable[..., wp.array] = wp.empty,
) -> LightCells:
    """Builds the light buffer of a point light on the device that holds the triangles.

    Args:
        mesh: its triangles.
        light: (3,) float64, relative to the scene's centre.
        resolution: cells along an edge of a face.
        accurate, watertight: of the triangle test (`wrt.kernels.triangle.support.triangle_contract.TriangleTest`).
        cull_backfaces: whether rays hit only the front of triangles; then those whose front the light sees are left out, and no
            triangle covers a cell.
        max_bytes: greatest size of cells and lists.
        allocate: allocates arrays; same signature as `wp.empty`.

    Raises:
        MemoryError: cells and lists would take more than `max_bytes`.
    """
    vertices, faces, low, high = mesh
    device, count = vertices.device, FACES * resolution * resolution
    corners = np.array([low, high], dtype=np.float64)
    extent = float((corners[1] - corners[0]).max())
    slack = slack_of(extent, float(np.abs(corners - light).max()))
    covering = accurate and watertight and not cull_backfaces and SMALLEST <= extent <= LARGEST
    check_bytes(count * CELL_BYTES, 0, resolution, max_bytes)
    words = allocate(count * CELL_WORDS, dtype=int, device=device)
    launch(clear_cells, count, [words], device=device, chunk=CELL_CHUNK)
    none = wp.empty(0, dtype=wp.uint64, device=device)
    inputs = [vertices, faces, wp.vec3d(*map(float, light)), resolution, wp.float64(slack), words]

    def rasterise(stage: str, entries: wp.array) -> None:
        kernel = make_rasteriser(stage, not accurate, covering, cull_backfaces)
        launch(kernel, len(faces), [*inputs, entries], device=device, chunk=TRIANGLE_CHUNK)

    if covering:
        rasterise(COVER, none)
    rasterise(COUNT, none)
    counts = wp.empty(count, dtype=int, device=device)
    launch(take_counts, count, [words, counts], device=device, chunk=CELL_CHUNK)
    total = int(counts.numpy().sum(dtype=np.int64))
    check_bytes(count * CELL_BYTES, total * ENTRY_BYTES, resolution, max_bytes)
    begins = wp.empty_like(counts)
    wp.utils.array_scan(counts, begins, inclusive=False)
    launch(put_begins, count, [begins, words], device=device, chunk=CELL_CHUNK)
    entries = allocate(max(total, 1), dtype=wp.uint64, device=device)
    rasterise(FILL, entries)
    launch(sort_lists, count, [words, entries], device=device, chunk=CELL_CHUNK)
    cells = LightCells()
    cells.cells, cells.entries, cells.resolution = words, entries, resolution
    cells.limit, cells.slack, cells.low, cells.high = REACH * extent, slack, low, high
    return cells


def check_bytes(cells: int, entries: int, resolution: int, max_bytes: int) -> None:
    """Refuses a buffer that is too large, or whose lists have more entries than an int counts."""
    if cells + entries > max_bytes or entries >= ENTRY_BYTES << 31:
        lists = f" and {entries / 1e6:,.1f} MB of lists" if entries else ""
        raise MemoryError(
            f"a light buffer of resolution {resolution} takes {cells / 1e6:,.1f} MB of cells{lists}, more than max_bytes = "
            f"{max_bytes / 1e6:,.1f} MB; choose a lower resolution or more max_bytes"
        )
