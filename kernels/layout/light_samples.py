"""Memory layout of the points of an area light to which shadow rays go: patterns of samples, 16 samples to a group.

Every pattern covers the light with S samples; neighbouring points use different patterns. A group is a small part of the light:
the rays from one point to its samples are one frustum (`wrt.kernels.traversal.shadows.multi_frusta`).
"""

import warp as wp

GROUP = 16
"""Samples of a group. In the last one unused places repeat its first sample."""


@wp.struct
class LightSamples:
    """Samples in the coordinates of the points that look at them."""

    samples: int
    """S."""
    groups: int
    """Groups of a pattern, ceil(S / 16)."""
    patterns: int
    """K. Point i uses pattern `pattern_of(i, K)`."""
    positions: wp.array(dtype=float)
    """(K, groups, 3, 16) component by component."""
    bounds: wp.array(dtype=float)
    """(K, groups, 6): least x, y, z, then greatest x, y, z of each group."""


def pattern_of(index, patterns: int):
    """(N,) the pattern that each point uses, by a hash of its number.

    Args:
        index: (N,) array of int64.
        patterns: K.
    """
    h = index * 0x9E3779B1 & 0xFFFFFFFF
    h = (h ^ (h >> 16)) * 0x85EBCA6B & 0xFFFFFFFF
    return (h ^ (h >> 13)) % patterns
