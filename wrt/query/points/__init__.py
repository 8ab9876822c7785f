"""Queries of points: on triangles, and between each other."""
