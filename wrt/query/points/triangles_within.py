"""All triangles within a distance of points: lists of different lengths, concatenated.

Triangles are counted, then listed, which takes two walks; the number of a list is known before there is memory for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.memory import empty
from wrt.kernels.points.point_batch import NearLists, copy_lists
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.query.all_hits import MAX_TOTAL
from wrt.query.points.closest_point import as_points, check_query, nearest_batch, search
from wrt.query.points.closest_points import TrianglesWithin

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState


def triangles_within(scene: SceneState, points: Any, radius: Any, mask: Any = None, environment: Any = None) -> TrianglesWithin:
    """All triangles within a distance of points; see `wrt.Scene.within`."""
    check_query(scene, points, "within")
    with use_threads(scene.num_threads):
        given, device = as_points(scene, points, radius, "radius", mask, environment), scene.device
        lists, count = NearLists(), given.batch.count
        lists.count = empty(count, wp.int32, device)
        search(scene, given.batch, lists, "count")
        room = sum_up(lists.count.numpy())
        lists.begin = wp.array(room[:-1].astype(np.int32), dtype=int, device=device)
        hits, feature = new_lists(int(room[-1]), device)
        lists.found = nearest_batch(hits, feature)
        search(scene, given.batch, lists, "list")
        offsets = sum_up(lists.count.numpy())
        if offsets[-1] < room[-1]:  # some triangles are in several leaves
            hits, feature = new_lists(int(offsets[-1]), device)
            begin = wp.array(offsets[:-1].astype(np.int32), dtype=int, device=device)
            launch(copy_lists, count, [lists, begin, nearest_batch(hits, feature)], device=device, chunk=1024)
        ends = wp.array(offsets, dtype=wp.int64, device=device)
    return TrianglesWithin(hits, feature, ends, given.form, scene)


def new_lists(count: int, device: wp.Device) -> tuple[DeviceHits, wp.array]:
    """Memory for lists of this many triangles together, and for their features."""
    return DeviceHits.lists(0, count, 0, device), empty(count, wp.int8, device)


def sum_up(counts: np.ndarray) -> np.ndarray:
    """(N + 1,) int64: where each of N lists begins, and the end of the last.

    Raises:
        ValueError: more than `MAX_TOTAL` triangles.
    """
    offsets = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, dtype=np.int64, out=offsets[1:])
    if offsets[-1] > MAX_TOTAL:
        raise ValueError(
            f"{int(offsets[-1]):,} triangles are within radius of these points, and one result holds {MAX_TOTAL:,}; pass fewer "
            "points at a time, or a smaller radius"
        )
    return offsets
