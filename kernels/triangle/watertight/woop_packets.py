"""The watertight test (`wrt.kernels.triangle.watertight.woop`) for packets: W rays x one triangle, and W rays x a triangle for
each, with the same results bit for bit (kernels/native/woop_packets.h)."""

from wrt.kernels.triangle.support.lane_form import PacketForm

_RAYS = "const wrt::WoopRays rays_of = {{origin_x, origin_y, origin_z}, origin0, slope_x, slope_y, shear_z, main_axis};"

PACKET = PacketForm(
    state=("shear_z",),
    passes=3,
    prepare="shear_z[k] = wrt::along_main_axis(main_x, main_y, ix, iy, iz);",
    triangle=f"{_RAYS} wrt::WoopPacket<W, SHARED> woop(rays_of); woop.begin(corner, pass);",
    inside="alignas(4 * W) int inside[W]; if (!woop.meet(f, inside)) continue;",
    hit="const auto hit = woop.hit(i, k); at = hit.t; hit_u = hit.u; hit_v = hit.v;",
    ray=f"{_RAYS} wrt::woop_ray<SHARED>(rays_of, k, ray);",
    rays=_RAYS,
    pairs="wrt::WoopPairs<W, SHARED>(rays_of)",
    headers="woop_packets.h",
    certain=True,
)
"""W rays x one triangle: the same arithmetic, with one pass for each main axis that occurs among the rays."""
