"""Drop-in replacements for the ray tracers of other libraries: code written for them runs unchanged on `wrt`.

    mesh.ray = wrt.RayMeshIntersector(mesh)         # trimesh's intersector
    scene = wrt.RaycastingScene()                   # Open3D's scene, on NumPy arrays

An adapter translates arguments and results; all geometry is computed by `wrt.Scene`.
"""
