"""Queries of points: nearest to them, on triangles, and between each other."""
