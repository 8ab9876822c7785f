"""The loops of packets one by one: packets of every kind of rays, a kernel that runs a loop on each of them, and plain rays.

`Packets` are rays that aim at the triangles of blocks; `loops` is a kernel whose items are packets in the memory of the device,
so that a test sees what a loop read and what it left behind. `plain_rays` is what `load_ray` and the triangle
test's `prepare` make of the same rays, and `candidates` what its scalar form finds, triangle by triangle.
"""

from dataclasses import dataclass, fields
from functools import cache

import numpy as np
import warp as wp

import wrt
from support.meshes import SCENES, snapped_soup
from wrt.kernels.layout.ray_batch import HitBatch, Ray, RayBatch, load_ray
from wrt.kernels.layout.unchecked import CACHE_LINE
from wrt.kernels.simd.boxes import SLACK, RaySlabs, clamp_to_box, ray_slabs, reach
from wrt.kernels.traversal.packet.leaves import packet_block
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import load_packet
from wrt.kernels.traversal.packet.rays.packet_store import store_packet
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import pack_blocks
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks, corners_high, corners_low, load_corners

BLOCKS = 4
"""Blocks of triangles that a packet is tested against."""

OPTIONS = {"module": "unique", "enable_backward": False, "module_options": {"fuse_fp": False}}
"""Of kernels with loops over lanes: compiled as those of queries are."""

TWIN_OPTIONS = OPTIONS | {"module_options": {"fuse_fp": False, "optimization_level": 1}}
"""Of kernels that only compare: they need not be fast, and compile in half of the time."""


@cache
def mesh() -> wrt.TriangleMesh:
    """Curved patches, triangles on a grid, where rays that start on it meet planes and edges exactly, and degenerate ones.

    Those on the grid are there twice, side by side. All are in the same unit cube.
    """
    grid, patches = snapped_soup(300, seed=5), SCENES["teapot"]()
    low, high = patches.bounds
    patches = wrt.TriangleMesh((patches.vertices - low) / (high - low).max(), patches.faces)
    parts = [patches, wrt.TriangleMesh(grid.vertices, np.repeat(grid.faces, 2, axis=0)), SCENES["degenerate"]()]
    return wrt.TriangleMesh(
        np.concatenate([part.vertices[part.faces].reshape(-1, 3) for part in parts]),
        np.arange(3 * sum(part.triangle_count for part in parts)).reshape(-1, 3),
    )


@wp.struct
class Loop:
    """What a loop reads and writes; a struct, because Warp compiles a kernel with arrays among its parameters twice."""

    rays: RayBatch
    hits: HitBatch
    triangles: TriangleBlocks
    blocks: wp.array2d(dtype=int)
    """(packets, BLOCKS) numbers of blocks."""
    masks: wp.array2d(dtype=wp.uint32)
    """(packets, columns) triangles of blocks."""
    low: wp.vec3
    """The scene."""
    high: wp.vec3
    packets: wp.array2d(dtype=float)
    bounds: wp.array(dtype=PacketBounds)
    boxes: wp.array(dtype=float)
    """Bounds of wide nodes."""
    keys: wp.array2d(dtype=int)
    intervals: wp.array2d(dtype=wp.vec2)
    """(packets, W) entry and leave of boxes."""
    frusta: wp.array2d(dtype=wp.vec2)
    answers: wp.array2d(dtype=int)
    columns: int
    """BLOCKS, and `lanes` is W: numbers that are known at run time only, because Warp would unroll loops over others."""
    lanes: int


LOAD, CLOSEST, ANY, STORE, STORE_ANY = range(5)
CLOSEST_BLOCKS = BLOCKS - 1
"""Blocks that a packet meets for its closest hits; the next is for any hit."""


