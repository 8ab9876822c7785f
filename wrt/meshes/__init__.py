"""Triangle meshes, instances of them, and their placement relative to a scene's centre."""
