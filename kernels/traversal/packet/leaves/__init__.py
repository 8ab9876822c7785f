"""The rays of a packet against the triangles of a leaf."""
