"""Returns of a scan: measured when they are first read, and the layers made of them."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import warp as wp

from wrt.engine.memory import outputs_of
from wrt.kernels.runtime.argument_packing import blank
from wrt.kernels.runtime.launch import launch
from wrt.sensors.fired_rays import launch_blocks
from wrt.sensors.outputs.hit_outputs import IDS, TracedLayers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.kernels.sensors.lidar_returns import Detector, Noise
    from wrt.kernels.sensors.pose_paths import PosePath
    from wrt.sensors.time_slices import TracedSlice

GATHERED = {"range": wp.float32, "intensity": wp.float32, "distance": wp.float64, "ray": wp.int32, "mean": wp.float32}
"""Arrays of `wrt.kernels.sensors.lidar_returns.Returns`."""


@cache
def no_noise() -> Noise:
    """The noise of an ideal sensor."""
    from wrt.kernels.sensors.lidar_returns import Noise

    return Noise()


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
    APART = (("normal",), ("radial_velocity",))

    def __init__(
        self,
        found: Sequence[TracedSlice],
        scan: tuple[Beams, PosePath, Noise, Detector],
        counts: tuple[int, int, int],
        labels: wp.array,
        num_threads: int | None,
    ) -> None:
        self._beams, self._path, self._noise, self._detector = scan
        self._counts, self._is_exact = counts, scan[2] is no_noise()
        self._measured: Any = None
        super().__init__(found, counts[0] * counts[1], labels, num_threads)

    @property
    def _is_single(self) -> bool:
        """Whether beams have one ray and one return."""
        return self._counts[1] == self._counts[2] == 1

    def companions(self, name: str) -> Sequence[str]:
        both = name in ("range", "intensity") and not (self._is_single and self._detector.threshold == 0.0)
        return ("range", "intensity") if both else (name,)

    def make_together(self, names: Sequence[str]) -> None:
        one, asked = self.found[0], set(names)
        if self._measured is None:
            at_once = self._is_single and len(self.found) == 1 and not self._beams.order.size and one.surface[0] is one.traced
            self._measure(asked if at_once else asked & {"range", "intensity"})
        elif asked & {"range", "intensity"}:
            self._measure(asked & {"range", "intensity"})
        asked -= set(self.arrays)
        if points := asked & {"point", "position"}:
            self._fill_points(points)
        if ids := asked.intersection(IDS):
            self._fill_ids(ids)

    def make_apart(self, names: Sequence[str]) -> None:
        from wrt.kernels.sensors.return_layers import ReturnLayers, fill_normals, fill_velocities

        if self._measured is None:
            self._measure(set())
        with self.new_arrays(blank(ReturnLayers), names) as layers:
            for found in self.found:
                count = (found.part.end - found.part.begin) * self._counts[1]
                last = [self._detector, self._measured, layers]
                if names[0] == "normal":
                    launch_blocks(fill_normals, count, [self._beams, *found.surface, *last], self.device)
                else:
                    inputs = [self._beams, self._path, found.traced, found.mesh, found.motions, *last]
                    launch_blocks(fill_velocities, count, inputs, self.device)

    def _measure(self, names: set[str]) -> None:
        """Measures all returns, and makes the other layers of these names along with them.

        Args:
            names: more than range and intensity only of beams of one ray, traced at once in the order of their numbers.
        """
        from wrt.kernels.sensors.lidar_returns import Returns, add_noise, gather_returns
        from wrt.kernels.sensors.return_layers import ReturnLayers, fill_single

        kinds, ordered = set(GATHERED), bool(self._beams.order.size)
        if self._is_single:
            needs_power = "intensity" in names or self._detector.threshold > 0.0
            unused = {"ray", "mean", *(() if needs_power else ("intensity",)), *(("distance",) if self._is_exact else ())}
            kinds -= unused
        returns = blank(Returns)
        arrays = outputs_of(returns, {name: GATHERED[name] for name in GATHERED if name in kinds}, self.count, self.device)
        with self.new_arrays(blank(ReturnLayers), names - kinds) as layers:
            for found in self.found:
                count = found.part.end - found.part.begin
                if self._is_single:
                    given = [self._beams, self._path, *found.surface, self.labels]
                    launch_blocks(fill_single, count, [*given, self._noise, self._detector, returns, layers], self.device)
                else:
                    inputs = [self._beams, *found.surface, self._detector, returns]
                    launch(gather_returns, count, inputs, device=self.device, chunk=1024)
            if ordered or not self._is_single:  # else each block of beams is one of returns, which has its noise
                launch_blocks(add_noise, self.count, [self._noise, returns], self.device)
        for name in kinds & {"range", "intensity"}:
            self.arrays.setdefault(name, arrays[name])  # callers may have changed one that they were given
        self._measured = returns

    def _fill_points(self, names: set[str]) -> None:
        from wrt.kernels.sensors.return_layers import ReturnLayers, fill_points

        with self.new_arrays(blank(ReturnLayers), names) as layers:
            inputs = [self._beams, self._path, self._noise, self._counts[1], self._measured, layers]
            launch_blocks(fill_points, self.count, inputs, self.device)

    def _fill_ids(self, names: set[str]) -> None:
        from wrt.kernels.sensors.return_layers import ReturnLayers, fill_ids

        with self.new_arrays(blank(ReturnLayers), names) as layers:
            for found in self.found:
                count = (found.part.end - found.part.begin) * self._counts[1]
                inputs = [self._beams, found.traced, found.mesh, self.labels, self._detector, self._measured, layers]
                launch_blocks(fill_ids, count, inputs, self.device)
