"""Distances between the meshes or instances of a scene, and triangles of two that meet; see `wrt.kernels.pairs`.

References: quinlan-1994; shewchuk-1997.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import state_of
from wrt.analysis.pair_bodies import PlacedBody, body_count, body_of, box_gaps, check_bodies, pair_work, slack_of
from wrt.kernels.pairs.pair_walk import NearestPairs, PairLists, make_meeting_kernel, make_nearest_kernel
from wrt.kernels.runtime.launch import launch, refuse_capture, specialise, use_threads
from wrt.kernels.validation import as_float, as_int

if TYPE_CHECKING:
    from wrt.array_types import Indices
    from wrt.engine.facts.scene_state import SceneState
    from wrt.scene.scene import Scene

ENTRIES = 512
"""Pairs of boxes that threads of a CPU share; CUDA takes 16 times as many."""

MAX_PAIRS = (1 << 31) - 1
"""Most pairs of triangles that are listed."""


@dataclass(frozen=True, eq=False)
class ClosestPair:
    """The nearest points of two meshes or instances; made by `closest_pair` and `clearance`.

    Attributes:
        distance: in the scene; 0 where triangles meet, inf if nothing was found.
        positions: (2, 3) float64, a point of each in the scene's coordinates; NaN if nothing was found.
        primitive_ids: their triangles, numbered within their meshes; -1 if nothing was found.
        geometry_ids: their meshes; -1 if nothing was found.
        instance_ids: their instances; -1 in a scene without instances, or if nothing was found.
    """

    distance: float
    positions: np.ndarray
    primitive_ids: tuple[int, int]
    geometry_ids: tuple[int, int]
    instance_ids: tuple[int, int]

    @property
    def found(self) -> bool:
        """Whether there is a pair within the distance."""
        return self.distance < np.inf


def closest_pair(scene: Scene, first: int, second: int, *, max_distance: float = np.inf) -> ClosestPair:
    """The nearest points of two instances, or of two meshes of a scene without instances.

        pair = wrt.analysis.closest_pair(scene, 0, 1)
        pair.distance, pair.positions[0], pair.positions[1]

    Distances are between surfaces: that of a body inside another one is to its inner side. Everything is computed in float64
    from the vertices as given and the transforms, which may also shear; a distance is right to some 1e-15 of the coordinates.
    It is 0 if triangles meet, which is decided without tolerance (`overlapping_triangles`). Of pairs of triangles at the same
    distance, the smallest triangle of the body with the smaller id counts, then that of the other. Exchanging `first` and
    `second` exchanges the answer, to the bit.

    The first call makes what the meshes lack: trees of their own for meshes that share one, or are in kd-trees, and vertices in
    float64. They are kept with the meshes; moving instances keeps them. Masks and environments do not matter.

    Args:
        scene: a `wrt.Scene` of at least two meshes or instances.
        first, second: two instance ids; in a scene without instances, two geometry ids.
        max_distance: a pair is found if its distance is at most this (closed interval), at least 0. The smaller, the faster.

    Raises:
        TypeError: scene is not a scene, ids are not ints, or max_distance is no number.
        ValueError: ids that do not exist, or are the same; max_distance is negative or a NaN; a scene of one mesh, or of fans,
            groups or fuzzy boxes.
        RuntimeError: a graph is being captured.
    """
    state, max_distance = state_of(scene), as_max_distance(max_distance)
    state.require_whole("a distance of meshes")
    ids = as_pair(state, "closest_pair", first, second)
    with use_threads(state.num_threads):
        a, b = (body_of(state, number) for number in sorted(ids))
        pair = answer_of(state, (a, b), nearest_of(a, b, max_distance))
    return pair if ids[0] < ids[1] else turned(pair)


def clearance(scene: Scene, instances: Indices | None = None, *, max_distance: float = np.inf) -> ClosestPair:
    """Which two of several instances, or of the meshes of a scene without instances, are nearest, and where.

        nearest = wrt.analysis.clearance(scene, max_distance=0.1)
        if nearest.found: print(nearest.distance, nearest.instance_ids)

    Pairs whose boxes are farther apart than the nearest pair so far are left out. Distances are those of `closest_pair`; of
    pairs at the same distance, the smaller ids count. The smaller id is the first one of the answer.

    Args:
        scene: as in `closest_pair`.
        instances: at least two ids, each of which counts once; None for all, but those with mask 0. Instances of different
            environments have no distance from each other.
        max_distance: as in `closest_pair`.

    Raises:
        TypeError, ValueError, RuntimeError: as `closest_pair`; fewer than two ids.
    """
    state, max_distance = state_of(scene), as_max_distance(max_distance)
    state.require_whole("a distance of meshes")
    chosen = as_bodies(state, instances)
    with use_threads(state.num_threads):
        bodies = {number: body_of(state, number) for number in chosen}
        best = answer_of(state, (), None)
        for gap, one, other in nearest_boxes(state, bodies, max_distance):
            if gap > best.distance + slack_of(bodies[one], bodies[other])[0]:
                continue
            pair = bodies[one], bodies[other]
            found = answer_of(state, pair, nearest_of(*pair, min(max_distance, best.distance)))
            if found.found and key_of(found) < key_of(best):
                best = found
    return best


def overlapping_triangles(scene: Scene, first: int, second: int) -> np.ndarray:
    """The pairs of triangles of two instances, or of two meshes of a scene without instances, that meet.

        pairs = wrt.analysis.overlapping_triangles(scene, 0, 1)
        has_collision = len(pairs) > 0

    Triangles are closed: those that touch, at a vertex, on an edge or in one plane, meet. Whether they do is exact for the
    vertices in float64, after the transforms have rounded them; there is no tolerance. Triangles without an area are segments
    or points. A body inside another one that does not touch it has no such pairs: `Scene.contains` tells it.

    Args:
        scene, first, second: as in `closest_pair`.

    Returns:
        (N, 2) int32: a triangle of `first` and one of `second`, numbered within their meshes, sorted by both.

    Raises:
        TypeError, ValueError, RuntimeError: as `closest_pair`; more than 2^31 - 1 pairs.
    """
    state = state_of(scene)
    state.require_whole("a test of overlap")
    ids = as_pair(state, "overlapping_triangles", first, second)
    with use_threads(state.num_threads):
        pairs = meeting_of(*(body_of(state, number) for number in sorted(ids)))
    pairs = pairs if ids[0] < ids[1] else pairs[:, ::-1]
    return np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def as_max_distance(max_distance: Any) -> float:
    """A greatest distance.

    Raises:
        TypeError, ValueError: as `closest_pair`.
    """
    max_distance = as_float("max_distance", max_distance)
    if max_distance < 0.0:
        raise ValueError(f"max_distance must be 0 or more, or inf for no limit, not {max_distance}")
    return max_distance


def as_pair(state: SceneState, query: str, first: Any, second: Any) -> tuple[int, int]:
    """Two ids; errors as in `closest_pair`."""
    refuse_capture(query, state.device)
    kind, last = check_bodies(state, query), body_count(state) - 1
    ids = as_int("first", first, 0, last), as_int("second", second, 0, last)
    if ids[0] == ids[1]:
        raise ValueError(f"first and second are both {kind} {ids[0]}; pass two different ones")
    return ids


def as_bodies(state: SceneState, instances: Any) -> list[int]:
    """Sorted ids, each once; errors as in `clearance`."""
    refuse_capture("clearance", state.device)
    kind, count = check_bodies(state, "clearance"), body_count(state)
    if instances is None:
        chosen = [i for i in range(count) if not state.instances or state.instances[i].mask]
    else:
        if not np.iterable(instances) or isinstance(instances, (str, bytes)):
            raise TypeError(f"instances must be a sequence of {kind} ids, not {instances!r}; pass [0, 1], or None for all")
        given = instances.numpy() if isinstance(instances, wp.array) else instances
        chosen = sorted({as_int(f"instances[{place}]", one, 0, count - 1) for place, one in enumerate(given)})
    if len(chosen) < 2:
        hidden = " that are not hidden by mask=0" if instances is None else ""
        raise ValueError(f"clearance is between at least two of the scene's {count}{hidden}, and there are {len(chosen)}")
    return chosen


def nearest_boxes(state: SceneState, bodies: dict[int, PlacedBody], max_distance: float) -> list[tuple[float, int, int]]:
    """(distance of boxes, id, greater id) of the pairs that may be the nearest, those with the nearest boxes first."""
    numbers = np.array(list(bodies))
    boxes = np.stack([body.box for body in bodies.values()])
    slack = np.array([sum(slack_of(body, body)) for body in bodies.values()])
    environments = np.array([one.environment for one in state.instances] or [-1] * body_count(state))[numbers]
    found, bound = [], max_distance
    for i in range(len(numbers) - 1):
        gap, greatest = box_gaps(boxes[i], boxes[i + 1 :])
        own, others = environments[i], environments[i + 1 :]
        sees = (own == others) | (own < 0) | (others < 0)
        bound = min(bound, float(greatest[sees].min(initial=np.inf)))
        near = np.flatnonzero(sees & (gap <= bound + slack[i] + slack[i + 1 :]))
        found += [(float(gap[j]), int(numbers[i]), int(numbers[i + 1 + j])) for j in near]
    return sorted(found)


def entries_of(body: PlacedBody) -> int:
    """How many pairs of boxes threads share."""
    return ENTRIES if body.part.is_cpu else 16 * ENTRIES


def nearest_of(a: PlacedBody, b: PlacedBody, max_distance: float) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Distance, triangles and points (2, 3) of the nearest pair; None if it is farther than `max_distance`."""
    work, found, device = pair_work(a, b, max_distance, entries_of(a)), NearestPairs(), a.part.device
    count = work.boxes.shape[0]
    if count == 0:
        return None
    found.square, found.triangles = (
        wp.empty(count, dtype=wp.float64, device=device),
        wp.empty(count, dtype=wp.vec2i, device=device),
    )
    found.first, found.second = (wp.empty(count, dtype=wp.vec3d, device=device) for _ in range(2))
    kernel = specialise(make_nearest_kernel, a.state.width)
    launch(kernel, count, [a.struct(), b.struct(), work, found], device=device, chunk=1, longest=16)
    square, triangles = found.square.numpy(), found.triangles.numpy()
    best = int(np.lexsort((triangles[:, 1], triangles[:, 0], square))[0])
    distance = float(np.sqrt(square[best]))
    if triangles[best, 0] < 0 or distance > max_distance:
        return None
    return distance, triangles[best], np.stack([found.first.numpy()[best], found.second.numpy()[best]])


