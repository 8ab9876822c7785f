"""Kernels of queries beside the traversals: before the rays are traced, and from hits to answers."""
