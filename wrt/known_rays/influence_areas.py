"""Detection of influence areas: which share of a batch of rays is parallel, or passes through common points, and where.

    rays = wrt.Rays(origins, directions)          # of a renderer, a sensor, a simulation
    found = wrt.known_rays.InfluenceAreas.from_rays(rays.origins, rays.directions, bounds=scene.bounds)
    print(found)                                  # each distribution and its share of the rays
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=found))

**Problem.** Falcone's method expects the influence areas as input, but the source of a batch of rays is often unknown.

**Method**, on a sample of the rays, taken as lines, since shadow rays run towards their light:

    parallel   directions are clustered by the angle between them with DBSCAN, which finds dense groups, ignores outliers and
               needs no number of clusters; the axis of a cluster is the median of its directions
    radial     the lines of random pairs of rays nearly meet if both pass through one point, and rarely otherwise; the meeting
               points are clustered in the same way, and a point is fitted to the lines near each cluster by least squares
    choose     the distribution that explains most rays is chosen, its rays are removed, and the search continues

A distribution explains a ray if the angle between the ray and the distribution's line through its origin is within the
tolerance. Since a point far away also explains parallel rays, a point has to explain more.

**Regions** enclose the origins of the explained rays and extend along the rays as far as `bounds`: a cuboid for parallel
rays; for radial rays a frustum, or, for wide bundles, one for each side of a cube around the point.

References: ester-1996; fischler-bolles-1981; falcone-2024.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea, PointInfluenceArea, frame_of
from wrt.engine.rays.rays import Rays
from wrt.kernels.validation import as_float, as_int, as_numbers, as_real_array

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike

SAMPLES = 2000
"""Default number of sampled rays: a distribution with 5 % of the rays is found."""

PAIRS = 20_000
"""Random pairs of rays whose meeting points are searched."""

MAX_MEETING_POINTS = 2000
"""Largest number of meeting points that are clustered; the time of clustering grows with its square."""

MIN_MEMBERS = 5
"""Smallest number of members of a cluster."""

MIN_LINE_SINE = 1e-3
"""Smallest sine of the angle between two lines whose meeting point is used."""

POINT_MARGIN = 1.1
"""Ratio by which a point must explain more rays than a direction."""

FIT_ROUNDS = 4
"""Rounds of fitting a point, each to the lines near the previous one."""

PAD = 1.05
"""Factor by which regions are larger than the bounds of the sample."""

WIDE_TANGENT = np.tan(np.radians(70.0))
"""Tangent of half the opening angle of a bundle from which its rays are divided among the sides of a cube."""


@dataclass(frozen=True)
class InfluenceAreas(Sequence):
    """Detected influence areas and their shares of the rays; a sequence of areas.

    Attributes:
        areas: the areas, by decreasing share of their distribution.
        shares: for each area, the share of the sampled rays that start in it and match its distribution within the
            tolerance.
    """

    areas: tuple[InfluenceArea, ...]
    shares: tuple[float, ...]

    @property
    def explained(self) -> float:
        """Share of the rays that belong to some area."""
        return sum(self.shares)

    def __len__(self) -> int:
        return len(self.areas)

    def __getitem__(self, index: Any) -> Any:
        return self.areas[index]

    def __str__(self) -> str:
        lines = []
        for area, share in zip(self.areas, self.shares, strict=True):
            parallel = isinstance(area, PlaneInfluenceArea)
            place = ", ".join(f"{x:.4g}" for x in (area.direction if parallel else area.position))
            lines.append(f"{share:6.1%}  {'parallel rays along' if parallel else 'rays through'} ({place})")
        return "\n".join([*lines, f"{max(0.0, 1.0 - self.explained):6.1%}  no area"])

    @classmethod
    def from_rays(
        cls,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        *,
        bounds: ArrayLike | None = None,
        tolerance: float = 1.0,
        least_share: float = 0.05,
        samples: int = SAMPLES,
        seed: int = 0,
    ) -> InfluenceAreas:
        """Finds the parallel and radial distributions in a batch of rays; needs scikit-learn, `pip install scikit-learn`.

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first two arguments; NumPy or convertible to it.
            directions: (..., 3), of any length; leading shapes broadcast. Rays with a NaN, an infinity or a zero direction
                are ignored.
            bounds: (2, 3) lower and upper corner of what the rays may hit, such as `scene.bounds`; None for the bounding
                box of the origins.
            tolerance: largest angle between a ray and its distribution's line, in degrees, in (0, 45).
            least_share: smallest share of the rays that a distribution must explain, in (0, 1].
            samples: number of sampled rays, at least 20; the time grows with its square.
            seed: seed of the sample and of the pairs.

        Returns:
            The areas found; empty if the rays have no such distribution.

        Raises:
            ImportError: scikit-learn is not installed; the message says how to install it.
            TypeError: an argument has a wrong type.
            ValueError: wrong shapes, a value out of range, or no valid ray.
        """
        tolerance, least_share = as_float("tolerance", tolerance), as_float("least_share", least_share)
        if not 0.0 < tolerance < 45.0:
            raise ValueError(f"tolerance is {tolerance}; it must be above 0 and below 45 degrees")
        if not 0.0 < least_share <= 1.0:
            raise ValueError(f"least_share is {least_share}; it must be above 0 and at most 1")
        rng = np.random.default_rng(as_int("seed", seed, 0))
        lines = sample_lines(origins, directions, as_int("samples", samples, 20), rng)
        box = _check_bounds(bounds, lines.origins)
        min_members = max(MIN_MEMBERS, int(np.ceil(least_share * len(lines))))
        found = find_distributions(lines, float(np.sin(np.radians(tolerance))), min_members, rng)
        areas, shares = [], []
        for distribution, chosen in found:
            for area, count in distribution.areas(lines.origins[chosen], lines.directions[chosen], box):
                areas.append(area)
                shares.append(count / len(lines))
        return cls(tuple(areas), tuple(shares))


@dataclass(frozen=True)
class Lines:
    """Sampled rays as lines: (N, 3) origins and unit directions, float64."""

    origins: np.ndarray
    directions: np.ndarray

    def __len__(self) -> int:
        return len(self.origins)

    def __getitem__(self, chosen: np.ndarray) -> Lines:
        return Lines(self.origins[chosen], self.directions[chosen])


@dataclass(frozen=True)
class Parallel:
    """Lines along a unit axis (3,)."""

    axis: np.ndarray

    def explains(self, lines: Lines, sine: float) -> np.ndarray:
        """(N,) bool: whether each line is parallel to the axis."""
        return np.linalg.norm(np.cross(lines.directions, self.axis), axis=1) <= sine

    def areas(self, origins: np.ndarray, directions: np.ndarray, box: np.ndarray) -> list[tuple[InfluenceArea, int]]:
        """The area of such rays, and the number of rays."""
        forward = self.axis if (directions @ self.axis).sum() >= 0.0 else -self.axis
        frame = frame_of(tuple(forward), None)
        places, ends = origins @ frame.T, corners_of(box) @ frame.T
        low = np.append(places[:, :2].min(axis=0), min(places[:, 2].min(), ends[:, 2].min()))
        high = np.append(places[:, :2].max(axis=0), max(places[:, 2].max(), ends[:, 2].max()))
        min_members = 1e-3 * np.linalg.norm(box[1] - box[0])  # the region of a single ray must have a volume, too
        size = np.maximum(PAD * (high - low), min_members).tolist()
        middle = (low + high) / 2
        position = np.array([middle[0], middle[1], middle[2] - size[2] / 2]) @ frame
        area = PlaneInfluenceArea(
            position=position,
            direction=forward,  # type: ignore[arg-type]
            width=size[0],
            height=size[1],
            depth=size[2],
            up=frame[1],  # type: ignore[arg-type]
        )
        return [(area, len(origins))]


@dataclass(frozen=True)
class Radial:
    """Lines through a point (3,); origins within the distance `near` count as being at the point."""

    point: np.ndarray
    near: float

    def explains(self, lines: Lines, sine: float) -> np.ndarray:
        """(N,) bool: whether each line passes through the point, as seen from its origin."""
        ways = self.point - lines.origins
        off = np.linalg.norm(np.cross(ways, lines.directions), axis=1)
        return off <= sine * np.linalg.norm(ways, axis=1) + self.near

    def areas(self, origins: np.ndarray, directions: np.ndarray, box: np.ndarray) -> list[tuple[InfluenceArea, int]]:
        """The areas of such rays and their numbers of rays: one, or one for each side of a cube."""
        ways = origins - self.point
        distance = np.linalg.norm(ways, axis=1, keepdims=True)
        at_point = distance <= self.near
        ways = np.where(at_point, directions, ways / np.where(at_point, 1.0, distance))
        far = PAD * float(max(np.linalg.norm(corners_of(box) - self.point, axis=1).max(), distance.max()))
        middle = ways.mean(axis=0)
        length = np.linalg.norm(middle)
        frame = frame_of(tuple(middle / length), None) if length > 0.1 else np.eye(3)
        tangents = tangents_of(ways @ frame.T)
        if tangents is not None and tangents.max() < WIDE_TANGENT:
            return [(self._frustum(frame, np.maximum(PAD * tangents, 1e-3), far), len(ways))]
        side = np.abs(ways).argmax(axis=1)
        sign = np.sign(ways[np.arange(len(ways)), side])
        sides: list[tuple[PlaneInfluenceArea | PointInfluenceArea, int]] = []
        for axis in range(3):
            for end in (-1.0, 1.0):
                count = int(((side == axis) & (sign == end)).sum())
                if count:
                    frame = frame_of(tuple(end * np.eye(3)[axis]), None)
                    sides.append((self._frustum(frame, np.ones(2), far), count))
        return sides

    def _frustum(self, frame: Any, tangents: np.ndarray, far: float) -> PointInfluenceArea:
        fov = 2.0 * np.degrees(np.arctan(tangents))
        return PointInfluenceArea(position=self.point, direction=frame[2], fov=fov, near=1e-3 * far, far=far, up=frame[1])  # type: ignore[arg-type]


Distribution = Parallel | Radial


def tangents_of(seen: np.ndarray) -> np.ndarray | None:
    """(2,) half sizes of the window at depth 1 that contains all (N, 3) vectors; None if some point backwards."""
    if seen[:, 2].min() <= 1e-3:
        return None
    return np.abs(seen[:, :2] / seen[:, 2:]).max(axis=0)


def find_distributions(
    lines: Lines, sine: float, min_members: int, rng: np.random.Generator
) -> list[tuple[Distribution, np.ndarray]]:
    """Distributions that explain at least `min_members` lines each, with the indices of those lines; no line is used twice."""
    rest = np.arange(len(lines))
    found: list[tuple[Distribution, np.ndarray]] = []
    while len(rest) >= min_members:
        left = lines[rest]
        best: Distribution | None = None
        best_explained = np.zeros(len(rest), dtype=bool)
        candidates: list[Distribution] = [*parallel_candidates(left, sine, min_members)]
        candidates += radial_candidates(left, sine, min_members, rng)
        for candidate in candidates:
            explained = candidate.explains(left, sine)
            worth = explained.sum() / (POINT_MARGIN if isinstance(candidate, Radial) and isinstance(best, Parallel) else 1.0)
            if worth > best_explained.sum():
                best, best_explained = candidate, explained
        if best is None or best_explained.sum() < min_members:
            break
        found.append((best, rest[best_explained]))
        rest = rest[~best_explained]
    return found


def parallel_candidates(lines: Lines, sine: float, min_members: int) -> list[Parallel]:
    """An axis for each cluster of directions."""
    cosines = np.clip(lines.directions @ lines.directions.T, -1.0, 1.0)
    sines = np.sqrt(1.0 - cosines * cosines)
    labels = cluster(sines, sine, min_members, "precomputed")
    axes = []
    for label in range(labels.max() + 1):
        members = lines.directions[labels == label]
        axis = np.median(members * np.sign(members @ members[0])[:, None], axis=0)  # lines have no orientation
        axes.append(Parallel(axis / np.linalg.norm(axis)))
    return axes


def radial_candidates(lines: Lines, sine: float, min_members: int, rng: np.random.Generator) -> list[Radial]:
    """A point for each cluster of meeting points of lines."""
    one, other = rng.integers(0, len(lines), (2, PAIRS))
    a, b = lines[one], lines[other]
    between = b.origins - a.origins
    cosine = (a.directions * b.directions).sum(axis=1)
    square = 1.0 - cosine * cosine
    meeting = square > MIN_LINE_SINE**2
    along_a, along_b = (between * a.directions).sum(axis=1), (between * b.directions).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (along_a - cosine * along_b) / square, (cosine * along_a - along_b) / square
        p, q = a.origins + s[:, None] * a.directions, b.origins + t[:, None] * b.directions
        gap = np.linalg.norm(p - q, axis=1)
    size = np.linalg.norm(np.ptp(lines.origins, axis=0))
    near = max(1e-6 * (size + np.abs(lines.origins).max()), np.finfo(float).tiny)
    meeting &= gap <= sine * np.minimum(np.abs(s), np.abs(t)) + near
    if meeting.sum() < MIN_MEMBERS:
        return []
    kept = np.flatnonzero(meeting)[:MAX_MEETING_POINTS]  # pairs are random: any subset will do
    places = (p[kept] + q[kept]) / 2
    expected = PAIRS * len(kept) / meeting.sum() * (min_members / len(lines)) ** 2
    labels = cluster(places, 2.0 * sine * size + near, max(MIN_MEMBERS, int(expected / 4)))
    centers = [np.median(places[labels == label], axis=0) for label in range(labels.max() + 1)]
    return [fit_point(Radial(center, near), lines, sine) for center in centers]


def fit_point(start: Radial, lines: Lines, sine: float) -> Radial:
    """The least-squares meeting point of the lines near `start`."""
    best = start
    for width in np.geomspace(4.0 * sine, sine, FIT_ROUNDS):
        near = lines[best.explains(lines, width)]
        if len(near) < 2:
            break
        across = np.eye(3) - near.directions[:, :, None] * near.directions[:, None, :]
        matrix, right = across.sum(axis=0), (across @ near.origins[:, :, None]).sum(axis=0)[:, 0]
        best = Radial(np.linalg.lstsq(matrix, right, rcond=None)[0], start.near)
    return best


def cluster(points: np.ndarray, distance: float, min_members: int, metric: str = "euclidean") -> np.ndarray:
    """(N,) cluster number of each point, -1 for none, by DBSCAN.

    Raises:
        ImportError: scikit-learn is not installed.
    """
    try:
        from sklearn.cluster import DBSCAN
    except ImportError as error:
        raise ImportError(
            "wrt.known_rays.InfluenceAreas.from_rays clusters rays with scikit-learn, which is not installed; "
            "install it with: pip install scikit-learn"
        ) from error
    return DBSCAN(eps=distance, min_samples=min_members, metric=metric).fit_predict(points)


def sample_lines(origins: Any, directions: Any, count: int, rng: np.random.Generator) -> Lines:
    """At most `count` of the valid rays.

    Raises:
        TypeError: directions are missing, or given twice.
        ValueError: wrong shapes, or no valid ray.
    """
    if isinstance(origins, Rays):
        if directions is not None:
            raise TypeError("pass either a wrt.Rays, or origins and directions, not both")
        origins, directions = origins.origins, origins.directions
    if directions is None:
        raise TypeError("directions is missing; pass origins and directions, or a wrt.Rays")
    given = {"origins": origins, "directions": directions}
    o, d = (as_real_array(name, a.numpy() if isinstance(a, wp.array) else a) for name, a in given.items())
    for name, array in (("origins", o), ("directions", d)):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"{name} must have shape (..., 3), not {array.shape}")
    try:
        o, d = np.broadcast_arrays(o, d)
    except ValueError:
        raise ValueError(f"origins {o.shape} and directions {d.shape} do not broadcast") from None
    total = o.size // 3
    # only a few of millions of rays are converted; more than requested, because some may be invalid
    chosen = np.unique(rng.integers(0, total, 4 * count)) if total > 4 * count else np.arange(total)
    places = np.unravel_index(chosen, o.shape[:-1]) if o.ndim > 1 else ()
    o, d = (np.atleast_2d(a[places].astype(np.float64)) for a in (o, d))
    length = np.linalg.norm(d, axis=1)
    with np.errstate(invalid="ignore"):
        valid = np.flatnonzero(np.isfinite(o).all(axis=1) & np.isfinite(length) & (length > 0.0))
    if not len(valid):
        raise ValueError("no ray has a finite origin and a finite direction other than zero; pass at least one")
    valid = rng.permutation(valid)[:count]
    return Lines(o[valid], d[valid] / length[valid, None])


def corners_of(box: np.ndarray) -> np.ndarray:
    """(8, 3) corners of a box (2, 3)."""
    return np.array([[box[k >> axis & 1, axis] for axis in range(3)] for k in range(8)])


def _check_bounds(bounds: Any, origins: np.ndarray) -> np.ndarray:
    if bounds is None:
        box = np.array([origins.min(axis=0), origins.max(axis=0)])
        if not (box[1] > box[0]).any():
            raise ValueError("all rays start at one point, which bounds no region; pass bounds=scene.bounds")
        return box
    box = as_numbers("bounds", bounds, finite=False)
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise ValueError(f"bounds must be (2, 3), a lower and an upper corner, not {bounds!r}")
    return box
