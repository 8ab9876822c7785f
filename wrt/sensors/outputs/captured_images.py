"""Images of a camera, and the layers of which they are made."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from wrt.kernels.runtime.argument_packing import blank
from wrt.kernels.validation import as_bool
from wrt.sensors.fired_rays import launch_blocks
from wrt.sensors.outputs.hit_outputs import HitOutputs, TracedLayers
from wrt.sensors.outputs.row_tables import Field, as_host, coordinates, row_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.kernels.sensors.pose_paths import PosePath
    from wrt.sensors.time_slices import TracedSlice
    from wrt.sensors.trajectory import StillPoses, Trajectory

MAX_USHORT = 65536
"""Largest image whose rows and columns are numbered in 16 bits."""


class CapturedLayers(TracedLayers):
    """Layers of images (`TracedLayers`).

    Args:
        found: the hits, slice by slice.
        beams, path: the camera's, as kernels see them.
        labels: (I,) of each instance, or (0,).
        miss: distance and depth of a pixel without a hit.
        count: number of pixels.
        num_threads: of the scene.
        motion_error: as in `CameraImages`.
    """

    KINDS: ClassVar[dict[str, Any]] = {
        "distance": wp.float32,
        "depth": wp.float32,
        "position": wp.vec3d,
        "normal": wp.vec3,
        "camera_normal": wp.vec3,
        "instance": wp.int32,
        "geometry": wp.int32,
        "primitive": wp.int32,
        "semantic": wp.int32,
    }
    APART = (("normal", "camera_normal"),)

    def __init__(
        self,
        found: Sequence[TracedSlice],
        beams: Beams,
        path: PosePath,
        labels: wp.array,
        miss: float,
        count: int,
        num_threads: int | None,
        motion_error: float,
    ) -> None:
        self._beams, self._path, self._miss = beams, path, miss
        self.motion_error = motion_error
        super().__init__(found, count, labels, num_threads)

    def make_together(self, names: Sequence[str]) -> None:
        from wrt.kernels.sensors.camera_images import Images, fill_images

        with self.new_arrays(blank(Images), names) as images:
            for found in self.found:
                inputs = [self._beams, found.traced, found.mesh, self.labels, found.origins, self._miss, images]
                launch_blocks(fill_images, found.part.end - found.part.begin, inputs, self.device)

    def make_apart(self, names: Sequence[str]) -> None:
        from wrt.kernels.sensors.camera_images import Images, fill_image_normals

        with self.new_arrays(blank(Images), names) as images:
            for found in self.found:
                inputs = [self._beams, self._path, *found.surface, images]
                launch_blocks(fill_image_normals, found.part.end - found.part.begin, inputs, self.device)


class CameraImages(HitOutputs):
    """What a `Camera` saw: images of shape (height, width), NumPy arrays, or Warp arrays on request.

    Those of many cameras have the leading shape of their poses before it. NumPy arrays are computed when they are first read,
    Warp arrays at once. Reading a layer that was not among those that `Camera.capture` was asked for raises a ValueError.

    Attributes:
        distance: float32, along the ray; the miss value where there is no hit.
        depth: float32, along the optical axis (z); the miss value where there is no hit.
        position: (..., 3) float64 in the world; NaN for a miss.
        normal: (..., 3) float32 in the world, by the winding of the triangle; 0 for a miss.
        camera_normal: (..., 3) float32, the same in the optical frame at the time of the row.
        instance_id: int32, index of the instance, or of the mesh in a scene without instances; -1 for a miss.
        geometry_id, primitive_id: int32, the mesh and the triangle within it; -1 for a miss.
        semantic_id: int32, the label of the instance; -1 for a miss, and without labels.
        albedo: (..., 3) float32, the colour of the surface's material, linear, without light; 0 for a miss. None unless asked
            for.
        flow: (..., 2) float32, by how many pixels to the right and down the surface point is elsewhere in the image some time
            after the pixel's own; NaN for a miss, and where the lens does not see it then. Other surfaces may hide it. None
            unless asked for.
        time: (height,) float64, when each row was exposed.
        camera, trajectory, start: how they were made.
        motion_error: bound on the displacement of surfaces by time slices (`wrt.sensors.time_slices`).
    """

    def __init__(
        self,
        camera: Any,
        layers: CapturedLayers,
        trajectory: Trajectory | StillPoses,
        start: float,
        to_warp: bool,
        chosen: Sequence[str] | None,
        extra: Mapping[str, wp.array],
    ) -> None:
        self.camera, self.trajectory, self.start, self.motion_error = camera, trajectory, start, layers.motion_error
        self._extra = extra
        shape = *getattr(trajectory, "shape", ()), camera.height, camera.width
        super().__init__(layers, shape, to_warp, chosen)

    def __getstate__(self) -> dict[str, Any]:
        """As that of all results; the colours and the flow are read first."""
        _ = self.albedo, self.flow
        return super().__getstate__() | {"_extra": {}}

    @cached_property
    def distance(self) -> Any:
        return self._out("distance")

    @cached_property
    def depth(self) -> Any:
        return self._out("depth")

    @cached_property
    def camera_normal(self) -> Any:
        return self._out("camera_normal")

    @cached_property
    def albedo(self) -> Any:
        return self._shaped(self._extra.get("albedo"))

    @cached_property
    def flow(self) -> Any:
        return self._shaped(self._extra.get("flow"))

    @cached_property
    def time(self) -> np.ndarray:
        return self.start + self.camera.line_delay * np.arange(self.camera.height)

    def to_structured(self, organized: bool = False) -> np.ndarray:
        """All pixels that see a surface: (N,) structured array, row by row, camera by camera.

        Fields are x, y and z in the world (float64), depth (float32), row and column of the pixel (uint16, or int32 in larger
        images), instance_id (int32), and semantic_id (int32) if `Camera.capture` was given labels. Their layers must be among
        the chosen ones: position, depth and the ids.

        Args:
            organized: whether to give all pixels, in the shape of the images; coordinates of misses are NaN.

        Raises:
            TypeError: `organized` is no bool.
            ValueError: a layer that was not chosen.
        """
        organized, layers = as_bool("organized", organized), self._layers
        height, width = self.camera.height, self.camera.width
        ids = ("instance", "semantic") if len(layers.labels) else ("instance",)
        self._make_ready(("position", "depth", *ids))
        kind = "<u2" if max(height, width) <= MAX_USHORT else "<i4"
        fields = [
            coordinates(self.position, "<f8"),
            Field(("depth",), "<f4", as_host(self.depth).ravel()),
            Field(("row",), kind, np.arange(height, dtype=kind), width),
            Field(("column",), kind, np.arange(width, dtype=kind)),
            *(Field((f"{name}_id",), "<i4", as_host(getattr(self, f"{name}_id")).ravel()) for name in ids),
        ]
        table = row_table(fields, None if organized else fields[4].values, layers.count, None, layers.num_threads)
        return table.reshape(self.shape) if organized else table
