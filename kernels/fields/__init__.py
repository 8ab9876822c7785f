"""Fields around surfaces: generalised winding numbers by clusters of triangles, and signs of distances by pseudonormals.

**Problem.** The winding number of a point is the sum of the solid angles of all triangles, seen from it, over 4 pi: a whole
number where the surface is closed, and a soft vote where it has holes. A test of each triangle for each point is too slow.

**Idea.** From afar, the triangles of a node look like a few numbers (Barill et al. 2018). Let a_i be the triangles' area
vectors and x_i points of them. Around a centre c, the field G(x) = (x - p) / (4 pi |x - p|^3) is expanded into

    sum of a_i . G(c) + (a_i (x - c)^T) : grad G(c) + 1/2 (a_i (x - c)^T (x - c)^T) : grad grad G(c)

with means over each triangle, which its vertices and its centroid give exactly. Of the second and the third sum, only the
symmetric parts without traces count, because the derivatives of G are symmetric and have no traces: 3 + 5 + 7 numbers, and the
centre.

**Bound.** Let A be the sum of the areas, r the distance of the farthest vertex from c, and R that of the point. The k-th term
of the expansion of 1 / |x - p| is r^k P_k / R^(k + 1), and its gradient is at most k r^(k - 1) / R^(k + 1), by the inequality
of Bernstein and Szegő for trigonometric polynomials. All terms behind the third are together at most

    A / (4 pi R^2) (4 q^3 - 3 q^4) / (1 - q)^2  <=  A / (4 pi R^2) 4 q^3 / (1 - q)^2,    q = r / R

A cluster is taken as a whole if the last fraction is at most `accuracy`. The error is then at most `accuracy` times the sum of
A / (4 pi R^2) over the clusters, the part of the sphere that the triangles would cover if they all faced the point: about 1
inside a round body, little outside, and growing with the logarithm of the distance near a surface. Errors of clusters cancel,
so that what is measured is some thousandth of the bound (docs/guides/distances.md). Rounding of float32 adds about 1e-6 of
each.

**Search.** The numbers of each child of a wide node are stored in lanes, so that one loop
evaluates all of them. Children that are too near are pushed. Triangles of leaves have their solid angles computed in lanes,
with an arc tangent by a polynomial (error 1e-8) fitted to it.

    cluster_moments.py   the numbers of each child of each node
    grid_points.py       points of regular grids in blocks, and their values
    winding_walk.py      the kernel that walks a tree, by kernels/native/winding.h
    disc_samples.py      points of a surface that are apart from each other
    column_sums.py       sums of weights, in groups, of the rows in which the booleans of columns are true
    exposures.py         rays from surfaces to given directions, and sums of the light that arrives
    distance_signs.py    the side of a surface on which a point is, by the normals at what is nearest, and distances with signs

References: barill-2018; jacobson-2013; van-oosterom-strackee-1983; baerentzen-aanaes-2005.
"""
