"""Closest points on a scene: from the caller's points to the kernels of `wrt.kernels.points`, and what they answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.memory import empty
from wrt.engine.plan.plan import stack_levels
from wrt.engine.rays.device_rays import number_on
from wrt.engine.rays.ray_integers import ENVIRONMENTS, MASKS
from wrt.engine.rays.rays import MAX_RAYS, ResultForm, as_vectors
from wrt.instances.instance_tables import vertex_parts
from wrt.kernels.layout.binary_nodes import WIDTH
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.points.point_batch import NearestBatch, NearLists, PointBatch, make_widen
from wrt.kernels.points.tree_points import GROUP, PointConfig, as_lists, as_space, make_points_kernel
from wrt.kernels.runtime.launch import launch, refuse_capture, specialise, use_threads
from wrt.kernels.traversal.leaf import CounterRows, Counters
from wrt.kernels.validation import as_bool, as_int, as_real_array
from wrt.query.points.closest_points import ClosestPoints
from wrt.query.points.few_points import FewPoints, may_be_few
from wrt.query.points.kept_search import KeptSearch, may_be_kept
from wrt.query.points.similar_instances import check_maps
from wrt.tapes import refuse_tape

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

MIN_SORTED = 1024
"""Fewest points that are sorted."""


MAX_NEAREST = 1024
"""Most triangles of one point: lists are sorted by insertion."""


@dataclass(frozen=True)
class Points:
    """The points of a query.

    Attributes:
        batch: on the device.
        shape: their leading shape.
        form: of results.
        flat: (N,) vec3 or vec3d, as they were given.
    """

    batch: PointBatch
    shape: tuple[int, ...]
    form: ResultForm
    flat: wp.array


def closest_point(
    scene: SceneState,
    points: Any,
    max_distance: Any = float("inf"),
    k: int | None = None,
    mask: Any = None,
    environment: Any = None,
    counters: bool = False,
    in_order: bool = False,
) -> ClosestPoints:
    """The closest point on the scene of each point; see `wrt.Scene.closest_point`.

    in_order: whether points that follow each other are near each other.
    """
    check_query(scene, points, in_graph=True)
    k = as_room(k)
    if as_bool("counters", counters) and k is not None:
        raise ValueError("counters are those of the search for one triangle; leave k out")
    is_plain = k is None and mask is None and environment is None and not counters and not in_order
    with use_threads(scene.num_threads):
        if is_plain and may_be_few(scene, points, max_distance, MIN_SORTED):
            return of_few(scene, points, max_distance)
        if is_plain and has_packed_nodes(scene) and not isinstance(points, np.ndarray):
            points = as_vectors(points, "points", scene.device)
            if may_be_kept(scene, points, max_distance, MIN_SORTED):
                return of_kept(scene, points, max_distance)
        given = as_points(scene, points, max_distance, "max_distance", mask, environment, in_order)
        if k is not None:
            hits, feature, form = find_some(scene, given, k)
            return ClosestPoints(hits, feature, form, scene)
        work = wp.zeros(given.batch.count, dtype=Counters, device=scene.device) if counters else None
        hits, feature = find_nearest(scene, given.batch, work)
    return ClosestPoints(hits, feature, given.form, scene, work)


def of_few(scene: SceneState, points: np.ndarray, max_distance: float) -> ClosestPoints:
    """The closest point of each of few points, by a kept launch (`may_be_few`)."""
    try:
        launch = scene.cache.few_points.pop()
    except IndexError:
        config = point_config(scene, "nearest")
        launch = FewPoints(scene, config, space_of(scene, config))
    hits, feature = launch.find(scene, points, max_distance)
    scene.cache.few_points.append(launch)
    return ClosestPoints(hits, feature, ResultForm(points.shape[:-1], False, points.dtype.type), scene)


def of_kept(scene: SceneState, points: wp.array, max_distance: float) -> ClosestPoints:
    """The closest point of each point in a Warp array, by kept launches (`may_be_kept`)."""
    dtype, waiting = points.dtype, scene.cache.point_searches
    search = waiting.take(dtype) or KeptSearch(scene, dtype)
    hits, feature = search.find(points, max_distance)
    waiting.give_back(search, dtype)
    form = ResultForm(points.shape, True, np.float64 if dtype is wp.vec3d else np.float32)
    return ClosestPoints(hits, feature, form, scene)


def find_nearest(scene: SceneState, points: PointBatch, work: wp.array | None = None) -> tuple[DeviceHits, wp.array]:
    """What is nearest to points, with distances as t, and the features.

    Args:
        scene: triangles in one tree, or instances of such; lazy trees are completed.
        points: on the device.
        work: (N,) `Counters` to be filled; None if nothing is counted.
    """
    hits, feature = DeviceHits.new(CLOSEST, points.count, scene.device), empty(points.count, wp.int8, scene.device)
    if work is None and has_packed_nodes(scene) and not scene.instances:
        search_packed(scene, points, nearest_batch(hits, feature))
        return hits, feature
    task = "counted" if work is not None else "nearest"
    search(scene, points, as_lists(nearest_batch(hits, feature)), task, work)
    return hits, feature


def has_packed_nodes(scene: SceneState) -> bool:
    """Whether points are searched in the nodes that persistent threads walk: those of BVHs of width 2 on CUDA."""
    return scene.device.is_cuda and scene.accelerator.kind != "kdtree" and scene.width == WIDTH


def search_packed(scene: SceneState, points: PointBatch, found: NearestBatch) -> None:
    """Finds what is nearest to points in one tree, by persistent threads."""
    from wrt.engine.launch.persistent_launch import binary_tree, next_ray
    from wrt.kernels.points.packed_points import BLOCKS, make_packed_points_kernel

    scene.require_opaque("a query of points")
    kernel = specialise(make_packed_points_kernel, stack_levels(scene.tree.depth))
    counter = next_ray(scene.device, points.count, blocks=BLOCKS)
    items = counter.threads if scene.device.is_cuda else points.count
    launch(kernel, items, [*binary_tree(scene), points, found, counter], device=scene.device, chunk=256, longest=4096)


def as_room(k: Any) -> int | None:
    """The number of triangles of each point; None for one without an axis for it.

    Raises:
        TypeError: not an int.
        ValueError: out of range.
    """
    k = None if k is None else as_int("k", k)
    if k is not None and not 1 <= k <= MAX_NEAREST:
        raise ValueError(
            f"k is {k}; it must be from 1 to {MAX_NEAREST}, or None for the nearest triangle without an axis for it"
        )
    return k


def rows_of(points: Points, k: int) -> tuple[int, ResultForm]:
    """The number of triangles of all points, and the form of results in rows of k.

    Raises:
        ValueError: more triangles than one result holds.
    """
    count = points.batch.count * k
    if count > MAX_RAYS:
        raise ValueError(
            f"{points.batch.count:,} points times k={k} are more than the {MAX_RAYS:,} of one call; pass parts of them"
        )
    return count, points.form._replace(shape=(*points.shape, k))


def find_some(scene: SceneState, points: Points, k: int) -> tuple[DeviceHits, wp.array, ResultForm]:
    """The k nearest triangles to each point, in rows, the features, and the form of results; errors as `rows_of`."""
    count, form = rows_of(points, k)
    hits, feature, lists = DeviceHits.new(CLOSEST, count, scene.device), empty(count, wp.int8, scene.device), NearLists()
    lists.found, lists.room = nearest_batch(hits, feature), k
    search(scene, points.batch, lists, "some")
    return hits, feature, form


def check_query(scene: SceneState, points: Any, query: str = "closest_point", in_graph: bool = False) -> None:
    """Refuses what no query of points can answer: in a tape, of a scene that `check_scene` refuses, or in a capture.

    in_graph: whether it can be captured, of points in a Warp array on the scene's device.

    Raises:
        RuntimeError: in a capture.
        TypeError, ValueError: as `refuse_tape` and `check_scene`.
    """
    if not (in_graph and scene.device.is_capturing and scene.lazy_tree is None):
        refuse_capture(query, scene.device)
    elif not isinstance(as_vectors(points, "points", scene.device), wp.array):
        refuse_capture(f"{query} of points that are not in a Warp array on {scene.device}", scene.device)
    refuse_tape(query, (points,), "differentiable_points")
    check_scene(scene, query)


def check_scene(scene: SceneState, query: str = "closest_point") -> None:
    """Refuses scenes that are not triangles in trees, and instances that are not similar to their meshes.

    Raises:
        ValueError: such a scene; the message says which one to make.
    """
    if isinstance(getattr(scene, "mesh_states", None), tuple) and scene.instances:
        check_maps(scene, query)
    elif not scene.is_plain:
        raise ValueError(f"{query} needs triangles in a single tree; use wrt.Scene(scene.meshes)")


def as_distances(values: Any, shape: tuple[int, ...], name: str = "max_distance", dtype: Any = np.float32) -> np.ndarray:
    """(N,) or (1,) greatest distances of points of a leading shape, float32 or float64.

    Raises:
        TypeError: not real numbers.
        ValueError: a negative number or a NaN, or a shape that does not broadcast.
    """
    values = values.numpy() if isinstance(values, wp.array) else values
    array = as_real_array(name, values)
    if not (array >= 0.0).all():
        wrong = array[~(array >= 0.0)].flat[0]
        raise ValueError(f"{name} must be 0 or more, or inf for no limit, not {wrong}")
    with np.errstate(over="ignore"):  # beyond float32 is no limit
        array = np.asarray(array).astype(dtype)
    if array.size == 1:
        return array.reshape(1)
    try:
        return np.ascontiguousarray(np.broadcast_to(array, shape)).reshape(-1)
    except ValueError:
        raise ValueError(f"{name} {array.shape} does not broadcast to the points' leading shape {shape}") from None


def limits_on(device: wp.Device, values: Any, shape: tuple[int, ...], name: str) -> wp.array:
    """(N,) or (1,) float32 on the device: as `as_distances`, which errors are those of.

    Raises:
        RuntimeError: more than a number while a graph is captured.
    """
    if device.is_capturing and np.ndim(values):
        raise RuntimeError(f"{name} must be a number while a graph is captured; make such a query before or after the capture")
    if type(values) is float and values >= 0.0:
        return number_on(device, values)
    limits = as_distances(values, shape, name)
    return number_on(device, float(limits[0])) if limits.size == 1 else wp.array(limits, dtype=float, device=device)


def as_points(
    scene: SceneState,
    points: Any,
    max_distance: Any,
    name: str = "max_distance",
    mask: Any = None,
    environment: Any = None,
    in_order: bool = False,
) -> Points:
    """Points of a caller on the scene's device, in the order in which they are searched.

    Args:
        scene: what they are searched in.
        points: (..., 3).
        max_distance: greatest distances, as in `as_distances`.
        name: of these, for messages.
        mask, environment: of the instances that points see, as in `wrt.Scene.intersect`.
        in_order: as in `closest_point`.

    Raises:
        TypeError, ValueError: as `wrt.Scene.closest_point`.
    """
    from wrt.kernels.points.point_order import morton_order

    given, device = as_vectors(points, "points", scene.device), scene.device
    is_warp, is_wide = isinstance(given, wp.array), given.dtype in (wp.vec3d, np.dtype(np.float64))
    shape = given.shape if is_warp else given.shape[:-1]
    count = math.prod(shape)
    if count > MAX_RAYS:
        raise ValueError(f"{count:,} points are more than the {MAX_RAYS:,} of one call; pass parts of them")
    limits = limits_on(device, max_distance, shape, name)
    flat, batch = flat_points(scene, given, is_wide), PointBatch()
    batch.count, batch.position = count, relative_points(scene, flat)
    batch.max_distance, batch.distance_stride = limits, int(limits.size > 1)
    if count >= MIN_SORTED and not (in_order or (device.is_cpu and device.is_capturing)):  # the CPU sorts without kernels
        batch.order = morton_order(batch.position, scene.device_mesh.low, scene.device_mesh.high)
    if scene.instances:
        batch.exact, center = empty(count, wp.vec3d, device), wp.vec3d(*map(float, scene.center))
        launch(specialise(make_widen, flat.dtype), count, [center, flat, batch.exact], device=device, chunk=4096)
    found = Points(batch, shape, ResultForm(shape, is_warp, np.float64 if is_wide else np.float32), flat)
    for integers, values in ((MASKS, mask), (ENVIRONMENTS, environment)):
        if values is None:
            continue
        if not scene.instances:
            key = integers.name
            raise ValueError(f"{key} needs instances, and this scene has none; make it from wrt.Instance(mesh, {key}=...)")
        integers.set(found, values, device)  # type: ignore[arg-type]
    return found


def flat_points(scene: SceneState, points: np.ndarray | wp.array, is_wide: bool) -> wp.array:
    """(N,) vec3 or vec3d on the device: the points as they are given."""
    if isinstance(points, wp.array):
        return points.flatten()
    dtype = wp.vec3d if is_wide else wp.vec3
    return wp.array(np.ascontiguousarray(points).reshape(-1, 3), dtype=dtype, device=scene.device, copy=False)


def relative_points(scene: SceneState, points: wp.array) -> wp.array:
    """(N,) vec3: points relative to the scene's centre, subtracted in float64."""
    relative, center = empty(len(points), wp.vec3, scene.device), wp.vec3d(*map(float, scene.center))
    launch(specialise(make_shift, points.dtype), len(points), [center, points, relative], device=scene.device, chunk=4096)
    return relative


