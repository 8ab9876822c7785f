"""Influence areas on the device: which rays belong to an area, and the projected area of a box.

view        `AreaView`: where the rays of an area start and go; the direction at a box; whether a ray is affine
projection  projected area of a box that needs no clipping; for one box, or for one box in each vector lane
clipping    projected area of a box that the window or the near plane cuts; of any box
silhouette  the outline of any box's projection, and the overlap of two projections within the window
polygons    hull, clipping and area of convex polygons
"""
