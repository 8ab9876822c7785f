"""The queries of a scene: closest hits and points, occlusion, all hits, counts, inside tests, visibility, and a check."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from wrt.execution.executor import on_device
from wrt.kernels.runtime.launch import use_threads
from wrt.planning.planner import find_plan
from wrt.query.answers import closest_hits, ray_values
from wrt.query.batches.block_rows import as_source
from wrt.query.blocks import blocks_of
from wrt.query.query_options import (
    BlockOptions,
    ClosestBlockOptions,
    ClosestOptions,
    ExplainOptions,
    ListOptions,
    OcclusionOptions,
    ValueOptions,
    as_query,
    check_options,
    new_query,
    takes,
)
from wrt.rays.rays import as_rays
from wrt.state.query_kinds import ALL, ANY, AUTO, CLOSEST, COUNT, QUERIES
from wrt.tables import lookup
from wrt.tapes import refuse_tape

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from wrt.planning.plan import Plan
    from wrt.query.all_hits import AllHits
    from wrt.query.blocks import Blocks
    from wrt.query.hits import Hits
    from wrt.query.points.closest_points import ClosestPoints
    from wrt.query.verification import Verification
    from wrt.state.scene_state import SceneState


INF = float("inf")


class Queries:
    """The queries of a `wrt.Scene`. Each takes the rays to the device, makes a plan for them and traces them by it.

    Attributes:
        state: what a query reads of the scene, once, at its beginning.
    """

    state: SceneState

    @takes(ClosestOptions)
    def intersect(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[ClosestOptions]
    ) -> Hits:
        """Closest hits.

        Of hits at the same t, the one with the smallest geometry index, then the smallest triangle index, is returned. The
        result depends neither on the tree, nor on the traversal, nor on the number of threads. A ray with a NaN or an
        infinity, or with a zero direction, misses.

        Directions need not be unit vectors; t is in units of their length. In float32, components smaller than 2^-126
        (1.2e-38), or smaller than 2^-100 times the largest component, are taken as 0. A direction with no other component
        is a zero direction, and a direction shorter than 2^-100 (7.9e-31) has less precision than float32. Geometry so far
        away that t exceeds the largest float32 (3.4e38) is not hit: t of a hit is always finite.

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first four arguments.
            directions: (..., 3), of any length from 2^-126 up; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; hits count if t_min <= t <= t_max (closed interval). 0 <= t_min < inf.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances whose masks have a
                bit in common with it (`wrt.Instance`); None for all bits.
            environment: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances of its
                environment and those of environment -1; a ray of environment -1, or None, sees those of all. Rays are fast if
                neighbours have the same environment.
            areas: in a scene of a `wrt.RayAwareBvh`, an int or (...) integers: the influence area of each ray, by its place in
                the accelerator's `areas`, -1 for none; None to find it. Saves the search, and for one area that all triangles
                touch everything else. A wrong area costs time, and changes no hit. Has no effect with `skip` or `precise`.
            cull_backfaces: whether rays hit only the front of triangles, from where their vertices are in counter-clockwise
                order. Not all traversals support this; "auto" chooses one that does.
            skip: each ray ignores one triangle, usually the one that it starts on. Either the `wrt.Hits` of this scene at
                which the rays start (a miss skips nothing), or, in a scene of one mesh or instance, (...) primitive ids, -1 for
                none; the leading shape broadcasts to that of the rays. Neighbouring and coincident triangles are not skipped.
                Rays are traced one at a time. To leave the surface instead of ignoring one triangle, start rays from
                `Hits.spawn`.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `Plan`, such as `explain` returns. A plan
                also determines the triangle test.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            counters: whether to count each ray's work (`Hits.counters`).
            precise: whether to answer as brute force in float64 would, on rays and vertices as given, without rounding
                them to float32: the triangle, t, uv, position and normal, the last four in float64. A direction that is zero
                or infinite in float32 misses. Uses a traversal and a triangle test of its own. Instances are mapped in float64.

        Raises:
            TypeError: an argument has a wrong type.
            ValueError: wrong shapes, a range that is negative or NaN, an unknown name, arrays on another device; `areas` in a
                scene without influence areas, or numbers of none; `precise` together with a traversal, a triangle test,
                counters or culling; `skip` together with a traversal, a triangle test, counters or `precise`, in a
                `wrt.FuzzyScene`, with ids of no triangle, hits of another scene, or a shape that does not broadcast to that of
                the rays; rays that require gradients inside a `wp.Tape` (call `wrt.differentiable_hits` for gradients).
        """
        query = as_query(Queries.intersect, CLOSEST, options)
        rays = as_rays(origins, directions, t_min, t_max)
        refuse_tape("intersect", (rays.origins, rays.directions))
        return closest_hits(self.state, rays, query)

    @takes(OcclusionOptions)
    def occluded(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[OcclusionOptions]
    ) -> Any:
        """Whether each ray hits anything: (...) bool, a NumPy array if the rays were, else a Warp array.

        Arguments and errors as in `intersect`. The search ends at the first hit found.
        """
        query = as_query(Queries.occluded, ANY, options)
        return ray_values(self.state, as_rays(origins, directions, t_min, t_max), query)

    @takes(ListOptions)
    def intersect_all(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[ListOptions]
    ) -> AllHits:
        """All hits of each ray, sorted by t, then geometry, then triangle.

        Each crossing of a surface is one hit. A ray through an edge or a vertex hits exactly one of the triangles there
        that it enters, so a line through a closed surface has an even number of hits. Of coincident triangles, each is hit.
        A triangle seen edge-on is not hit. (At an edge, `intersect` may return another of the adjacent triangles.)

        Args:
            origins, directions, t_min, t_max, mask, environment, cull_backfaces, traversal, triangle_test: as in `intersect`;
                not every traversal and triangle test supports this query.
            max_hits: largest number of hits kept for each ray, the nearest ones; at least 1, or None for all. This saves
                memory, not time: all hits are found.

        Raises:
            TypeError: an argument has a wrong type.
            ValueError: as `intersect`; a traversal or triangle test that does not support this query; more than 2^31 - 1
                hits.
        """
        from wrt.query.all_hits import list_hits

        query = as_query(Queries.intersect_all, ALL, options)
        rays = as_rays(origins, directions, t_min, t_max)
        refuse_tape("intersect_all", (rays.origins, rays.directions))
        return list_hits(self.state, rays, query)

    @takes(ValueOptions)
    def count(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[ValueOptions]
    ) -> Any:
        """Number of hits of each ray: (...) int32, a NumPy array if the rays were, else a Warp array.

        Equal to the number of hits that `intersect_all` lists. Arguments and errors as there, and `skip` as in `intersect`.
        """
        query = as_query(Queries.count, COUNT, options)
        return ray_values(self.state, as_rays(origins, directions, t_min, t_max), query)

    @takes(ClosestBlockOptions)
    def intersect_blocks(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[ClosestBlockOptions]
    ) -> Blocks:
        """Closest hits of any number of rays, block by block: iterate over pairs (rows, hits), or call `write` or `result`.

            for rows, hits in scene.intersect_blocks(np.load("origins.npy", mmap_mode="r"), direction, progress=True):
                nearest[rows] = hits.t
            scene.intersect_blocks(origins, directions, executor=client.get_executor()).write({"t": t})  # on a cluster

        The hits equal those of `intersect`, whatever the size of the blocks and whoever answers them.

        Args:
            origins, directions, t_min, t_max: as in `intersect`, with at least one leading axis. An array may be any object
                with a shape whose slices are arrays, such as an np.memmap; only the rows of a block are read and converted
                at a time. Alternatively, `origins` is an iterable of pairs (origins, directions) or of `wrt.Rays`, and
                `directions` is left out: items are answered in order, and items larger than a block in parts. Or it is a
                `wrt.GeneratedRays`: a function that makes the rays of given numbers.
            mask, environment, skip: as in `intersect`; arrays, and the hits of the whole batch, are cut into blocks with the
                rays. One number if the rays come from an iterator.
            memory: bound on the memory for a block, in bytes or as text such as "1.5 GB" or "512 MiB"; about 320 bytes a
                ray. A block has at least one row.
            progress: whether to show a progress bar on stderr.
            executor: who answers blocks, several at a time: a `concurrent.futures.Executor`, such as a ThreadPoolExecutor, a
                `wrt.cluster.ProcessPool` or Dask's `client.get_executor()`; or a `wrt.cluster.Workers`, which adds options.
                None for this process, one block after the other. Each worker needs the memory of a block for each task it runs
                at a time. Hits that come from another process are as those of a pickle.
            reduce: what is kept of the answers: "sum", "mean", "min", "max", "any", "all", a `wrt.cluster.Histogram`, a
                function(values, axes) that keeps the first axis, or an object with the methods of `wrt.cluster.Reduction`. Of
                closest hits, a dict from attributes to these, such as {"t": "min"}. Integers are summed as int64; sums of
                floats are exact, and rounded once. None keeps the answers.
            axis: axes of the rays' leading shape along which answers are reduced: an int, several, or None for all. Without the
                first axis among them, blocks have reduced rows; with it, only `result` gives the answer.
            traversal, triangle_test, precise: as in `intersect`.

        Raises:
            TypeError: an argument has a wrong type.
            ValueError: as `intersect`; rays without a leading axis, a bound that is not an amount of memory, an unknown
                reduction or axis. Values and types of arrays are checked block by block.
            RuntimeError: later, if the workers that took a block died each time.
        """
        check_options(Queries.intersect_blocks, options)
        return blocks_of(self, "intersect", as_source(origins, directions, t_min, t_max), **options)

    @takes(BlockOptions)
    def occluded_blocks(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[BlockOptions]
    ) -> Blocks:
        """Occlusion block by block: pairs (rows, bool array), or call `write`; arguments and errors as in
        `intersect_blocks`.
        """
        check_options(Queries.occluded_blocks, options)
        return blocks_of(self, "occluded", as_source(origins, directions, t_min, t_max), **options)

    @takes(BlockOptions)
    def count_blocks(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[BlockOptions]
    ) -> Blocks:
        """Numbers of hits block by block: pairs (rows, int32 array), or `write`; arguments and errors as in
        `intersect_blocks`.
        """
        check_options(Queries.count_blocks, options)
        return blocks_of(self, "count", as_source(origins, directions, t_min, t_max), **options)

    def points_on(self, primitive_id: Any, uv: Any = None, *, points: Any = None, instance_id: Any = None) -> Hits:
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

    def contains(self, points: Any, *, rule: str = "parity", traversal: str | Plan = AUTO) -> Any:
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

    def closest_point(self, points: Any, *, max_distance: Any = INF) -> ClosestPoints:
        """The closest point on the geometry to each point, and its triangle.

            near = scene.closest_point(points)
            near.distance, near.position, near.primitive_id, near.normal

        Distances are computed in float32, relative to the point (`wrt.kernels.points`). Of triangles at the same computed
        distance, as at an edge or a vertex, the one with the smallest geometry index, then the smallest triangle index, is
        returned. The result depends neither on the tree nor on the number of threads. A triangle without area counts as the
        segment or the point that it is. Positions up to 5e-4 of the distance apart may have the same distance in float32.

        Instances are searched one after the other, so time grows with their number; those with mask 0 are left out.

        A point with a NaN or an infinity finds nothing, nor does one that is farther than 1.8e19 from everything.

        Args:
            points: (..., 3).
            max_distance: scalar or (...) array, at least 0: a triangle is found if its distance is at most this (closed
                interval). Small ones make the search faster.

        Raises:
            TypeError: points or distances are not real numbers.
            ValueError: wrong shapes, a negative distance or a NaN, an array on another device; instances that are sheared or
                not scaled alike along all axes; a scene of fans, groups or fuzzy boxes.
        """
        from wrt.query.points.closest_point import closest_point

        return closest_point(self.state, points, max_distance)

    def visible(self, points_a: Any, points_b: Any) -> Any:
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

    @takes(ExplainOptions)
    def explain(
        self, origins: Any, directions: Any = None, t_min: Any = 0.0, t_max: Any = INF, **options: Unpack[ExplainOptions]
    ) -> Plan:
        """The plan by which these rays would be traced, with the reason for it. Nothing is traced.

        Args:
            origins, directions, t_min, t_max, mask, environment, cull_backfaces, traversal, triangle_test: as in `intersect`.
            query: "closest" (`intersect`), "any" (`occluded`), "count", "all" (`intersect_all`) or "winding" (`contains`).

        Raises:
            TypeError, ValueError: as `intersect`.
        """
        check_options(Queries.explain, options)
        rays, scene = as_rays(origins, directions, t_min, t_max), self.state
        query = new_query(lookup(QUERIES, options.pop("query", CLOSEST), "query").kind, options)
        with use_threads(scene.num_threads):
            return find_plan(scene, on_device(scene, rays, query), query).plan
