"""Phases of BVH builds: binning, levels, subtrees, and collapse."""
