# Written by `python -m tests.typed.stubs` from the table of names in wrt/compat/__init__.py.
from wrt.compat.open3d_rays import RaycastingScene as RaycastingScene
from wrt.compat.torch_scene import TensorResult as TensorResult
from wrt.compat.torch_scene import TorchScene as TorchScene
from wrt.compat.torch_scene import as_tensors as as_tensors
from wrt.compat.trimesh_proximity import ProximityQuery as ProximityQuery
from wrt.compat.trimesh_proximity import for_all_meshes as for_all_meshes
from wrt.compat.trimesh_rays import RayMeshIntersector as RayMeshIntersector

__all__ = [
    "ProximityQuery",
    "RayMeshIntersector",
    "RaycastingScene",
    "TensorResult",
    "TorchScene",
    "as_tensors",
    "for_all_meshes",
]
