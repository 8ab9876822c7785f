"""The queries of a scene: closest hits, occlusion, all hits, counts, inside tests, visibility, and a check of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from wrt.execution.executor import on_device
from wrt.execution.planner import find_plan
from wrt.execution.query_kinds import ALL, ANY, AUTO, CLOSEST, COUNT, Query
from wrt.kernels.runtime.launch import use_threads
from wrt.query.answers import closest_hits, ray_values
from wrt.query.blocks import BlockQueries
from wrt.rays.rays import as_rays
from wrt.tables import lookup
from wrt.tapes import refuse_tape

if TYPE_CHECKING:
    from wrt.execution.plan import Plan
    from wrt.execution.scene_state import SceneState
    from wrt.query.all_hits import AllHits
    from wrt.query.hits import Hits
    from wrt.query.verification import Verification


class Queries(BlockQueries):
    """The queries of a `wrt.Scene`. Each takes the rays to the device, makes a plan for them and traces them by it.

    Attributes:
        state: what a query reads of the scene, once, at its beginning.
    """

    state: SceneState

    def intersect(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        mask: Any = None,
        cull_backfaces: bool = False,
        skip: Any = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        counters: bool = False,
        precise: bool = False,
    ) -> Hits:
        """Closest hits.

        Among hits at the same t, the smaller geometry, then the smaller triangle wins: neither the tree, the traversal
        nor the number of threads shows in the result. A ray with a NaN or an infinity, or with a direction of zero, misses.

        Directions need not be unit, and t counts in units of their length. In float32, components below 2^-126 (1.2e-38), or
        below 2^-100 of the largest one, count as 0: a direction without any other is one of zero, and one that is shorter
        than 2^-100 (7.9e-31) has fewer digits than float32. What is so far away that t is no finite float32 (3.4e38 and
        less) is not hit: a hit's t is always finite.

        Args:
            origins: (..., 3) or a `wrt.Rays` (then leave the next three out).
            directions: (..., 3), of any length from 2^-126 on; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; a hit counts if t_min <= t <= t_max. 0 <= t_min < inf.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances that have a bit in
                common with it (`wrt.Instance`); None for all bits.
            cull_backfaces: whether triangles are hit only from their front, from which they are wound counter-clockwise. Not
                all traversals can: of those that can, "auto" takes the fastest.
            skip: each ray passes through one triangle as if it was not there: the one that it starts on. The `wrt.Hits` of this
                scene at which the rays start (misses skip nothing), or, in a scene of one mesh, (...) primitive ids, -1 for
                none; their leading shape broadcasts to that of the rays. Neighbours and coincident triangles stay. The rays go
                one by one, and `Hits.spawn` is the way for those that others than their own triangle stop at once.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a whole `Plan`, such as `explain` returns;
                the plan's triangle test then counts.
            triangle_test: "auto", the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            counters: whether to count each ray's work (`Hits.counters`).
            precise: whether to answer as brute force in float64 would, on rays and vertices as they were given (float32 ones
                are taken to be exact): which triangle is hit, t, uv, position and normal, the last four in float64. A direction
                that is too short or infinite in float32 misses. It has a traversal and a triangle test of its own.

        Raises:
            TypeError: an argument is of a wrong type.
            ValueError: wrong shapes, a range that is negative or NaN, unknown names, arrays on another device, or
                `precise` together with a traversal, a triangle test, counters or culling, or in a scene of instances; `skip`
                together with a traversal, a triangle test, counters or `precise`, in a scene of instances or of fuzzy boxes,
                of numbers of no triangle, of hits of another scene, or of a shape that does not broadcast to that of the rays;
                rays that take gradients inside a `wp.Tape` (`wrt.differentiable_hits` passes them on).
        """
        rays = as_rays(origins, directions, t_min, t_max)
        refuse_tape("intersect", (rays.origins, rays.directions))
        query = Query(CLOSEST, traversal, triangle_test, cull_backfaces, counters)
        return closest_hits(self.state, rays, query, mask, skip, precise)

    def occluded(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        mask: Any = None,
        cull_backfaces: bool = False,
        skip: Any = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> Any:
        """Whether anything is hit: (...) bool, a NumPy array if the rays were, else a Warp array.

        Arguments and errors as in `intersect`; the search ends at the first hit that it finds.
        """
        rays = as_rays(origins, directions, t_min, t_max)
        query = Query(ANY, traversal, triangle_test, cull_backfaces)
        return ray_values(self.state, rays, query, "occluded", mask, skip)

    def intersect_all(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        max_hits: int | None = None,
        mask: Any = None,
        cull_backfaces: bool = False,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> AllHits:
        """All hits of each ray, sorted by t, then geometry, then triangle.

        Each crossing of a surface is one hit: a ray that meets an edge or a vertex hits exactly one of the triangles that it
        passes into there, so that the line through a closed surface has an even number of hits. Coincident triangles are hit
        each; a triangle that is seen edge-on is not. (`intersect` may name another of the triangles at an edge.)

        Args:
            origins, directions, t_min, t_max, mask, cull_backfaces, traversal, triangle_test: as in `intersect`; not every
                traversal and triangle test answers this.
            max_hits: keep only so many of the nearest hits of each ray, at least 1; None for all. That saves memory, not
                time: all are found.

        Raises:
            TypeError: an argument is of a wrong type.
            ValueError: as `intersect`; a traversal or triangle test that does not answer this; more than 2^31 - 1 hits.
        """
        from wrt.query.all_hits import list_hits

        rays = as_rays(origins, directions, t_min, t_max)
        refuse_tape("intersect_all", (rays.origins, rays.directions))
        query = Query(ALL, traversal, triangle_test, cull_backfaces)
        return list_hits(self.state, rays, query, mask, max_hits)

    def count(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        mask: Any = None,
        cull_backfaces: bool = False,
        skip: Any = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> Any:
        """Number of hits of each ray: (...) int32, a NumPy array if the rays were, else a Warp array.

        What `intersect_all` would list, counted; arguments and errors as there, and `skip` as in `intersect`.
        """
        rays = as_rays(origins, directions, t_min, t_max)
        query = Query(COUNT, traversal, triangle_test, cull_backfaces)
        return ray_values(self.state, rays, query, "counts", mask, skip)

    def contains(self, points: Any, *, traversal: str | Plan = AUTO) -> Any:
        """Which points are inside: (...) bool, a NumPy array if the points were, else a Warp array.

        By parity: inside are those from which a ray crosses the surface an odd number of times. If every mesh is closed
        (`TriangleMesh.is_closed`), that does not depend on the ray's direction. If one is not, two of three directions
        decide, which is a guess near its holes. Of several meshes, or shells within each other, a point is inside if it is
        inside an odd number of them. Points nearer to the surface than float32 tells, relative to the scene's centre, may
        count as either; a point with a NaN or an infinity is outside.

        Args:
            points: (..., 3).
            traversal: as in `count`.

        Raises:
            TypeError: points are no array of real numbers.
            ValueError: wrong shape, an array on another device, a traversal that does not count.
        """
        from wrt.query.inside import contains

        return contains(self.state, points, traversal)

    def visible(self, points_a: Any, points_b: Any) -> Any:
        """Which pairs of points see each other: (...) bool, a NumPy array if both points were, else a Warp array.

            matrix = scene.visible(points[:, None], points[None, :])

        A pair is visible if no triangle crosses the open segment between the two. The points may lie on surfaces: a triangle
        whose plane passes through one of them within rounding (float32 relative to the scene's centre, float32 of the points
        themselves if they are given so) does not hide it from the other. So two points in one flat wall see each other, and
        what is on a wall is seen from both its sides. A point sees itself; one with a NaN or an infinity sees nothing.
        The answer is symmetric: visible(a, b) and visible(b, a) are the same.

        Args:
            points_a, points_b: (..., 3); leading shapes broadcast. Pairs go through memory in blocks.

        Raises:
            TypeError: points are no arrays of real numbers.
            ValueError: wrong shapes, shapes that do not broadcast, an array on another device.
        """
        from wrt.query.visibility import visible

        return visible(self.state, points_a, points_b)

    def verify(self, samples: int = 1000, seed: int = 0) -> Verification:
        """Checks `intersect` and `occluded` against brute force in float64, on this mesh and this machine.

        By the scene's triangle test: `wrt.Scene(mesh, triangle_test="moeller_trumbore").verify()` checks another one.

            report = scene.verify()
            print(report)
            assert report.ok

        A quarter of the rays each is random, aimed at vertices, aimed at edges, and grazing. The reference tests every
        triangle, one ray at a time on one core: some 25 ms a ray for a million triangles; it takes 550 bytes a triangle.

        Args:
            samples: number of rays, at least 4.
            seed: of the rays, at least 0.

        Raises:
            TypeError: samples or seed is no int.
            ValueError: it is too small, or the scene's triangle test needs rays that share their origin.
        """
        from wrt.query.verification import verify

        return verify(self.state, samples, seed)

    def explain(
        self,
        origins: Any,
        directions: Any = None,
        t_min: Any = 0.0,
        t_max: Any = float("inf"),
        *,
        query: str = CLOSEST,
        cull_backfaces: bool = False,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
    ) -> Plan:
        """How these rays would be answered, and why; nothing is traced.

        Args:
            query: "closest" (`intersect`), "any" (`occluded`), "count" or "all" (`intersect_all`).
            origins, directions, t_min, t_max, cull_backfaces, traversal, triangle_test: as in `intersect`.
        """
        rays = as_rays(origins, directions, t_min, t_max)
        lookup(dict.fromkeys((CLOSEST, ANY, COUNT, ALL)), query, "query")
        scene = self.state
        with use_threads(scene.num_threads):
            buffers = on_device(scene, rays, None)
            return find_plan(scene, buffers, Query(query, traversal, triangle_test, cull_backfaces)).plan
