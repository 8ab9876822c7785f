"""Checks of single queries against references."""
