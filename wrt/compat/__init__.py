"""Other libraries: replacements for their ray and distance queries, on which code written for them runs unchanged, and tensors.

    mesh.ray = wrt.compat.RayMeshIntersector(mesh)         # trimesh's intersector
    mesh.nearest = wrt.compat.ProximityQuery(mesh)         # trimesh's nearest points
    with wrt.compat.for_all_meshes(): ...                  # both, for all meshes that are made meanwhile
    scene = wrt.compat.RaycastingScene()                   # Open3D's scene, on NumPy arrays
    tensors = wrt.compat.TorchScene(scene)                 # a wrt.Scene on tensors of PyTorch, with gradients

An adapter translates arguments and results; all geometry is computed by `wrt.Scene`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "ProximityQuery": "wrt.compat.trimesh_proximity",
    "RayMeshIntersector": "wrt.compat.trimesh_rays",
    "RaycastingScene": "wrt.compat.open3d_rays",
    "TensorResult": "wrt.compat.torch_scene",
    "TorchScene": "wrt.compat.torch_scene",
    "as_tensors": "wrt.compat.torch_scene",
    "for_all_meshes": "wrt.compat.trimesh_proximity",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
