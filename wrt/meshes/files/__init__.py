"""Readers of mesh files: PLY, OBJ, STL, OFF and, in `gltf`, glTF. Triangles come in the order of the file's faces.

A reader takes the bytes of a file and where it lies (`MeshSource`) and returns a `FileMesh`, or raises a ValueError that says
what is wrong or not supported. What is left out without changing the shape, such as an image that is missing, is a warning.
"""
