"""Geometry that moves: ways to follow it, and what they cost."""
