"""Queries of a scene that take points: inside tests, closest points, visibility, points on triangles; a check of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

from wrt.engine.facts.query_kinds import AUTO
from wrt.kernels.validation import as_bool

if TYPE_CHECKING:
    import numpy as np
    import warp as wp

    from wrt.array_types import ArrayLike, Numbers, NumpyLike, WarpLike
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.meshes.instance import Instance
    from wrt.meshes.mesh import TriangleMesh
    from wrt.query.hits import Hits
    from wrt.query.inside import InsideRule
    from wrt.query.points.closest_points import ClosestPoints, TrianglesWithin
    from wrt.query.verification import Verification


INF = float("inf")


class PointQueries:
    """Queries of points.

    Attributes:
        state: what a query reads of the scene, once, at its beginning.
    """

    state: SceneState

    if TYPE_CHECKING:  # what every scene has, for functions that take one

        @property
        def device(self) -> wp.Device: ...
        @property
        def meshes(self) -> tuple[TriangleMesh, ...]: ...
        @property
        def instances(self) -> tuple[Instance, ...]: ...

    def points_on(
        self,
        primitive_id: Numbers,
        uv: Numbers | None = None,
        *,
        points: ArrayLike | None = None,
        instance_id: Numbers | None = None,
    ) -> Hits:
        """Points on triangles as hits that no ray made, so that rays can leave them: `Hits.spawn`, `Hits.faces`.

            facade = scene.points_on(triangles, points=samples)           # (N,), (N, 3)
            lit = facade.faces(sun) & ~scene.occluded(facade.spawn(sun), sun)

        Args:
            primitive_id: (...) integers, triangles within their mesh; -1 for none, which is a miss.
            uv: (..., 2) weights of the second and third vertex, each at least 0, and together at most 1.
            points: (..., 3) points in the scene's coordinates, in place of `uv`. Each is moved to the nearest point of its
                triangle. Without both, the points are the centroids.
            instance_id: (...) integers, the instances, or meshes in a scene without instances, that the triangles are of; may
                be left out if there is only one.

        Returns:
            Hits of the broadcast leading shape with t = 0, whose `plan` is None and whose positions are float64.

        Raises:
            TypeError: not numbers, or both `uv` and `points`.
            ValueError: a triangle or an instance that does not exist, shapes that do not broadcast, weights outside of the
                triangle, points farther from their triangle than a thousandth of its longest edge, or no `instance_id` in a
                scene of several.
        """
        from wrt.query.points.surface_points import points_on

        return points_on(self.state, primitive_id, uv, points, instance_id)

    @overload
    def contains(self, points: NumpyLike, *, rule: InsideRule = "parity", traversal: str | Plan = AUTO) -> np.ndarray: ...
    @overload
    def contains(self, points: WarpLike, *, rule: InsideRule = "parity", traversal: str | Plan = AUTO) -> wp.array: ...
    def contains(
        self, points: ArrayLike, *, rule: InsideRule = "parity", traversal: str | Plan = AUTO
    ) -> np.ndarray | wp.array:
        """Whether points are inside the geometry: (...) bool, a NumPy array if the points were, else a Warp array.

        Decided by the crossings of a ray from the point with the surface. By parity, the point is inside if their number is
        odd. The other rules take their signs, 1 where the ray leaves through the front of a triangle, from which its vertices
        are counter-clockwise, and -1 where it comes in. The sum is the winding number: how often the surface, with its front
        outside, surrounds the point.

        ============ ==================== ==========================================================================
        `rule`       inside where         right for
        ============ ==================== ==========================================================================
        `"parity"`   crossings are odd    one body, whichever way its triangles face; a shell within another is a
                                          cavity; where two bodies overlap is outside
        `"union"`    winding number > 0   bodies that overlap (assemblies), each with its front outside; a shell
                                          that faces inwards is a cavity; a body that is inside out is nowhere
        `"winding"`  winding number not 0 the same, also if the whole mesh is inside out; where a body overlaps with
                                          one that is inside out, they cancel
        ============ ==================== ==========================================================================

        If every mesh is closed (`TriangleMesh.is_closed`), the direction of the ray does not matter. For the last two rules,
        neighbouring triangles must face the same way, too. Otherwise the majority of three directions decides, which is
        unreliable near holes and triangles that are turned over. Of instances, those with mask 0 are left out; one whose
        transform mirrors has its front where that of its mesh was, so that a body remains one.

        A triangle that repeats an earlier one exactly, with the same side in front, is left out, unless another body is
        closed by it; so is an instance of an equal mesh with equal transform and environment. If there are any, the first
        call builds a second tree. A triangle that is there with both sides in front counts twice, as the common wall of
        two bodies that touch, and is neither crossed in nor out for the sum of signs. `verify` says what no rule can answer on
        a mesh.

        Points whose distance to the surface is within float32 rounding, relative to the scene's centre, may count as inside
        or outside. A point with a NaN or an infinity is outside.

        Args:
            points: (..., 3).
            rule: "parity", "union" or "winding".
            traversal: as in `count`.

        Raises:
            TypeError: points are not an array of real numbers, or the rule is not a string.
            ValueError: wrong shape, an array on another device, a traversal that does not count, or an unknown rule.

        References: shimrat-1962 (parity); jacobson-2013 (winding numbers).
        """
        from wrt.query.inside import contains

        return contains(self.state, points, traversal, rule)

    def closest_point(
        self,
        points: ArrayLike,
        *,
        max_distance: Numbers = INF,
        k: int | None = None,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        counters: bool = False,
        precise: bool = False,
    ) -> ClosestPoints:
        """The closest point on the geometry to each point, and its triangle.

            near = scene.closest_point(points)
            near.distance, near.position, near.primitive_id, near.normal

        Distances are computed in float32, relative to the point (`wrt.kernels.points`). Of triangles at the same computed
        distance, as at an edge or a vertex, the one with the smallest geometry index, then the smallest triangle index, is
        returned. The result depends neither on the tree nor on the number of threads. A triangle without area counts as the
        segment or the point that it is. Positions up to 5e-4 of the distance apart may have the same distance in float32.

        Of instances, those with mask 0 are left out. A tree over their boxes says which are near, so there may be thousands.

        A point with a NaN or an infinity finds nothing, nor does one that is farther than 1.8e19 from everything.

        Args:
            points: (..., 3).
            max_distance: scalar or (...) array, at least 0: a triangle is found if its distance is at most this (closed
                interval). Small ones make the search faster.
            k: how many nearest triangles are found, from 1 to 1024, sorted by distance, then geometry, then triangle; results
                then have the leading shape (..., k). Where there are fewer, the last ones are those of a point that finds
                nothing. Each triangle is listed once, with its own nearest point, which neighbours may share. None for the
                nearest triangle, without the axis.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a point sees the instances whose masks have a
                bit in common with it; None for all bits.
            environment: in a scene of instances, an int or (...) integers of 32 bits: a point sees the instances of its
                environment and those of environment -1; a point of environment -1, or None, sees those of all.
            counters: whether to count the work for each point (`ClosestPoints.counters`); not together with `k`.
            precise: whether to search in float64: the triangle and the distance are those of brute force in float64 on the
                points, the vertices and `max_distance` as they were given, and the result is a
                `wrt.results.PreciseClosestPoints`. Takes no `counters`.

        Raises:
            TypeError: points or distances are not real numbers, `k` is not an int, or masks or environments are not integers.
            ValueError: wrong shapes, a negative distance or a NaN, `k` out of range, an array on another device; masks or
                environments in a scene without instances; `precise` with what it does not take; instances that are sheared or
                not scaled alike along all axes; a scene of fans, groups or fuzzy boxes; points that require gradients inside a
                `wp.Tape` (call `wrt.device.differentiable_points` for gradients).
        """
        if as_bool("precise", precise):
            from wrt.query.points.precise_points import closest_point_precisely as closest_point
        else:
            from wrt.query.points.closest_point import closest_point  # type: ignore[assignment]

        return closest_point(self.state, points, max_distance, k, mask, environment, counters)

    def within(
        self,
        points: ArrayLike,
        radius: Numbers,
        *,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
    ) -> TrianglesWithin:
        """All triangles within a distance of each point, sorted by distance, then geometry, then triangle.

            near = scene.within(points, 0.05)
            first = slice(near.offsets[0], near.offsets[1])  # of point 0: near.primitive_id[first], near.distance[first] ...

        Distances and the choice of instances are those of `closest_point`, and so is what finds nothing: an empty list.

        Args:
            points: (..., 3).
            radius: scalar or (...) array, at least 0: a triangle is listed if its distance is at most this (closed interval).
            mask, environment: the instances that points see, as in `closest_point`.

        Raises:
            TypeError, ValueError: as `closest_point`; more than 2^31 - 1 triangles together.
        """
        from wrt.query.points.triangles_within import triangles_within

        return triangles_within(self.state, points, radius, mask, environment)

    @overload
    def visible(self, points_a: NumpyLike, points_b: NumpyLike) -> np.ndarray: ...
    @overload
    def visible(self, points_a: WarpLike, points_b: ArrayLike) -> wp.array: ...
    @overload
    def visible(self, points_a: NumpyLike, points_b: WarpLike) -> wp.array: ...
    def visible(self, points_a: ArrayLike, points_b: ArrayLike) -> np.ndarray | wp.array:
        """Whether pairs of points see each other: (...) bool, a NumPy array if both points were, else a Warp array.

            matrix = scene.visible(points[:, None], points[None, :])

        A pair is visible if no triangle crosses the open segment between its points. Points may lie on surfaces: a triangle
        whose plane contains one of the points up to rounding does not block the segment (rounding of float32 relative to
        the scene's centre, and of the points themselves if they are float32). So two points on one flat wall see each
        other, and a point on a wall is visible from both sides; `Hits.faces` tells on which side a direction is. A point sees
        itself. A point with a NaN or an infinity sees nothing. The relation is symmetric: visible(a, b) equals visible(b, a).

        Args:
            points_a, points_b: (..., 3); leading shapes broadcast. Pairs are processed in blocks of bounded memory.

        Raises:
            TypeError: points are not arrays of real numbers.
            ValueError: wrong shapes, shapes that do not broadcast, or an array on another device.
        """
        from wrt.query.points.visibility import visible

        return visible(self.state, points_a, points_b)

    def verify(self, samples: int = 1000, seed: int = 0) -> Verification:
        """Compares `intersect`, `occluded` and `contains` with brute force in float64, on this scene and this machine.

        Uses the scene's triangle test: `wrt.Scene(mesh, triangle_test="moeller_trumbore").verify()` checks another one.

            report = scene.verify()
            print(report)
            assert report.ok

        A quarter of the rays is random, a quarter is aimed at vertices, a quarter at edges, and a quarter grazes triangles.
        The reference tests every triangle against every ray, so the time grows with the number of triangles and of samples.
        `contains` is compared with winding numbers at as many points, at fewer if there are more than 20,000 triangles.

        Args:
            samples: number of rays, at least 4.
            seed: seed of the random rays, at least 0.

        Raises:
            TypeError: samples or seed is not an int.
            ValueError: samples or seed is too small, or the scene's triangle test needs rays with a shared origin.
        """
        from wrt.query.verification import verify

        return verify(self.state, samples, seed)
