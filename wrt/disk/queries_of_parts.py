"""The queries of a partitioned scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypedDict, overload

from wrt.disk.partitioned_hits import PartitionedHits
from wrt.engine.facts.query_kinds import ANY, AUTO, CLOSEST, COUNT, Query
from wrt.engine.rays.rays import as_rays
from wrt.query.query_options import checked, lists_options

if TYPE_CHECKING:
    import numpy as np
    import warp as wp
    from typing_extensions import Unpack

    from wrt.array_types import ArrayLike, ArrayT, Numbers, NumpyLike, WarpLike
    from wrt.disk.partition_files import PartList
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.device_rays import DeviceRays
    from wrt.engine.rays.rays import Rays

INF = float("inf")

CYCLE: Final = "cycle"

Mode: TypeAlias = Literal["cycle", "forward"]


class Parts(TypedDict, total=False):
    """Options of queries of parts, for type checkers; the signatures list them, with their defaults."""

    mode: Mode
    traversal: str
    triangle_test: str
    cull_backfaces: bool


class PartQueries:
    """The queries of a `wrt.disk.PartitionedScene`, which answers them part by part."""

    _parts: PartList

    if TYPE_CHECKING:

        @property
        def num_threads(self) -> int | None: ...

    def _answer(self, rays: Rays, query: Query, mode: str) -> tuple[DeviceRays, DeviceHits, wp.array, Plan | None]:
        """The answers of all rays: the rays on the device, the answers, the corners of triangles hit, and a plan."""
        raise NotImplementedError

    @overload
    def intersect(self, origins: Rays[ArrayT], **options: Unpack[Parts]) -> PartitionedHits[ArrayT]: ...
    @overload
    def intersect(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> PartitionedHits[np.ndarray]: ...
    @overload
    def intersect(
        self, origins: WarpLike, directions: ArrayLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> PartitionedHits[wp.array]: ...
    @overload
    def intersect(
        self, origins: NumpyLike, directions: WarpLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> PartitionedHits[wp.array]: ...
    @lists_options
    def intersect(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        mode: Mode = CYCLE,
        traversal: str = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
    ) -> PartitionedHits:
        """Closest hits, those of `wrt.Scene.intersect`.

        Args:
            origins, directions, t_min, t_max, triangle_test, cull_backfaces: as there.
            mode: "cycle": each part is loaded at most once for every two million rays, and all rays that may hit something
                in it are traced; or "forward": each ray waits for one part after the other, front to back, and the part with
                the most waiting rays for the bytes to load is next.
            traversal: "auto" or a key of `wrt.kernels.traversal.TRAVERSALS`: how rays are traced in a part.

        Raises:
            TypeError, ValueError: as `wrt.Scene.intersect`; an unknown mode; records of the triangle test with which the
                largest part exceeds the budget; a damaged part.
            FileNotFoundError: a part is gone.
        """
        query = checked(Query(CLOSEST, traversal, triangle_test, cull_backfaces))
        buffers, batch, corners, plan = self._answer(as_rays(origins, directions, t_min, t_max), query, mode)
        return PartitionedHits(batch, buffers.form, self._parts, corners, plan, self.num_threads)

    @overload
    def occluded(self, origins: Rays[ArrayT], **options: Unpack[Parts]) -> ArrayT: ...
    @overload
    def occluded(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> np.ndarray: ...
    @overload
    def occluded(
        self, origins: WarpLike, directions: ArrayLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> wp.array: ...
    @overload
    def occluded(
        self, origins: NumpyLike, directions: WarpLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> wp.array: ...
    @lists_options
    def occluded(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        mode: Mode = CYCLE,
        traversal: str = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
    ) -> Any:
        """Whether each ray hits anything: (...) bool, as in `wrt.Scene.occluded`.

        Args:
            origins, directions, t_min, t_max, mode, traversal, triangle_test, cull_backfaces: as in `intersect`.

        Raises:
            TypeError, ValueError, FileNotFoundError: as `intersect`.
        """
        query = checked(Query(ANY, traversal, triangle_test, cull_backfaces))
        buffers, batch, _, _ = self._answer(as_rays(origins, directions, t_min, t_max), query, mode)
        return batch.values(ANY, buffers.form)

    @overload
    def count(self, origins: Rays[ArrayT], **options: Unpack[Parts]) -> ArrayT: ...
    @overload
    def count(
        self, origins: NumpyLike, directions: NumpyLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> np.ndarray: ...
    @overload
    def count(
        self, origins: WarpLike, directions: ArrayLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> wp.array: ...
    @overload
    def count(
        self, origins: NumpyLike, directions: WarpLike, t_min: Numbers = ..., t_max: Numbers = ..., **options: Unpack[Parts]
    ) -> wp.array: ...
    @lists_options
    def count(
        self,
        origins: Rays | ArrayLike,
        directions: ArrayLike | None = None,
        t_min: Numbers = 0.0,
        t_max: Numbers = INF,
        *,
        mode: Mode = CYCLE,
        traversal: str = AUTO,
        triangle_test: str = AUTO,
        cull_backfaces: bool = False,
    ) -> Any:
        """Number of hits of each ray: (...) int32, as in `wrt.Scene.count`.

        Args:
            origins, directions, t_min, t_max, mode, traversal, triangle_test, cull_backfaces: as in `intersect`.

        Raises:
            TypeError, ValueError, FileNotFoundError: as `intersect`.
        """
        query = checked(Query(COUNT, traversal, triangle_test, cull_backfaces))
        buffers, batch, _, _ = self._answer(as_rays(origins, directions, t_min, t_max), query, mode)
        return batch.values(COUNT, buffers.form)
