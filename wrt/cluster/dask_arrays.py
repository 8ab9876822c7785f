"""Queries on arrays of Dask and xarray: lazy, chunk by chunk, as a step of a larger computation.

A chunk of rays becomes a chunk of answers (`dask.array.map_blocks`). Its worker reads the scene once from a file, as with an
executor. Dask decides where and when; there is no window, so chunks should hold 10^6 to 10^8 rays.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.engine.rays.rays import Rays
from wrt.kernels.validation import as_float
from wrt.query.batches.block_outputs import ATTRIBUTES
from wrt.query.batches.block_queries import UPWARDS
from wrt.query.batches.block_work import BlockQuery, BlockWork, PickledWork
from wrt.query.batches.shared_files import SharedScene, deliver_scene, dumps, share_scene
from wrt.query.batches.workers import Workers, task_threads
from wrt.query.hits import rounds_positions

if TYPE_CHECKING:
    from pathlib import Path

    from wrt.scene.scene import Scene

FORMS = {
    "t": (np.float32, 0),
    "primitive_id": (np.int32, 0),
    "geometry_id": (np.int32, 0),
    "uv": (np.float32, 2),
    "is_hit": (np.bool_, 0),
    "position": (None, 3),
    "normal": (None, 3),
    "occluded": (np.bool_, 0),
    "count": (np.int32, 0),
}
"""Type and components of answers; None: that of the rays, as in `wrt.Hits`."""

POINT_FORMS = {
    "distance": (np.float32, 0),
    "feature": (np.int8, 0),
    "instance_id": (np.int32, 0),
    **{name: FORMS[name] for name in ("primitive_id", "geometry_id", "uv", "is_hit", "position", "normal")},
}
"""The same of closest points."""

POINT_OPTIONS = ("mask", "environment", "precise")
"""Options of `map_points`."""


def map_rays(
    scene: Scene,
    origins: Any,
    directions: Any,
    what: str = "t",
    *,
    t_min: float = 0.0,
    t_max: float = float("inf"),
    folder: str | Path | None = None,
    client: Any = None,
    **options: Any,
) -> Any:
    """A query on arrays of Dask or xarray: lazy, with the chunks of the rays.

        t = wrt.cluster.map_rays(scene, origins, directions, "t")          # dask.array, (N,) float32
        shaded = wrt.cluster.map_rays(scene, origins, [0, 0, 1], "occluded").mean(axis=0).compute()

    Args:
        scene: the scene.
        origins, directions: (..., 3), of which at least one is an array of Dask, or an xarray.DataArray over one, with the
            components as its last axis; leading shapes broadcast.
        what: "occluded", "count", or an attribute of hits: "t", "primitive_id", "geometry_id", "uv", "is_hit", "position",
            "normal".
        t_min, t_max: numbers, as in `wrt.Scene.intersect`.
        folder: a folder for the scene's file that all workers see; None for a temporary one of this machine.
        client: the Dask client; None for the current one, or for Dask's threads if there is none.
        options: of the query: `traversal`, `triangle_test`, `mask` (a number).

    Returns:
        An array of Dask, (...) or (..., C) for C components; an xarray.DataArray with the dimensions of the rays if one was
        passed.

    Raises:
        ImportError: Dask is not installed.
        TypeError: neither argument is an array of Dask.
        ValueError: an unknown answer, a last axis that is not of 3 components, or shapes that do not broadcast.
    """
    da = dask_arrays("map_rays")
    if what not in FORMS:
        raise ValueError(f"what is {what!r}; choose from {', '.join(FORMS)}")
    labelled = next((one for one in (origins, directions) if hasattr(one, "dims") and hasattr(one, "data")), None)
    arrays = [getattr(one, "data", one) if hasattr(one, "dims") else one for one in (origins, directions)]
    if not any(isinstance(one, da.Array) for one in arrays):
        kinds = f"{type(origins).__name__} and {type(directions).__name__}"
        raise TypeError(f"origins or directions must be an array of Dask, not {kinds}; for others call scene.intersect_blocks")
    arrays = [one if isinstance(one, da.Array) else da.from_array(np.asarray(one), chunks=-1) for one in arrays]
    if any(one.shape[-1:] != (3,) for one in arrays):
        raise ValueError(f"origins and directions must have shape (..., 3), not {arrays[0].shape} and {arrays[1].shape}")
    arrays = [one.rechunk({one.ndim - 1: 3}) for one in arrays]
    both = da.broadcast_arrays(*arrays)
    dtype, components = FORMS[what]
    if dtype is None:
        far = what == "position" and rounds_positions(scene.state.device_mesh)
        is_wide = far or any(one.dtype.itemsize > 4 for one in arrays)
        dtype = np.float64 if is_wide else np.float32
    method = what if what in ("occluded", "count") else "intersect"
    assert method != "intersect" or what in ATTRIBUTES
    function = MapChunk(shared_query(scene, method, folder, client, options), t_min, t_max, what)
    result = mapped(da, function, both, dtype, components)
    return result if labelled is None else as_labelled(result, labelled, what, components)


def map_points(
    scene: Scene,
    points: Any,
    what: str = "distance",
    *,
    max_distance: float = float("inf"),
    folder: str | Path | None = None,
    client: Any = None,
    **options: Any,
) -> Any:
    """Closest points to those in an array of Dask or xarray: lazy, with its chunks.

        distance = wrt.cluster.map_points(scene, points)  # dask.array, (N,) float32

    Args:
        scene: the scene.
        points: (..., 3), an array of Dask, or an xarray.DataArray over one, with the components as its last axis.
        what: an attribute of `wrt.results.ClosestPoints`: "distance", "feature", "instance_id", "primitive_id", "geometry_id",
            "uv", "is_hit", "position" or "normal".
        max_distance: a number, as in `wrt.Scene.closest_point`.
        folder, client: as in `map_rays`.
        options: `mask` and `environment` (numbers), and `precise`.

    Returns:
        As `map_rays`.

    Raises:
        ImportError: Dask is not installed.
        TypeError: points are not an array of Dask, max_distance is no number, or an option that there is not.
        ValueError: an unknown answer, a max_distance that is a NaN, or a last axis that is not of 3 components.
    """
    da = dask_arrays("map_points")
    if what not in POINT_FORMS:
        raise ValueError(f"what is {what!r}; choose from {', '.join(POINT_FORMS)}")
    if unknown := options.keys() - POINT_OPTIONS:
        raise TypeError(f"{min(unknown)} is not an option of map_points; choose from {', '.join(POINT_OPTIONS)}")
    max_distance = as_float("max_distance", max_distance)
    labelled = points if hasattr(points, "dims") and hasattr(points, "data") else None
    array = points if labelled is None else points.data
    if not isinstance(array, da.Array):
        kind = type(points).__name__
        raise TypeError(f"points must be an array of Dask, not {kind}; for others call scene.closest_point_blocks")
    if array.shape[-1:] != (3,):
        raise ValueError(f"points must have shape (..., 3), not {array.shape}")
    dtype, components = POINT_FORMS[what]
    if dtype is None:
        far = what == "position" and rounds_positions(scene.state.device_mesh)
        dtype = np.float64 if far or array.dtype.kind != "f" or array.dtype.itemsize > 4 else np.float32
    if options.get("precise") and dtype is np.float32:
        dtype = np.float64
    function = MapChunk(shared_query(scene, "closest_point", folder, client, options), 0.0, max_distance, what)
    result = mapped(da, function, [array.rechunk({array.ndim - 1: 3})], dtype, components)
    return result if labelled is None else as_labelled(result, labelled, what, components)


def dask_arrays(name: str) -> Any:
    """`dask.array`, for a function.

    Raises:
        ImportError: Dask is not installed.
    """
    try:
        import dask.array as da
    except ImportError as error:
        raise ImportError(f"{name} needs Dask: pip install 'wrt[cluster-dask]'") from error
    return da


def mapped(da: Any, function: MapChunk, arrays: list[Any], dtype: Any, components: int) -> Any:
    """The answers to arrays of the same chunks, whose last axis has 3 components."""
    axis, names = arrays[0].ndim - 1, str([function.t_min, function.t_max, *(one.name for one in arrays)])
    return da.map_blocks(
        function,
        *arrays,
        dtype=dtype,
        drop_axis=None if components else axis,
        chunks=(*arrays[0].chunks[:-1], (components,)) if components else None,
        meta=np.empty((0,) * (axis + bool(components)), dtype=dtype),
        name=f"wrt-{function.what}-{hashlib.sha256(function.work.hash.encode() + names.encode()).hexdigest()}",
    )


def shared_query(scene: Any, method: str, folder: Any, client: Any, options: dict[str, Any]) -> PickledWork:
    """The query for workers."""
    shared = share_scene(scene, folder)
    send_to(client, shared, folder)
    work = BlockWork(shared, BlockQuery(method, options, None), None, {}, 1)
    data = dumps(work)
    return PickledWork(data, None, hashlib.sha256(data).hexdigest())


def send_to(client: Any, shared: SharedScene, folder: Any) -> None:
    """Sends the scene's file to the workers of a client, or of the current one, that do not see it."""
    if client is None:
        try:
            from distributed import get_client

            client = get_client()
        except (ImportError, ValueError):  # no cluster: Dask's own threads or processes, on this machine
            return
    deliver_scene(Workers(client.get_executor(), folder), shared)


