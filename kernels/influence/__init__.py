"""Influence areas on the device: which rays belong to one, and how much of it a box covers.

view        `AreaView`: where the rays of an area start and go; the direction at a box; whether a ray is affine
projection  area of a box's picture, where nothing of the box is cut off; for one box or for one in each vector lane
clipping    area of what is left of a box's picture that the window or the near plane cuts; of any box
silhouette  the outline of any box's picture, and what two of them share within the window
polygons    hull, clipping and area of convex polygons
"""
