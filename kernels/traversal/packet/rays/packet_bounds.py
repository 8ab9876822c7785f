"""Intervals over the rays of a packet, and a frustum around them: what culling knows of it."""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

FEW = 6
"""Rays at a leaf up to which each is tested on its own, against W triangles at a time
(`wrt.kernels.traversal.packet.core.few_active_rays`)."""

FewRays = wp.types.vector(length=FEW, dtype=wp.int32)


@wp.struct
class PacketBounds:
    """Intervals over the active rays; if there are none, nothing but `active` means anything.

    Along an axis on which the directions have both signs, slabs bound nothing: `inverse_large` and `inverse_small` are NaN,
    and every comparison with what follows from them is false. What bounds boxes in front of all origins, or behind them, is
    `forward_small` and `backward_small`.
    """

    active: int
    """Number of active rays."""
    mixed_axes: int
    """Number of axes along which the directions have both signs."""
    passes: int
    """Passes over the rays that the triangle test asks for, one bit each (`PacketForm.passes`)."""
    t_min: float
    """Least of all."""
    t_max: float
    """Greatest t at which a hit would still count."""
    slack: float
    """Greatest of all."""
    backward: wp.vec3i
    """Per axis, 1 if the directions are negative."""
    inverse_large: wp.vec3
    """Per axis, the end of the interval of 1 / direction that is farther from 0."""
    inverse_small: wp.vec3
    """The end that is nearer to 0."""
    forward_small: wp.vec3
    """Per axis with both signs, the least 1 / direction of the rays that go forward; 0 along the others."""
    backward_small: wp.vec3
    """Likewise the greatest, nearest to 0, of the rays that go backward."""
    origin_in: wp.vec3
    """End of the interval of `RaySlabs.origin_in` from which near planes are closest."""
    origin_out: wp.vec3
    """End of the interval of `RaySlabs.origin_out` from which far planes are farthest."""
    origin_low: wp.vec3
    origin_high: wp.vec3
    slope_low: wp.vec2
    """Of the two slopes against the main axis. The next three mean something only if all rays have the same
    main axis, and the culling asks for them (`Culling.slopes`)."""
    slope_high: wp.vec2
    plane: float
    """A plane across the main axis, near the origins."""
    through_low: wp.vec2
    """Where the rays' lines go through the plane, widened by what rounding may move a vertex in the watertight test."""
    through_high: wp.vec2
    main_axes: int
    """Main axes that occur, one bit each."""
    frame: int
    """Axis along which the frustum below is set up, the main axis of all rays; -1 if there is none."""
    forward: float
    """1 or -1: the sign of the directions along it."""
    near_plane: float
    """Where the frustum begins; a position p on the axis has the depth (p - near_plane) forward."""
    depth: float
    """Where it ends."""
    side_low: wp.vec2
    """Along the next two axes, in cyclic order: at depth d, a ray is between side_low + rise_low d ..."""
    side_high: wp.vec2
    """... and side_high + rise_high d."""
    rise_low: wp.vec2
    rise_high: wp.vec2
    margin: float
    """What these four planes may err by, and a hit may lie beside its triangle
    (`wrt.kernels.traversal.packet.culling.inverse_frustum`)."""
    few: FewRays
    """Numbers of the rays that meet the leaf at hand, if they are no more than `FEW` (`Culling.leaf`)."""
