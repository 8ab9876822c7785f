"""Integrators: from a scene with materials and lights to a picture, by waves of rays."""

__all__ = ["INTEGRATORS"]

INTEGRATORS = ("ambient", "whitted", "distribution", "path")
"""Names of all ways to make a picture; here, because the kernels that the modules import need time."""
