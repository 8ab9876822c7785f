"""Lights: what callers describe, and their tables on the device."""
