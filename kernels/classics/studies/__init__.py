"""Studies: triangle tests without a tree, and counts of their exits and comparisons."""
