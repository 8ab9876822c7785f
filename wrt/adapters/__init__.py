"""The shapes of other libraries' ray tracers, answered by `wrt`: code written for them runs on as it is.

    mesh.ray = wrt.RayMeshIntersector(mesh)         # trimesh's intersector
    scene = wrt.RaycastingScene()                   # Open3D's scene, on NumPy arrays

An adapter translates arguments and answers and computes nothing about rays and triangles itself.
"""
