"""Queries about points: the triangles that are nearest to each, by brute force, through wide BVHs and through kd-trees.

**Problem.** Of all triangles, find the one with the least distance from a point, without a test of each.

**Distance.** Everything is relative to the point: vertices are subtracted first, so that rounding is relative to their
distance and not to that of the scene's centre. The nearest point of a triangle is on an edge, or it is the foot of the
perpendicular (`wrt.kernels.points.point_triangle`):

* Along an edge e from its nearer end p, t = -(p . e) / (e . e), clamped to [0, 1]. Both triangles at an edge get the same bits,
  unless its ends are equally far. An edge without length gives its end.
* The foot has the weights n . (c' x a) / n . n and n . (a x b') / n . n, with the edges b', c' from a, and n = b' x c'. It
  counts if all weights are positive, and if it is not farther than the edges by more than rounding. For triangles that are
  nearly flat, too large or too small, weights are computed in float64.

The result is always the length of a + v b' + w c', whose weights are those of a point of the triangle, to rounding. So a
distance may come out too large where the weights are wrong, but not too small by more than rounding: that makes pruning safe.

**Bounds.** Let u = 2^-24 and R be the reach: the sum over the axes of the greatest distance of the scene's box from the point.
Then |a|, |b|, |c| <= R, and

    computed distance of a triangle  >=  true distance - 16 u R
    computed distance of a box       <=  true distance + 3 u R
    computed min(a.a, a.b, a.c)/|a|  <=  true distance + 10 u R

as a vertex has an error of u R, a sum of it and two weighted edges at most ten more of that size, a product a.b at most
5 u |a| R, and a square and its root two each. The third line is the distance of the nearest vertex along the line to a: no
point of the triangle is nearer along it. A box is left out if it is farther than the best triangle by more than
32 u R = 2^-19 R, and a triangle if its own box or that vertex is. No triangle that is as near, as computed, is left out with
it. So every tree, every width and brute force give the same triangle, with the same bits, whichever way they take. Of
triangles at the same computed distance, the one with the smallest id is kept. Squares of distances below 1e-18 are no normal
numbers, so the bound adds that.

**Search.** Depth first. The children of a wide node are tested in lanes, their squared distances sorted in a register, and
pushed so that the nearest is on top. In a kd-tree, the nearer child comes first, and a cell's distance is kept axis by axis
(Arya and Mount 1993). Points are sorted by cells along a Morton curve, and each begins with the triangles that were nearest to
the one before it: its first bound is nearly final (`wrt.kernels.points.point_order`). In a leaf, the last two lines above leave
out most triangles, without a division; the others wait side by side until they fill a register, and are tested together. W
points that follow each other begin at a node of their own: the subtrees that their box and the farthest of them from a triangle
near them leave, as deep as W of them allow. Points that are dense beside that triangle walk the tree in a packet, and each
triangle is tested for all of them. The k nearest triangles are kept sorted, and the bound is the distance of the last; those
within a distance are counted, then listed, sorted, and each kept once.

**Instances.** A map that keeps angles scales all distances alike. A BVH over the boxes of the instances is walked in the same
way. At a leaf, the point is mapped in float64 by the inverse and rounded once, and the instance's own tree is walked, up to
the least distance so far over the scale. Distances are compared in the scene: the computed one in the mesh's space times the
scale. As a map stretches the sum over the axes by up to the root of 3, and may differ from a similar one by 1e-6, boxes of
instances have 8 times the slack above.

**Limits.** Distances that differ by less than 2^-23 are the same in float32, so that of triangles side by side the one
with the smaller id may be taken, with a position 5e-4 of the distance beside the nearest one. A point with a NaN or an infinity
finds nothing, nor does one farther than 1.8e19 from all triangles: its square overflows.

    cell_sort.py        sorts points by the cells of point_order.py, by threads
    packed_points.py    the nearest triangle, through the nodes of persistent threads
    point_triangle.py   the distance in plain Warp, for brute force and for your own kernels
    point_batch.py      points and answers on the device
    point_order.py      the order in which points are searched
    device_points.py    points in your own kernels
    exact_points.py     the nearest triangle in float64
    point_gradients.py  closest points of given triangles, with adjoints
    tree_points.py      the kernels that walk trees, by kernels/native/point_groups.h and point_packets.h

References: ericson-2005 (section 5.1.5); arya-mount-1993; morton-1966.
"""
