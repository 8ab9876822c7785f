"""BVHs whose triangles have moved: refit, measurement, and partial rebuilds."""
