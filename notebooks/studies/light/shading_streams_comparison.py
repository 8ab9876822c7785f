"""Streams that shade, beside sorting by material and a branch for each hit, on the generations of the path tracer.

Every way does the same step of a generation, whose rays are those of a picture in the making. The answers are compared bit for
bit: light found, shadow rays, and the rays that follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.engine.device_hits import DeviceHits
from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.integrators.rendering_job import Rendering
from wrt.imaging.integrators.tile_runs import new_queue
from wrt.imaging.integrators.wavefront import GROUP, Wave
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.query.ordering.ray_order import sort_buckets
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.wavefront.path_step import MISSED, UNKNOWN
from wrt.kernels.shading.wavefront.shading_streams import (
    FILTERS,
    Streams,
    filter_streams,
    find_kinds,
    find_materials,
    make_stream_step,
    move_hits,
)
from wrt.lights.light_sources import PointLight
from wrt.lights.sky_image import Sky
from wrt.materials.material import Material
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scenes.shapes import plane

STREAM = 4096
"""Rays of a stream, 64 x 64, as in Ramani et al. (2009)."""

WAYS = ("branches", "sorted", "filtered", "lanes", "sorted, lanes", "filtered, lanes")
"""The first three shade rays one by one, by numbers; rays do not move. In lanes, W matte rays side by side are shaded at once,
as in wrt's pictures; the last two move the rays together before."""

WIDTHS = (4, 8, 16, 32)
"""Lanes for which utilisation is counted."""

ANSWERS = ("lit", "shadow_origin", "shadow_direction")
FOLLOWING = ("origin", "direction", "weight", "density", "media")


@dataclass(frozen=True)
class StreamFigures:
    """What was measured of one way in one generation.

    Attributes:
        generation: 0 for camera rays.
        way: one of `WAYS`.
        rays: number of rays.
        shares: share of the rays by filter: missed, diffuse, mirror, dielectric, glossy.
        seconds: of the step with all that prepares it, median.
        ratio: speed over that of "branches", median of the rounds.
        prepared: seconds of sorting, filtering and moving alone, median; 0 without.
        same: whether all answers have the bits of "branches".
    """

    generation: int
    way: str
    rays: int
    shares: tuple[float, ...]
    seconds: float
    ratio: float
    prepared: float
    same: bool


