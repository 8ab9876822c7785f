"""Interleaved walks: each ray takes its own way through the tree, and many rays take turns."""
