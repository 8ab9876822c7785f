"""The queries of a scene: closest hits, occlusion, all hits, counts, and the plan of a query.

The time of a call of few rays is Python's: without options, a query is a row of a table, and is neither made nor checked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

from wrt.engine.executor import on_device
from wrt.engine.facts.query_kinds import ALL, ANY, AUTO, CLOSEST, COUNT, QUERIES, Query
from wrt.engine.plan.choices import find_choice
from wrt.engine.rays.rays import Rays, as_rays
from wrt.kernels.runtime.launch import use_threads
from wrt.query.answers import closest_hits, ray_values
from wrt.query.batches.block_queries import BlockQueries
from wrt.query.points.point_queries import PointQueries
from wrt.query.query_options import QueryKind, checked, lists_options, unknown_option
from wrt.tables import lookup
from wrt.tapes import refuse_tape, tape_records

if TYPE_CHECKING:
    import numpy as np
    import warp as wp
    from typing_extensions import Unpack

    from wrt.array_types import ArrayLike, ArrayT, Numbers, NumpyLike, WarpLike
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.query.all_hits import AllHits
    from wrt.query.hits import Hits
    from wrt.query.query_options import Closest, Counted, Listed, Occluded

INF = float("inf")


class Queries(BlockQueries, PointQueries):
    """The queries of a `wrt.Scene`. Each takes the rays to the device, makes a plan for them and traces them by it.

    Attributes:
        state: what a query reads of the scene, once, at its beginning.
    """

    state: SceneState

    @overload
    def intersect(self, origins: Rays[ArrayT], **options: Unpack[Closest]) -> Hits[ArrayT]: ...
    @overload
    def intersect(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Closest]
    ) -> Hits[np.ndarray]: ...
    @overload
    def intersect(
        self,
        origins: WarpLike,
        directions: ArrayLike,
        t_min: Numbers = ...,
        t_max: Numbers = ...,
        **options: Unpack[Closest],
    ) -> Hits[wp.array]: ...
    @overload
    def intersect(
        self,
        origins: NumpyLike,
        directions: WarpLike,
        t_min: Numbers = ...,
        t_max: Numbers = ...,
        **options: Unpack[Closest],
    ) -> Hits[wp.array]: ...
    @lists_options
    def intersect(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
        counters: bool = False,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        areas: Numbers | None = None,
        skip: Hits | Numbers | None = None,
        precise: bool = False,
        **unknown: Any,
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
            areas: in a scene of a `wrt.known_rays.RayAwareBvh`, an int or (...) integers: the influence area of each ray, by
                its place in the accelerator's `areas`, -1 for none; None to find it. Saves the search, and for one area that
                all triangles touch everything else. A wrong area costs time, and changes no hit. Has no effect with `skip` or
                `precise`.
            cull_backfaces: whether rays hit only the front of triangles, from where their vertices are in counter-clockwise
                order. Not all traversals support this; "auto" chooses one that does.
            skip: each ray ignores one triangle, usually the one that it starts on; None for none. Either the `wrt.Hits` of this
                scene at which the rays start (a miss skips nothing), or, in a scene of one mesh or instance, (...) primitive
                ids, -1 for none; the leading shape broadcasts to that of the rays. Neighbouring and coincident triangles are
                not skipped. Rays are traced one at a time. To leave the surface instead of ignoring one triangle, start rays
                from `Hits.spawn`.
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
                `wrt.moving.FuzzyScene`, with ids of no triangle, hits of another scene, or a shape that does not broadcast to
                that of the rays; rays that require gradients inside a `wp.Tape` (call `wrt.device.differentiable_hits` for
                gradients).
        """
        if unknown:
            raise unknown_option(Queries.intersect, unknown)
        plain = traversal is triangle_test is AUTO and cull_backfaces is counters is precise is False
        if plain and mask is environment is areas is skip is None:
            query = QUERIES[CLOSEST]
        else:
            options = (traversal, triangle_test, cull_backfaces, counters, mask, environment, areas, skip, precise)
            query = checked(Query(CLOSEST, *options))
        if tape_records():
            rays = as_rays(origins, directions, t_min, t_max)
            refuse_tape("intersect", (rays.origins, rays.directions))
        return closest_hits(self.state, (origins, directions, t_min, t_max), query)

    @overload
    def occluded(self, origins: Rays[ArrayT], **options: Unpack[Occluded]) -> ArrayT: ...
    @overload
    def occluded(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Occluded]
    ) -> np.ndarray: ...
    @overload
    def occluded(
        self,
        origins: WarpLike,
        directions: ArrayLike,
        t_min: Numbers = ...,
        t_max: Numbers = ...,
        **options: Unpack[Occluded],
    ) -> wp.array: ...
    @overload
    def occluded(
        self,
        origins: NumpyLike,
        directions: WarpLike,
        t_min: Numbers = ...,
        t_max: Numbers = ...,
        **options: Unpack[Occluded],
    ) -> wp.array: ...
    @lists_options
    def occluded(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        areas: Numbers | None = None,
        skip: Hits | Numbers | None = None,
        **unknown: Any,
    ) -> Any:
        """Whether each ray hits anything. The search ends at the first hit found.

            dark = scene.occluded(points, toward_light, t_max=1.0)
            lit = hits.faces(d) & ~scene.occluded(hits.spawn(d), d)  # the fronts of surfaces that were hit

        A ray to a light behind a surface leaves its back, where nothing may be in the way: `wrt.Hits.faces` tells these apart.

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first four arguments.
            directions: (..., 3), of any length from 2^-126 up; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; hits count if t_min <= t <= t_max (closed interval). 0 <= t_min < inf.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            cull_backfaces: whether rays hit only the front of triangles, from where their vertices are in counter-clockwise
                order.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances whose masks have a
                bit in common with it; None for all bits.
            environment: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances of its
                environment and those of environment -1; a ray of environment -1, or None, sees those of all.
            areas: in a scene of a `wrt.known_rays.RayAwareBvh`, an int or (...) integers: the influence area of each ray,
                -1 for none; None to find it. Has no effect with `skip`.
            skip: the triangle that each ray ignores: the `wrt.Hits` of this scene at which the rays start, or, in a scene of
                one mesh or instance, (...) primitive ids, -1 for none; None for none.

        Returns:
            (...) bool, a NumPy array if the rays were, else a Warp array.

        Raises:
            TypeError, ValueError: as `intersect`.
        """
        if unknown:
            raise unknown_option(Queries.occluded, unknown)
        if traversal is triangle_test is AUTO and cull_backfaces is False and mask is environment is areas is skip is None:
            query = QUERIES[ANY]
        else:
            query = checked(Query(ANY, traversal, triangle_test, cull_backfaces, False, mask, environment, areas, skip))
        return ray_values(self.state, (origins, directions, t_min, t_max), query)

    @overload
    def intersect_all(self, origins: Rays[ArrayT], **options: Unpack[Listed]) -> AllHits[ArrayT]: ...
    @overload
    def intersect_all(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Listed]
    ) -> AllHits[np.ndarray]: ...
    @overload
    def intersect_all(
        self, origins: WarpLike, directions: ArrayLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Listed]
    ) -> AllHits[wp.array]: ...
    @overload
    def intersect_all(
        self, origins: NumpyLike, directions: WarpLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Listed]
    ) -> AllHits[wp.array]: ...
    @lists_options
    def intersect_all(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        max_hits: int | None = None,
        **unknown: Any,
    ) -> AllHits:
        """All hits of each ray, sorted by t, then geometry, then triangle.

        Each crossing of a surface is one hit. A ray through an edge or a vertex hits exactly one of the triangles there
        that it enters, so a line through a closed surface has an even number of hits. Of coincident triangles, each is hit.
        A triangle seen edge-on is not hit. (At an edge, `intersect` may return another of the adjacent triangles.)

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first four arguments.
            directions: (..., 3), of any length from 2^-126 up; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; hits count if t_min <= t <= t_max (closed interval). 0 <= t_min < inf.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`; not every one supports this
                query.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`;
                likewise.
            cull_backfaces: whether rays hit only the front of triangles, from where their vertices are in counter-clockwise
                order.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances whose masks have a
                bit in common with it; None for all bits.
            environment: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances of its
                environment and those of environment -1; a ray of environment -1, or None, sees those of all.
            max_hits: largest number of hits kept for each ray, the nearest ones; at least 1, or None for all. This saves
                memory, not time: all hits are found.

        Raises:
            TypeError: an argument has a wrong type.
            ValueError: as `intersect`; a traversal or triangle test that does not support this query; more than 2^31 - 1
                hits.
        """
        if unknown:
            raise unknown_option(Queries.intersect_all, unknown)
        from wrt.query.all_hits import list_hits

        query = checked(Query(ALL, traversal, triangle_test, cull_backfaces, False, mask, environment, max_hits=max_hits))
        rays = as_rays(origins, directions, t_min, t_max)
        refuse_tape("intersect_all", (rays.origins, rays.directions))
        return list_hits(self.state, rays, query)

    @overload
    def count(self, origins: Rays[ArrayT], **options: Unpack[Counted]) -> ArrayT: ...
    @overload
    def count(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Counted]
    ) -> np.ndarray: ...
    @overload
    def count(
        self,
        origins: WarpLike,
        directions: ArrayLike,
        t_min: Numbers = ...,
        t_max: Numbers = ...,
        **options: Unpack[Counted],
    ) -> wp.array: ...
    @overload
    def count(
        self,
        origins: NumpyLike,
        directions: WarpLike,
        t_min: Numbers = ...,
        t_max: Numbers = ...,
        **options: Unpack[Counted],
    ) -> wp.array: ...
    @lists_options
    def count(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        skip: Hits | Numbers | None = None,
        **unknown: Any,
    ) -> Any:
        """Number of hits of each ray, equal to the number that `intersect_all` lists.

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first four arguments.
            directions: (..., 3), of any length from 2^-126 up; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; hits count if t_min <= t <= t_max (closed interval). 0 <= t_min < inf.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`; not every one supports this
                query.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`;
                likewise.
            cull_backfaces: whether rays hit only the front of triangles, from where their vertices are in counter-clockwise
                order.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances whose masks have a
                bit in common with it; None for all bits.
            environment: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances of its
                environment and those of environment -1; a ray of environment -1, or None, sees those of all.
            skip: the triangle that each ray ignores: the `wrt.Hits` of this scene at which the rays start, or, in a scene of
                one mesh or instance, (...) primitive ids, -1 for none; None for none.

        Returns:
            (...) int32, a NumPy array if the rays were, else a Warp array.

        Raises:
            TypeError, ValueError: as `intersect_all`.
        """
        if unknown:
            raise unknown_option(Queries.count, unknown)
        if traversal is triangle_test is AUTO and cull_backfaces is False and mask is environment is skip is None:
            query = QUERIES[COUNT]
        else:
            query = checked(Query(COUNT, traversal, triangle_test, cull_backfaces, False, mask, environment, skip=skip))
        return ray_values(self.state, (origins, directions, t_min, t_max), query)

    @lists_options
    def explain(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        query: QueryKind = "closest",
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
    ) -> Plan:
        """The plan by which these rays would be traced, with the reason for it. Nothing is traced.

        Args:
            origins: (..., 3), or a `wrt.Rays`, which replaces the first four arguments.
            directions: (..., 3), of any length from 2^-126 up; leading shapes broadcast.
            t_min, t_max: scalars or (...) arrays; hits count if t_min <= t <= t_max (closed interval). 0 <= t_min < inf.
            query: "closest" (`intersect`), "any" (`occluded`), "count", "all" (`intersect_all`) or "winding" (`contains`).
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            cull_backfaces: whether rays hit only the front of triangles, from where their vertices are in counter-clockwise
                order.
            mask: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances whose masks have a
                bit in common with it; None for all bits.
            environment: in a scene of instances, an int or (...) integers of 32 bits: a ray sees the instances of its
                environment and those of environment -1; a ray of environment -1, or None, sees those of all.

        Raises:
            TypeError, ValueError: as `intersect`.
        """
        rays, scene = as_rays(origins, directions, t_min, t_max), self.state
        kind = lookup(QUERIES, query, "query").kind
        asked = checked(Query(kind, traversal, triangle_test, cull_backfaces, False, mask, environment))
        with use_threads(scene.num_threads):
            brought = on_device(scene, rays, asked)
            chosen, contest = find_choice(scene, brought.facts, asked, brought.sample)
            if contest is None:
                return chosen.plan
            contest.show(contest.best(scene))
            return contest.shown
