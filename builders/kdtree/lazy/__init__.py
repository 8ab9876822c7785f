"""Kd-trees that are built while rays are traced."""
