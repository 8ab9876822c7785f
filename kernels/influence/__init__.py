"""Influence areas on the device: which rays belong to an area, and the projected area of a box.

view             `AreaView`: where the rays of an area start and go; the direction at a box; whether a ray belongs to it
box_projection   projected area of a box that needs no clipping; for one box, or for one box in each vector lane
box_clipping     projected area of a box that the window or the near plane cuts; of any box
silhouette       the outline of any box's projection, the overlap of two projections within the window, and convex polygons
region_tests     whether points and boxes are in the region of an area
area_assignment  which area each ray of a batch belongs to, and where it leaves it
area_lanes       the same for 16 rays at a time
ray_casting      rays of a known distribution
"""
