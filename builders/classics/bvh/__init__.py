"""Bounding volume hierarchies: the exact sweep (`sweep_bvh`), `reinsertion`, builds on a random subset (`subset_levels`)."""