@cache
def loops(layout: PacketLayout) -> wp.Kernel:
    """The loops that every packet goes through; which one is `stage`. Item: a packet."""
    load, store, store_any = load_packet(layout), store_packet(layout, False), store_packet(layout, True)
    closest, any_hit = packet_block.test_block(layout, False, False), packet_block.test_block(layout, True, False)
    rays = layout.rays

    def run(loop: Loop, stage: int):
        i = wp.tid()
        bounds = loop.bounds[i]
        first = i * wp.static(rays)
        if stage == LOAD:
            load(loop.rays, first, loop.low, loop.high, loop.packets[i], bounds)
        elif stage == CLOSEST:
            for j in range(loop.columns - 1):
                block = loop.blocks[i, j]
                closest(loop.triangles.records, loop.triangles.primitive, block, loop.masks[i, j], loop.packets[i], bounds)
        elif stage == ANY:
            block = loop.blocks[i, CLOSEST_BLOCKS]
            mask = loop.masks[i, CLOSEST_BLOCKS]
            any_hit(loop.triangles.records, loop.triangles.primitive, block, mask, loop.packets[i], bounds)
        elif stage == STORE:
            store(loop.packets[i], loop.rays, first, loop.hits, False)
        elif stage == STORE_ANY:
            store_any(loop.packets[i], loop.rays, first, loop.hits, False)
        loop.bounds[i] = bounds

    return wp.kernel(run, **OPTIONS)