def meeting_of(a: PlacedBody, b: PlacedBody) -> np.ndarray:
    """(N, 2) int32 pairs of triangles that meet, in no order.

    Raises:
        ValueError: too many.
    """
    work, lists, device = pair_work(a, b, 0.0, entries_of(a)), PairLists(), a.part.device
    count = work.boxes.shape[0]
    lists.count = wp.zeros(count, dtype=int, device=device)
    lists.begin, lists.pairs = wp.empty(0, dtype=wp.int64, device=device), wp.empty(0, dtype=wp.vec2i, device=device)
    kernel, inputs = specialise(make_meeting_kernel, a.state.width), [a.struct(), b.struct(), work, lists]
    launch(kernel, count, inputs, device=device, chunk=1, longest=16)
    ends = np.cumsum(lists.count.numpy().astype(np.int64))
    total = int(ends[-1]) if count else 0
    if total > MAX_PAIRS:
        raise ValueError(f"{total:,} pairs of triangles meet, and at most {MAX_PAIRS:,} are listed; pass parts of the meshes")
    if total == 0:
        return np.empty((0, 2), dtype=np.int32)
    lists.begin = wp.array(np.concatenate([[0], ends[:-1]]), dtype=wp.int64, device=device)
    lists.pairs = wp.empty(total, dtype=wp.vec2i, device=device)
    launch(kernel, count, inputs, device=device, chunk=1, longest=16)
    return lists.pairs.numpy()


def answer_of(state: SceneState, bodies: tuple[PlacedBody, ...], found: tuple | None) -> ClosestPair:
    """The answer for two bodies; without `found`, that nothing is within the distance."""
    if found is None:
        return ClosestPair(np.inf, np.full((2, 3), np.nan), (-1, -1), (-1, -1), (-1, -1))
    distance, triangles, points = found
    numbers = bodies[0].number, bodies[1].number
    primitives = int(triangles[0]), int(triangles[1])
    if not state.instances:
        return ClosestPair(distance, points, primitives, numbers, (-1, -1))
    meshes = int(state.geometry_ids[numbers[0]]), int(state.geometry_ids[numbers[1]])
    return ClosestPair(distance, points, primitives, meshes, numbers)


def key_of(pair: ClosestPair) -> tuple:
    """By which the first of pairs at the same distance is told."""
    return pair.distance, pair.instance_ids, pair.geometry_ids


def turned(pair: ClosestPair) -> ClosestPair:
    """The same, the second one first."""
    ids = (pair.primitive_ids[::-1], pair.geometry_ids[::-1], pair.instance_ids[::-1])
    return ClosestPair(pair.distance, pair.positions[::-1].copy(), *ids)
