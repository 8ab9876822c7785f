"""Pairs of meshes: the nearest points of two, and the triangles of two that meet, through both of their BVHs.

**Problem.** Of all pairs of a triangle of one mesh and one of another, find the nearest, or those that have a point in common,
without a test of each pair.

**Search.** Both trees are walked at a time (Quinlan 1994). A pair of boxes waits on a stack with their distance; the larger box
is opened, and its children that are near enough take its place, the nearest on top. Boxes of a mesh are mapped to the scene
when they are met, and enclosed by boxes along its axes, so that nothing is built for a placement. The pairs of boxes near both
roots are entries of a list, sorted by distance, which threads take; they share the least distance so far. Each entry keeps its
own nearest pair, and the first of these in the order of triangles is taken, so that the answer does not depend on threads.

**Distance.** Vertices are the caller's, mapped to the scene and rounded to float64; all else is float64 of these. Two triangles
that do not meet are nearest at a vertex of one and an edge or the face of the other, or at two edges: 33 candidates, the least
of which counts. Each is the distance of two points of the triangles, to rounding. So it may come out too large where the place
of a foot is wrong, but too small only by rounding. Places are corrected once by the same formula, from the difference that is
left: of edges at an angle of 1e-7, the distance is right to 1e-15 of their length, and without the correction to 1e-9.

**Bounds.** Trees hold vertices in float32 relative to the mesh's centre. The computed distance of two boxes is at most

    (distance of what is in them) + 2^-22 (r_a + r_b) + 2^-44 s

where r is the sum over the axes of how far a mesh reaches from its centre, in the scene, and s is the sum of the sizes of all
coordinates, of the maps too. The distance of the boxes of two triangles exceeds the computed one of the triangles by less than
2^-44 s. So does the gap between two boxes or triangles along any axis of length 1; that of the nearest points so far is tried,
from which a turned box looks thinner. What is farther than the best pair by more than that is left out; so pairs at the same
computed distance are all seen, and the smaller numbers are kept.

**Meeting.** Triangles are closed: a common vertex, or a vertex on a face, is a point in common. Two triangles meet if an edge
of one meets the other. If an edge is not in the other's plane, and its ends are not on one side of it, three determinants tell
whether it passes the triangle's edges on one side. In the plane, segments are compared after leaving out an axis along which
the plane is not seen edge on; a triangle without an area is its edges. All of it is signs of determinants, which are exact
(Shewchuk 1997): there is no tolerance. Vertices have been mapped and rounded before. Where triangles meet, the distance is 0.

    pair_walk.py   bodies, work and answers on the device, and the kernels

References: quinlan-1994; shewchuk-1997; dekker-1971.
"""
