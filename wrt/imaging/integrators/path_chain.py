"""Paths in tiles that stay in the cache: all generations of some thousand samples, then the next ones.

A path depends on no other one. So each thread follows the paths of a tile from the camera to their end, and does not wait for
others: camera rays, closest hits, the step, shadow rays, and the sums of light are stages of a chain
(`wrt.kernels.runtime.launch_chain`). Between two generations the paths that go on are moved to the front of their tile. A wave
of generations instead reads and writes more than 500 bytes of memory for each path and generation
(notebooks/records/2026-11-23-light-tiles.md).

Plans for similar rays are made from a sample of them. So the stages before such rays are carried out for some first tiles
before the chain is complete.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.imaging.lights.device_lights import samples_sky
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.launch import get_num_threads
from wrt.kernels.runtime.launch_chain import LaunchChain, Stage
from wrt.kernels.shading.wavefront import path_step, ray_queue
from wrt.kernels.shading.wavefront.camera_rays import CameraModel, start_rays
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.state.device_hits import DeviceHits
from wrt.state.query_kinds import ANY, CLOSEST

if TYPE_CHECKING:
    from wrt.imaging.integrators.ray_tracer import RayTracer

TILE, LEAST_TILE = 4096, 512
"""Most and least paths of a tile. What is known of 4096 of them takes 700 KB."""

TILES_PER_THREAD = 8
"""Tiles of a wave that a thread has at least, if they need not be smaller than `LEAST_TILE`."""

FIRST_SAMPLES = 1 << 17
"""Samples whose first stages are carried out one by one: plans depend on the number of rays, of which no more matter."""

SORTED_TRIANGLES = 1024
"""Triangles of a scene from which the paths of a tile are sorted by the octants of their directions."""

STOP_OF_START, STOP = 1, 2
"""Which argument of `start_rays` and `mark_hits`, and of `path_step` and `settle_tile`, says where the paths end, the number of
the first item counted."""

WAVE_OF_START, WAVE_OF_STEP = 5, 7
"""Which argument of `start_rays` and of `path_step` is the wave."""


def tile_size(slots: int) -> int:
    """Paths of a tile of a wave of so many samples: a power of two."""
    size, share = TILE, slots // (TILES_PER_THREAD * get_num_threads())
    while size > max(share, LEAST_TILE):
        size //= 2
    return size


@dataclass
class Paths:
    """The memory of a wave's paths, and how they are followed.

    Attributes:
        scene: with materials and lights.
        samples: random numbers.
        step: of any generation.
        depth: generations at most.
        group: rays of an item of a step.
        queue, scratch: the rays of a generation, and those that follow.
        gathered: light and shadow rays.
        goes_on: (N,) int32, whether each path goes on.
    """

    scene: LitScene
    samples: PixelSamples
    step: path_step.PathStep
    depth: int
    group: int
    queue: ray_queue.RayQueue
    scratch: ray_queue.RayQueue
    gathered: ray_queue.Gathered
    goes_on: wp.array

    def step_of(self, generation: int) -> path_step.PathStep:
        """The step of a generation."""
        step = path_step.PathStep()
        step.roulette, step.samples_lights = self.step.roulette, self.step.samples_lights
        step.generation, step.is_last = generation, generation + 1 >= self.depth
        return step


class PathChain:
    """The generations of path tracing, tile by tile, for waves of one rendering.

    Args:
        paths: the memory.
        tracer: of the rays.
        from_one_point: whether all camera rays start at the same point.
    """

    def __init__(self, paths: Paths, tracer: RayTracer, from_one_point: bool) -> None:
        self._paths, self._tracer, self._one_point = paths, tracer, from_one_point
        slots, device = len(paths.gathered.radiance), paths.gathered.radiance.device
        self._tile = tile_size(slots)
        self._left, self._traced = (wp.zeros(-(-slots // self._tile), dtype=int, device=device) for _ in range(2))
        self._chain: LaunchChain | None = None
        self._hits, self._blocked = DeviceHits.new(CLOSEST, slots, device), DeviceHits.new(ANY, slots, device)
        self._of_wave: list[tuple[PackedKernel, int]] = []

    def run(self, camera: CameraModel, samples: ray_queue.Wave, count: int) -> int:
        """Follows the paths of so many samples, and returns the number of rays.

        Args:
            camera: the camera.
            samples: of the wave.
            count: number of samples.
        """
        size = self._tile
        tiles = -(-count // size)
        left = np.minimum(count - size * np.arange(tiles), size).astype(np.int32)
        self._left.numpy()[:tiles] = left
        self._traced.numpy()[:tiles] = left
        if self._chain is None:
            done = min(tiles, FIRST_SAMPLES // size)
            self._chain = self._begin(camera, samples, done, min(count, done * size))
        else:
            done = 0
            for packed, index in self._of_wave:
                packed.replace(index, samples)
        self._chain.run(done, tiles)
        return int(self._traced.numpy()[:tiles].sum())

    def _eye(self, camera: CameraModel) -> wp.array:
        """(1,) vec3, where all camera rays start: `queue.origin[0]` changes while other tiles are at their camera rays."""
        point = np.array(camera.view.position) - np.array(camera.center)
        return wp.array(point.astype(np.float32)[None], dtype=wp.vec3, device=self._left.device)

    def _begin(self, camera: CameraModel, samples: ray_queue.Wave, tiles: int, count: int) -> LaunchChain:
        """Makes the stages, and carries them out for some tiles, which hold so many samples: before the plan for similar rays
        is made, which samples them, and at the end."""
        chain = LaunchChain(self._tile, self._left, self._left.device)
        self._of_wave.clear()

        def add(*ways: Stage, wave_at: int = 0) -> None:
            packed = chain.add(*ways)
            if wave_at:
                self._of_wave += [(way, wave_at) for way in packed]

        def trace(
            kind: str, origins: wp.array, directions: wp.array, found: HitBatch, similar: bool, are_segments: bool
        ) -> None:
            nonlocal done
            if similar:
                chain.run(0, tiles, done)
                done = len(chain)
            add(*tracer.stages(kind, origins, directions, count, self._tile, found, similar, are_segments))

        done = 0
        paths, tracer, group = self._paths, self._tracer, self._paths.group
        scene, queue, scratch, rays, goes_on = paths.scene, paths.queue, paths.scratch, paths.gathered, paths.goes_on
        hits, has_shadows = self._hits.struct(), paths.step.samples_lights and scene.lights.count > 0
        blocked = self._blocked.occluded if has_shadows else wp.empty(0, dtype=wp.bool, device=self._left.device)
        by_octant = scene.shaded.records.shape[0] >= SORTED_TRIANGLES
        inputs: list[Any] = [0, group, camera, paths.samples, samples, queue, rays.radiance]
        add(Stage(start_rays, inputs, group, (STOP_OF_START, "")), wave_at=WAVE_OF_START)
        only_sky = scene.lights.areas == 0 and scene.lights.triangle_entry < 0
        for generation in range(paths.depth):
            step, similar = paths.step_of(generation), generation == 0
            origins = self._eye(camera) if similar and self._one_point else queue.origin
            if step.is_last and only_sky and not similar:  # then all that counts is whether rays hit anything
                trace(ANY, origins, queue.direction, self._blocked.struct(), False, False)
                add(Stage(path_step.mark_hits, [0, group, self._blocked.occluded, hits], group, (STOP_OF_START, "")))
            else:
                trace(CLOSEST, origins, queue.direction, hits, similar, False)
            inputs = [0, 0, group, step, scene, paths.samples, samples, queue, hits, rays, scratch, goes_on]
            add(Stage(path_step.path_step, inputs, group, (STOP, "")), wave_at=WAVE_OF_STEP)
            if step.is_last:
                break
            if has_shadows:
                shadows = rays.shadow_origin, rays.shadow_direction, self._blocked.struct()
                trace(ANY, *shadows, similar and not samples_sky(scene.lights), True)
            inputs = [self._tile, 0, blocked, rays, scratch, goes_on, queue, by_octant, self._left, self._traced]
            add(Stage(ray_queue.settle_tile, inputs, self._tile, (STOP, "")))
        chain.run(0, tiles, done)
        return chain
