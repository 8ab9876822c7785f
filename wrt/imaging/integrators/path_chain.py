"""Paths in tiles that stay in the cache: all generations of some thousand samples, then the next ones.

A path depends on no other one. So each thread follows the paths of a tile from the camera to their end, and does not wait for
others: camera rays, closest hits, the step, shadow rays, and the sums of light are stages of a chain
(`wrt.kernels.runtime.launch_chain`). The step appends the paths that go on to the front of their tile
(`wrt.kernels.shading.paths`). A wave of generations instead reads and writes more than 500 bytes of memory for each path and
generation (notebooks/records/2026-11-23-light-tiles.md).

The memory of a tile belongs to a thread, which uses it again for its next tile (`wrt.kernels.shading.ray_trees.tile_memories`).

Plans for camera rays are made from a sample of them, which the caller has. The other rays have two ways, of which each tile
takes the faster one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.engine.memory import empty
from wrt.imaging.integrators.ray_tracer import TileRays
from wrt.imaging.integrators.tile_runs import FIRST_SAMPLES, STOP, TileRuns, new_queue
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.launch import get_num_threads
from wrt.kernels.runtime.launch_chain import LaunchChain, Stage
from wrt.kernels.shading.paths import last_rays, path_tiles
from wrt.kernels.shading.ray_trees.tile_memories import start_tile
from wrt.kernels.shading.wavefront import path_step, ray_queue
from wrt.kernels.shading.wavefront.camera_rays import CameraModel
from wrt.kernels.shading.wavefront.picture import Film
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.lights.device_lights import samples_sky

if TYPE_CHECKING:
    from wrt.imaging.integrators.ray_tracer import RayTracer

TILE, MIN_TILE = 8192, 512
"""Most and least paths of a tile. What is known of 8192 of them takes 1.5 MB."""

TILES_PER_THREAD = 8
"""Tiles of a wave that a thread has at least, if they need not be smaller than `MIN_TILE`."""

SORTED_TRIANGLES = 1024
"""Triangles of a scene from which the paths of a tile are sorted by the octants of their directions."""

WAVE_OF_START, WAVE_OF_STEP, WAVE_OF_LAST = 5, 8, 3
"""Which argument of `start_tile`, `step_tile` and `develop_tile` is the wave."""

FILM_OF_LAST = 5
"""Which argument of `develop_tile` is the film."""


def tile_size(slots: int) -> int:
    """Paths of a tile of a wave of this many samples: a power of two."""
    size, share = TILE, slots // (TILES_PER_THREAD * get_num_threads())
    while size > max(share, MIN_TILE):
        size //= 2
    return size


@dataclass
class Paths:
    """What is followed.

    Attributes:
        scene: with materials and lights.
        samples: random numbers.
        step: of any generation.
        depth: generations at most.
        group: rays of an item of a step; 1 if none are done together.
        radiance: (slots,) sums of the samples of a wave.
    """

    scene: LitScene
    samples: PixelSamples
    step: path_step.PathStep
    depth: int
    group: int
    radiance: wp.array

    def step_of(self, generation: int) -> path_step.PathStep:
        """The step of a generation."""
        step = path_step.PathStep()
        step.roulette, step.samples_lights = self.step.roulette, self.step.samples_lights
        step.generation, step.is_last = generation, generation + 1 >= self.depth
        return step


class PathChain:
    """The generations of path tracing, tile by tile, for waves of one rendering.

    Args:
        paths: what is followed.
        tracer: of the rays.
        from_one_point: whether all camera rays start at the same point.
    """

    def __init__(self, paths: Paths, tracer: RayTracer, from_one_point: bool) -> None:
        self._paths, self._tracer, self._one_point = paths, tracer, from_one_point
        size = tile_size(len(paths.radiance))
        device = paths.radiance.device
        self._runs = runs = TileRuns(size, size, device)
        self._queues = [new_queue(runs.places, device) for _ in range(2)]
        self._rays = ray_queue.Gathered()
        self._rays.radiance = paths.radiance
        for name in ("lit", "shadow_origin", "shadow_direction"):
            setattr(self._rays, name, empty(runs.places, wp.vec3, device))
        self._lit_slot = empty(runs.places, wp.int32, device)
        self._hits, self._blocked = DeviceHits.new(CLOSEST, runs.places, device), DeviceHits.new(ANY, runs.places, device)
        self._chain: LaunchChain | None = None
        self._of_wave: list[tuple[PackedKernel, int]] = []

    def develops(self, samples: int) -> bool:
        """Whether `run` adds waves with this many samples of each pixel to the film: if a tile has all those of a pixel."""
        return self._runs.size % samples == 0

    def run(
        self,
        camera: CameraModel,
        samples: ray_queue.Wave,
        count: int,
        film: Film,
        sample: tuple[wp.array, wp.array] | None,
    ) -> int:
        """Follows the paths of this many samples, and returns the number of rays.

        Args:
            camera: the camera.
            samples: of the wave.
            count: number of samples.
            film: to which samples are added if the wave `develops`.
            sample: origins and directions of camera rays, at least `FIRST_SAMPLES` or `count` of them; of the first wave.
        """
        if self._chain is None:
            self._chain = self._begin(camera, samples, min(count, FIRST_SAMPLES), sample)
            runs = self._runs
            inputs = [runs.size, 0, samples, self._paths.radiance, film, runs.memories]
            self._last = self._chain.add(Stage(path_tiles.develop_tile, inputs, runs.size, (STOP, "")))[0]
            self._of_wave.append((self._last, WAVE_OF_LAST))
        else:
            for packed, index in self._of_wave:
                packed.replace(index, samples)
            self._last.replace(FILM_OF_LAST, film)
        return self._runs.run(self._chain, count, 1)

    def _begin(
        self, camera: CameraModel, samples: ray_queue.Wave, known: int, sample: tuple[wp.array, wp.array]
    ) -> LaunchChain:
        """Makes the stages; of the camera rays of `sample`, this many are known."""
        paths, tracer, rays, runs = self._paths, self._tracer, self._rays, self._runs
        scene, size, memories = paths.scene, runs.size, runs.memories
        chain = LaunchChain(size, memories.left, memories.left.device)
        self._of_wave.clear()
        queue, other = self._queues
        hits, blocked = self._hits.struct(), self._blocked.struct()
        has_shadows = paths.step.samples_lights and scene.lights.count > 0
        by_octant = scene.shaded.records.shape[0] >= SORTED_TRIANGLES
        lanes = path_tiles.WIDTH if paths.group > 1 else 1
        eye = wp.array(sample[0].numpy()[:1].copy(), dtype=wp.vec3, device=chain.device) if self._one_point else None
        inputs: list[Any] = [size, 0, camera, paths.samples, samples, queue, rays.radiance, memories, lanes]
        self._of_wave.append((chain.add(Stage(start_tile, inputs, size, (STOP, "")))[0], WAVE_OF_START))
        for generation in range(paths.depth):
            step, is_first = paths.step_of(generation), generation == 0
            if step.is_last and not is_first:
                self._add_sky_rays(chain, other, queue, known)
                queue, other = other, queue
            origins = eye if is_first and self._one_point else queue.origin
            seen = (eye if self._one_point else sample[0], sample[1]) if is_first else None
            traced = TileRays(origins, queue.direction, known, size, is_first)
            chain.add(*tracer.stages(CLOSEST, traced, hits, sample=seen))
            casts = has_shadows and not step.is_last
            inputs = [size, 0, lanes, casts, step, scene, paths.samples, samples, queue, hits, rays, self._lit_slot, other]
            stage = Stage(path_tiles.make_step_tile(), [*inputs, memories], size, (STOP, ""))
            self._of_wave.append((chain.add(stage)[0], WAVE_OF_STEP))
            if casts:
                similar = is_first and not samples_sky(scene.lights)  # to a light, those of camera rays' hits are
                shadows = TileRays(rays.shadow_origin, rays.shadow_direction, known, size, similar, are_segments=True)
                chain.add(*tracer.stages(ANY, shadows, blocked, counts=memories.shadows))
                inputs = [size, 0, self._blocked.occluded, rays, self._lit_slot]
                chain.add(Stage(path_tiles.gather_lit, inputs, size, (STOP, ""), memories.shadows))
            if generation + 2 >= paths.depth:
                continue
            if by_octant:
                chain.add(Stage(path_tiles.order_tile, [size, 0, other, queue], size, (STOP, "")))
            else:
                queue, other = other, queue
        return chain

    def _add_sky_rays(self, chain: LaunchChain, source: ray_queue.RayQueue, target: ray_queue.RayQueue, known: int) -> None:
        """Adds the stages of those rays of the last generation that can bring the light of the sky only; the others are left
        in the queue `source`."""
        paths, runs = self._paths, self._runs
        scene, size, memories = paths.scene, runs.size, runs.memories
        inputs: list[Any] = [size, 0, scene.lights, source, self._hits.primitive, target, memories]
        chain.add(Stage(last_rays.part_tile, inputs, size, (STOP, "")))
        if scene.lights.sky_entry < 0:
            return
        blocked, own = self._blocked.struct(), memories.shadows
        rays = TileRays(target.origin, target.direction, known, size)
        chain.add(*self._tracer.stages(ANY, rays, blocked, counts=own))
        inputs = [size, 0, paths.step.samples_lights, scene, self._blocked.occluded, target, self._rays.radiance]
        chain.add(Stage(last_rays.gather_sky, inputs, size, (STOP, ""), own))