def search(scene: SceneState, points: PointBatch, lists: NearLists, task: str, work: wp.array | None = None) -> None:
    """Runs a task of `wrt.kernels.points.tree_points.TASKS`; lazy trees are completed.

    Args:
        scene: what is searched, which `check_scene` has seen.
        points: on its device.
        lists: is filled.
        task: which of its arrays.
        work: (N,) `Counters`, for those that count.
    """
    from wrt.engine.launch.traversal_launch import no_work

    config, rows = point_config(scene, task), CounterRows()
    rows.rows = no_work(Counters, scene.device.alias) if work is None else work
    launch_groups(scene, config, make_points_kernel, points.count, [space_of(scene, config), points, lists, rows])


def point_config(scene: SceneState, task: str) -> PointConfig:
    """The specialisation of a kernel for a scene."""
    kind = "kdtree" if scene.accelerator.kind == "kdtree" else "binary" if has_packed_nodes(scene) else "bvh"
    return PointConfig(kind, scene.width, 1 if scene.device.is_cuda else GROUP, task, bool(scene.instances))


def space_of(scene: SceneState, config: PointConfig) -> Any:
    """Where kernels search points; lazy trees are completed."""
    from wrt.engine.launch.persistent_launch import binary_parts, binary_tree
    from wrt.engine.launch.triangle_records import vertex_blocks

    scene.require_opaque("a query of points")
    for part in scene.parts if scene.instances else (scene,):
        part.complete()
    if scene.instances:
        parts = binary_parts(scene) if config.tree == "binary" else vertex_parts(scene)
        return as_space(config, scene.upper(), parts)
    if config.tree == "binary":
        return as_space(config, *binary_tree(scene))
    return as_space(config, scene.tree.struct(), vertex_blocks(scene))


def launch_groups(scene: SceneState, config: PointConfig, make: Any, count: int, inputs: list[Any]) -> None:
    """Launches the kernel that `make` makes, whose items are groups of `count` points."""
    items, chunk = -(-count // config.group), max(1, 256 // config.group)
    launch(specialise(make, config), items, inputs, device=scene.device, chunk=chunk, longest=4096)


def nearest_batch(hits: DeviceHits, feature: wp.array) -> NearestBatch:
    """The arrays of answers for kernels."""
    batch = NearestBatch()
    batch.distance, batch.primitive, batch.uv, batch.feature = hits.t, hits.primitive, hits.uv, feature
    return batch
