"""Martin Newell's teapot: 32 bicubic Bezier patches, tessellated at any level.

Newell measured a Melitta teapot and published its control points in his thesis. The bottom was added later by others
(Crow). The spout and the handle end inside the body, and the lid is slightly above the rim, so the surface is not closed,
unless it is asked for.

Each patch is evaluated on a lattice of (level + 1) x (level + 1) parameters. The evaluation is exactly symmetric: reversing
a patch's control points reverses its points bit for bit. So neighbouring patches agree exactly along their common curve,
and their points can be welded without a tolerance. Where a side of a patch shrinks to a point (the top of the knob, the
centre of the bottom), the collapsed triangles are dropped.

References: newell-1975; crow-1987.
"""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np

from wrt.kernels.validation import as_bool
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import check_count, plane, sheets, with_caps, without_collapsed

__all__ = ["bernstein", "teapot", "teapot_patches"]

_GROUND_HALF_SIZE = 100.0
_GROUND_CELLS = 16


def teapot(level: int = 16, ground: bool = True, closed: bool = False) -> TriangleMesh:
    """The teapot on a wide ground, 6.4 units long and 3.15 high, handle at -x, spout at +x.

    Args:
        level: quads along each side of a patch, >= 1. The teapot has 64 level^2 - 8 level triangles (level 1, too coarse
            for the lip of the spout, has 52).
        ground: whether to add a ground plane at z = 0, 200 x 200 units, whose edge looks like a horizon; 512 more
            triangles.
        closed: whether to close the holes, as a body of glass needs it: each of the six, such as the rim and the ends of the
            handle, gets a fan of triangles. Pot, lid, spout and handle are then solid bodies, the last two reaching into the
            pot.

    Raises:
        TypeError: level is not a whole number.
        ValueError: level < 1, or 1 if it shall be closed.
    """
    ground, closed = as_bool("ground", ground), as_bool("closed", closed)
    level = check_count("level", level, 2 if closed else 1)
    weights = bernstein(level)
    patches = _blend(weights, _blend(weights, teapot_patches()).swapaxes(1, 2)).swapaxes(1, 2)
    patches = np.round(patches, 12)  # the weights sum to 1 only up to rounding: this makes collapsed sides one point again
    # Rows lead away from the axis and columns clockwise: swapping the two turns the normals outward.
    pot = without_collapsed(sheets(patches.swapaxes(1, 2)).welded())
    if closed:
        pot = with_caps(pot)
    if not ground:
        return TriangleMesh(pot.vertices, pot.faces, name="teapot")
    half = _GROUND_HALF_SIZE
    return TriangleMesh.concatenate([pot, plane((-half, -half), (half, half), cells=_GROUND_CELLS)], name="teapot")


def teapot_patches() -> np.ndarray:
    """(32, 4, 4, 3) float64 control points of Newell's patches, z up."""
    data = json.loads(files("wrt.scenes").joinpath("newell_teapot.json").read_text(encoding="utf-8"))
    return np.array(data["vertices"])[np.array(data["patches"])].reshape(-1, 4, 4, 3)


def bernstein(level: int) -> np.ndarray:
    """(level + 1, 4) cubic Bernstein polynomials at the parameters 0, 1/level, ..., 1.

    Row i is row level - i reversed, bit for bit.
    """
    t = np.arange(level + 1) / level
    s = t[::-1]
    return np.stack([s * s * s, (s * s) * t * 3.0, (t * t) * s * 3.0, t * t * t], axis=-1)


def _blend(weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, 4, K, 3) control points -> (P, level + 1, K, 3); the order of the sum is symmetric, as the weights are."""
    terms = weights[None, :, :, None, None] * points[:, None]
    return (terms[:, :, 0] + terms[:, :, 3]) + (terms[:, :, 1] + terms[:, :, 2])
