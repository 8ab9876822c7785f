"""What `wrt.Scene.closest_point` returns: points on triangles, which are hits, with distances in place of t."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from wrt.engine.device_hits import shaped
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
        counters: no work is counted: ValueError.
    """

    def __init__(self, batch: DeviceHits, feature: wp.array, form: ResultForm, scene: SceneState) -> None:
        super().__init__(batch, form, scene, None)
        self._feature = feature

    def __repr__(self) -> str:
        return f"ClosestPoints(shape={self.shape})"

    @property
    def distance(self) -> Any:
        return self.t

    @cached_property
    def feature(self) -> Any:
        return shaped(self._feature, self._form)
