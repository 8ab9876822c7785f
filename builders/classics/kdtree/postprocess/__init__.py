"""Passes over a finished kd-tree: tests of triangles against leaves, and late cutting of empty space."""
