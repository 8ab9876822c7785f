"""The nested parallel build of a kd-tree: levels of large nodes whose sorted events move with the nodes."""
