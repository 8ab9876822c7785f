"""The teapot in a stadium: a small, finely tessellated object in a large, coarse scene.

The classic bad case of uniform grids (the name is from discussions in Eric Haines's Ray Tracing News): a grid whose cells
suit the stadium puts the whole teapot into one cell. Adaptive trees, kd-trees and bounding volume hierarchies, handle it
well. The stadium is an oval bowl, about a hundred times as long as the teapot: a field with lines and goals, stepped stands
around it, a canopy above them, and four masts with floodlights.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.newell_teapot import teapot
from wrt.scenes.shapes import boxes, check_count, copies, lathe, plane, sheets

__all__ = ["teapot_in_stadium"]

_TEAPOT_SCALE = 0.4  # 2.6 metres long, 1.26 high
_FIELD = np.array([62.0, 44.0])  # half axes of the innermost row's ellipse
_STANDS_DEPTH = 60.0
_STANDS_HEIGHT = 34.0


def teapot_in_stadium(level: int = 24, rows: int = 24, segments: int = 64) -> TriangleMesh:
    """Newell's teapot on the centre spot of a stadium 244 m long, 208 m wide and 62 m high; z = 0 is the grass.

    Args:
        level: quads along each side of a teapot patch, >= 1; the teapot has 64 level^2 - 8 level triangles.
        rows: rows of the stands, >= 1, six triangles for each segment.
        segments: corners of the oval, >= 8.

    Raises:
        TypeError: an argument is not a whole number.
        ValueError: an argument is too small.
    """
    rows = check_count("rows", rows)
    segments = check_count("segments", segments, 8)
    scale = np.diag([_TEAPOT_SCALE, _TEAPOT_SCALE, _TEAPOT_SCALE, 1.0])
    outer = _FIELD + _STANDS_DEPTH
    parts = [
        teapot(level, ground=False).transformed(scale),
        plane(tuple(-outer), tuple(outer), cells=8),
        _stands(rows, segments),
        _aisles(rows, segments),
        _canopy(segments),
        _markings(),
        *_masts(),
    ]
    return TriangleMesh.concatenate(parts, name="teapot_in_stadium")


def _oval(depth: ArrayLike, height: ArrayLike, segments: int) -> np.ndarray:
    """(R, segments + 1, 3) ellipses at `depth` metres behind the innermost one, clockwise seen from above."""
    angle = np.linspace(0.0, -2.0 * np.pi, segments + 1)
    half_axes = _FIELD + np.asarray(depth, dtype=float)[:, None]
    points = np.empty((len(half_axes), segments + 1, 3))
    points[..., 0] = half_axes[:, :1] * np.cos(angle)
    points[..., 1] = half_axes[:, 1:] * np.sin(angle)
    points[..., 2] = np.asarray(height, dtype=float)[:, None]
    points[:, -1] = points[:, 0]
    return points


def _row_profile(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the front edge, and height, of every row; rows further back rise more steeply.

    A parapet of 4 m between the tiers shows as a band all around.
    """
    step = np.arange(rows) / rows
    height = 1.2 + (_STANDS_HEIGHT - 5.2) * (0.6 * step + 0.4 * step**2)
    return step * _STANDS_DEPTH, height + np.where(np.arange(rows) >= 0.5 * rows, 4.0, 0.0)


def _stands(rows: int, segments: int) -> TriangleMesh:
    """Riser, slanting bench front, tread, riser ... turned into an oval, then the outer wall down to the ground."""
    front, height = _row_profile(rows)
    before = np.append(0.0, height[:-1])
    bench = 0.45 * np.minimum(height - before, _STANDS_HEIGHT / rows)
    depth = np.stack([front, front, front + 0.35 * _STANDS_DEPTH / rows], axis=-1)
    profile = np.stack([before, height - bench, height], axis=-1)
    depth = np.append(depth, [_STANDS_DEPTH, _STANDS_DEPTH])
    profile = np.append(profile, [height[-1], 0.0])
    return sheets(_oval(depth, profile, segments)[:, ::-1])


