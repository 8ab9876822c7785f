"""Hashes of scenes: of all that answers depend on. Meshes and states of scenes do not change, and are hashed once."""

from __future__ import annotations

import hashlib
import json
import threading
import weakref
from collections.abc import Callable
from typing import Any

from wrt.cluster.identity.array_hashes import array_hash

_lock = threading.Lock()
_known: weakref.WeakKeyDictionary[Any, str] = weakref.WeakKeyDictionary()
"""Hashes of meshes and of states of scenes, which do not change."""


def scene_hash(scene: Any) -> str:
    """SHA-256 of all that answers depend on: triangles, instances, triangle test; not of the tree."""
    return remembered(scene.state, state_hash)


def state_hash(state: Any) -> str:
    """The hash of a state of a scene."""
    geometry_ids = getattr(state, "geometry_ids", ())
    whole = hashlib.sha256(json.dumps([state.triangle_test, len(state.meshes), *geometry_ids]).encode())
    for mesh in state.meshes:
        whole.update(remembered(mesh, mesh_hash).encode())
    if state.instances:
        whole.update(array_hash(state.instances.transforms).encode())
        whole.update(json.dumps([[instance.mask, instance.environment] for instance in state.instances]).encode())
    for part in (state, *state.parts):
        if part.hit_filter is not None:
            whole.update(json.dumps(["filtered", part.hit_filter.alpha]).encode())
            whole.update(b"" if part.hit_filter.ignored is None else array_hash(part.hit_filter.ignored).encode())
    return whole.hexdigest()


def mesh_hash(mesh: Any) -> str:
    """The hash of a mesh's triangles."""
    return array_hash(mesh.vertices) + array_hash(mesh.faces)


def remembered(value: Any, make: Callable[[Any], str]) -> str:
    """The hash of an object that does not change, computed once."""
    with _lock:
        found = _known.get(value)
    if found is None:
        found = make(value)
        with _lock:
            _known[value] = found
    return found
