"""Waves of rays: the samples of some pixels, traced together, generation by generation.

A generation is a queue of rays. Its closest hits are found in one batch; a kernel turns them into light, shadow rays and the
rays of the next generation; the shadow rays are one batch for each light; what arrives is added to the samples;
and the rays that go on are moved together. All arrays stay on the device. On CUDA, the number of rays that go on is the only
value that the host reads. On the CPU, paths are followed tile by tile where that is possible
(`wrt.imaging.integrators.path_chain`).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.memory import empty
from wrt.imaging.integrators.path_chain import PathChain, Paths
from wrt.imaging.integrators.ray_tracer import RayTracer
from wrt.imaging.integrators.render_settings import RenderSettings
from wrt.imaging.integrators.texture_tiles import TextureTiles
from wrt.imaging.integrators.tile_runs import FIRST_SAMPLES, new_queue
from wrt.imaging.integrators.tree_chain import MAX_TREE_LIGHTS, TreeChain, Trees
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.wavefront import path_step, ray_queue, tree_step
from wrt.kernels.shading.wavefront.camera_rays import CameraModel, start_rays
from wrt.kernels.shading.wavefront.picture import Film
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.scene_light import LitScene

ROULETTE_FROM = 3
"""First generation of path tracing whose rays may end by roulette."""

SQUARE = 8
"""Edge of the squares in whose order pixels are traced: the rays of a packet are then similar, and those of a stream meet the
same part of the scene."""

CHUNK = 512
"""Least number of rays of a chunk."""

GROUP = 64
"""Rays that an item of a step takes on the CPU, one after the other. A step has arguments of several kilobytes, which are
copied once for each item."""


class Wave:
    """Memory for the rays of one wave, and the loop over its generations.

    Args:
        scene: with materials and lights, on the device.
        device: its device.
        integrator: "path", "whitted" or "distribution".
        settings: as the caller gave them.
        samples: random numbers.
        ambient: radiance of the ambient light of the last two.
        slots: most samples of a wave.
        tiles: of the scene's images; None if they are whole.
    """

    def __init__(
        self,
        scene: LitScene,
        device: wp.Device,
        integrator: str,
        settings: RenderSettings,
        samples: PixelSamples,
        ambient: Any,
        slots: int,
        tiles: TextureTiles | None = None,
    ) -> None:
        self.scene, self.settings, self.samples = scene, settings, samples
        self._tiles = tiles
        self._device, self._is_path = device, integrator == "path"
        self._branches = 1 if self._is_path else 2
        self.radiance = empty(slots, wp.vec3, device)
        self._room = 0
        self.gathered = ray_queue.Gathered()
        self.gathered.radiance = self.radiance
        self._none = wp.empty(0, dtype=wp.bool, device=device)
        self._step = path_step.PathStep() if self._is_path else tree_step.TreeStep()
        if self._is_path:
            self._step.roulette = ROULETTE_FROM if settings.roulette else settings.depth
            self._step.samples_lights = settings.sample_lights
        else:
            self._step.distributed = integrator == "distribution"
            self._step.threshold = settings.threshold
            self._step.roulette = settings.roulette
            self._step.ambient = wp.vec3(*map(float, ambient))
            self._step.unlit = -1
        self.ray_count = 0
        self._chain: PathChain | TreeChain | None = None
        self._chain_tracer: RayTracer | None = None
        self._make_room(slots)

    def _make_room(self, count: int) -> None:
        """Makes the queues hold this many rays: a generation of a tree may be larger than the one before."""
        if count <= self._room:
            return
        self._room = count
        old = getattr(self, "queue", None)
        self.queue = new_queue(count, self._device)
        del old
        for name, dtype in (("emitted", wp.vec3), ("lit", wp.vec3), ("shadow_origin", wp.vec3), ("shadow_direction", wp.vec3)):
            setattr(self.gathered, name, empty(count, dtype, self._device))
        places = count * self._branches
        self.scratch = new_queue(places, self._device)
        self.is_alive, self._places = (empty(places, wp.int32, self._device) for _ in range(2))

    def follow_in_tiles(
        self, tracer: RayTracer, camera: CameraModel, wave: ray_queue.Wave, count: int, film: Film, from_one_point: bool
    ) -> bool:
        """Follows this many samples tile by tile, if that is possible: on the CPU, with whole textures. If the wave
        `develops_in_tiles`, they are then in the film."""
        if self._tiles is not None or self._device.is_cuda:
            return False
        if self._chain_tracer is not tracer:
            self._chain_tracer = tracer
            self._chain = self._new_chain(tracer, count, from_one_point)
            if self._chain is not None:  # plans are made of camera rays
                self.start(camera, wave, min(count, FIRST_SAMPLES))
        if self._chain is None:
            return False
        first = self.queue.origin, self.queue.direction
        if isinstance(self._chain, PathChain):
            traced = self._chain.run(camera, wave, count, film, first)
        else:
            traced = self._chain.run(camera, wave, count, first)
        if traced < 0:
            self._chain = None
            return False
        self.ray_count += traced
        return True

    def develops_in_tiles(self, samples: int) -> bool:
        """Whether waves with this many samples of each pixel that were followed in tiles need no development."""
        return isinstance(self._chain, PathChain) and self._chain.develops(samples)

    def _new_chain(self, tracer: RayTracer, count: int, from_one_point: bool) -> PathChain | TreeChain | None:
        """The stages for tiles; None if waves of this many samples cannot be followed tile by tile."""
        if not tracer.makes_stages(count):
            return None
        if self._is_path:
            paths = Paths(self.scene, self.samples, self._step, self.settings.depth, self._group, self.radiance)  # type: ignore[arg-type]
            return PathChain(paths, tracer, from_one_point)
        lights = self._lights()
        if len(lights) > MAX_TREE_LIGHTS:
            return None
        trees = Trees(self.scene, self.samples, self._step, self.settings.depth, self.radiance, lights)  # type: ignore[arg-type]
        return TreeChain(trees, tracer, from_one_point)

    def start(self, camera: CameraModel, wave: ray_queue.Wave, count: int) -> None:
        """Writes the camera rays of a wave of this many samples."""
        self._wave, self.count = wave, count
        group = self._group
        inputs = [count, group, camera, self.samples, wave, self.queue, self.radiance]
        launch(start_rays, -(-count // group), inputs, device=self._device, chunk=-(-CHUNK // group))

    def first_hits(self, tracer: RayTracer, from_one_point: bool) -> DeviceHits:
        """The hits of the camera rays; `from_one_point` says whether all start at the same point."""
        self.ray_count += self.count
        rays = self.queue.origin, self.queue.direction, self.count
        return tracer.closest(*rays, similar=True, from_one_point=from_one_point)

    def finish(self, tracer: RayTracer, hits: DeviceHits) -> None:
        """Follows the rays from the hits of the first generation to the last."""
        generation = 0
        while True:
            self._step.generation = generation
            self._step.is_last = generation + 1 >= self.settings.depth
            if self._is_path:
                self._follow_paths(tracer, hits)
            else:
                self._follow_trees(tracer, hits)
            generation += 1
            if self._step.is_last:
                return
            self.count = self._compact()
            if self.count == 0:
                return
            self.ray_count += self.count
            hits = tracer.closest(self.queue.origin, self.queue.direction, self.count)

    def _follow_paths(self, tracer: RayTracer, hits: DeviceHits) -> None:
        self._run_step(path_step.path_step, hits)
        self._blocked = self._none
        if self.settings.sample_lights and self.scene.lights.count > 0 and not self._step.is_last:
            self._blocked = self._shadows(tracer, self.scene.lights.sky_entry < 0)

    def _follow_trees(self, tracer: RayTracer, hits: DeviceHits) -> None:
        lights, sky = [] if self._step.is_last else self._lights(), self.scene.lights.sky_entry
        self._step.first_light, self._step.light_end = (lights[0], lights[0] + 1) if lights else (0, 0)
        self._run_step(tree_step.tree_step, hits, tree_step.ShadowList())
        self._gather(self._shadows(tracer, lights[0] != sky) if lights else self._none, True)
        for entry in lights[1:]:
            found = hits.struct()
            inputs = (self._step, entry, self.scene, self.samples, self._wave, self.queue, found, self.gathered)
            self.run_groups(tree_step.shade_by_light, found, *inputs)
            self._gather(self._shadows(tracer, entry != sky), False)

    def _lights(self) -> list[int]:
        """Entries of the lights that light all points; with hard shadows, the sky's mean is the ambient light."""
        lights = self.scene.lights
        return [entry for entry in range(lights.count) if self._step.distributed or entry != lights.sky_entry]

    def _run_step(self, kernel: wp.Kernel, hits: DeviceHits, *more: Any) -> None:
        found = hits.struct()
        inputs = (self._step, self.scene, self.samples, self._wave, self.queue, found, self.gathered, self.scratch)
        self.run_groups(kernel, found, *inputs, self.is_alive, *more)

    def _shadows(self, tracer: RayTracer, similar: bool) -> wp.array:
        """Which shadow rays are blocked. Those of camera rays' hits to a light are similar; to the sky they go all ways."""
        self.ray_count += self.count
        similar = similar and self._step.generation == 0
        return tracer.blocked(self.gathered.shadow_origin, self.gathered.shadow_direction, self.count, similar=similar)

    def _gather(self, blocked: wp.array, with_emitted: bool) -> None:
        self._run(ray_queue.gather, self.count, self.count, self.queue.slot, with_emitted, blocked, self.gathered)

    def _compact(self) -> int:
        """Moves the rays that go on to the queue, and returns their number; of paths, light past shadow rays is added first."""
        places = self.count * self._branches
        wp.utils.array_scan(self.is_alive[:places], self._places[:places], inclusive=True)
        scratch, is_alive, sums = self.scratch, self.is_alive, self._places
        if self._is_path:
            self._run(ray_queue.settle_paths, places, self._blocked, self.gathered, scratch, is_alive, sums, self.queue)
        following = int(sums[places - 1 : places].numpy()[0])
        if not self._is_path and following > 0:
            self._make_room(following)
            self._run(ray_queue.fill, places, scratch, is_alive, sums, self.queue)
        return following

    @property
    def _group(self) -> int:
        """Rays of an item."""
        return 1 if self._device.is_cuda else GROUP

    def ranges(self, hits: HitBatch) -> Iterable[tuple[int, int]]:
        """The rays of the generation, (start, stop), in parts whose textures are in memory."""
        return [(0, self.count)] if self._tiles is None else self._tiles.ranges(self.scene, hits, self.count)

    def run_groups(self, kernel: wp.Kernel, hits: HitBatch, *inputs: Any) -> None:
        """Runs a step over the rays of the generation, by groups."""
        group = self._group
        for start, stop in self.ranges(hits):
            items = -(-(stop - start) // group)
            launch(kernel, items, [start, stop, group, *inputs], device=self._device, chunk=-(-CHUNK // group))

    def _run(self, kernel: wp.Kernel, count: int, *inputs: Any) -> None:
        launch(kernel, count, inputs, device=self._device, chunk=CHUNK)


def pixel_samples(sampler: int, samples: int, seed: int, device: wp.Device) -> PixelSamples:
    """Random numbers for this many samples of each pixel; a grid has as many columns as make it closest to a square."""
    from wrt.kernels.shading.wavefront.pixel_samples import PRIMES

    made = PixelSamples()
    made.sampler, made.samples = sampler, samples
    made.columns = max(divisor for divisor in range(1, int(np.sqrt(samples)) + 1) if samples % divisor == 0)
    made.seed = (seed * 0x9E3779B1 + 0x7F4A7C15) & 0xFFFFFFFF  # type: ignore[assignment]
    made.primes = wp.array(np.array(PRIMES, dtype=np.int32), dtype=int, device=device)
    return made


@lru_cache(maxsize=8)
def square_order(width: int, height: int) -> np.ndarray:
    """(width * height,) int32, numbers of a picture's pixels, square by square; squares and the pixels in them by rows."""
    across, down = -(-width // SQUARE), -(-height // SQUARE)
    numbers = np.full((down * SQUARE, across * SQUARE), -1, dtype=np.int32)
    numbers[:height, :width] = np.arange(width * height, dtype=np.int32).reshape(height, width)
    squares = numbers.reshape(down, SQUARE, across, SQUARE).transpose(0, 2, 1, 3).ravel()
    return squares[squares >= 0]
