"""What pairs of triangles are compared with: distances in extended precision and in rational numbers, and separating planes."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np

AFTER = [1, 2, 0]


def triangles_of(mesh, transform=None) -> np.ndarray:
    """(F, 3, 3) float64 vertices of triangles in the scene."""
    corners = np.asarray(mesh.vertices, dtype=np.float64)[np.asarray(mesh.faces)]
    return corners if transform is None else corners @ np.asarray(transform)[:3, :3].T + np.asarray(transform)[:3, 3]


def all_pairs(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F * G, 3, 3) of each: every pair, those of the first triangle first."""
    return np.repeat(a, len(b), axis=0), np.tile(b, (len(a), 1, 1))


def dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Along the last axis."""
    return (p * q).sum(axis=-1)


def segment_squares(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Squared distances of segments: the second parameter from the first, clamped, and back (Ericson 2005, 5.1.9)."""
    d, e, r = q - p, b - a, p - a
    dd, ee, de, dr, er = dot(d, d), dot(e, e), dot(d, e), dot(d, r), dot(e, r)
    with np.errstate(all="ignore"):
        s = np.clip(np.nan_to_num((de * er - dr * ee) / (dd * ee - de * de)), 0, 1)
        t = np.clip(np.nan_to_num((de * s + er) / ee), 0, 1)
        s = np.clip(np.nan_to_num((de * t - dr) / dd), 0, 1)
    apart = r + s[..., None] * d - t[..., None] * e
    return dot(apart, apart)


def face_squares(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Squared distances of points from planes, where their feet are inside the triangles; inf elsewhere."""
    n = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    with np.errstate(all="ignore"):
        foot = p - (dot(n, p - t[:, 0]) / dot(n, n))[:, None] * n
        inside = np.all([dot(n, np.cross(t[:, AFTER[i]] - t[:, i], foot - t[:, i])) >= 0 for i in range(3)], axis=0)
        return np.where(inside & (dot(n, n) > 0), dot(n, p - t[:, 0]) ** 2 / dot(n, n), np.inf)


def distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) distances of pairs of triangles; 0 if they meet."""
    wide_a, wide_b = a.astype(np.longdouble), b.astype(np.longdouble)
    least = np.full(len(a), np.inf, dtype=np.longdouble)
    for i in range(3):
        for j in range(3):
            p, q, c, d = wide_a[:, i], wide_a[:, AFTER[i]], wide_b[:, j], wide_b[:, AFTER[j]]
            least = np.minimum(least, np.minimum(segment_squares(p, q, c, d), segment_squares(c, d, p, q)))
        least = np.minimum(least, np.minimum(face_squares(wide_a[:, i], wide_b), face_squares(wide_b[:, i], wide_a)))
    return np.where(meet(a, b), 0.0, np.sqrt(least)).astype(np.float64)


def meet(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) whether closed triangles have a common point: no plane separates them. Exact for whole numbers up to 30.

    Planes to try: across every difference of vertices, normal to every pair of these, and through them.
    """
    vertices = np.concatenate([a, b], axis=1)
    number = np.int64 if np.array_equal(vertices, np.rint(vertices)) and np.abs(vertices).max() <= 30 else np.longdouble
    vertices = vertices.astype(number)
    differences = [vertices[:, i] - vertices[:, j] for i, j in combinations(range(6), 2)]
    apart = np.zeros(len(a), dtype=bool)

    def try_axis(axis: np.ndarray) -> None:
        along = np.einsum("nij,nj->ni", vertices, axis)
        own, other = along[:, :3], along[:, 3:]
        apart[:] |= (own.max(axis=1) < other.min(axis=1)) | (other.max(axis=1) < own.min(axis=1))

    for difference in differences:
        try_axis(difference)
    for first, second in combinations(differences, 2):
        normal = np.cross(first, second)
        try_axis(normal)
        if number is np.int64:  # in one plane
            try_axis(np.cross(normal, first))
            try_axis(np.cross(normal, second))
    return ~apart


def rational_distance(a: np.ndarray, b: np.ndarray) -> float:
    """The distance of two triangles that have areas and do not meet, of which only the square and its root are rounded."""
    a, b = (np.array([[Fraction(float(x)) for x in vertex] for vertex in t], dtype=object) for t in (a, b))
    squares = []

    def project(apart: np.ndarray, first: np.ndarray, second: np.ndarray, is_inside) -> None:
        """The least square of apart - v first - w second, if the weights are inside."""
        ff, ss, fs, fa, sa = first @ first, second @ second, first @ second, first @ apart, second @ apart
        area = ff * ss - fs * fs
        if area and is_inside(v := (fa * ss - sa * fs) / area, w := (sa * ff - fa * fs) / area):
            rest = apart - v * first - w * second
            squares.append(rest @ rest)

    for own, other in ((a, b), (b, a)):
        for point in own:
            project(point - other[0], other[1] - other[0], other[2] - other[0], lambda v, w: v >= 0 and w >= 0 and v + w <= 1)
            for i in range(3):
                edge, apart = other[AFTER[i]] - other[i], point - other[i]
                rest = apart - min(max((apart @ edge) / (edge @ edge), Fraction(0)), Fraction(1)) * edge
                squares.append(rest @ rest)
    for i in range(3):
        for j in range(3):
            edges = b[AFTER[j]] - b[j], a[i] - a[AFTER[i]]
            project(a[i] - b[j], *edges, lambda v, w: 0 <= v <= 1 and 0 <= w <= 1)
    return float(np.sqrt(float(min(squares))))
