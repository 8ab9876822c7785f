"""Scenes that move: of groups, of frames, of skins on bones, and of instances.

    scene = wrt.moving.GroupedScene([building, curtain])            # each mesh has its own tree
    scene = wrt.moving.FuzzyScene(frames, faces)                    # frames of an animation, one tree for all
    scene = wrt.moving.SkinnedScene(vertices, faces, weights, skeleton)

Any `wrt.Scene` moves by `update`, too. `UpdatePolicy` says when its tree is built again. `Motion` is motion blur in pictures.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "FuzzyScene": "wrt.moving.fuzzy_scene",
    "GroupedScene": "wrt.moving.grouped_scene",
    "InstancedScene": "wrt.scene.instanced_scene",
    "Motion": "wrt.imaging.integrators.scene_motion",
    "Skeleton": "wrt.meshes.skeleton",
    "SkinnedScene": "wrt.moving.skinned_scene",
    "UpdatePolicy": "wrt.scene.updates",
    "nested_meshes": "wrt.meshes.node_graph",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
