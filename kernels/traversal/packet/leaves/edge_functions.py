"""Which triangles of a block the rays of a packet may meet, by linear edge functions: for rays through one point.

**Idea.** Let rays along (sx, sy, 1), in the order of axes that their main axis gives, start at a common point, and let p, q, r
be the vertices of a triangle relative to it. The three areas of Woop's test, such as a = (r - s r_z) x (q - s q_z), are linear
in the slopes: the product sx sy has the factor q_z r_z - r_z q_z = 0. So a = a0 + a1 sx + a2 sy, where (a1, a2, a0) is the
normal r x q of the plane through the point and an edge (Komatsu et al. 2008 precompute the same planes for frusta). The nine
coefficients are computed for W triangles at a time, and a pair of a ray and a triangle takes six fused multiply-adds.

**Which packets.** All lines pass through the box of `PacketBounds.origin_in` and `origin_out`: rays from one point, and shadow
rays to a point light, whose bounds are seen from their ends (`wrt.kernels.traversal.packet.rays.reversed_bounds`). It must not
be larger than rounding makes it (`WIDEST`). The rays need one main axis in common. Others are tested by `WoopPairs.may_meet`.

**Exactness.** A pair is left out only if one area is below -e and another above e, where e bounds the difference to the areas
that the test computes. To first order in u:

    u      2^-24
    M      largest distance along an axis of a vertex from the point or an origin
    h      largest component of an edge
    S      the packet's slack, S >= 16 u M
    d      half the size of the box of the lines; S - u M <= d, as its ends are rounded, so S <= 1.07 d
    s      slopes of a ray, |s| <= 1
    D      greatest size of a sheared vertex of a hit

    edge r - q                    u h
    vertex less the point         u M
    a coefficient                 two products of an edge and a vertex and their difference: 2 (3 u h M) + 2 u h M = 8 u h M
    three of them                 24 u h M, and two sums of up to 4 h M and 6 h M: 34 u h M
                                  <= 2.2 S h
    a line passes the point       at 2 d, along x and y where z is that of the point
    edges are sheared to          2 h along each axis, so areas change by 2 d (2 h + 2 h) = 8 d h
    D <= 2 h + 3 S                a hit is accepted only if the ray meets the triangle's box, widened by its slack
    D <= 2 M                      |V_x - s V_z|, and slopes are at most 1
    a sheared vertex              3.1 u M + u D
    an area                       4 D (3.1 u M + u D) + 4 u D^2 = 12.4 u M D + 8 u D^2
                                  <= (12.4 / 16) S D + S D = 1.78 S D, by D <= 2 M in one factor of the second term
                                  <= 3.6 S h + 5.4 S^2
    sum                           5.8 S h + 8 d h + 5.4 S^2 <= 14.3 d h + 6.2 d^2

That is less than e = 16 d (h + d): a ninth of the first term is slack, and more than half of the second. `TINY` is for products
that underflow; packets whose coordinates are so large that products might overflow are not tested this way (`LARGEST`).
Searched by `edges` of tests/bounds.

References: komatsu-2008; woop-2013.
"""

WIDEST = 4.0
"""Greatest half size of the box through which all lines pass, as a multiple of the packet's slack."""

ERROR = 16.0
"""Factor of the bound e; see the module docstring."""

TINY = 1e-36
"""Added to e: much more than products lose that underflow."""

LARGEST = 1e12
"""Half sizes of the box above which products might overflow: those of a scene of 10^18 units."""

GUARDS = f"""
static_assert(wrt::WIDEST == {WIDEST!r}f && wrt::EDGE_ERROR == {ERROR!r}f);
static_assert(wrt::EDGE_TINY == {TINY!r}f && wrt::LARGEST_HALF == {LARGEST!r}f);
"""
"""C++: the constants have these values."""
