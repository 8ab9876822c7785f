"""Signed distances on regular grids, dense or in a band around the surface.

**Problem.** A grid has millions of points, and most are far from the surface: their signs are those of their neighbours, and in
a narrow band, their distances are of no interest.

**Idea.** The grid is cut into blocks of 8 x 8 x 8 points. If the middle of a block is farther from the surface than its corners
are from the middle, the surface does not pass through it, and all its points have the sign of the middle. If it is farther by
more than the band, all its values are the band's.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import state_of
from wrt.analysis.signed_distances import AUTO, SIGNS, SignRule, sign_rule, signed
from wrt.kernels.fields.grid_points import BLOCK, Grid, place_middles, place_points, store_values
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.engine.facts.scene_state import SceneState
    from wrt.scene.scene import Scene

BATCH, CUDA_BATCH = 512, 8192
"""Blocks whose distances are computed at a time: 2^18 points on CPUs, of which rays and answers take some 40 MB."""

MAX_POINTS = 1 << 31
"""Largest number of points of a grid."""

MARGIN = 2
"""Cells between the surface's box and the end of the grid."""

FLOATS = np.finfo(np.float32)


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances at the points of a regular grid; made by `distance_grid`.

    Attributes:
        values: (X, Y, Z) float32, negative inside; `values[i, j, k]` is at `origin + spacing * (i, j, k)`.
        origin: (3,) float64, the first point.
        spacing: distance of neighbouring points, the same along all axes.
        band: greatest absolute value; None for a dense grid.
    """

    values: np.ndarray
    origin: np.ndarray
    spacing: float
    band: float | None = None

    @property
    def end(self) -> np.ndarray:
        """(3,) float64, the last point."""
        return self.origin + self.spacing * (np.array(self.values.shape) - 1)

    def axis(self, number: int) -> np.ndarray:
        """Coordinates of the points along axis `number` (0, 1 or 2), float64.

        Raises:
            TypeError, ValueError: there is no such axis.
        """
        number = as_int("number", number, 0, 2)
        return self.origin[number] + self.spacing * np.arange(self.values.shape[number])

    def volume(self, device: str | wp.Device | None = None) -> wp.Volume:
        """The grid as a `wp.Volume` for kernels (`wp.volume_sample_f`), whose world coordinates are the scene's.

        In a band, voxels that hold the positive end of the band are not stored: they are its background.

        Args:
            device: a Warp device; None for CUDA's first. Warp makes volumes of arrays on CUDA only.

        Raises:
            RuntimeError: there is no CUDA device.
        """
        chosen = wp.get_device(device) if device is not None else next(iter(wp.get_cuda_devices()), None)
        if chosen is None or not chosen.is_cuda:
            raise RuntimeError("Warp makes volumes of arrays on CUDA only, and there is no such device; use values")
        background = float("inf") if self.band is None else float(np.float32(self.band))
        return wp.Volume.load_from_numpy(
            self.values, min_world=tuple(self.origin), voxel_size=self.spacing, bg_value=background, device=chosen
        )


def distance_grid(
    scene: Scene,
    resolution: int,
    *,
    bounds: ArrayLike | None = None,
    band: float | None = None,
    sign: SignRule = "auto",
    progress: bool = False,
) -> DistanceGrid:
    """Signed distances at the points of a grid around the surface.

        grid = wrt.analysis.distance_grid(scene, 64)                # dense: every distance
        grid = wrt.analysis.distance_grid(scene, 256, band=0.05)    # distances up to 0.05, the rest is 0.05 or -0.05

    Blocks of 8 x 8 x 8 points that the surface does not pass through get one sign, that of their middle. Where a mesh has holes
    larger than that, the sign may step from block to block there.

    Args:
        scene: a `wrt.Scene` whose `closest_point` works.
        resolution: points along the longest side of the box, at least 2.
        bounds: (2, 3) lower and upper corner of the grid; None for the scene's, and two cells on each side. The last points may
            lie up to a cell beyond the upper corner.
        band: greatest distance of interest, above 0; None for all.
        sign: as in `signed_distance`.
        progress: whether to show a progress bar on stderr.

    Raises:
        TypeError: an argument has a wrong type.
        RuntimeError: a graph is being captured.
        ValueError: `resolution` is too small, or the grid has more than 2^31 points; `bounds` are not two corners, the upper
            one not less in any coordinate; the scene's box is a point; `band` is not above 0 and finite in float32, or with
            pseudonormals; or as `signed_distance`.
    """
    from wrt.query.batches.block_limits import progress_bar

    state_of(scene).require_whole("a signed distance")
    refuse_capture("distance_grid", state_of(scene).device)
    resolution, progress = as_int("resolution", resolution, 2, MAX_POINTS), as_bool("progress", progress)
    lookup(SIGNS, sign, "sign")
    if band is not None:
        band = as_float("band", band)
        if not float(FLOATS.tiny) <= band <= float(FLOATS.max):
            raise ValueError(f"band must be above 0 and a float32, or None for a dense grid, not {band}")
        if sign == "pseudonormal":
            raise ValueError('a band needs signs where nothing is near: use sign="auto", "parity" or "winding"')
    origin, spacing, shape = lay_out(scene.bounds, resolution, bounds)
    state, rule = state_of(scene), sign_rule(scene) if sign == AUTO else sign
    device, size = state.device, CUDA_BATCH if state.device.is_cuda else BATCH
    grid, values = Grid(), wp.empty(shape, dtype=float, device=device)
    grid.origin, grid.spacing, grid.shape = wp.vec3d(*origin), spacing, wp.vec3i(*shape)  # type: ignore[assignment]
    starts = (np.arange(0, count, BLOCK, dtype=np.int32) for count in shape)
    blocks = np.stack(np.meshgrid(*starts, indexing="ij"), axis=-1).reshape(-1, 3)
    host = HostCopy(values)
    with progress_bar(progress, len(blocks) * BLOCK**3, what="points") as advance, use_threads(state.num_threads):
        for begin in range(0, len(blocks), size):
            fill(state, grid, blocks[begin : begin + size], np.inf if band is None else band, rule, values)
            advance(len(blocks[begin : begin + size]) * BLOCK**3)
    return DistanceGrid(host.numpy(), origin, spacing, band)


class HostCopy:
    """What will be copied to the host. Its memory there is touched by another thread while a device computes, for a copy takes
    long where it is the first to touch a page (notebooks/records/2026-11-28-points-gpu.md)."""

    def __init__(self, values: wp.array) -> None:
        self._values = values
        if values.device.is_cuda:
            self._host = np.empty(values.shape, dtype=np.float32)
            self._touching = Thread(target=self._host.fill, args=(0.0,), daemon=True)
            self._touching.start()

    def numpy(self) -> np.ndarray:
        """The values; on a CPU they are not copied."""
        if self._values.device.is_cpu:
            return self._values.numpy()
        self._touching.join()
        wp.copy(wp.array(self._host, dtype=float, device="cpu", copy=False), self._values)
        wp.synchronize_device(self._values.device)
        return self._host


def lay_out(box: np.ndarray, resolution: int, bounds: Any) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    """The first point, the spacing and the numbers of points of a grid; arguments and errors as in `distance_grid`."""
    if bounds is None:
        low, high = np.asarray(box, dtype=np.float64)
        cells = resolution - 1 - 2 * MARGIN
        if cells < 1:
            raise ValueError(f"resolution must be at least {2 + 2 * MARGIN}, not {resolution}, or pass bounds")
        spacing = float((high - low).max()) / cells
        if not spacing > 0.0:
            raise ValueError("the scene's box is a point, around which no grid has a size; pass bounds")
        low, high = low - MARGIN * spacing, high + MARGIN * spacing
    else:
        low, high = as_numbers("bounds", bounds, (2, 3))
        spacing = float((high - low).max()) / (resolution - 1)
    if not (high - low >= 0.0).all() or not spacing > 0.0:
        raise ValueError(f"bounds must be a lower and an upper corner, not {low.tolist()} and {high.tolist()}")
    counts = tuple(int(np.ceil(side / spacing - 1e-6)) + 1 for side in high - low)
    if np.prod(counts, dtype=np.float64) > MAX_POINTS:
        raise ValueError(f"a grid of {' x '.join(map(str, counts))} points is too large; lower resolution")
    return low, spacing, counts  # type: ignore[return-value]


def fill(state: SceneState, grid: Grid, blocks: np.ndarray, band: float, sign: str, values: wp.array) -> None:
    """Computes the values of some blocks.

    Args:
        state: of the scene.
        grid: its origin, spacing and shape.
        blocks: (B, 3) int32, the first point of each.
        band: greatest absolute value; inf for none.
        sign: a rule, not "auto".
        values: of the grid; is filled.
    """
    reach = 0.5 * (BLOCK - 1) * grid.spacing * np.sqrt(3.0) * 1.0001
    middle = signed(state, points_of(state, grid, blocks, place_middles, 1), sign).numpy()
    is_near = np.abs(middle) <= reach + (band if band < np.inf else 0.0)
    for chosen in (is_near, ~is_near):
        own = blocks[chosen]
        if not len(own):
            continue
        distance = signs = wp.empty(0, dtype=float, device=state.device)
        if chosen is is_near or band == np.inf:
            points = points_of(state, grid, own, place_points, BLOCK**3)
            distance = signed(state, points, sign if chosen is is_near else None, band)
        if chosen is not is_near:
            signs = wp.array(middle[chosen], dtype=float, device=state.device)
        grid.blocks = wp.array(own, dtype=wp.vec3i, device=state.device)
        inputs = [grid, distance, signs, band, values]
        launch(store_values, len(own) * BLOCK**3, inputs, device=state.device, chunk=4096)


def points_of(state: SceneState, grid: Grid, blocks: np.ndarray, place: wp.Kernel, count: int) -> wp.array:
    """(B * count,) vec3d: points of blocks, by a kernel."""
    grid.blocks = wp.array(blocks, dtype=wp.vec3i, device=state.device)
    points = wp.empty(len(blocks) * count, dtype=wp.vec3d, device=state.device)
    launch(place, len(points), [grid, points], device=state.device, chunk=4096)
    return points
