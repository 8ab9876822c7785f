"""Studies that only measure: triangle tests without a tree, their exits and comparisons, walks, and a model of caches."""
