"""Builds that scan a node's triangles in place of sorting them."""
