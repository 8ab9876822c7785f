"""Maps of instances, from gentle to nearly flat."""

from __future__ import annotations

import numpy as np
import trimesh

TURNED = trimesh.transformations.rotation_matrix(0.8, [1.0, -2.0, 0.5], [0.3, 0.1, 0.2])

MIRRORED = np.diag([-1.0, 1.0, 1.0, 1.0])


def maps(size: float) -> list[np.ndarray]:
    """Maps that keep angles: none, a motion, one that mirrors, and ones that scale, far from each other and near."""
    moved = [np.eye(4), TURNED.copy(), MIRRORED @ TURNED, TURNED @ np.diag([0.3, 0.3, 0.3, 1.0])]
    moved.append(MIRRORED @ np.diag([2.5, 2.5, 2.5, 1.0]))
    for number, matrix in enumerate(moved):
        matrix[:3, 3] += np.array([0.9, -0.4, 0.3]) * number * size
    return moved
