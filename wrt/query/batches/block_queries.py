"""The queries of a scene that are answered block by block."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrt.engine.facts.query_kinds import AUTO
from wrt.query.batches.block_rows import as_source
from wrt.query.blocks import MEMORY, How, blocks_of
from wrt.query.query_options import chosen, lists_options

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from concurrent.futures import Executor

    from wrt.array_types import ArrayLike, Numbers
    from wrt.engine.plan.plan import Plan
    from wrt.query.batches.block_rows import HasRows, PointRows, RayRows
    from wrt.query.batches.reductions import ReduceBy
    from wrt.query.batches.workers import Workers
    from wrt.query.blocks import Blocks
    from wrt.query.hits import Hits

INF = float("inf")

UPWARDS = np.array([0.0, 0.0, 1.0], dtype=np.float32)
"""Direction of the rays that stand for points; nothing reads it."""


class BlockQueries:
    """Queries of any number of rays or points, which need not fit in memory."""

    @lists_options
    def intersect_blocks(
        self,
        origins: RayRows,
        directions: ArrayLike | HasRows | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        memory: int | str = MEMORY,
        progress: bool = False,
        executor: Executor | Workers | None = None,
        reduce: ReduceBy | Mapping[str, ReduceBy] | None = None,
        axis: int | Sequence[int] | None = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        skip: Hits | Numbers | None = None,
        precise: bool = False,
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
                `wrt.batches.GeneratedRays`: a function that makes the rays of given numbers.
            mask, environment, skip: as in `intersect`; arrays, and the hits of the whole batch, are cut into blocks with the
                rays. One number if the rays come from an iterator.
            memory: bound on the memory for a block, in bytes or as text such as "1.5 GB" or "512 MiB"; about 320 bytes a
                ray. A block has at least one row.
            progress: whether to show a progress bar on stderr.
            executor: who answers blocks, several at a time: a `concurrent.futures.Executor`, such as a ThreadPoolExecutor, a
                `wrt.cluster.ProcessPool` or Dask's `client.get_executor()`; or a `wrt.cluster.Workers`, which adds options.
                None for this process, one block after the other. Each worker needs the memory of a block for each task it runs
                at a time. Hits that come from another process are as those of a pickle.
            reduce: what is kept of the answers: "sum", "mean", "min", "max", "any", "all", a `wrt.batches.Histogram`, a
                `wrt.batches.WeightedSum`, a function(values, axes) that keeps the first axis, or an object with the methods of
                `wrt.batches.Reduction`. Of closest hits, a dict from attributes to these, such as {"t": "min"}. Integers are
                summed as int64; sums of floats are exact, and rounded once. None keeps the answers.
            axis: axes of the rays' leading shape along which answers are reduced: an int, several, or None for all. Without the
                first axis among them, blocks have reduced rows; with it, only `result` gives the answer, unless each array
                varies along reduced axes or along others only, as in `occluded_blocks(points, suns[:, None], axis=0)`: then
                the reduced axes are put last, and blocks have reduced rows.
            traversal, triangle_test, precise: as in `intersect`.

        Raises:
            TypeError: an argument has a wrong type.
            ValueError: as `intersect`; rays without a leading axis, a bound that is not an amount of memory, an unknown
                reduction or axis. Values and types of arrays are checked block by block.
            RuntimeError: later, if the workers that took a block died each time.
        """
        source, how = as_source(origins, directions, t_min, t_max), How(memory, progress, executor, reduce, axis)
        options = chosen(traversal=traversal, triangle_test=triangle_test, precise=precise)
        return blocks_of(self, "intersect", source, how, {"mask": mask, "environment": environment, "skip": skip}, options)

    @lists_options
    def occluded_blocks(
        self,
        origins: RayRows,
        directions: ArrayLike | HasRows | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        memory: int | str = MEMORY,
        progress: bool = False,
        executor: Executor | Workers | None = None,
        reduce: ReduceBy | Mapping[str, ReduceBy] | None = None,
        axis: int | Sequence[int] | None = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        skip: Hits | Numbers | None = None,
    ) -> Blocks:
        """Occlusion block by block: iterate over pairs (rows, bool array), or call `write` or `result`.

        Args:
            origins, directions, t_min, t_max: the rays, as in `intersect_blocks`.
            memory: bound on the memory for a block, in bytes or as text such as "1.5 GB".
            progress: whether to show a progress bar on stderr.
            executor: who answers blocks, several at a time; None for this process.
            reduce: what is kept of the answers, such as "sum" or "any"; None keeps them.
            axis: axes of the rays' leading shape along which answers are reduced: an int, several, or None for all.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            mask, environment: the instances that rays see, one number or one for each ray; None for all.
            skip: the triangle that each ray ignores: `wrt.Hits`, primitive ids, or None for none.

        Raises:
            TypeError, ValueError, RuntimeError: as `intersect_blocks`.
        """
        source, how = as_source(origins, directions, t_min, t_max), How(memory, progress, executor, reduce, axis)
        options = chosen(traversal=traversal, triangle_test=triangle_test)
        return blocks_of(self, "occluded", source, how, {"mask": mask, "environment": environment, "skip": skip}, options)

    @lists_options
    def count_blocks(
        self,
        origins: RayRows,
        directions: ArrayLike | HasRows | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        memory: int | str = MEMORY,
        progress: bool = False,
        executor: Executor | Workers | None = None,
        reduce: ReduceBy | Mapping[str, ReduceBy] | None = None,
        axis: int | Sequence[int] | None = None,
        traversal: str | Plan = AUTO,
        triangle_test: str = AUTO,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        skip: Hits | Numbers | None = None,
    ) -> Blocks:
        """Numbers of hits block by block: iterate over pairs (rows, int32 array), or call `write` or `result`.

        Args:
            origins, directions, t_min, t_max: the rays, as in `intersect_blocks`.
            memory: bound on the memory for a block, in bytes or as text such as "1.5 GB".
            progress: whether to show a progress bar on stderr.
            executor: who answers blocks, several at a time; None for this process.
            reduce: what is kept of the answers, such as "sum" or "any"; None keeps them.
            axis: axes of the rays' leading shape along which answers are reduced: an int, several, or None for all.
            traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`.
            triangle_test: "auto" for the scene's, or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
            mask, environment: the instances that rays see, one number or one for each ray; None for all.
            skip: the triangle that each ray ignores: `wrt.Hits`, primitive ids, or None for none.

        Raises:
            TypeError, ValueError, RuntimeError: as `intersect_blocks`.
        """
        source, how = as_source(origins, directions, t_min, t_max), How(memory, progress, executor, reduce, axis)
        options = chosen(traversal=traversal, triangle_test=triangle_test)
        return blocks_of(self, "count", source, how, {"mask": mask, "environment": environment, "skip": skip}, options)

    @lists_options
    def closest_point_blocks(
        self,
        points: PointRows,
        *,
        max_distance: Numbers = INF,
        memory: int | str = MEMORY,
        progress: bool = False,
        executor: Executor | Workers | None = None,
        reduce: ReduceBy | Mapping[str, ReduceBy] | None = None,
        axis: int | Sequence[int] | None = None,
        mask: Numbers | None = None,
        environment: Numbers | None = None,
        precise: bool = False,
    ) -> Blocks:
        """Closest points block by block: iterate over pairs (rows, closest points), or call `write` or `result`.

            scene.closest_point_blocks(np.load("points.npy", mmap_mode="r")).write({"t": distance})  # "t" is the distance

        Args:
            points: (..., 3), with at least one leading axis: an array, or any object with a shape whose slices are arrays.
            max_distance: as in `closest_point`; an array is cut into blocks with the points.
            memory: bound on the memory for a block, in bytes or as text such as "1.5 GB".
            progress: whether to show a progress bar on stderr.
            executor: who answers blocks, several at a time; None for this process.
            reduce: what is kept of the answers, by attribute, such as {"t": "max"}; None keeps them.
            axis: axes of the points' leading shape along which answers are reduced: an int, several, or None for all.
            mask, environment: the instances that points see, one number or one for each point; None for all.
            precise: as in `closest_point`.

        Raises:
            TypeError, ValueError, RuntimeError: as `closest_point` and `intersect_blocks`.
        """
        if not hasattr(points, "shape") and not isinstance(points, (list, tuple)):
            raise TypeError(f"points must be an array or have a shape and slices, not {type(points).__name__}")
        source = as_source(points, UPWARDS, 0.0, max_distance)
        try:
            shape = source.shape
        except ValueError:
            own = np.shape(max_distance)  # type: ignore[arg-type]
            raise ValueError(f"max_distance {own} does not broadcast to points {np.shape(points)}") from None  # type: ignore[arg-type]
        if not shape:
            raise ValueError("points must have a leading axis to cut into blocks: pass points of shape (N, 3)")
        how, columns = How(memory, progress, executor, reduce, axis), {"mask": mask, "environment": environment}
        return blocks_of(self, "closest_point", source, how, columns, {"precise": precise})
