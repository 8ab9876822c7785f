"""Valid arguments of what `wrt.analysis` answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import wrt
from support.call_objects import Call, hits, instances, mesh, pinhole, rays, scene

NUMBERS = {"max_distance": 64.0}


def analysis_calls() -> Iterator[Call]:
    ask = wrt.analysis
    yield Call("sky_directions", lambda **o: ask.sky_directions(**o), {"count": 4})
    yield Call("exposure", lambda **o: ask.exposure(scene(), hits(), [[0, 0, 1]], **o), {"cosine": False})
    yield Call("ambient_occlusion", lambda **o: ask.ambient_occlusion(scene(), hits(), **o), {"rays": 4, "seed": 1, **NUMBERS})
    yield Call("shape_diameter", lambda **o: ask.shape_diameter(scene(), hits(), **o), {"rays": 4, "opening": 64.0, "seed": 1})
    yield Call("sample_surface", lambda **o: ask.sample_surface(scene(), **o).position, {"count": 4, "seed": 1})
    yield Call("sample_surface", lambda **o: ask.sample_surface(scene(), **o).position, {"radius": 64.0})
    yield Call("bake", lambda **o: baked(instances(), to="vertices", **o), {"rays": 4, "instance_id": 1})
    sizes = {"resolution": 4, "padding": 1, "rays": 4}
    yield Call("bake", lambda **o: baked(scene(), to="texture", uv=flat_map(), **o).values, sizes)
    yield Call("closest_pair", lambda **o: ask.closest_pair(instances(), **o).distance, {"first": 0, "second": 1, **NUMBERS})
    yield Call("clearance", lambda **o: ask.clearance(instances(), **o).distance, NUMBERS)
    yield Call("overlapping_triangles", lambda **o: ask.overlapping_triangles(instances(), **o), {"first": 0, "second": 1})
    options = {"resolution": 8, "band": 0.5, "progress": False}
    yield Call("distance_grid", lambda **o: ask.distance_grid(scene(), **o).values, options)
    yield Call("DistanceGrid.axis", lambda **o: ask.distance_grid(scene(), 8).axis(**o), {"number": 1})
    yield Call("visible_faces", lambda **o: ask.visible_faces(scene(), pinhole(), **o), {"samples": 2})
    options = {"eye_height": 2.0, "target_height": 0.5}
    yield Call("viewshed", lambda **o: ask.viewshed(scene(), rays()[0], rays()[0][0], **o), options)
    yield Call("winding_number", lambda **o: ask.winding_number(scene(), rays()[0], **o), {"accuracy": 0.25})


def baked(of: wrt.Scene, **options: Any) -> Any:
    return wrt.analysis.bake(of, "ambient_occlusion", **options)


def flat_map() -> np.ndarray:
    """(V, 2) texture coordinates: the vertices from above."""
    low, high = mesh().bounds[:, :2]
    return (mesh().vertices[:, :2] - low) / (high - low)
