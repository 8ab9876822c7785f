"""Bounds of a packet: intervals over its rays and a frustum around them, the input of culling."""

import warp as wp

MAX_FEW_RAYS = 2
"""Greatest number of rays at a leaf that are tested one by one, each against W triangles at a time
(`wrt.kernels.traversal.packet.core.few_active_rays`). A larger value favours reflected rays, a smaller one shadow rays
(notebooks/records/2026-11-22-leaf-rays.md, notebooks/records/2026-11-23-edge-functions.md)."""

FewRays = wp.types.vector(length=MAX_FEW_RAYS, dtype=wp.int32)


@wp.struct
class PacketBounds:
    """Intervals over the active rays. If there are none, only `active` is defined.

    Along an axis on which the directions have both signs, slabs give no bounds: `inverse_large` and `inverse_small` are NaN,
    and every comparison with values derived from them is false. Boxes in front of all origins, or behind all of them, are
    bounded by `forward_small` and `backward_small`.
    """

    active: int
    """Number of active rays."""
    mixed_axes: int
    """Number of axes along which the directions have both signs."""
    finished: int
    """1 if the packet has the values that only the triangle test reads
    (`wrt.kernels.traversal.packet.rays.packet_load.finish_packet`), else 0."""
    passes: int
    """Passes over the rays that the triangle test needs, one bit each (`PacketForm.passes`); 0 until the packet is
    finished."""
    t_min: float
    """Least t_min of the rays."""
    t_max: float
    """Greatest t at which a hit still counts for some ray."""
    slack: float
    """Greatest slack of the rays."""
    backward: wp.vec3i
    """Per axis, 1 if the directions are negative, else 0."""
    inverse_large: wp.vec3
    """Per axis, the end of the interval of 1 / direction that is farther from 0."""
    inverse_small: wp.vec3
    """Per axis, the end that is nearer to 0."""
    forward_small: wp.vec3
    """Per axis with both signs, least 1 / direction of the rays with positive direction; 0 along the other axes."""
    backward_small: wp.vec3
    """Per axis with both signs, greatest 1 / direction (nearest to 0) of the rays with negative direction; 0 along the other
    axes."""
    origin_in: wp.vec3
    """End of the interval of `RaySlabs.origin_in` that gives the earliest entry through near planes."""
    origin_out: wp.vec3
    """End of the interval of `RaySlabs.origin_out` that gives the latest exit through far planes."""
    origin_low: wp.vec3
    origin_high: wp.vec3
    end_low: wp.vec3
    """Interval of the points origin + t_max direction at which the rays end. This and the next field are defined only if they
    are asked for (`wrt.kernels.traversal.packet.rays.reversed_bounds`)."""
    end_high: wp.vec3
    slope_low: wp.vec2
    """Least slopes against the main axis. This and the next four fields are defined only if all rays have the same main axis
    and the culling needs them (`CullingTraits.SLOPES`)."""
    slope_high: wp.vec2
    plane: float
    """Position of a plane normal to the main axis, near the origins."""
    through_low: wp.vec2
    """Interval in which the lines of the rays cross that plane, widened by the greatest distance that rounding moves a vertex
    in the watertight test."""
    through_high: wp.vec2
    main_axes: int
    """Main axes that occur, one bit each; 0 until the packet is finished."""
    frame: int
    """Axis of the frustum below, the main axis of all rays; -1 if there is no frustum."""
    forward: float
    """1 or -1: the sign of the directions along `frame`."""
    near_plane: float
    """Position at which the frustum begins; a position p on the axis has the depth (p - near_plane) forward."""
    depth: float
    """Depth at which the frustum ends."""
    side_low: wp.vec2
    """The lower lines along the next two axes, in cyclic order: at depth d, a ray is at least at side_low + rise_low d ..."""
    side_high: wp.vec2
    """... and at most at side_high + rise_high d."""
    rise_low: wp.vec2
    rise_high: wp.vec2
    margin: float
    """Error bound of these four planes plus the greatest distance of a hit from its triangle
    (`wrt.kernels.classics.culling.inverse_frustum`)."""
    few: FewRays
    """Numbers of the rays that meet the current leaf, if they are at most `MAX_FEW_RAYS` (`Culling.leaf`)."""
