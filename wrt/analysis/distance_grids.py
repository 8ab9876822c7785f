"""Signed distances on regular grids, dense or in a band around the surface.

**Problem.** A grid has millions of points, and most are far from the surface: their signs are those of their neighbours, and in
a narrow band, their distances are of no interest.

**Idea.** The grid is cut into blocks of 8 x 8 x 8 points. If the middle of a block is farther from the surface than its corners
are from the middle, the surface does not pass through it, and all its points have the sign of the middle. If it is farther by
more than the band, all its values are the band's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import state_of
from wrt.analysis.signed_distances import SIGNS, signed_distance
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.scene.scene import Scene

BLOCK = 8
"""Points of a block along an axis."""

BATCH = 512
"""Blocks whose distances are computed at a time: 2^18 points, of which rays and answers take some 40 MB."""

MOST_POINTS = 1 << 31
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
        """Coordinates of the points along axis 0, 1 or 2, float64.

        Raises:
            TypeError, ValueError: there is no such axis.
        """
        number = as_int("number", number, 0, 2)
        return self.origin[number] + self.spacing * np.arange(self.values.shape[number])

    def volume(self, device: Any = None) -> wp.Volume:
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
    bounds: Any = None,
    band: float | None = None,
    sign: str = "auto",
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
        ValueError: `resolution` is too small, or the grid has more than 2^31 points; `bounds` are not two corners, the upper
            one not less in any coordinate; the scene's box is a point; `band` is not above 0 and finite in float32, or with
            pseudonormals; or as `signed_distance`.
    """
    from wrt.query.batches.block_limits import progress_bar

    state_of(scene).require_whole("a signed distance")
    resolution, progress = as_int("resolution", resolution, 2, MOST_POINTS), as_bool("progress", progress)
    lookup(SIGNS, sign, "sign")
    if band is not None:
        band = as_float("band", band)
        if not float(FLOATS.tiny) <= band <= float(FLOATS.max):
            raise ValueError(f"band must be above 0 and a float32, or None for a dense grid, not {band}")
        if sign == "pseudonormal":
            raise ValueError('a band needs signs where nothing is near: use sign="auto", "parity" or "winding"')
    origin, spacing, shape = lay_out(scene.bounds, resolution, bounds)
    values = np.empty(tuple(-(-count // BLOCK) * BLOCK for count in shape), dtype=np.float32)
    blocks = np.stack(np.meshgrid(*(np.arange(0, n, BLOCK) for n in values.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    with progress_bar(progress, len(blocks) * BLOCK**3, what="points") as advance:
        for begin in range(0, len(blocks), BATCH):
            own = blocks[begin : begin + BATCH]
            for block, found in zip(own, values_of(scene, origin + spacing * own, spacing, band, sign), strict=True):
                values[tuple(slice(start, start + BLOCK) for start in block)] = found
            advance(len(own) * BLOCK**3)
    cut = np.ascontiguousarray(values[tuple(slice(0, count) for count in shape)])
    return DistanceGrid(cut, origin, spacing, band)


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
    if np.prod(counts, dtype=np.float64) > MOST_POINTS:
        raise ValueError(f"a grid of {' x '.join(map(str, counts))} points is too large; lower resolution")
    return low, spacing, counts  # type: ignore[return-value]


def values_of(scene: Scene, starts: np.ndarray, spacing: float, band: float | None, sign: str) -> Iterator[np.ndarray]:
    """(8, 8, 8) float32 values of each block.

    Args:
        scene, band, sign: as in `distance_grid`.
        starts: (N, 3) first points of the blocks.
        spacing: of points.
    """
    inner = np.stack(np.meshgrid(*(np.arange(BLOCK),) * 3, indexing="ij"), axis=-1).reshape(-1, 3) * spacing
    reach = 0.5 * (BLOCK - 1) * spacing * np.sqrt(3.0) * 1.0001
    middle = signed_distance(scene, starts + 0.5 * (BLOCK - 1) * spacing, sign=sign)
    near = np.abs(middle) <= reach + (band or 0.0)
    found = np.empty((len(starts), BLOCK**3), dtype=np.float32)
    points = starts[near][:, None] + inner
    if band is None:
        found[near] = signed_distance(scene, points, sign=sign)
        far = scene.closest_point(starts[~near][:, None] + inner).distance
        found[~near] = np.copysign(far, middle[~near][:, None])
    else:
        found[near] = np.clip(signed_distance(scene, points, sign=sign, max_distance=band), -band, band)
        found[~near] = np.copysign(np.float32(band), middle[~near][:, None])
    yield from found.reshape(-1, BLOCK, BLOCK, BLOCK)