class MapChunk:
    """Answers a chunk of rays.

    Args:
        work: the query, for workers.
        t_min, t_max: the interval.
        what: as in `map_rays` or `map_points`.
    """

    def __init__(self, work: PickledWork, t_min: float, t_max: float, what: str) -> None:
        self.work, self.t_min, self.t_max, self.what = work, t_min, t_max, what

    def __call__(self, origins: np.ndarray, directions: np.ndarray = UPWARDS) -> np.ndarray:
        work = self.work.get()
        with task_threads(work.threads):
            rays = Rays(origins, directions, self.t_min, self.t_max)
            found = work.query.answer(work.scene.get(work.device), rays, {})
        return np.asarray(getattr(found, self.what)) if work.query.gives_hits else found


def as_labelled(result: Any, labelled: Any, what: str, components: int) -> Any:
    """An xarray.DataArray with the dimensions and coordinates of the rays."""
    import xarray

    dims = list(labelled.dims[:-1])
    if len(dims) != result.ndim - bool(components):
        raise ValueError(f"the labelled rays have dimensions {tuple(labelled.dims)}, which do not cover {result.ndim} axes")
    coords = {name: one for name, one in labelled.coords.items() if set(one.dims) <= set(dims)}
    return xarray.DataArray(result, dims=[*dims, "component"] if components else dims, coords=coords, name=what)
