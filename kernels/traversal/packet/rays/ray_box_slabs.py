"""Each ray of a packet against one box: C++ shared by all loops over the rays of a packet."""

SLABS = """
                    const float ix = inverse_x[k], iy = inverse_y[k], iz = inverse_z[k], wide = SHARED ? slack0 : slack[k];
                    const float ox = SHARED ? origin0[0] : origin_x[k], oy = SHARED ? origin0[1] : origin_y[k],
                                oz = SHARED ? origin0[2] : origin_z[k];
                    const bool back_x = ix < 0.0f, back_y = iy < 0.0f, back_z = iz < 0.0f;
                    const float step_x = back_x ? -wide : wide, step_y = back_y ? -wide : wide, step_z = back_z ? -wide : wide;
                    float s;
                    s = ((back_x ? high[0] : low[0]) - (ox + step_x)) * ix; enter = s > enter ? s : enter;
                    s = ((back_y ? high[1] : low[1]) - (oy + step_y)) * iy; enter = s > enter ? s : enter;
                    s = ((back_z ? high[2] : low[2]) - (oz + step_z)) * iz; enter = s > enter ? s : enter;
                    s = ((back_x ? low[0] : high[0]) - (ox - step_x)) * ix; leave = s < leave ? s : leave;
                    s = ((back_y ? low[1] : high[1]) - (oy - step_y)) * iy; leave = s < leave ? s : leave;
                    s = ((back_z ? low[2] : high[2]) - (oz - step_z)) * iz; leave = s < leave ? s : leave;
"""
"""Ray k against the box `low[3]`, `high[3]`: shrinks [`enter`, `leave`] as `wrt.kernels.simd.boxes.slab_interval` does."""

SHARED_ORIGIN = """
    const float slack0 = bounds.slack;
    const float origin0[3] = {bounds.origin_low.c[0], bounds.origin_low.c[1], bounds.origin_low.c[2]};
"""
"""The values that `SLABS` takes from the packet's bounds if all rays start at one point."""
