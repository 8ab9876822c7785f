"""Rays as callers pass them, their way to the device, and what is detected in them."""