def _aisles(rows: int, segments: int) -> TriangleMesh:
    """Balusters along the aisles: at every fourth corner of the oval, one upright box on the front edge of each row."""
    front, height = _row_profile(rows)
    feet = _oval(front + 0.3, height, segments)[:, :-1:4].reshape(-1, 3)
    return boxes(feet - np.array([0.35, 0.35, 0.05]), feet + np.array([0.35, 0.35, 1.0]))


def _canopy(segments: int) -> TriangleMesh:
    """A thin roof over the upper rows, rising towards the field, and the columns that carry it."""
    depth = np.array([_STANDS_DEPTH, 0.45 * _STANDS_DEPTH, 0.45 * _STANDS_DEPTH, _STANDS_DEPTH, _STANDS_DEPTH])
    height = np.array([42.0, 47.0, 47.6, 43.2, 42.0])
    roof = sheets(_oval(depth, height, segments)[:, ::-1])
    feet = _oval([_STANDS_DEPTH - 1.0], [_STANDS_HEIGHT - 1.0], max(segments // 2, 8))[0, :-1]
    columns = boxes(feet - np.array([0.3, 0.3, 3.0]), feet + np.array([0.3, 0.3, 9.4]))
    return TriangleMesh.concatenate([roof, columns])


def _markings() -> TriangleMesh:
    """Touch lines, half-way line, penalty areas and centre circle, 2 cm above the grass, and two goals."""
    length, width, line = 45.0, 29.0, 0.15
    lines = [(-length, -width, length, -width), (-length, width, length, width)]
    lines += [(x, -width, x, width) for x in (-length, 0.0, length)]
    for side in (-1.0, 1.0):
        inner = side * (length - 14.0)
        lines += [(inner, -17.0, inner, 17.0)]
        lines += [(min(inner, side * length), y, max(inner, side * length), y) for y in (-17.0, 17.0)]
    low_high = np.array(lines)
    low = np.column_stack([low_high[:, :2] - line, np.zeros(len(lines))])
    high = np.column_stack([low_high[:, 2:] + line, np.full(len(lines), 0.02)])
    circle = lathe([(8.0 - line, 0.02), (8.0 + line, 0.02)][::-1], 64)
    posts = []
    for x in (-length, length):
        for y in (-3.66, 3.66):
            posts.append((x - 0.06, y - 0.06, 0.0, x + 0.06, y + 0.06, 2.44))
        posts.append((x - 0.06, -3.72, 2.44, x + 0.06, 3.72, 2.56))
    ends = np.array(posts)
    return TriangleMesh.concatenate([boxes(low, high), circle, boxes(ends[:, :3], ends[:, 3:])])


def _masts() -> list[TriangleMesh]:
    """Four tapering masts outside the stands, each with a frame of 4 x 6 lamps turned towards the field."""
    shaft = lathe([(1.1, 0.0), (0.5, 52.0)], 10)
    row, column = (index.ravel() for index in np.meshgrid(np.arange(4), np.arange(6), indexing="ij"))
    lamp = np.stack([(column - 2.5) * 1.9, np.zeros(24), 53.0 + row * 2.2], axis=-1)
    size = np.array([0.8, 0.35, 0.8])
    frame = TriangleMesh.concatenate([boxes(lamp - size, lamp + size), boxes([-6.0, -0.7, 51.8], [6.0, -0.4, 61.8])])
    masts = []
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            place = np.array([x * 100.0, y * 88.0, 0.0])
            facing = np.arctan2(-place[1], -place[0]) - np.pi / 2.0
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(facing), -np.sin(facing)], [np.sin(facing), np.cos(facing)]]
            turn[:3, 3] = place
            masts += [copies(shaft, place), frame.transformed(turn)]
    return masts
