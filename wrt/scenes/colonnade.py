"""An atrium: a court open to the sky, with storeys of arcades around it.

A test scene similar to Marko Dabrovic's Sponza model of 2002: walls and floors of a few huge triangles, column shafts of
long thin ones, mouldings of many small ones. A closed box surrounds everything, so that light on the outer walls that did
not come through the opening reveals a leak.

The court is a rectangle of square bays. A column stands at every corner of its outline; arches span between columns. Behind
them, a gallery on every storey is closed by the outer wall. The court lies three steps lower than the gallery.
"""

from __future__ import annotations

import numpy as np

from wrt.kernels.validation import host_array
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import boxes, check_count, copies, lathe, plane, sheets

__all__ = ["atrium"]

_BAY = 4.0  # distance of column axes
_MAX_COUNT = 10_000  # bays in a row, and storeys: columns are placed one by one
_GALLERY = 4.5  # depth of the gallery behind the columns
_STOREY = 5.6
_SPRING = 3.3  # height of the springing line of the arches
_THICK = 0.56  # thickness of the arcade wall
_WALL = 0.6  # thickness of the outer walls, the roof and the ground slab
_SLAB = 0.3  # thickness of the upper floors
_STEP = 0.17
_SHAFT = (0.62, 2.72)  # heights of the ends of a column's shaft


def atrium(bays: tuple[int, int] = (6, 3), storeys: int = 2, detail: int = 4) -> TriangleMesh:
    """A colonnaded court of `bays` bays of 4 m along x and y, centred on the origin; z = 0 is the gallery's floor.

    Args:
        bays: arches along x and along y, each from 1 to 10,000.
        storeys: number of storeys, from 1 to 10,000, 5.6 m each.
        detail: points per flute of the shafts and per quarter of the mouldings, >= 1; the number of triangles is about
            proportional.

    Raises:
        TypeError: `bays` is not a pair of whole numbers.
        ValueError: an argument is out of range.
    """
    if host_array("bays", bays).shape != (2,):
        raise TypeError(f"bays must be a pair (along x, along y), got {bays!r}")
    bays_x, bays_y = (check_count("bays", bay, maximum=_MAX_COUNT) for bay in bays)
    storeys, detail = check_count("storeys", storeys, maximum=_MAX_COUNT), check_count("detail", detail)
    half = 0.5 * _BAY * np.array([bays_x, bays_y], dtype=float)
    column, floors = _column(detail), _STOREY * np.arange(storeys)
    feet = np.array([(x, y, z) for z in floors for x, y in _outline(bays_x, bays_y)])
    parts = [copies(column, feet), _shell(half, storeys), _steps(half), _fountain(detail)]
    for z in floors:
        parts += _arcades(half, (bays_x, bays_y), z, 6 * detail)
    return TriangleMesh.concatenate(parts, name="atrium")


def _outline(bays_x: int, bays_y: int) -> list[tuple[float, float]]:
    """The column axes on the outline of the court."""
    x, y = (_BAY * (np.arange(bays + 1) - 0.5 * bays) for bays in (bays_x, bays_y))
    return [(a, b) for a in x for b in y if abs(a) == x[-1] or abs(b) == y[-1]]


def _column(detail: int) -> TriangleMesh:
    """Plinth, rounded base, fluted shaft in one long strip, bell capital and abacus; 3.3 m high."""
    flutes = 20
    angle = np.linspace(0.0, 2.0 * np.pi, flutes * (detail + 1) + 1)
    groove = 1.0 - 0.09 * np.abs(np.sin(0.5 * flutes * angle)) ** 0.7
    low, high = _SHAFT
    shaft = np.empty((2, len(angle), 3))
    for row, (radius, height) in enumerate([(0.30, low), (0.25, high)]):
        shaft[row] = np.stack([radius * groove * np.cos(angle), radius * groove * np.sin(angle), angle * 0 + height], -1)
    bulge = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * detail + 1)
    base = [(0.0, 0.2)]
    base += [(0.36 + 0.07 * np.cos(a), 0.29 + 0.09 * np.sin(a)) for a in bulge]
    base += [(0.32, 0.40)]
    base += [(0.32 + 0.05 * np.cos(a), 0.52 + 0.06 * np.sin(a)) for a in bulge]
    base += [(0.30, low), (0.0, low)]
    rise = np.linspace(0.0, 1.0, 2 * detail + 1)
    capital = [(0.0, high), (0.28, high), (0.30, high + 0.03), (0.28, high + 0.07)]
    capital += [(0.25 + 0.15 * r**2.5, high + 0.09 + 0.31 * r) for r in rise]
    capital += [(0.0, high + 0.40)]
    segments = 8 * detail
    return TriangleMesh.concatenate(
        [
            boxes([-0.45, -0.45, 0.0], [0.45, 0.45, 0.2]),
            lathe(base, segments),
            sheets(shaft[:, ::-1]),
            lathe(capital, segments),
            boxes([-0.42, -0.42, high + 0.40], [0.42, 0.42, _SPRING]),
        ]
    )