def scene_of_materials(balls: int = 12, seed: int = 0) -> Scene:
    """balls x balls balls over a floor, each with a material of its own, the four kinds at random."""
    import trimesh

    random, ball = np.random.default_rng(seed), trimesh.creation.icosphere(subdivisions=3, radius=0.4)
    meshes = [plane((-1.0, -1.0), (balls, balls), z=-0.4).with_materials(Material(color=0.7))]
    for number in range(balls * balls):
        at = (number % balls, number // balls, 0.0)
        meshes.append(TriangleMesh(ball.vertices + at, ball.faces).with_materials(_material(random)))
    return Scene(meshes)


def _material(random: np.random.Generator) -> Material:
    color = tuple(random.uniform(0.4, 0.95, 3))
    match random.integers(4):
        case 0:
            return Material(color=color)
        case 1:
            return Material("mirror", color=color)
        case 2:
            return Material("dielectric", color=1.0, index=random.uniform(1.3, 1.8), roughness=0.3 * random.integers(2))
        case _:
            return Material("glossy", color=color, roughness=random.uniform(0.1, 0.6))


def compare_shading(
    scene: Scene,
    camera: PinholeCamera,
    *,
    lights: Sequence[Any] = (Sky(1.0), PointLight((0.0, 0.0, 8.0), 30.0)),
    samples: int = 1,
    depth: int = 6,
    stream: int = STREAM,
    rounds: int = 5,
    ways: Sequence[str] = WAYS,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[StreamFigures]:
    """Does the step of each generation of a picture in each way.

    Args:
        scene: without instances, with fewer than 65535 materials.
        camera, lights, samples, depth: of the picture, which is one wave.
        stream: rays of a stream.
        rounds: number of rounds per way.
        ways: of `WAYS`; the first is what ratios and answers refer to.
        on_turn: told the name of each turn.

    Raises:
        ValueError: a scene of instances, or an unknown way.
    """
    if scene.instances:
        raise ValueError("streams are filtered in scenes without instances; pass a scene of meshes")
    if unknown := [way for way in ways if way not in WAYS]:
        raise ValueError(f"unknown way {unknown[0]!r}; choose from {', '.join(WAYS)}")
    figures: list[StreamFigures] = []

    class MeasuredWave(Wave):
        """A wave whose path steps are done in every way."""

        def follow_in_tiles(self, *_: Any) -> bool:
            return False

        def _run_step(self, kernel: wp.Kernel, hits: DeviceHits) -> None:
            generation = Generation(self, kernel, hits, stream)
            figures.extend(_measure(generation, ways, rounds, on_turn))
            generation.begin()
            super()._run_step(kernel, hits)

    class MeasuredRendering(Rendering):
        wave_type = MeasuredWave

    wave = camera.width * camera.height * samples
    MeasuredRendering(scene, camera, lights=list(lights), samples=samples, depth=depth, wave=wave).advance()
    return figures


class Generation:
    """The rays and hits of a generation, and the ways to shade them.

    The stack has a filter for misses, and one for each kind of material that the scene has.
    """

    def __init__(self, wave: Wave, kernel: wp.Kernel, hits: DeviceHits, stream: int) -> None:
        self.wave, self.kernel, self.hits, self.stream = wave, kernel, hits.struct(), stream
        self.count, self.device, self.is_last = wave.count, wave._device, wave._step.is_last
        self._radiance = wp.clone(wave.radiance)
        present = {*wave.scene.materials.kind.numpy().tolist()}
        self.filters = [one for one in FILTERS if one == MISSED or one in present]
        self._stack = wp.array(np.array(self.filters, dtype=np.int32), dtype=int, device=self.device)
        self._rest, self.kinds = (wp.empty(self.count, dtype=int, device=self.device) for _ in range(2))
        self._moved = new_queue(self.count, self.device)
        self._moved_hits = HitBatch()
        for name, dtype in (("t", float), ("primitive", int), ("uv", wp.vec2)):
            setattr(self._moved_hits, name, wp.empty(self.count, dtype=dtype, device=self.device))
        identity = wp.array(np.arange(self.count, dtype=np.int32), dtype=int, device=self.device)
        self._unordered = self._in_blocks(identity, GROUP)

    def begin(self) -> None:
        """Undoes what steps have added to the samples."""
        wp.copy(self.wave.radiance, self._radiance)

    def prepare(self, way: str) -> Streams | None:
        """Sorts or filters, and moves the rays for a way in lanes."""
        materials = self.wave.scene.materials
        streams = None
        if way.startswith("sorted"):
            numbers = wp.empty(self.count, dtype=wp.uint16, device=self.device)
            launch(find_materials, self.count, [materials, self.hits, numbers], device=self.device, chunk=4096)
            streams = self._in_blocks(sort_buckets(numbers, materials.kind.shape[0] + 1)[0], GROUP)
        if way.startswith("filtered"):
            launch(find_kinds, self.count, [materials, self.hits, self.kinds], device=self.device, chunk=4096)
            streams = Streams()
            streams.order = wp.empty(self.count, dtype=int, device=self.device)
            streams.ends = wp.empty((-(-self.count // self.stream), len(self.filters) + 1), dtype=int, device=self.device)
            inputs = [self.stream, self.kinds, self._stack, self._rest, streams]
            launch(filter_streams, streams.ends.shape[0], inputs, device=self.device, chunk=1)
        if streams is not None and way.endswith("lanes"):
            inputs = [streams.order, self.wave.queue, self.hits, self._moved, self._moved_hits]
            launch(move_hits, self.count, inputs, device=self.device, chunk=4096)
        return streams

    def shade(self, way: str) -> None:
        """Does the step in one way, everything included."""
        streams = self.prepare(way)
        wave, queue, hits = self.wave, self.wave.queue, self.hits
        if way.endswith("lanes") and streams is not None:
            queue, hits = self._moved, self._moved_hits
        inputs = (wave._step, wave.scene, wave.samples, wave._wave, queue, hits, wave.gathered, wave.scratch, wave.is_alive)
        if way.endswith("lanes"):
            wave.run_groups(self.kernel, hits, *inputs)
            return
        streams = self._unordered if streams is None else streams
        own = self.filters if way == "filtered" else (UNKNOWN,)
        for number, known in enumerate(own):
            items, chunk = streams.ends.shape[0], 1 if way == "filtered" else 8
            launch(make_stream_step(known), items, [number, streams, *inputs], device=self.device, chunk=chunk)

    def answers(self, way: str) -> dict[str, np.ndarray]:
        """What the step of a way gives, by sample: places without a ray hold 0."""
        wave = self.wave
        self.begin()
        self.shade(way)
        found = {"radiance": wave.radiance.numpy().copy()}
        if self.is_last:
            return found
        slots, alive = (array.numpy()[: self.count] for array in (wave.scratch.slot, wave.is_alive))
        by_slot = {name: getattr(wave.gathered, name) for name in ANSWERS}
        by_slot |= {f"following {name}": getattr(wave.scratch, name) for name in FOLLOWING}
        for name, array in by_slot.items():
            values = array.numpy()[: self.count]
            kept = values if name in ANSWERS else np.where(alive.reshape(-1, *[1] * (values.ndim - 1)) != 0, values, 0)
            found[name] = np.zeros((len(wave.radiance), *values.shape[1:]), dtype=values.dtype)
            found[name][slots] = kept
        found["goes on"] = np.zeros(len(wave.radiance), dtype=np.int32)
        found["goes on"][slots] = alive
        return found

    def _in_blocks(self, order: wp.array, length: int) -> Streams:
        """Blocks of an order as streams of one list."""
        streams, begins = Streams(), np.arange(0, self.count, length, dtype=np.int32)
        streams.order = order
        ends = np.column_stack([begins, np.minimum(begins + length, self.count)]).astype(np.int32)
        streams.ends = wp.array(ends, dtype=int, device=self.device)
        return streams


def _measure(generation: Generation, ways: Sequence[str], rounds: int, on_turn: Callable[[str], None]) -> list[StreamFigures]:
    number = generation.wave._step.generation
    whole = [Contender(way, lambda way=way: generation.shade(way), generation.count) for way in ways]
    parts = [Contender(f"{way}: order", lambda way=way: generation.prepare(way), generation.count) for way in ways]
    timings = take_turns(whole + parts, rounds, on_turn=lambda way: on_turn(f"generation {number}: {way}"))
    expected = generation.answers(ways[0])
    materials = generation.wave.scene.materials
    launch(find_kinds, generation.count, [materials, generation.hits, generation.kinds], device=generation.device)
    kinds = generation.kinds.numpy()
    shares = tuple(float((kinds == one).mean()) for one in FILTERS)
    rows = []
    for way in ways:
        found = generation.answers(way)
        same = all(found[name].tobytes() == values.tobytes() for name, values in expected.items())
        ratio = 1.0 / timings[way].ratio_to(timings[ways[0]])
        prepared = timings[f"{way}: order"].median
        rows.append(StreamFigures(number, way, generation.count, shares, timings[way].median, ratio, prepared, same))
    return rows


def utilisation(kinds: np.ndarray, width: int, stream: int = 0) -> float:
    """Share of the lanes that work when groups of `width` rays take each kind among them in turn.

    Args:
        kinds: (N,) kind of each ray, in order.
        width: number of lanes.
        stream: rays of the streams that are filtered by kind before; 0 for rays as they come.
    """
    kinds, steps = np.asarray(kinds), 0
    block = stream or width
    for begin in range(0, len(kinds), block):
        counts = np.unique(kinds[begin : begin + block], return_counts=True)[1]
        steps += int((-(-counts // width)).sum())
    return len(kinds) / (steps * width)
