"""Streams: lists of rays, filtered node by node."""
