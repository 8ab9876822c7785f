"""Skeletons: bones that turn about joints within limits, and skins that follow them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wrt.kernels.validation import as_int, as_numbers, as_real_array, first_bad

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones, each of which turns about a joint relative to its parent.

    Attributes:
        parents: (B,) int, the parent of each bone, which comes before it; -1 for a root.
        joints: (B, 3) float64, the point that the bone turns about, in the rest pose.
        limits: (B, 3, 2) float64, least and greatest angle about the x, y and z axis of the rest pose, in degrees. The bone is
            turned about x first, then y, then z.

    Raises:
        ValueError: wrong shapes, a parent that does not come before its bone, numbers that are not finite, or a least angle
            above the greatest one.
    """

    parents: np.ndarray
    joints: np.ndarray
    limits: np.ndarray

    def __post_init__(self) -> None:
        parents = as_real_array("parents", self.parents)
        joints, limits = (as_numbers(name, getattr(self, name), finite=False) for name in ("joints", "limits"))
        count = len(parents) if parents.ndim == 1 else 0
        if not count or parents.dtype.kind not in "iu":
            raise ValueError(f"parents must be an integer for each bone, (B,), not {parents.dtype} of shape {parents.shape}")
        if joints.shape != (count, 3) or limits.shape != (count, 3, 2):
            raise ValueError(
                f"joints and limits must be of shapes ({count}, 3) and ({count}, 3, 2), not {joints.shape} and {limits.shape}"
            )
        for name, values in (("joints", joints), ("limits", limits)):
            if bad := first_bad(~np.isfinite(values), values):
                raise ValueError(f"{name}{bad}; all must be finite")
        if bad := first_bad(limits[..., 0] > limits[..., 1], limits):
            raise ValueError(f"limits{bad}: the least angle must not exceed the greatest one")
        if bad := first_bad((parents < -1) | (parents >= np.arange(count)), parents):
            raise ValueError(f"parents{bad}; parents must come before their bones, and -1 stands for none")
        for name, values in (("parents", parents.astype(np.int64)), ("joints", joints), ("limits", limits)):
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Number of bones."""
        return len(self.parents)

    def maps(self, angles: ArrayLike) -> np.ndarray:
        """(..., B, 4, 4) float64 maps of the bones from the rest pose.

        Args:
            angles: (..., B, 3) angles about the axes, in degrees, within the limits or not.

        Raises:
            ValueError: another shape.
        """
        angles = as_numbers("angles", angles, finite=False)
        if angles.shape[-2:] != (len(self), 3):
            raise ValueError(f"angles must be of shape (..., {len(self)}, 3), not {angles.shape}")
        turns = np.zeros((*angles.shape[:-1], 4, 4))
        turns[..., :3, :3] = rotations(np.radians(angles))
        turns[..., :3, 3] = self.joints - np.einsum("...ij,...j->...i", turns[..., :3, :3], self.joints)
        turns[..., 3, 3] = 1.0
        maps = np.empty_like(turns)
        for bone, parent in enumerate(self.parents):
            own = turns[..., bone, :, :]
            maps[..., bone, :, :] = own if parent < 0 else maps[..., parent, :, :] @ own
        return maps

    def sample(self, count: int, seed: int = 0) -> np.ndarray:
        """(count, B, 3) angles within the limits: the rest pose if the limits contain it, then random ones.

        Half of the random angles are at a limit, because the boxes of skins are widest there.

        Args:
            count: number of poses, at least 0.
            seed: of the random numbers, at least 0.

        Raises:
            TypeError, ValueError: no whole number, or out of range.
        """
        count, rng = as_int("count", count, 0), np.random.default_rng(as_int("seed", seed, 0))
        low, high = self.limits[..., 0], self.limits[..., 1]
        share = rng.random((count, len(self), 3))
        share = np.where(rng.random(share.shape) < 0.5, np.round(share), share)
        angles = low + share * (high - low)
        angles[:1] = np.clip(0.0, low, high)
        return angles


def rotations(angles: np.ndarray) -> np.ndarray:
    """(..., 3, 3) turns about x, then y, then z by (..., 3) angles in radians."""
    (a, b, c), (s, u, w) = (np.moveaxis(wave(angles), -1, 0) for wave in (np.cos, np.sin))
    rows = [[b * c, s * u * c - a * w, a * u * c + s * w], [b * w, s * u * w + a * c, a * u * w - s * c], [-u, s * b, a * b]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def skinned(vertices: np.ndarray, weights: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """(..., V, 3) positions of a skin: of each vertex, the mean of where its bones move it, by weight.

    Args:
        vertices: (V, 3) in the rest pose.
        weights: (V, B), rows that sum to 1.
        maps: (..., B, 4, 4).
    """
    points = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    return np.einsum("vb,...bij,vj->...vi", weights, maps[..., :3, :], points, optimize=True)
