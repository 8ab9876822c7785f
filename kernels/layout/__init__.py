"""Data structures in device memory: rays, hits, nodes, and instances."""
