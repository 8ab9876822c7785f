"""Returns of a scan: measured when they are first read, and the layers made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import warp as wp

from wrt.engine.memory import outputs_of
from wrt.kernels.runtime.launch import launch
from wrt.sensors.fired_rays import launch_blocks
from wrt.sensors.outputs.hit_outputs import TracedLayers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.kernels.sensors.lidar_returns import Detector, Noise
    from wrt.kernels.sensors.pose_paths import PosePath
    from wrt.sensors.time_slices import TracedSlice

MEASURED = {"range": wp.float32, "intensity": wp.float32, "distance": wp.float64}
"""Arrays of `wrt.kernels.sensors.lidar_returns.Returns` that are made of one ray and one return a beam."""

GATHERED = MEASURED | {"ray": wp.int32, "mean": wp.float32}


class MeasuredReturns(TracedLayers):
    """Layers of a scan (`TracedLayers`).

    Args:
        found: the hits, slice by slice.
        beams, path, noise, detector: as kernels see them.
        counts: number of beams of all sensors, and of returns and rays of each.
        labels: (I,) of each instance, or (0,).
        num_threads: of the scene.
    """

    KINDS: ClassVar[dict[str, Any]] = {
        "range": wp.float32,
        "intensity": wp.float32,
        "point": wp.vec3d,
        "position": wp.vec3d,
        "instance": wp.int32,
        "geometry": wp.int32,
        "primitive": wp.int32,
        "semantic": wp.int32,
        "normal": wp.vec3,
        "radial_velocity": wp.float32,
    }
    TOGETHER = (
        ("range", "intensity"),
        ("point",),
        ("position",),
        ("instance", "geometry", "primitive", "semantic"),
        ("normal",),
        ("radial_velocity",),
    )

    def __init__(
        self,
        found: Sequence[TracedSlice],
        scan: tuple[Beams, PosePath, Noise, Detector],
        counts: tuple[int, int, int],
        labels: wp.array,
        num_threads: int | None,
    ) -> None:
        self._beams, self._path, self._noise, self._detector = scan
        self._counts = counts
        self._measured: Any = None
        super().__init__(found, counts[0] * counts[1], labels, num_threads)

    def new_struct(self) -> Any:
        from wrt.kernels.sensors.return_layers import ReturnLayers

        return ReturnLayers()

    def _make(self, group: tuple[str, ...], chosen: Mapping[str, Any]) -> None:
        if group[0] == "range":
            self._measure()
        else:
            super()._make(group, chosen)

    def fill(self, group: tuple[str, ...], struct: Any) -> None:
        from wrt.kernels.sensors.return_layers import fill_ids, fill_normals, fill_points, fill_velocities

        returns, device = self._measure(), self.device
        if group[0] in ("point", "position"):
            inputs = [self._beams, self._path, self._noise, self._counts[1], returns, struct]
            launch_blocks(fill_points, self.count, inputs, device)
            return
        for found in self.found:
            count = (found.part.end - found.part.begin) * self._counts[1]
            last = [self._detector, returns, struct]
            if group[0] == "radial_velocity":
                inputs = [self._beams, self._path, found.traced, found.mesh, found.motions, *last]
                launch_blocks(fill_velocities, count, inputs, device)
            else:
                normals, hits = group[0] == "normal", (found.traced, found.mesh)
                kernel, given = (fill_normals, found.surface) if normals else (fill_ids, (*hits, self.labels))
                launch_blocks(kernel, count, [self._beams, *given, *last], device)

    def _measure(self) -> Any:
        """What is measured of all returns, as kernels see it."""
        if self._measured is not None:
            return self._measured
        from wrt.kernels.sensors.lidar_returns import Returns, add_noise, gather_returns, measure_single

        _, kept, bundle = self._counts
        returns, single = Returns(), kept == bundle == 1
        arrays = outputs_of(returns, MEASURED if single else GATHERED, self.count, self.device)
        for found in self.found:
            given, count = [self._beams, *found.surface], found.part.end - found.part.begin
            if single:
                inputs = [*given, self._noise, self._detector, returns]
                launch_blocks(measure_single, count, inputs, self.device)
            else:
                launch(gather_returns, count, [*given, self._detector, returns], device=self.device, chunk=1024)
        if not single or self._beams.order.size:  # else each block of beams is one of returns
            launch_blocks(add_noise, self.count, [self._noise, returns], self.device)
        self.arrays |= {name: arrays[name] for name in ("range", "intensity")}
        self._measured = returns
        return returns
