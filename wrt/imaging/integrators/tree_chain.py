"""Trees of rays in tiles that stay in the cache: all generations of some hundred samples, then the next ones.

A thread follows the samples of a tile from the camera to the end, as in paths (`wrt.imaging.integrators.path_chain`). A sample
has more rays in a generation than before, so a tile has places for more rays than samples. Where they do not suffice, its
samples are done in halves. The memory of a tile belongs to a thread, which uses it again for the next tile
(`wrt.kernels.shading.ray_trees.tile_memories`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.engine.memory import empty
from wrt.imaging.integrators.ray_tracer import TileRays
from wrt.imaging.integrators.tile_runs import FIRST_SAMPLES, STOP, TileRuns, new_queue
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.launch import get_num_threads
from wrt.kernels.runtime.launch_chain import LaunchChain, Stage
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, MIRROR
from wrt.kernels.shading.ray_trees import tile_memories, tree_tiles
from wrt.kernels.shading.wavefront import ray_queue
from wrt.kernels.shading.wavefront.camera_rays import CameraModel
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.kernels.shading.wavefront.tree_step import ShadowList, TreeStep

if TYPE_CHECKING:
    from wrt.imaging.integrators.ray_tracer import RayTracer

SIZE, ROOM = 4096, 16384
"""Samples of a tile at most, and its places for rays of a generation."""

MAX_TREE_LIGHTS = 16
"""Lights up to which shadow rays find place: each light may take a place for each ray."""


@dataclass
class Trees:
    """How the trees of samples are followed.

    Attributes:
        scene: with materials and lights.
        samples: random numbers.
        step: of any generation.
        depth: generations at most.
        radiance: (slots,) sums of the samples of a wave.
        lights: entries of the lights that are sampled at each hit, in ascending order.
    """

    scene: LitScene
    samples: PixelSamples
    step: TreeStep
    depth: int
    radiance: wp.array
    lights: list[int]

    @property
    def surfaces_end_dark(self) -> bool:
        """Whether the surfaces and lights that rays of the last generation may meet give no light: mirrors and glass do not.
        Any hit then tells as much as the closest."""
        materials, lights = self.scene.materials, self.scene.lights
        send_on = np.isin(materials.kind.numpy(), (int(MIRROR), int(DIELECTRIC))).all()
        return bool(send_on and lights.areas == 0 and not materials.emission.numpy().any())

    def step_of(self, generation: int) -> TreeStep:
        """The step of a generation."""
        step = TreeStep()
        for name in ("distributed", "threshold", "roulette", "ambient"):
            setattr(step, name, getattr(self.step, name))
        step.generation, step.is_last = generation, generation + 1 >= self.depth
        step.first_light = step.light_end = 0
        step.unlit = -1
        if self.lights and not step.is_last:
            step.first_light, step.light_end = self.lights[0], self.lights[-1] + 1
            left_out = set(range(step.first_light, step.light_end)) - set(self.lights)  # the sky at most
            step.unlit = left_out.pop() if left_out else -1
        return step


class TreeChain:
    """The generations of trees of rays, tile by tile, for waves of one rendering.

    Args:
        trees: what is followed.
        tracer: of the rays.
        from_one_point: whether all camera rays start at the same point.

    Attributes:
        ends_by_any_hit: whether rays of the last generation are traced to any hit.
    """

    def __init__(self, trees: Trees, tracer: RayTracer, from_one_point: bool) -> None:
        self._trees, self._tracer, self._one_point = trees, tracer, from_one_point
        self.ends_by_any_hit = trees.surfaces_end_dark and trees.depth > 1
        self._device = device = trees.radiance.device
        size = min(SIZE, ROOM, max(64, len(trees.radiance) // (8 * get_num_threads())))
        self._runs = TileRuns(ROOM, size, device)
        self._chain: LaunchChain | None = None
        self._of_wave: list[tuple[PackedKernel, int]] = []

    @property
    def min_samples_together(self) -> int:
        """The fewest samples of the last wave that were tried together, because more found no place."""
        return self._runs.min_samples_together

    def run(self, camera: CameraModel, samples: ray_queue.Wave, count: int, sample: tuple[wp.array, wp.array] | None) -> int:
        """Follows this many samples, and returns the number of rays; -1 if those of a single sample find no place.

        Args:
            camera: the camera.
            samples: of the wave.
            count: number of samples.
            sample: origins and directions of camera rays, at least `FIRST_SAMPLES` or `count` of them; of the first wave.
        """
        if self._chain is None:
            self._chain = self._begin(camera, samples, min(count, FIRST_SAMPLES), sample)
        else:
            for packed, index in self._of_wave:
                packed.replace(index, samples)
        return self._runs.run(self._chain, count)

    def _begin(
        self, camera: CameraModel, samples: ray_queue.Wave, count: int, sample: tuple[wp.array, wp.array]
    ) -> LaunchChain:
        """Makes the stages."""
        trees, tracer, device, memories = self._trees, self._tracer, self._device, self._runs.memories
        scene, places = trees.scene, self._runs.places
        queues = [new_queue(places, device) for _ in range(2)]
        scratch = new_queue(2 * tree_tiles.WIDTH * len(memories.left), device)
        is_alive = empty(len(scratch.slot), wp.int32, device)
        rays, listed = ray_queue.Gathered(), ShadowList()
        rays.radiance = trees.radiance
        for name in ("emitted", "lit", "shadow_origin", "shadow_direction"):
            setattr(rays, name, empty(places, wp.vec3, device))
        listed.ray, listed.light = (empty(places, wp.int32, device) for _ in range(2))
        found, blocked = DeviceHits.new(CLOSEST, places, device), DeviceHits.new(ANY, places, device)
        hits = found.struct()
        chain = LaunchChain(ROOM, memories.left, device)
        chain.keep = (queues, scratch, is_alive, rays, listed, found, blocked)  # type: ignore[attr-defined]
        self._of_wave.clear()
        inputs: list[Any] = [ROOM, 0, camera, trees.samples, samples, queues[0], trees.radiance, memories, tile_memories.WIDTH]
        self._of_wave.append((chain.add(Stage(tile_memories.start_tile, inputs, ROOM, (STOP, "")))[0], 5))
        eye = wp.array(sample[0].numpy()[:1].copy(), dtype=wp.vec3, device=device) if self._one_point else None
        for generation in range(trees.depth):
            queue, following, is_first = queues[generation % 2], queues[1 - generation % 2], generation == 0
            origins = eye if is_first and self._one_point else queue.origin
            if generation + 1 == trees.depth and self.ends_by_any_hit:
                ends = blocked.struct()
                chain.add(*tracer.stages(ANY, TileRays(queue.origin, queue.direction, count, ROOM), ends))
                inputs = [ROOM, 0, scene, queue, blocked.occluded, rays, memories]
                chain.add(Stage(tree_tiles.end_tile, inputs, ROOM, (STOP, "")))
                inputs = [ROOM, 0, 0, 0, queue.slot, blocked.occluded, rays, listed, memories]
                chain.add(Stage(tree_tiles.gather_tile, inputs, ROOM, (STOP, ""), memories.shaded))
                break
            seen = (eye if self._one_point else sample[0], sample[1]) if is_first else None
            traced = TileRays(origins, queue.direction, count, ROOM, is_first)
            chain.add(*tracer.stages(CLOSEST, traced, hits, sample=seen))
            step = trees.step_of(generation)
            lights = 0 if step.is_last else len(trees.lights)
            inputs = [ROOM, 0, step, lights, scene, trees.samples, samples, queue, hits, rays]
            inputs += [scratch, is_alive, following, listed, memories]
            self._of_wave.append((chain.add(Stage(tree_tiles.shade_tile, inputs, ROOM, (STOP, "")))[0], 7))
            if lights:
                shadows = TileRays(rays.shadow_origin, rays.shadow_direction, count, ROOM, are_segments=True)
                found_blocked, own = blocked.struct(), memories.shadows
                chain.add(*tracer.stages(ANY, shadows, found_blocked, counts=own))
            inputs = [
                ROOM,
                0,
                step.first_light,
                step.light_end - step.first_light,
                queue.slot,
                blocked.occluded,
                rays,
                listed,
                memories,
            ]
            chain.add(Stage(tree_tiles.gather_tile, inputs, ROOM, (STOP, ""), memories.shaded))
        return chain
