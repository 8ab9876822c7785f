# Written by `python -m tests.typed.stubs` from the table of names in wrt/moving/__init__.py.
from wrt.imaging.integrators.scene_motion import Motion as Motion
from wrt.meshes.node_graph import nested_meshes as nested_meshes
from wrt.meshes.skeleton import Skeleton as Skeleton
from wrt.moving.fuzzy_scene import FuzzyScene as FuzzyScene
from wrt.moving.grouped_scene import GroupedScene as GroupedScene
from wrt.moving.skinned_scene import SkinnedScene as SkinnedScene
from wrt.scene.instanced_scene import InstancedScene as InstancedScene
from wrt.scene.updates import UpdatePolicy as UpdatePolicy

__all__ = [
    "FuzzyScene",
    "GroupedScene",
    "InstancedScene",
    "Motion",
    "Skeleton",
    "SkinnedScene",
    "UpdatePolicy",
    "nested_meshes",
]
