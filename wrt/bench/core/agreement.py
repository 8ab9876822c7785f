"""How many rays have the same answer as wrt's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Agreement:
    """How an answer compares with wrt's.

    Attributes:
        hits: rays that hit something, or points inside, by this answer; of all hits, their number.
        same_hit: share of the rays that hit, or miss, by both; of all hits, share of the rays with as many.
        same_primitive: share of the rays with the same triangle, or none, by both; of all hits, with the same triangles; None
            for occlusion.
        same_t: share of the rays with |t - t'| within the tolerance, or no hit by both; None for occlusion.
    """

    hits: int
    same_hit: float
    same_primitive: float | None = None
    same_t: float | None = None


def closest_agreement(
    primitive: np.ndarray, t: np.ndarray, expected_primitive: np.ndarray, expected_t: np.ndarray, tolerance: float
) -> Agreement:
    """Compares closest hits; -1 and inf are misses, `tolerance` is in units of t."""
    hit, expected_hit = primitive >= 0, expected_primitive >= 0
    both = hit & expected_hit
    close = ~hit & ~expected_hit
    close[both] = np.abs(t[both].astype(np.float64) - expected_t[both]) <= tolerance
    return Agreement(int(hit.sum()), share(hit == expected_hit), share(primitive == expected_primitive), share(close))


def occlusion_agreement(occluded: np.ndarray, expected: np.ndarray) -> Agreement:
    """Compares occlusion."""
    return Agreement(int(occluded.sum()), share(occluded == expected))


def lists_agreement(
    rays: int, ray: np.ndarray, primitive: np.ndarray, expected_ray: np.ndarray, expected_primitive: np.ndarray
) -> Agreement:
    """Compares all hits of this many rays, whatever the order of a ray's hits."""
    counts, expected = (np.bincount(numbers, minlength=rays) for numbers in (ray, expected_ray))
    as_many = counts == expected
    found, wanted = (
        (own[order], triangles[order])
        for own, triangles in ((ray, primitive), (expected_ray, expected_primitive))
        for order in [np.lexsort([triangles, own])]
    )
    found, wanted = (triangles[as_many[own]] for own, triangles in (found, wanted))
    same = as_many.copy()
    same[np.repeat(np.flatnonzero(as_many), counts[as_many])[found != wanted]] = False
    return Agreement(len(ray), share(as_many), share(same))


def share(mask: np.ndarray) -> float:
    """Share of the elements that are true; one if there are none."""
    return float(mask.mean()) if mask.size else 1.0
