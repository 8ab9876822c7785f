"""Points as surfaces for rays: a sphere around each point, a disc across its normal, or a box along the axes.

**Search.** A wide BVH over the boxes of the points is walked by the walk of single rays
(`wrt.kernels.traversal.single.key_walk`), W boxes at a time, or by streams and interleaved walks, to which points are a test
with a filter and a decision of its own. In a leaf, W points are filtered at a time, in float32; the few that are left are
decided one by one, in float64. What is decided depends on the ray and the point alone.

**Decision.** With x the vector from the ray's origin to the centre and D the direction, the foot of the perpendicular is at
b = x . D / D . D, and the line meets the sphere if f = x - b D is no longer than the radius r:

    t = b -+ sqrt((r^2 - f . f) / D . D)

The usual form of the quadratic equation subtracts r^2 from x . x, which are almost equal for a sphere that is far away; f . f
is as small as r^2 (Haines et al. 2019). In float64, with positions of float32, t is right to some 2^-50 of |x| / |D|, far below
the rounding of the stored float32. A disc across the normal n is met at t = n . x / n . D, if t D - x is no longer than r; one
that is seen exactly edge-on is not met. Of a sphere, the first root from t_min on counts: a ray that starts in a sphere meets
its far side. A box is met by slabs, in float64, and counts as a sphere does.

**Filter.** It computes f for W points in float32, with the unit direction e in place of D, and keeps those whose |f| is at most
r + m; of a box, r is half its diagonal, rounded by 4 u r, and 10^-22 more, as squares may underflow. No point that the line
meets is lost. With u = 2^-24, and s the sum of the radius and of the sizes of x's components, which is at least |x| + r:

    x       is rounded by u |x|
    e       is off by 2 u from the direction (a division, a product), and its length by 5 u: f is off by (2 * 2 + 2 * 5) u |x|
    x . e   is rounded by 3 u |x|, and f by as much again
    sum     21 u |x|
    r + m, and the squares that are compared: 5 u s; r of a box: 4 u r

so m = 2^-18 s = 64 u s is enough. The bound covers origins at any distance, as s grows with it. Where squares overflow, the
comparison is with an infinity or a NaN, and keeps the point.

**One answer.** A candidate is clamped to the interval in which the ray is in the point's own widened box, by the consistency
rule of `wrt.kernels.simd.boxes`; boxes of nodes contain those of their points. So the walk finds the hits of brute force, to
the bit; ties go to the smaller number. The exact root lies in that interval, whose slack is 16 u R: rounding of the box's
corners takes 1 of the 12 that are left for the test, and the box of a disc is enlarged by 2^-20 of the radius for its normal.

**Coordinates of a hit.** u and v say where on its point a ray has met it. On a disc, they are coordinates in its plane over
the radius, in the frame of Duff et al. (2017); on a sphere those of the normal on an unfolded octahedron (Cigolle et al.
2014), and on a box those of the direction in which the place is, after the box was made a cube. So positions and normals can
be computed later, without the ray, to the precision of the point.

    cloud_test.py      the ray for filter and decision, and the boxes and records of points
    cloud_walk.py      the kernels of a cloud: a walk, and brute force
    tangent_planes.py  hits as triangles in tangential planes, for all that is computed from triangles

References: haines-2019; duff-2017; cigolle-2014.
"""