def _arch(segments: int, top: float) -> TriangleMesh:
    """One bay of arcade wall along x, centred on the origin: front, back, underside and top."""
    radius = 0.5 * _BAY - 0.5 * _THICK
    angle = np.linspace(np.pi, 0.0, segments + 1)
    x = np.concatenate([[-0.5 * _BAY], radius * np.cos(angle), [0.5 * _BAY]])
    z = np.concatenate([[_SPRING], _SPRING + radius * np.sin(angle), [_SPRING]])
    lower = np.stack([x, np.zeros_like(x), z], axis=-1)
    upper = lower.copy()
    upper[:, 2] = top
    front, back = np.array([0.0, -0.5 * _THICK, 0.0]), np.array([0.0, 0.5 * _THICK, 0.0])
    loop = np.stack([upper + back, lower + back, lower + front, upper + front, upper + back])
    return sheets(loop[:, ::-1])


def _arcades(half: np.ndarray, bays: tuple[int, int], z: float, segments: int) -> list[TriangleMesh]:
    """The four sides of one storey: arches, and a moulded band at the height of the floor above."""
    arch, parts = _arch(segments, _STOREY), []
    quarter = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    for axis, mesh in enumerate((arch, arch.transformed(quarter))):
        other = 1 - axis
        for side in (-1.0, 1.0):
            offsets = np.zeros((bays[axis], 3))
            offsets[:, axis] = _BAY * (np.arange(bays[axis]) + 0.5) - half[axis]
            offsets[:, other] = side * half[other]
            offsets[:, 2] = z
            parts.append(copies(mesh, offsets))
            for reach, low, high in ((0.44, 0.35, 0.20), (0.54, 0.20, 0.0)):
                centre = np.zeros(3)
                centre[other] = side * half[other]
                size = np.zeros(3)
                size[axis], size[other] = half[axis] + reach, reach
                parts.append(boxes(centre - size + [0, 0, z + _STOREY - low], centre + size + [0, 0, z + _STOREY - high]))
    return parts


def _ring(inner: np.ndarray, outer: np.ndarray, low: float, high: float) -> TriangleMesh:
    """Four boxes between two rectangles centred on the origin (half sizes), z from `low` to `high`."""
    (a, b), (c, d) = inner, outer
    lows = [(-c, -d, low), (-c, b, low), (-c, -b, low), (a, -b, low)]
    highs = [(c, -b, high), (c, d, high), (-a, b, high), (c, b, high)]
    return boxes(np.array(lows), np.array(highs))


def _shell(half: np.ndarray, storeys: int) -> TriangleMesh:
    """Outer walls, ground slab, gallery floors, and the roof that leaves the court open."""
    inside, outside = half + _GALLERY, half + _GALLERY + _WALL
    roof, sunk = storeys * _STOREY, -3.0 * _STEP
    parts = [
        _ring(inside, outside, sunk - _WALL, roof + _WALL),
        _ring(half + 0.45, inside, sunk - _WALL, 0.0),
        boxes(np.append(-half - 0.45, sunk - _WALL), np.append(half + 0.45, sunk)),
        _ring(half - 0.5 * _THICK, inside, roof, roof + _WALL),
        plane(tuple(-outside * 2.0), tuple(outside * 2.0), z=sunk - _WALL),
    ]
    for storey in range(1, storeys):
        parts.append(_ring(half - 0.5 * _THICK, inside, storey * _STOREY - _SLAB, storey * _STOREY))
    return TriangleMesh.concatenate(parts)


def _steps(half: np.ndarray) -> TriangleMesh:
    """Three steps from the gallery down into the court; the columns stand on the uppermost."""
    sunk = -3.0 * _STEP
    return TriangleMesh.concatenate(
        [_ring(half - inset, half + 0.45, sunk, -down * _STEP) for inset, down in ((1.25, 2), (0.85, 1), (0.45, 0))]
    )


def _fountain(detail: int) -> TriangleMesh:
    """A round basin with a bowl on a stem, in the middle of the court."""
    z, water = -3.0 * _STEP, -3.0 * _STEP + 0.35
    rim = [(1.5, z), (1.5, z + 0.4), (1.58, z + 0.45), (1.58, z + 0.55), (1.3, z + 0.55), (1.3, water), (0.0, water)]
    turn = np.linspace(0.0, 0.5 * np.pi, 3 * detail + 1)
    stem = [(0.3, water), (0.13, water + 0.2), (0.1, water + 0.55), (0.16, water + 0.75)]
    bowl = [(0.16 + 0.6 * np.sin(a), water + 0.75 + 0.35 * (1.0 - np.cos(a))) for a in turn[1:]]
    inside = [(0.7 * np.sin(a), water + 0.8 + 0.3 * (1.0 - np.cos(a))) for a in turn[::-1]]
    return TriangleMesh.concatenate([lathe(rim, 12 * detail), lathe(stem + bowl + inside, 8 * detail)])
