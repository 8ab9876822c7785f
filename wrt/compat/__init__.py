"""Drop-in replacements for the ray tracers of other libraries: code written for them runs unchanged on `wrt`.

    mesh.ray = wrt.compat.RayMeshIntersector(mesh)         # trimesh's intersector
    scene = wrt.compat.RaycastingScene()                   # Open3D's scene, on NumPy arrays

An adapter translates arguments and results; all geometry is computed by `wrt.Scene`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "RayMeshIntersector": "wrt.compat.trimesh_rays",
    "RaycastingScene": "wrt.compat.open3d_rays",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
