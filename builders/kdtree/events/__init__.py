"""Sorted events of boxes, and the planes swept from them."""
