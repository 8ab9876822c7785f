"""Bodies of known volume and area as polygons, for files that readers get wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Shape:
    """Polygons, counter-clockwise from outside.

    Attributes:
        points: (V, 3).
        polygons: vertices of each.
        volume, area: exact.
    """

    points: np.ndarray
    polygons: tuple[tuple[int, ...], ...]
    volume: float
    area: float

    @property
    def triangle_count(self) -> int:
        """Triangles after each polygon is cut."""
        return sum(len(one) - 2 for one in self.polygons)


QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
TRIANGLES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])

CUBE = Shape(CORNERS, QUADS, 1.0, 6.0)
MIXED = Shape(
    CORNERS, (*map(tuple, TRIANGLES[:2].tolist()), QUADS[1], *map(tuple, TRIANGLES[4:6].tolist()), *QUADS[3:]), 1.0, 6.0
)
"""A cube with sides of one quad and of two triangles, in turn."""


def prism(outline: list[tuple[float, float]], area: float, length: float) -> Shape:
    """A polygon in the plane z = 0, counter-clockwise, drawn out to z = 1.

    Args:
        outline: of the polygon.
        area: its area.
        length: of its outline.
    """
    count = len(outline)
    points = np.array([(x, y, z) for z in (0.0, 1.0) for x, y in outline])
    sides = tuple((k, (k + 1) % count, count + (k + 1) % count, count + k) for k in range(count))
    floor, roof = tuple(reversed(range(count))), tuple(range(count, 2 * count))
    return Shape(points, (floor, roof, *sides), area, 2.0 * area + length)


ANGLE = prism([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 3.0, 8.0)
"""An L. A fan from its second corner would cover more than it."""
ANGLE = Shape(ANGLE.points, tuple(one[1:] + one[:1] for one in ANGLE.polygons), ANGLE.volume, ANGLE.area)

ARROW = prism([(2, 0), (0, 3), (-2, 0), (0, 1)], 4.0, float(2 * np.hypot(2, 3) + 2 * np.hypot(2, 1)))
"""A quadrilateral with a corner that turns inward."""

TEETH = 12
COMB = prism(
    [(0, 0), (TEETH, 0), *((TEETH - k / 2, 5.0 if k % 2 else 1.0) for k in range(2 * TEETH + 1))],
    TEETH * 3.0,
    float(TEETH + 2 + 2 * TEETH * np.hypot(0.5, 4.0)),
)
"""Teeth of height 4 on a bar of height 1: every other corner turns inward."""

RING = Shape(
    np.array([(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (1, 1, 0), (1, 3, 0), (3, 3, 0), (3, 1, 0)], dtype=np.float64),
    ((0, 1, 2, 3, 0, 4, 5, 6, 7, 4),),
    0.0,
    12.0,
)
"""A plate with a hole, as one polygon that goes to the hole and back along the same line."""
