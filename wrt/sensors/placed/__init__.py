"""Poses of sensors, and values of many of them, that are on the scene's device."""
