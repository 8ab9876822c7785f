"""Shadow rays towards a point light: how they are made, and which cell of the light buffer answers them."""

import warp as wp

from wrt.kernels.layout.light_cells import DEPTH_SLACK, LightCells
from wrt.kernels.layout.ray_batch import Ray, RayBatch, checked_ray

LIT = 0
OCCLUDED = 1
UNDECIDED = 2
"""Answers; rays that the lists do not decide are to be traced."""


@wp.struct
class LightQuery:
    """The cell of a shadow ray, and the depths between which its hits lie."""

    cell: int
    decided: bool
    """Whether the lists hold all triangles that the ray can hit."""
    min_depth: float
    """Hits lie behind this depth ..."""
    max_depth: float
    """... and in front of this one, rounding included."""
    sure: float
    """A hit for certain in front of this depth, and behind `min_depth`, counts."""


@wp.func
def light_ray(rays: RayBatch, i: int, target: wp.vec3d):
    """Ray number i: from its point to the light, at t = 1. Its direction is rounded once.

    Args:
        rays: points as origins, and ranges; its directions are not read.
        i: number of the ray.
        target: the light, in the coordinates of the points.
    """
    point = wp.vec3d(rays.origins[i * rays.origin_stride])
    return checked_ray(
        wp.vec3(point - rays.center),
        wp.vec3(target - point),
        rays.t_min[i * rays.t_min_stride],
        rays.t_max[i * rays.t_max_stride],
    )


@wp.func
def find_cell(cells: LightCells, ray: Ray, distance: float):
    """The cell of a valid ray whose reach is `distance`."""
    query = LightQuery()
    away = -ray.direction
    size = wp.abs(away)
    axis = wp.where(size[0] >= size[1], wp.where(size[0] >= size[2], 0, 2), wp.where(size[1] >= size[2], 1, 2))
    depth = wp.where(axis == 0, size[0], wp.where(axis == 1, size[1], size[2]))
    ahead = wp.where(axis == 0, away[0], wp.where(axis == 1, away[1], away[2]))
    u = wp.where(axis == 0, away[1], wp.where(axis == 1, away[2], away[0])) / depth
    v = wp.where(axis == 0, away[2], wp.where(axis == 1, away[0], away[1])) / depth
    half = 0.5 * float(cells.resolution)
    i = wp.min(int((u + 1.0) * half), cells.resolution - 1)
    j = wp.min(int((v + 1.0) * half), cells.resolution - 1)
    face = 2 * axis + wp.where(ahead < 0.0, 1, 0)
    query.cell = (face * cells.resolution + j) * cells.resolution + i
    start = (1.0 - ray.t_min) * depth
    end = (1.0 - ray.t_max) * depth
    query.max_depth = start * (1.0 + DEPTH_SLACK) + cells.slack
    query.sure = start * (1.0 - DEPTH_SLACK) - cells.slack
    query.min_depth = wp.where(ray.t_max == 1.0, 0.0, end * (1.0 + DEPTH_SLACK) + cells.slack)
    query.decided = distance <= cells.limit and ray.t_max <= 1.0
    return query
