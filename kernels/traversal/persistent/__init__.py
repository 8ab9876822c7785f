"""Rays one by one on CUDA, by threads that stay and take the next ray when they are done."""
