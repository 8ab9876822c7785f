"""Shadows of point lights and area lights."""
