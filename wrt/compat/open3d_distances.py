"""The distance queries of Open3D's `t.geometry.RaycastingScene`, on NumPy arrays and a `wrt.Scene`.

Results are NumPy arrays that also answer to the methods by which programs read Open3D's tensors (`TensorArray`).

The sign, and whether a point is inside, are by the parity of crossings, as in Open3D. Crossings are exact, also at edges and
vertices, so one ray is enough, and `nsamples` is accepted and changes nothing.

Differences: where nothing is found, in an empty scene and for a point with a NaN or an infinity, points are NaN and distances
inf or NaN, where Open3D returns zeros and what the query before has left; float64 points are not rounded to float32.

References: zhou-2018 (the interface).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.kernels.validation import as_int, as_real_array, unreadable

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.scene.scene import Scene


class TensorArray(np.ndarray):
    """A NumPy array with the methods of an Open3D tensor that have no other meaning for arrays: `numpy`, `cpu`, `isfinite`,
    `isinf` and `isnan`. Others are an AttributeError that says how to get a tensor."""

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(
            f"a result of wrt.compat.RaycastingScene is a NumPy array and has no {name!r}; open3d.core.Tensor(result) has all "
            "methods of Open3D's tensors"
        )

    def numpy(self) -> np.ndarray:
        """The same as a plain NumPy array."""
        return self.view(np.ndarray)

    def cpu(self) -> TensorArray:
        """Itself."""
        return self

    def isfinite(self) -> np.ndarray:
        """`numpy.isfinite` of it."""
        return np.isfinite(self)

    def isinf(self) -> np.ndarray:
        """`numpy.isinf` of it."""
        return np.isinf(self)

    def isnan(self) -> np.ndarray:
        """`numpy.isnan` of it."""
        return np.isnan(self)


def tensor_arrays(query: Callable[..., Any]) -> Callable[..., Any]:
    """Decorates a method that returns an array, or a dictionary of such: they become `TensorArray`, with the same memory."""

    @wraps(query)
    def answer(*args: Any, **kwargs: Any) -> Any:
        found = query(*args, **kwargs)
        if isinstance(found, dict):
            return {name: np.asarray(values).view(TensorArray) for name, values in found.items()}
        return np.asarray(found).view(TensorArray)

    return answer


class DistanceQueries:
    """Queries of points.

    Attributes:
        scene: the `wrt.Scene` of the triangles added so far; None if there are none.
    """

    INVALID_ID = 0xFFFFFFFF
    """Geometry and primitive id where nothing was found."""

    if TYPE_CHECKING:

        @property
        def scene(self) -> Scene | None: ...
        def _threads(self, nthreads: int | None) -> Any: ...

    @tensor_arrays
    def compute_closest_points(self, query_points: ArrayLike, nthreads: int | None = 0) -> dict[str, np.ndarray]:
        """The closest points on the surfaces.

        Args:
            query_points: (..., 3) real.
            nthreads: CPU threads; 0 for the scene's number.

        Returns:
            `points` (..., 3) float32, NaN if nothing was found; `geometry_ids` and `primitive_ids` (...) uint32, `INVALID_ID`
            if nothing was found; `primitive_uvs` (..., 2) float32, weights of the triangle's second and third vertex;
            `primitive_normals` (..., 3) float32, unit vectors from the triangle's winding. The last two are 0 if nothing was
            found.

        Raises:
            TypeError: query_points are not an array of real numbers, or nthreads is not an int.
            ValueError: wrong shape, or a negative nthreads.
        """
        points = as_points(query_points)
        shape = points.shape[:-1]
        with self._threads(nthreads):
            if self.scene is None:
                return {
                    "points": np.full((*shape, 3), np.nan, dtype=np.float32),
                    "geometry_ids": np.full(shape, self.INVALID_ID, dtype=np.uint32),
                    "primitive_ids": np.full(shape, self.INVALID_ID, dtype=np.uint32),
                    "primitive_uvs": np.zeros((*shape, 2), dtype=np.float32),
                    "primitive_normals": np.zeros((*shape, 3), dtype=np.float32),
                }
            found = self.scene.closest_point(points)
            return {
                "points": found.position.astype(np.float32, copy=False),
                "geometry_ids": found.geometry_id.view(np.uint32),  # -1 is INVALID_ID
                "primitive_ids": found.primitive_id.view(np.uint32),
                "primitive_uvs": found.uv,
                "primitive_normals": found.normal.astype(np.float32, copy=False),
            }

    @tensor_arrays
    def compute_distance(self, query_points: ArrayLike, nthreads: int | None = 0) -> np.ndarray:
        """Distances to the surfaces: (...) float32; inf in an empty scene, NaN for a point with a NaN or an infinity.

        Errors as in `compute_closest_points`.
        """
        points = as_points(query_points)
        with self._threads(nthreads):
            found = np.float32(np.inf) if self.scene is None else self.scene.closest_point(points).distance
        return np.where(np.isfinite(points).all(axis=-1), found, np.float32(np.nan))

    @tensor_arrays
    def compute_signed_distance(self, query_points: ArrayLike, nthreads: int | None = 0, nsamples: int = 1) -> np.ndarray:
        """Distances to the surfaces, negative inside: (...) float32; as in `compute_distance` where there is none.

        Args:
            query_points, nthreads: as in `compute_closest_points`.
            nsamples: an odd number; one ray is enough here, whatever it is.

        Raises:
            TypeError, ValueError: as `compute_closest_points`, and for an `nsamples` that is even or less than 1.
        """
        from wrt.analysis.signed_distances import signed_distance

        check_samples(nsamples)
        points = as_points(query_points)
        with self._threads(nthreads):
            if self.scene is None:
                return np.where(np.isfinite(points).all(axis=-1), np.float32(np.inf), np.float32(np.nan))
            return signed_distance(self.scene, points, sign="parity")

    @tensor_arrays
    def compute_occupancy(self, query_points: ArrayLike, nthreads: int | None = 0, nsamples: int = 1) -> np.ndarray:
        """Whether points are inside: (...) float32, 1 inside and 0 outside. Arguments and errors as in
        `compute_signed_distance`."""
        check_samples(nsamples)
        points = as_points(query_points)
        with self._threads(nthreads):
            if self.scene is None:
                return np.zeros(points.shape[:-1], dtype=np.float32)
            return self.scene.contains(points).astype(np.float32)


def as_points(query_points: Any) -> np.ndarray:
    """Points (..., 3).

    Raises:
        TypeError, ValueError: as `DistanceQueries.compute_closest_points`.
    """
    points = as_real_array("query_points", as_numpy("query_points", query_points))
    if points.ndim == 0 or points.shape[-1] != 3:
        raise ValueError(f"query_points must have shape (..., 3), not {points.shape}")
    return points if points.dtype in (np.float32, np.float64) else points.astype(np.float64)


def check_samples(nsamples: int) -> None:
    """Refuses numbers of rays that Open3D refuses.

    Raises:
        TypeError, ValueError: as `DistanceQueries.compute_signed_distance`.
    """
    if as_int("nsamples", nsamples, 1) % 2 == 0:
        raise ValueError(f"nsamples must be odd, not {nsamples}; 1 is enough, because crossings are exact")


def as_numpy(name: str, values: Any) -> Any:
    """An Open3D tensor, or any object with a method `numpy`, as a NumPy array; what NumPy converts itself, unchanged.

    Raises:
        TypeError: the method fails.
    """
    if not callable(getattr(values, "numpy", None)) or hasattr(values, "__array__"):
        return values
    try:
        return values.numpy()
    except Exception as error:  # each library has its own
        raise TypeError(unreadable(name, values, error)) from error
