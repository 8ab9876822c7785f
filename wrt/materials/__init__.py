"""Materials of surfaces, the materials of a mesh's triangles, and their import from trimesh."""
