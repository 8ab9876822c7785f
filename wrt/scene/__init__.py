"""Scenes: meshes with a tree, of one level or two, still or moving, in memory or in files."""
