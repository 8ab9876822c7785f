"""Rays that wait in queues at subtrees of a tree, or at parts of a scene, and are traced queue by queue."""
