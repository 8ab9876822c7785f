"""Scenes whose rays pass through chosen triangles and through the holes of alpha masks; see `wrt.Scene.filtered`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.facts.hit_filter import HitFilter
from wrt.engine.facts.query_cache import QueryCache
from wrt.kernels.validation import as_bool, as_int, host_array

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState


def filtered(state: SceneState, ignore: Any, alpha: bool) -> SceneState:
    """The state of the same tree with a filter; arguments and errors as in `wrt.Scene.filtered`."""
    if not (state.is_plain or state.instances) or state.area_trees is not None:
        raise ValueError("filters need a scene with one tree, or one of instances; make wrt.Scene(scene.meshes)")
    alpha, ignored = as_bool("alpha", alpha), ignored_triangles(state, ignore)
    state.complete()
    if state.instances:
        parts = tuple(with_filter(part, ignored.get(number), False) for number, part in enumerate(state.parts))
        seen = replace(state, mesh_states=parts, hit_filter=None, cache=QueryCache())  # type: ignore[call-arg]
        return replace(seen, hit_filter=HitFilter(alpha=alpha) if ignored or alpha else None)
    counts = [mesh.triangle_count for mesh in state.meshes]
    hidden = [ignored.get(number, np.zeros(count, dtype=bool)) for number, count in enumerate(counts)]
    return with_filter(state, np.concatenate(hidden) if ignored else None, alpha)


def with_filter(state: SceneState, ignored: np.ndarray | None, alpha: bool) -> SceneState:
    """The state of one level with a filter, or without; itself if nothing changes."""
    wanted = None if ignored is None and not alpha else HitFilter(ignored, alpha)
    if wanted is None and state.hit_filter is None:
        return state
    return replace(state, hit_filter=wanted, cache=QueryCache())


def ignored_triangles(state: SceneState, ignore: Any) -> dict[int, np.ndarray]:
    """The triangles that rays do not see, by mesh; only meshes with some."""
    if ignore is None:
        return {}
    meshes = state.meshes
    if not isinstance(ignore, Mapping):
        if len(meshes) > 1:
            raise ValueError(
                f"ignore is one array, and the scene has {len(meshes)} meshes; pass a mapping from a mesh's index to its array"
            )
        ignore = {0: ignore}
    found = {}
    for key, values in ignore.items():
        number = as_int("a key of ignore", key, 0, len(meshes) - 1)
        array = host_array("ignore", values.numpy() if isinstance(values, wp.array) else values)
        count = meshes[number].triangle_count
        if array.dtype != bool:
            raise TypeError(
                f"ignore must hold bools, one a triangle, not {array.dtype}; of ids make np.isin(np.arange({count}), ids)"
            )
        if array.shape != (count,):
            raise ValueError(f"ignore has shape {array.shape}, and mesh {number} has {count} triangles; it must be ({count},)")
        if array.any():
            found[number] = array.copy()
            found[number].flags.writeable = False
    return found


def given_filter(state: SceneState) -> tuple[dict[int, np.ndarray] | None, bool] | tuple[()]:
    """The arguments `ignore` and `alpha` that make a state's filter of the whole scene; none if it has no filter."""
    filters = state.hit_filter
    if filters is None:
        return ()
    each: list[Any]
    if state.instances:
        each = [None if part.hit_filter is None else part.hit_filter.ignored for part in state.parts]
    elif filters.ignored is None:
        each = []
    else:
        each = np.split(filters.ignored, np.cumsum([mesh.triangle_count for mesh in state.meshes])[:-1])
    return {number: ignored for number, ignored in enumerate(each) if ignored is not None} or None, filters.alpha
