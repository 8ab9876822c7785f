"""Trees on the host: the way of a ray, the boxes of levels, and both as lines."""