@dataclass
class Packets:
    """Packets of rays and what they are tested against, on a device; see `make_packets`."""

    layout: PacketLayout
    loop: Loop
    count: int
    ids: np.ndarray
    """(blocks, W) primitive ids, -1 in unused lanes."""
    device: str

    def run(self, kernel: wp.Kernel, stage: int) -> None:
        """One loop on every packet."""
        wp.launch(kernel, self.count, [self.loop, stage], device=self.device)

    def bounds(self) -> np.ndarray:
        """(packets,) of `PacketBounds`."""
        return self.loop.bounds.numpy()

    def components(self) -> dict[str, np.ndarray]:
        """A copy of each component of all packets, (packets, P); whole numbers as int32."""
        return self._split(self.loop.packets.numpy().copy())

    def change(self, **components: np.ndarray) -> None:
        """Gives components other values."""
        rows = self.loop.packets.numpy().copy()
        places = self._split(rows)
        for name, values in components.items():
            places[name][:] = values
        self.loop.packets.assign(rows)

    def _split(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """The components that rows of memory hold."""
        begin = -(self.loop.packets.ptr // 4) % CACHE_LINE
        places = {}
        for number, name in enumerate(self.layout.components):
            first = begin + number * self.layout.rays
            values = rows[:, first : first + self.layout.rays]
            places[name] = values.view(np.int32) if name in ("primitive", "main_axis", "part") else values
        return places


def aims(rng: np.random.Generator, corners: np.ndarray) -> np.ndarray:
    """A point for each triangle: of its inside, an edge, a vertex, or beside it."""
    weights = rng.dirichlet((1, 1, 1), len(corners))
    kind = rng.integers(0, 8, len(corners))
    weights[kind == 0] = (1.0, 0.0, 0.0)
    weights[kind == 1] = (0.0, 0.5, 0.5)
    weights[kind == 2] = (0.25, 0.75, 0.0)
    beside = kind == 3
    weights[beside, 0] += 0.2
    weights[beside, 1] -= 0.2
    return np.einsum("ij,ijk->ik", weights, corners)


def aimed_rays(
    rng: np.random.Generator, targets: np.ndarray, low: np.ndarray, high: np.ndarray, shared: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Rays (packets, P, 3) to the targets, from an eye a packet, from around it, or all from one point; some go elsewhere."""
    packets, rays = targets.shape[:2]
    size = high - low
    grid = size.max() / 8.0  # where vertices lie on such a grid too, planes and areas come out as 0
    eyes = low + np.round(rng.uniform(-0.6, 1.6, (packets, 1, 3)) * size / grid) * grid
    spread = rng.choice([0.0, 0.02, 0.3], (packets, 1, 1)) * size
    origins = eyes + np.round(rng.normal(size=(packets, rays, 3)) * spread * 64.0 / grid) * grid / 64.0
    if shared:
        origins[:] = low + np.round(np.array([0.5, 0.3, 0.7]) * size / grid) * grid
    directions = targets - origins
    kind = rng.integers(0, 10, packets)
    axes = np.eye(3)[rng.integers(0, 3, packets)] * rng.choice([-1.0, 1.0], (packets, 1)) * size.max()
    directions[kind == 0] = axes[kind == 0, None]  # parallel to an axis
    directions[kind == 1, :, 0] = rng.choice([0.0, -0.0])  # in a plane
    directions[kind == 2] = rng.normal(size=(int((kind == 2).sum()), rays, 3)) * size  # everywhere
    far = np.isin(kind, (3, 4, 5))
    directions[far] = (targets[far, :1] - origins[far]) + rng.normal(size=(int(far.sum()), rays, 3)) * size * 0.02  # a beam
    bad = rng.integers(0, 300, (packets, rays))
    directions[bad == 0] = 0.0
    for code, value in enumerate((np.nan, np.inf, -np.inf)):
        for axis in range(3):
            directions[bad == 3 * code + axis + 1, axis] = value
            if not shared:
                origins[bad == 3 * code + axis + 11, axis] = value
    return origins, directions


def ranges(rng: np.random.Generator, packets: int, rays: int) -> tuple[np.ndarray, np.ndarray]:
    """(packets, P) t_min and t_max: open, narrow, reaching just to the target or from it on, empty, bad."""
    t_min = rng.choice([0.0, -0.0, 0.25, 1.0], (packets, rays), p=[0.6, 0.2, 0.15, 0.05])
    t_max = rng.choice([np.inf, 1.0, 1.5, 0.25], (packets, rays), p=[0.7, 0.15, 0.1, 0.05])
    t_min[0], t_max[0] = np.nan, 1.0  # a packet without a single ray
    bad = rng.integers(0, 100, (packets, rays))
    t_min[bad == 0] = np.nan
    t_min[bad == 1] = -1.0
    t_min[bad == 3] = -np.inf
    t_max[bad == 2] = np.nan
    return t_min, t_max


def tile_order(columns: int, rows: int, packet: int) -> np.ndarray:
    """Numbers of the pixels of a picture, tile by tile: bands of tiles, tiles from left to right, their pixels row by row. In a
    band, pixels of the columns beside the whole tiles come first, until a packet begins; the others come last."""
    across = min(packet, 8)
    down = packet // across
    pixels, found = np.arange(columns * rows).reshape(rows, columns), []
    for y in range(0, rows, down):
        band = pixels[y : y + down]
        before = -(y * columns) % packet if packet % across == 0 and len(band) == down else 0
        tiled = max(band.size - before, 0) // (across * len(band)) * across
        beside = band[:, tiled:].T.ravel()
        tiles = [band[:, x : x + across].ravel() for x in range(0, tiled, across)]
        found += [beside[:before], *tiles, beside[before:]]
    return np.concatenate(found)


def make_packets(layout: PacketLayout, count: int, device: str, columns: int = 0) -> Packets:
    """Packets that aim at blocks of neighbouring triangles of `mesh`; the last packet is not full.

    columns: that of the picture whose pixels the rays are taken for; 0 for rays as they come.
    """
    rng = np.random.default_rng(layout.rays + layout.width)
    total = count * layout.rays - layout.rays // 2 + 1
    total -= total % columns if columns else 0
    count = -(-total // layout.rays)
    center = np.full(3, 0.5)
    corners = (np.float64(mesh().vertices[mesh().faces]) - center).astype(np.float32)
    width, rays = layout.width, layout.rays
    ids = np.full(-(-len(corners) // width) * width, -1, dtype=np.int32)
    ids[: len(corners)] = np.arange(len(corners))
    blocks = rng.integers(0, len(ids) // width, (count, BLOCKS))
    blocks[:, 1] = (blocks[:, 0] + 1) % (len(ids) // width)
    blocks[::7, 2] = len(ids) // width - 1  # that with unused lanes
    chosen = (blocks[:, rng.choice([0, 1, 3], rays)] * width + rng.integers(0, width, (count, rays))) % len(corners)
    targets = aims(rng, corners[chosen.ravel()].astype(np.float64)).reshape(count, rays, 3)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    origins, directions = aimed_rays(rng, targets, low, high, layout.shared_origin)
    t_min, t_max = ranges(rng, count, rays)

    place = np.argsort(tile_order(columns, total // columns, rays)) if columns else np.arange(total)  # among the packets' rays

    def on_device(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

    def of_rays(values: np.ndarray, dtype: type) -> wp.array:
        return on_device(values.reshape(count * rays, -1)[place].astype(np.float32).squeeze(), dtype)

    loop = Loop()
    loop.rays.count, loop.rays.columns, loop.rays.center = total, columns, wp.vec3d(*center)
    loop.rays.origins = of_rays(origins + center, wp.vec3)[: 1 if layout.shared_origin else None]
    loop.rays.directions = of_rays(directions, wp.vec3)
    loop.rays.t_min, loop.rays.t_max = of_rays(t_min, float), of_rays(t_max, float)
    loop.rays.origin_stride = 0 if layout.shared_origin else 1
    loop.rays.direction_stride = loop.rays.t_min_stride = loop.rays.t_max_stride = 1
    test = TRIANGLE_TESTS[layout.triangle_test]
    shuffled = np.where(ids >= 0, rng.permutation(len(ids)), -1).astype(np.int32)  # ties do not go by places in the block
    vertices, faces = (
        on_device(corners.reshape(-1, 3), wp.vec3),
        on_device(np.arange(corners.size // 3).reshape(-1, 3), wp.vec3i),
    )
    origin = tuple((loop.rays.origins.numpy()[0] - center).astype(np.float32).tolist())
    loop.triangles = pack_blocks(test.record, vertices, faces, on_device(ids, int), width, origin)
    loop.triangles.primitive = on_device(shuffled, int)
    loop.blocks = on_device(blocks, int)
    everything = (1 << width) - 1
    masks = rng.choice([0, everything], (count, BLOCKS)) | rng.integers(0, everything + 1, (count, BLOCKS))
    loop.masks = on_device(masks, wp.uint32)
    loop.low, loop.high = wp.vec3(*low.tolist()), wp.vec3(*high.tolist())
    loop.packets = wp.zeros((count, -(-layout.size // CACHE_LINE) * CACHE_LINE), dtype=float, device=device)
    loop.columns, loop.lanes = BLOCKS, width
    loop.bounds = wp.zeros(count, dtype=PacketBounds, device=device)
    loop.answers = wp.zeros((count, 16), dtype=int, device=device)
    return Packets(layout, loop, count, shuffled.reshape(-1, width), device)


def bits(values: np.ndarray) -> np.ndarray:
    """Of float32 values, to tell -0 from 0."""
    return np.ascontiguousarray(values).view(np.int32)


@dataclass
class PlainRays:
    """The rays of packets as `load_ray` and `prepare` make them, and all candidates for hits; rows of P rays."""

    number: np.ndarray
    """(packets, P) of each ray in the batch; -1 beyond its end."""
    ray: np.ndarray
    """(packets, P) of `Ray`."""
    slabs: np.ndarray
    state: np.ndarray
    slack: np.ndarray
    candidates: np.ndarray
    """(packets, P, BLOCKS, W, 3) t, u, v by the scalar form and the consistency rule; t NaN for none."""

    def __getitem__(self, rows: np.ndarray) -> "PlainRays":
        """Those of some packets."""
        return PlainRays(*(getattr(self, field.name)[rows] for field in fields(self)))

    @property
    def valid(self) -> np.ndarray:
        """(packets, P) whether a ray is there, and good."""
        return (self.number >= 0) & (self.ray["valid"] != 0)

    def meeting(self, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(enter, leave) of each ray in each box of its packet's node, (packets, P, W), as `slab_interval`, within its range.

        boxes: (packets, 6, W).
        """
        shape = (*self.valid.shape, boxes.shape[-1])
        enter = np.broadcast_to(np.where(self.valid, self.ray["t_min"], np.float32(np.inf))[..., None], shape)
        leave = np.broadcast_to(np.where(self.valid, self.ray["t_max"], np.float32(-np.inf))[..., None], shape)
        with np.errstate(invalid="ignore", over="ignore"):
            for axis in range(3):
                low, high, inverse = boxes[:, None, axis], boxes[:, None, 3 + axis], self.slabs["inverse"][..., axis, None]
                near = (np.where(inverse < 0, high, low) - self.slabs["origin_in"][..., axis, None]) * inverse
                far = (np.where(inverse < 0, low, high) - self.slabs["origin_out"][..., axis, None]) * inverse
                enter, leave = np.where(near > enter, near, enter), np.where(far < leave, far, leave)
        return enter, leave


@cache
def make_plain(triangle_test: str) -> tuple[wp.Kernel, type]:
    """The kernel behind `plain_rays` and the struct that it fills. Item: a ray of a packet."""
    test = TRIANGLE_TESTS[triangle_test]
    RayState, prepare, intersect, load = test.ray_state, test.prepare, test.intersect, test.record.load
    load_vertices = load_corners(test.record.components)

    @wp.struct
    class Plain:
        number: wp.array(dtype=int)
        ray: wp.array(dtype=Ray)
        slabs: wp.array(dtype=RaySlabs)
        state: wp.array(dtype=RayState)
        slack: wp.array(dtype=float)
        candidates: wp.array3d(dtype=wp.vec3)

    def plain(loop: Loop, out: Plain, rays: int):
        i = wp.tid()
        number = out.number[i]
        if number < 0:
            return
        ray = load_ray(loop.rays, number)
        distance = reach(ray.origin, loop.low, loop.high)
        slabs = ray_slabs(ray.origin, ray.direction, distance)
        state = prepare(ray.origin, ray.direction)
        out.ray[i] = ray
        out.slabs[i] = slabs
        out.state[i] = state
        out.slack[i] = SLACK * distance
        for column in range(loop.columns):
            block = loop.blocks[i / rays, column]
            for lane in range(loop.lanes):
                slot = block * loop.lanes + lane
                hit = intersect(state, load(loop.triangles.records, slot, loop.lanes))
                corners = load_vertices(loop.triangles.records, slot, loop.lanes)
                if hit[0] == hit[0]:
                    hit[0] = clamp_to_box(slabs, corners_low(corners), corners_high(corners), hit[0])
                out.candidates[i, column, lane] = hit

    return wp.kernel(plain, **TWIN_OPTIONS), Plain


def plain_rays(packets: Packets) -> PlainRays:
    """The rays one by one, in plain Warp."""
    layout, loop, device = packets.layout, packets.loop, packets.device
    places = packets.count * layout.rays
    kernel, Plain = make_plain(layout.triangle_test)
    number = np.full(places, -1, dtype=np.int32)
    columns, total = loop.rays.columns, loop.rays.count
    number[:total] = tile_order(columns, total // columns, layout.rays) if columns else np.arange(total)
    out = Plain()
    out.number = wp.array(number, dtype=int, device=device)
    out.ray, out.slabs = (wp.zeros(places, dtype=kind, device=device) for kind in (Ray, RaySlabs))
    out.state = wp.zeros(places, dtype=TRIANGLE_TESTS[layout.triangle_test].ray_state, device=device)
    out.slack = wp.zeros(places, dtype=float, device=device)
    out.candidates = wp.zeros((places, BLOCKS, layout.width), dtype=wp.vec3, device=device)
    wp.launch(kernel, places, [loop, out, layout.rays], device=device)

    def rows(values: wp.array) -> np.ndarray:
        return values.numpy().reshape(packets.count, layout.rays, *values.numpy().shape[1:])

    return PlainRays(*(rows(getattr(out, name)) for name in ("number", "ray", "slabs", "state", "slack", "candidates")))
