"""Spatial splits: a triangle that straddles a plane may be in both children, each time with the box of its part there."""
