"""Structures around lights: the light buffer."""
