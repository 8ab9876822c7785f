"""Descriptions of acceleration structures: what to build, not the built tree."""
