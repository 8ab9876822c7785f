"""Sensors that are mounted on one body."""
