"""Kd-trees whose triangles have moved: refilled leaves, and subtrees built again."""
