"""Trees on the host: the traversal path of a ray, the boxes of levels, and both as lines."""
