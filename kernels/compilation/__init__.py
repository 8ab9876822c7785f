"""Compiling kernels: for which CPU, side by side, with progress, kept in a cache or shipped."""
