"""Motion decomposition: clusters of triangles that move almost alike, each with an affine map per frame.

**Problem.** The box around all positions of a triangle in an animation is huge. In a space that moves with the triangle's
surroundings it is small, if these move coherently: limbs, cloth, any deformation of a mesh.

**Phases.** Generalised Lloyd relaxation. *Fit* the maps of each cluster by least squares, from the vertices of a rest pose to
those of every frame. *Assign* each triangle to the cluster in whose space its vertices move least. Repeat until nothing
improves. Then *seed* a new cluster with the triangle whose vertices move most, and its neighbours. Continue until the requested
number of clusters exists, or the residual motion is below a threshold.

**What we changed.** The residual motion of a triangle is measured by the size of the boxes that its vertices need over all
frames, because these boxes go into the tree. A map is drawn slightly towards the nearest rotation, which determines what a flat
cluster leaves undetermined. It is replaced by that rotation if it almost flattens space.

**Complexity.** Linear in frames x triangles x clusters.

References: guenther-2006-motion; lloyd-1982.
"""

from dataclasses import dataclass

import numpy as np

from wrt.builders.motion_residuals import nearest_clusters

MAX_ROUNDS = 12
"""Most rounds of assigning and fitting for a given number of clusters."""

ROTATION_WEIGHT = 1e-3
"""Weight of the rotation relative to the spread of the vertices in the fit. Small, so that it acts only where the fit is
singular."""

MIN_IMPROVEMENT = 1e-3
"""Relative decrease of the residual motion below which a round is rejected."""

MAX_CONDITION = 1e3
"""Condition number, or shrink factor, of a map from which on its rotation is used instead."""


@dataclass(frozen=True)
class Decomposition:
    """Clusters of triangles and how they move.

    Attributes:
        labels: (T,) int, the cluster of each triangle; every cluster has at least one triangle.
        matrices: (F, C, 3, 3) and
        origins: (F, C, 3) float64: a point q of a cluster's space is at matrices q + origins in frame f.
        residual: (T,) size of the boxes of the triangle's vertices in its cluster's space, summed over axes; the largest of
            three.
    """

    labels: np.ndarray
    matrices: np.ndarray
    origins: np.ndarray
    residual: np.ndarray


def fit_maps(rest: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The affine maps, (F, 3, 3) and (F, 3), that map points closest to their positions in each frame.

    Args:
        rest: (N, 3) points; the maps take 0 to the mean of their images.
        frames: (F, N, 3).
    """
    x = rest - rest.mean(axis=0)
    origins = frames.mean(axis=1)
    y = frames - origins[:, None]
    spread, moved = x.T @ x, np.einsum("fni,nj->fij", y, x)
    u, _, vt = np.linalg.svd(moved)
    flip = np.ones((len(frames), 3))
    flip[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * flip[:, None]) @ vt
    weight = max(ROTATION_WEIGHT * np.trace(spread) / 3, np.finfo(np.float64).tiny)
    maps = np.linalg.solve(spread + weight * np.eye(3), np.swapaxes(moved + weight * rotation, 1, 2)).swapaxes(1, 2)
    sizes = np.linalg.svd(maps, compute_uv=False)
    flat = ~(sizes[:, 2] * MAX_CONDITION > np.maximum(sizes[:, 0], 1.0))
    maps[flat] = rotation[flat]
    return maps, origins


def assign_triangles(frames: np.ndarray, faces: np.ndarray, matrices: np.ndarray, origins: np.ndarray) -> Decomposition:
    """Assigns each triangle to the cluster in which it needs the smallest boxes. Clusters without triangles are removed.

    Args:
        frames: (F, V, 3).
        faces: (T, 3).
        matrices, origins: (F, C, 3, 3), (F, C, 3).
    """
    chosen, residual = nearest_clusters(frames, faces, matrices, origins)
    used = np.flatnonzero(np.bincount(chosen, minlength=matrices.shape[1]))
    return Decomposition(np.searchsorted(used, chosen), matrices[:, used], origins[:, used], residual)


def decompose(frames: np.ndarray, faces: np.ndarray, clusters: int, threshold: float, rest: int) -> Decomposition:
    """Finds clusters and their maps.

    Args:
        frames: (F, V, 3) float64.
        faces: (T, 3).
        clusters: most clusters.
        threshold: residual motion of all triangles below which no cluster is added.
        rest: the frame from which maps start.
    """
    whole = [fit_maps(*_used(frames, faces, rest))]
    found = assign_triangles(frames, faces, *_stacked(whole))
    while True:
        for _ in range(MAX_ROUNDS):
            members = [np.flatnonzero(found.labels == c) for c in range(found.matrices.shape[1])]
            better = assign_triangles(frames, faces, *_stacked([fit_maps(*_used(frames, faces[own], rest)) for own in members]))
            if not is_better(better, found):
                break
            found = better
        count = found.matrices.shape[1]
        if count >= clusters or found.residual.max() <= threshold:
            return found
        seed = np.isin(faces, faces[found.residual.argmax()]).any(axis=1)
        matrices, origins = fit_maps(*_used(frames, faces[seed], rest))
        more = assign_triangles(
            frames,
            faces,
            np.concatenate([found.matrices, matrices[:, None]], axis=1),
            np.concatenate([found.origins, origins[:, None]], axis=1),
        )
        if not is_better(more, found):
            return found
        found = more


def is_better(one: Decomposition, other: Decomposition) -> bool:
    """Whether `one` has clearly less residual motion. Fitting minimises another measure than assigning, so it may have more."""
    return one.residual.sum() < (1.0 - MIN_IMPROVEMENT) * other.residual.sum()


def _used(frames: np.ndarray, faces: np.ndarray, rest: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices of some triangles in the rest pose and in every frame."""
    own = frames[:, np.bincount(faces.ravel(), minlength=frames.shape[1]) > 0]
    return own[rest], own


def _stacked(maps: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """(F, C, 3, 3) and (F, C, 3) from the maps of each cluster."""
    return np.stack([matrices for matrices, _ in maps], axis=1), np.stack([origins for _, origins in maps], axis=1)


def fuzzy_boxes(corners: np.ndarray, matrices: np.ndarray, origins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) float32 boxes in a cluster's space that contain the triangles' boxes of every frame, rounded outwards.

    Args:
        corners: (F, 2, N, 3) lower and upper corners of the triangles' boxes in the scene.
        matrices, origins: (F, 3, 3), (F, 3) of the cluster.
    """
    inverse = np.linalg.inv(matrices)
    middle = np.einsum("fij,fnj->fni", inverse, (corners[:, 0] + corners[:, 1]) / 2 - origins[:, None])
    half = np.einsum("fij,fnj->fni", np.abs(inverse), (corners[:, 1] - corners[:, 0]) / 2)
    low, high = (middle - half).min(axis=0), (middle + half).max(axis=0)
    return (
        np.nextafter(low.astype(np.float32), np.float32(-np.inf)),
        np.nextafter(high.astype(np.float32), np.float32(np.inf)),
    )
