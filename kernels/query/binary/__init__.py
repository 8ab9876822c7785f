"""Queries through the layout of persistent threads: in float64, and of users' kernels."""
