"""Finished trees in other layouts."""
