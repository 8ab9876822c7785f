"""Polygons as triangles, in the order of the polygons: fans where they are convex, ears where they are not.

A fan from a corner of a concave polygon covers more than the polygon, and some of it twice: areas and counts of crossings are
wrong. Convex here is what a fan from the first corner covers exactly: every corner turns to the same side as the whole, and all
turns together go round once. Others are projected along their normal (Newell's sum, exact for flat polygons) and cut ear by
ear.

References: meisters-1975; sutherland-1974 (Newell's normal).
"""

from __future__ import annotations

import numpy as np

__all__ = ["Triangles", "triangulate"]

MAX_CONCAVE = 10_000
"""Corners of a concave polygon; cutting ears takes time in proportion to their square."""

MANY_REFLEX = 48
"""Inward corners from which on they are compared by NumPy."""

CHUNK = 1 << 18
"""Corners that are looked at together."""

Triangles = tuple[np.ndarray, np.ndarray]
"""(T, 3) places of the triangles' corners in the list of all corners, and (T,) the polygon of each."""


def triangulate(vertices: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> Triangles:
    """Cuts polygons into triangles: those of polygon 0 first.

    A polygon of n corners has n - 2; one of fewer than three has none.

    Args:
        vertices: (V, 3).
        corners: (N,) vertex of each corner, polygon after polygon.
        counts: (P,) corners of each polygon.

    Raises:
        ValueError: a corner refers to no vertex; a concave polygon has more than 10,000 corners.
    """
    check_corners(corners, counts, len(vertices))
    if (counts == 3).all():
        return np.arange(len(corners)).reshape(-1, 3), np.arange(len(counts))
    starts = np.cumsum(counts) - counts
    pieces = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), pieces)
    place = np.arange(len(polygon)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first = starts[polygon]
    triangles = np.stack([first, first + place + 1, first + place + 2], axis=1)
    begins = np.cumsum(pieces) - pieces
    for count in np.unique(counts[counts > 3]).tolist():
        same = np.flatnonzero(counts == count)
        step = max(1, CHUNK // count)
        for rows in (same[begin : begin + step] for begin in range(0, len(same), step)):
            points = np.asarray(vertices[corners[starts[rows][:, None] + np.arange(count)]], dtype=np.float64)
            convex, normals = convexity(points)
            for row in np.flatnonzero(~convex).tolist():
                cut = ears_of(points[row], normals[row])
                begin = begins[rows[row]]
                triangles[begin : begin + count - 2] = starts[rows[row]] + cut
    return triangles, polygon


def check_corners(corners: np.ndarray, counts: np.ndarray, vertex_count: int) -> None:
    """Raises a ValueError that names the first face with a corner that is no vertex."""
    if len(corners) == 0 or (corners.min() >= 0 and corners.max() < vertex_count):
        return
    first = int(np.argmax((corners < 0) | (corners >= vertex_count)))
    face = int(np.searchsorted(np.cumsum(counts), first, side="right"))
    raise ValueError(
        f"face {face} refers to vertex {int(corners[first])}, but there are {vertex_count} vertices (valid: 0 to "
        f"{vertex_count - 1}, counted from zero)"
    )


def convexity(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R,) bool, whether fans cover the polygons (R, n, 3), and (R, 3) their normals.

    Those that are not finite count as convex.
    """
    with np.errstate(all="ignore"):
        local = points - points[:, :1]
        after = np.roll(local, -1, axis=1)
        normals = np.cross(local, after).sum(axis=1)
        edges = after - local
        before = np.roll(edges, 1, axis=1)
        turns = np.einsum("rni,ri->rn", np.cross(before, edges), normals)
        straight = np.einsum("rni,rni->rn", before, edges) * np.linalg.norm(normals, axis=1)[:, None]
        around = np.arctan2(turns, straight).sum(axis=1)
        concave = (turns < 0.0).any(axis=1) | (around > 3.0 * np.pi)
    return ~concave, normals


def ears_of(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n - 2, 3) corners of the triangles of a concave polygon (n, 3)."""
    if len(points) > MAX_CONCAVE:
        raise ValueError(
            f"a concave polygon has {len(points)} corners, and those of more than {MAX_CONCAVE} are not triangulated; do so in "
            "the program that made the file"
        )
    axis = int(np.argmax(np.abs(normal)))
    flat = points[:, [(axis + 1) % 3, (axis + 2) % 3]] - points[0, [(axis + 1) % 3, (axis + 2) % 3]]
    if normal[axis] < 0.0:
        flat = flat[:, ::-1]
    return np.array(EarClipping(flat).run(), dtype=np.int64)


class EarClipping:
    """A polygon in the plane, counter-clockwise, from which ears are cut until a triangle is left.

    An ear is a corner that turns left and whose triangle holds no other corner. If no corner is one, as in polygons that touch
    themselves, corners on the border of the triangle and corners without a turn are allowed; if there is still none, the
    polygon crosses itself, and any corner is cut.
    """

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        self.left = list(range(len(points)))
        self.x, self.y = points[:, 0].tolist(), points[:, 1].tolist()
        self.x_all, self.y_all = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        self.reflex = {k for k in self.left if self._turn(k - 1, k, (k + 1) % len(self.left)) <= 0.0}

    def run(self) -> list[tuple[int, int, int]]:
        """The triangles."""
        cut, at, failed, strict = [], 0, 0, True
        left = self.left
        while len(left) > 3:
            at %= len(left)
            a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
            if failed <= len(left) and not self._is_ear(a, b, c, strict):
                at, failed = at + 1, failed + 1
                if failed > len(left) and strict:
                    strict, failed = False, 0
                continue
            cut.append((a, b, c))
            del left[at]
            self._changed(at - 1)
            self._changed(at)
            at, failed, strict = at - 1, 0, True
        return [*cut, (left[0], left[1], left[2])]

    def _changed(self, at: int) -> None:
        left = self.left
        at %= len(left)
        self.reflex.discard(left[at])
        if self._turn(left[at - 1], left[at], left[(at + 1) % len(left)]) <= 0.0:
            self.reflex.add(left[at])

    def _turn(self, a: int, b: int, c: int) -> float:
        x, y = self.x, self.y
        return (x[b] - x[a]) * (y[c] - y[b]) - (y[b] - y[a]) * (x[c] - x[b])

    def _is_ear(self, a: int, b: int, c: int, strict: bool) -> bool:
        turn = self._turn(a, b, c)
        if turn < 0.0 or (turn == 0.0 and strict):
            return False
        if len(self.reflex) > MANY_REFLEX:
            return not self._holds_any(a, b, c, strict)
        own = {(self.x[k], self.y[k]) for k in (a, b, c)}
        for other in self.reflex:
            if other in (a, b, c) or (self.x[other], self.y[other]) in own:
                continue
            sides = self._turn(a, b, other), self._turn(b, c, other), self._turn(c, a, other)
            smallest = min(sides)
            if smallest > 0.0 or (strict and smallest == 0.0):
                return False
        return True

    def _holds_any(self, a: int, b: int, c: int, strict: bool) -> bool:
        """The same for many corners at once."""
        others = np.fromiter(self.reflex, dtype=np.int64, count=len(self.reflex))
        px, py = self.x_all[others], self.y_all[others]
        inside = np.ones(len(others), dtype=bool)
        for i, j in ((a, b), (b, c), (c, a)):
            side = (self.x[j] - self.x[i]) * (py - self.y[j]) - (self.y[j] - self.y[i]) * (px - self.x[j])
            inside &= side >= 0.0 if strict else side > 0.0
        for k in (a, b, c):
            inside &= (px != self.x[k]) | (py != self.y[k])
        return bool(inside.any())
