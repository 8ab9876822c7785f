"""Phases of BVH builds: binning, levels, subtrees, collapse, and reinsertion."""
