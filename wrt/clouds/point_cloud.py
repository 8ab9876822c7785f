"""Point clouds as what rays meet."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.clouds.cloud_state import CloudState, build_cloud, place_cloud
from wrt.engine.facts.query_kinds import ALL, ANY, AUTO, CLOSEST, COUNT, QUERIES, Query
from wrt.engine.facts.scene_settings import as_settings
from wrt.engine.rays.rays import Rays, as_rays
from wrt.kernels.validation import as_bool, as_numbers
from wrt.query.answers import closest_hits, ray_values
from wrt.query.query_options import lists_options
from wrt.scene.updates import as_policy
from wrt.tapes import refuse_tape

if TYPE_CHECKING:
    import trimesh

    from wrt.array_types import ArrayLike, Numbers
    from wrt.query.all_hits import AllHits
    from wrt.query.hits import Hits
    from wrt.scene.updates import UpdatePolicy, UpdateReport

INF = float("inf")

MIN_RADIUS = 2.0**-126
"""Smallest normal float32."""


MISSING = {
    ("closest_point", "closest_points", "distance", "within"): (
        "distances to points need no tree of surfaces; scipy.spatial.cKDTree(points).query finds the nearest centres"
    ),
    ("signed_distance", "contains", "winding_number", "occupancy", "crossings"): (
        "spheres and discs enclose nothing; make a wrt.Scene of triangles"
    ),
    ("save", "load"): "pickle it, or write its table with wrt.sensors.write_points and read it with wrt.sensors.read_points",
    ("filtered",): "leave points out: wrt.sensors.PointCloud(points[keep], radius)",
    ("handle",): "kernels trace rays through triangles; make a wrt.Scene of triangles",
}
"""Why there are no methods of such names."""


class PointCloud:
    """Points with a radius, in a tree, that rays meet: spheres, discs across their normals, or boxes along the axes.

        map = wrt.sensors.PointCloud(points, radius=0.05)
        hits = map.intersect(origins, directions)       # hits.primitive_id: which point
        scan = wrt.sensors.Lidar.preset("ouster_os1_64").scan(map, pose)

    Every query answers as brute force over all points would: the decision about a point is made in float64, of positions in
    float32 relative to the cloud's centre. So coordinates may be large (UTM), and points are moved by at most 3e-8 of the
    cloud's longest side. Spheres and discs are no closed surface: rays pass between points whose radius is too small.

    A ray meets a sphere where it enters it; a ray that starts in one, or whose range does, meets its far side. Both sides of a
    disc are met; one that is seen exactly edge-on is not. A box is met as a sphere is. Of hits at the same t, the one with the
    smallest number is returned.

    **Results** are those of `wrt.Scene`, with these differences: `primitive_id` numbers the points, `geometry_id` and
    `instance_id` are 0, -1 for a miss. `normal` points outward from a sphere or a box, whatever side is met, and is that of a
    disc as given. `position` and `normal` have the precision of float32. `uv` says where on its point a ray has met it
    (`wrt.kernels.clouds`). `Hits.spawn` and `faces` work as on triangles, `smooth_normal`, `interpolate` and `uv_at` do not. Of
    `plan`, `triangle_test` is "spheres", "discs" or "boxes".

    Args:
        points: (N, 3) real numbers, at least one point, all finite; or a table, a structured array with the fields x, y and z,
            such as `wrt.sensors.read_points` gives; or a trimesh.PointCloud.
        radius: of the points, a number or (N,), positive, in units of length. Half the distance between neighbours times 1.5
            closes a surface that was sampled evenly.
            Of boxes half their edges, a number, (N,) for cubes, or (N, 3).
        normals: (N, 3), of any length but zero: points are discs across these. None: they are spheres.
        boxes: whether points are boxes along the axes, such as the voxels of a map.
        device: a Warp device or its name; None for Warp's default device.
        num_threads: threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`.

    Attributes:
        state: what queries read. For code inside wrt; names of its members may change between releases.
        meshes, instances: empty.

    Raises:
        TypeError: not real numbers.
        ValueError: wrong shapes, no point, NaN or infinite values, a radius that is not positive, a normal that is zero, points
            that spread over more than 6.9e10, or an unknown device.
        MemoryError: there is too little memory for the tree.
    """

    state: CloudState
    meshes: tuple[()] = ()
    instances: tuple[()] = ()

    def __init__(
        self,
        points: ArrayLike | trimesh.PointCloud,
        radius: Numbers,
        normals: ArrayLike | None = None,
        *,
        boxes: bool = False,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        settings = as_settings(Bvh(), AUTO, device, num_threads)
        given = _as_points(points)
        radii = _as_radii(radius, len(given), as_bool("boxes", boxes))
        if boxes and normals is not None:
            raise ValueError("boxes lie along the axes and have no normals; leave out one of boxes and normals")
        self.state = build_cloud(given, radii, None if normals is None else _as_normals(normals, len(given)), settings)

    def __len__(self) -> int:
        """Number of points."""
        return self.state.triangle_count

    def __repr__(self) -> str:
        return f"PointCloud({self.state.contents()}, device={str(self.device)!r})"

    def __copy__(self) -> PointCloud:
        """Another cloud with the same state."""
        return cloud_of_state(self.state)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold the points; the tree is built again, and answers have the same bits."""
        return unpickle_cloud, (self.state.arrays(), str(self.device), self.num_threads, self.state.mark)

    @property
    def device(self) -> wp.Device:
        """The device that holds the points."""
        return self.state.device

    @property
    def num_threads(self) -> int | None:
        """Threads on the CPU; None for `wrt.get_num_threads()`."""
        return self.state.num_threads

    @property
    def center(self) -> np.ndarray:
        """(3,) float64; the device holds points in float32, relative to this one."""
        return self.state.center

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the box of all spheres or discs."""
        return self.state.bounds

    @property
    def bytes(self) -> int:
        """Memory of points and tree."""
        return self.state.bytes

    @property
    def last_update(self) -> UpdateReport | None:
        """What the last `update` did to the tree; None before the first."""
        return self.state.last_update

    def update(
        self,
        points: ArrayLike | trimesh.PointCloud | None = None,
        radius: Numbers | None = None,
        normals: ArrayLike | None = None,
        *,
        rebuild: str | UpdatePolicy = "auto",
    ) -> None:
        """Moves the points, or changes their radius or normals; what is None stays as it is.

        Nodes are kept and their boxes fitted anew, or rebuilt, as by `wrt.Scene.update`; answers are those of a new cloud.
        Hits that were found before keep the points as they were. Another number of points builds a new tree.

        Args:
            points: (N, 3) as in the class, of any number if `radius` is one number and there are no normals, or new ones.
            radius: a number or (N,), of boxes also (N, 3).
            normals: (N, 3); makes discs of spheres.
            rebuild: "auto": what has become too costly for rays is rebuilt; "always"; "never"; or a `wrt.moving.UpdatePolicy`.

        Raises:
            TypeError, ValueError: as the class; nothing has changed then.
        """
        state, policy = self.state, as_policy(rebuild)
        relative, center, own_radius, own_normals = state.arrays()
        moved = relative.astype(np.float64) + center if points is None else _as_points(points)
        is_box = own_radius.ndim == 2
        radii = _as_radii(own_radius if radius is None else radius, len(moved), is_box)
        if is_box and normals is not None:
            raise ValueError("boxes lie along the axes and have no normals; make another PointCloud")
        if normals is not None or own_normals is not None:
            own_normals = _as_normals(own_normals if normals is None else normals, len(moved))
        same = len(moved) == len(relative)
        move = partial(state.built_tree.moved, policy=policy) if same else None
        made = build_cloud(moved, radii, own_normals, state.settings, move)
        self.state = replace(made, mark=state.mark)

    if not TYPE_CHECKING:  # type checkers refuse names that are not there

        def __getattr__(self, name: str) -> Any:
            """Says of what scenes of triangles alone have why it is missing.

            Raises:
                AttributeError: always.
            """
            reason = next((reason for names, reason in MISSING.items() if name in names), None)
            raise AttributeError(f"a PointCloud has no {name!r}" + (f": {reason}" if reason else ""))

    @lists_options
    def intersect(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str = AUTO,
        brute_force: bool = False,
    ) -> Hits:
        """Closest hits.

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first four arguments.
            directions: (..., 3), of any length from 2^-126 up; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; hits count if t_min <= t <= t_max (closed interval). 0 <= t_min < inf.
            traversal: "auto", or a key of `wrt.kernels.traversal.TRAVERSALS` that traces rays through points: "single",
                "stream", "interleaved" or "brute", whose answers are the same to the bit. Others are refused.
            brute_force: the same as traversal="brute": every point is tested, which takes as long as it sounds.

        Returns:
            A `wrt.Hits`; the class says what differs.

        Raises:
            TypeError, ValueError: as `wrt.Scene.intersect`.
        """
        query = _as_query(CLOSEST, traversal, brute_force)
        return closest_hits(self.state, self._rays("intersect", origins, directions, t_min, t_max), query)

    @lists_options
    def occluded(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str = AUTO,
        brute_force: bool = False,
    ) -> Any:
        """Whether each ray hits anything: (...) bool, a NumPy array if the rays were, else a Warp array.

        Args:
            origins, directions, t_min, t_max, traversal, brute_force: as in `intersect`.

        Raises:
            TypeError, ValueError: as `intersect`.
        """
        rays = self._rays("occluded", origins, directions, t_min, t_max)
        return ray_values(self.state, rays, _as_query(ANY, traversal, brute_force))

    @lists_options
    def count(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str = AUTO,
        brute_force: bool = False,
    ) -> Any:
        """How many points each ray meets: (...) int32, a NumPy array if the rays were, else a Warp array.

        A sphere counts once, though a line through it enters and leaves it.

        Args:
            origins, directions, t_min, t_max, traversal, brute_force: as in `intersect`.

        Raises:
            TypeError, ValueError: as `intersect`.
        """
        rays = self._rays("count", origins, directions, t_min, t_max)
        return ray_values(self.state, rays, _as_query(COUNT, traversal, brute_force))

    @lists_options
    def intersect_all(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        max_hits: int | None = None,
        traversal: str = AUTO,
        brute_force: bool = False,
    ) -> AllHits:
        """All points that each ray meets, each once, where the ray meets it first; sorted by t, then number.

        Args:
            origins, directions, t_min, t_max, traversal, brute_force: as in `intersect`.
            max_hits: largest number of hits kept for each ray, the nearest ones; at least 1, or None for all.

        Raises:
            TypeError, ValueError: as `wrt.Scene.intersect_all`, and as `intersect`.
        """
        from wrt.query.all_hits import list_hits

        rays = self._rays("intersect_all", origins, directions, t_min, t_max)
        return list_hits(self.state, rays, _as_query(ALL, traversal, brute_force)._replace(max_hits=max_hits))

    @staticmethod
    def _rays(query: str, *given: Any) -> Rays:
        """The rays of a query."""
        rays = as_rays(*given)
        refuse_tape(query, (rays.origins, rays.directions))
        return rays


def cloud_of_state(state: CloudState) -> PointCloud:
    """A cloud with the state of another."""
    cloud = object.__new__(PointCloud)
    cloud.state = state
    return cloud


def unpickle_cloud(arrays: tuple[Any, Any, Any, Any], device: str, num_threads: int | None, mark: str) -> PointCloud:
    """The cloud of a pickle, on its device."""
    return cloud_of_state(replace(place_cloud(*arrays, as_settings(Bvh(), AUTO, device, num_threads)), mark=mark))


def _as_query(kind: str, traversal: Any, brute_force: bool) -> Query:
    """A query of a kind by a traversal of `TRAVERSALS`, or by "auto"."""
    if not isinstance(traversal, str):
        raise TypeError(
            f"traversal must be a name, not {type(traversal).__name__}; choose from auto, single, stream, interleaved"
        )
    if as_bool("brute_force", brute_force):
        if traversal not in (AUTO, "brute"):
            raise ValueError(f"traversal {traversal!r} is no brute force; leave out one of traversal and brute_force")
        traversal = "brute"
    return QUERIES[kind] if traversal == AUTO else Query(kind, traversal)


def _as_points(points: Any) -> np.ndarray:
    """(N, 3) float64, finite."""
    names = getattr(getattr(points, "dtype", None), "names", None) or ()
    if names:
        if not {"x", "y", "z"} <= set(names):
            raise ValueError(f"points is a table without x, y and z; its fields are {', '.join(names)}")
        points = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    elif type(points).__module__.startswith("trimesh.") and type(points).__name__ == "PointCloud":
        points = points.vertices
    elif hasattr(points, "vertices"):
        raise TypeError(
            f"points must be an array of (N, 3), not {type(points).__name__}; pass its vertices, or points sampled on it"
        )
    array = as_numbers("points", points, (None, 3), finite=False)
    if len(array) == 0:
        raise ValueError("points is empty; a cloud has at least one point")
    good = np.isfinite(array).all(axis=1)
    if not good.all():
        raise ValueError(
            f"points has {np.count_nonzero(~good)} points that are not finite, the first of them number {np.argmin(good)}; "
            "leave them out: points[np.isfinite(points).all(axis=1)]"
        )
    return array


def _as_radii(radius: Any, count: int, is_box: bool) -> np.ndarray:
    """(1,) or (N,) float32, positive; (N, 3) of boxes."""
    array = np.atleast_1d(as_numbers("radius", radius, finite=False))
    if is_box and array.shape in ((1,), (count,)):
        array = np.broadcast_to(array[:, None], (count, 3))
    if array.shape not in (((count, 3),) if is_box else ((1,), (count,))):
        raise ValueError(f"radius has the shape {array.shape}; pass one number, or one for each of {count} points")
    good = (array >= MIN_RADIUS) & (array < INF)
    if not good.all():
        first = int(np.argmin(good.reshape(len(array), -1).all(axis=1)))
        raise ValueError(
            f"radius must be positive and finite, but that of point {first} is {array[first]}; points without extent are not "
            "met by rays: give half the distance between neighbours"
        )
    return array.astype(np.float32)


def _as_normals(normals: Any, count: int) -> np.ndarray:
    """(N, 3) float64 unit vectors."""
    array = as_numbers("normals", normals, (count, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        array /= np.abs(array).max(axis=1, keepdims=True)
        array /= np.linalg.norm(array, axis=1, keepdims=True)
    good = np.isfinite(array).all(axis=1)
    if not good.all():
        raise ValueError(
            f"normals has {np.count_nonzero(~good)} zero vectors, the first of them number {np.argmin(good)}; leave these "
            "points out, or leave normals out for spheres"
        )
    return array
