"""What `wrt.Scene.closest_point` and `within` return: points on triangles, which are hits, with distances in place of t."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from wrt.array_types import ArrayT
from wrt.engine.device_hits import shaped
from wrt.query.all_hits import AllHits
from wrt.query.hits import Hits

if TYPE_CHECKING:
    import warp as wp

    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.rays.rays import ResultForm


class ClosestPoints(Hits):
    """Closest points on a scene of a batch of points, in its leading shape (...).

    They are hits with distances in place of t: `interpolate`, `smooth_normal`, `uv_at` and `spawn` are those of `wrt.Hits`. The
    attributes are NumPy arrays if the points were, else Warp arrays on the scene's device.

    Attributes:
        distance: (...) float32, from the point to `position`; inf if nothing was found.
        position: (..., 3), in the scene's coordinates, computed in float64 from `uv`; NaN if nothing was found. float64 if the
            points were, or if the scene is so far from 0 that float32 would move points (`is_far`), else float32.
        primitive_id: (...) int32, index of the triangle within its geometry; -1 if nothing was found.
        geometry_id: (...) int32, index of the mesh within the scene; -1 if nothing was found.
        instance_id: (...) int32, index of the instance, or of the mesh in a scene without instances; -1 if nothing was found.
        uv: (..., 2) float32, weights of the triangle's second and third vertex; 0 if nothing was found.
        feature: (...) int8, what `position` is on: 0 a vertex of the triangle, 1 an edge, 2 its face; -1 if nothing was found.
        normal: (..., 3), unit vectors, of the type of the points, from the triangle's winding (counter-clockwise seen from the
            front); 0 if nothing was found and for a triangle without area.
        is_hit: (...) bool, whether something was found.
        t: the same as `distance`.
        counters: {"nodes", "leaves", "triangles" ...: (...) int32}, the work for each point, if requested: inner nodes and
            leaves visited, and triangles in those leaves. A block that was near another point is tried first, and not counted.
    """

    def __init__(
        self,
        batch: DeviceHits,
        feature: wp.array,
        form: ResultForm,
        scene: SceneState,
        work: wp.array | None = None,
    ) -> None:
        super().__init__(batch, form, scene, None, work)
        self._feature = feature

    def __repr__(self) -> str:
        return f"ClosestPoints(shape={self.shape})"

    @property
    def distance(self) -> Any:
        return self.t

    @property
    def features(self) -> tuple[wp.array, wp.array, wp.array]:
        """(N,) each, on the device: triangles numbered through the scene, weights, and features."""
        return self.batch.primitive, self.batch.uv, self._feature  # type: ignore[return-value]

    @cached_property
    def feature(self) -> Any:
        return shaped(self._feature, self._form)


class TrianglesWithin(AllHits[ArrayT]):
    """Triangles within a distance of points, point after point, each list sorted by distance, then geometry, then triangle.

    The triangles of point i of the flattened batch are the elements offsets[i] .. offsets[i + 1] - 1 of the arrays of M
    triangles. The attributes are NumPy arrays if the points were, else Warp arrays on the scene's device.

    Attributes:
        offsets: (N + 1,) int64, index of each point's first triangle; the last is M.
        count: (...) int32, number of each point's triangles, in the points' leading shape.
        distance: (M,) float32, from the point to `position`.
        position: (M, 3), the nearest point of the triangle, of the type of `ClosestPoints.position`.
        primitive_id: (M,) int32, index of the triangle within its geometry.
        geometry_id: (M,) int32, index of the mesh within the scene.
        instance_id: (M,) int32, index of the instance, or of the mesh in a scene without instances.
        uv: (M, 2) float32, weights of the triangle's second and third vertex.
        feature: (M,) int8, what `position` is on: 0 a vertex of the triangle, 1 an edge, 2 its face.
        normal: (M, 3), unit vectors, float64 if the points were, else float32, from the triangle's winding; 0 for a triangle
            without area.
        point_id: (M,) int32, index of the point in the flattened batch.
        t, ray_id: the same as `distance` and `point_id`.
        plan: None.

    `Scene.within` makes them: batch, offsets, form and scene are as in `AllHits`, feature is of each triangle.
    """

    def __init__(self, batch: DeviceHits, feature: wp.array, offsets: wp.array, form: ResultForm, scene: SceneState) -> None:
        super().__init__(batch, offsets, form, scene, None)  # type: ignore[arg-type]
        self._feature = feature

    def __repr__(self) -> str:
        return f"TrianglesWithin({len(self)} triangles of points of shape {self.shape})"

    @property
    def distance(self) -> ArrayT:
        return self.t

    @property
    def point_id(self) -> ArrayT:
        return self.ray_id

    @cached_property
    def feature(self) -> ArrayT:
        return shaped(self._feature, self._form._replace(shape=self._feature.shape))
