"""Integrators: from a scene with materials and lights to a picture, by waves of rays."""
