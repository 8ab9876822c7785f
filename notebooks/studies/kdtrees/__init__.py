"""Kd-trees: builders, growth, layouts in memory, and what else papers claim."""
