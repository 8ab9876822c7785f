"""Packet orders: which rays of a generation share a packet, by what is known of them before they are traced.

**Problem.** Packets of camera rays are tiles of the picture. Rays that these spawn lie in the order of their camera rays, and
neighbours may be of different types (shadow, reflected, refracted) and come from different surfaces.

**Idea.** Boulos et al. (2007) name four ways to put them together:
* `blind`: all rays as they were spawned, types mixed;
* `group`: rays that share a property, such as the material that their parents met, wherever in the picture they come from;
* `runs`: rays of one type that share the property and come from neighbouring camera rays;
* `types`: rays of one type.

A packet holds rays of one group only. The last packet of a group is filled up with places without a ray, so an order that makes
many groups leaves lanes idle: the reason why Boulos et al. rejected `group` without a test.

**Differences from the paper.** There a packet of camera rays spawns packets of its own. Here the rays of a whole wave are put
together, so that rays which end leave no gaps, and only `runs` depends on which camera rays are neighbours. Sorting rays
before they are traced, as Månsson, Munkberg and Akenine-Möller (2007) tried, by origin and direction needs no tags; that is the
order `cells` of `wrt.kernels.query.ordering.ray_order`.

**Steps.** Keys are sorted, stably; places where a packet must end are marked; groups are numbered by a scan; the rooms of the
groups, rounded up to whole packets, are summed; each ray is put into its place.

References: boulos-2007; mansson-2007; rahikainen-2013 (section 3.2).
"""

from dataclasses import dataclass

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

NO_RAY = -1
"""Number in a place that no ray takes."""

NEIGHBOURS = wp.constant(1)
"""Greatest difference of the numbers of two camera rays that count as neighbours."""


@dataclass(frozen=True)
class PacketOrder:
    """An order in which the rays of a generation fill packets.

    Attributes:
        name: key in `PACKET_ORDERS`.
        paper: authors, title, year.
        by_kind: whether rays are sorted by type; each type begins a packet.
        by_group: whether rays are sorted by the shared property; each value begins a packet.
        adjacent: whether a packet also ends where the property changes or a camera ray without such a ray lies between.
    """

    name: str
    paper: str
    by_kind: bool = False
    by_group: bool = False
    adjacent: bool = False

    @property
    def sorts(self) -> bool:
        """Whether the order differs from that in which the rays are given."""
        return self.by_kind or self.by_group


_BOULOS = "Boulos et al.: Packet-based Whitted and distribution ray tracing (2007)"

PACKET_ORDERS: dict[str, PacketOrder] = {
    order.name: order
    for order in (
        PacketOrder("blind", _BOULOS),
        PacketOrder("group", _BOULOS, by_group=True),
        PacketOrder("runs", _BOULOS, by_kind=True, adjacent=True),
        PacketOrder("types", _BOULOS, by_kind=True),
    )
}
"""Packet orders by name."""


@wp.struct
class RayTags:
    """What is known of the rays of a generation. (N,) each."""

    kind: wp.array(dtype=int)
    """Type, not negative."""
    group: wp.array(dtype=int)
    """Shared property, not negative."""
    source: wp.array(dtype=int)
    """Number of the camera ray that the ray comes from."""


@exact_kernel
def write_keys(
    first: int, tags: RayTags, by_kind: bool, by_group: bool, keys: wp.array(dtype=wp.int64), order: wp.array(dtype=int)
):
    """Writes the sort key of a ray, its type above its property. Item: a ray. keys: (2 rays,)."""
    i = first + wp.tid()
    kind = wp.where(by_kind, tags.kind[i], 0)
    group = wp.where(by_group, tags.group[i], 0)
    keys[i] = (wp.int64(kind) << wp.int64(32)) | wp.int64(group)
    order[i] = i


@exact_kernel
def mark_begins(
    first: int,
    tags: RayTags,
    adjacent: bool,
    keys: wp.array(dtype=wp.int64),
    order: wp.array(dtype=int),
    begins: wp.array(dtype=int),
):
    """Marks where packets must begin: 1, else 0. Item: a place of the sorted rays."""
    i = first + wp.tid()
    begin = int(1)
    if i > 0:
        begin = wp.where(keys[i] == keys[i - 1], 0, 1)
        if adjacent:
            own = order[i]
            last = order[i - 1]
            gap = tags.source[own] - tags.source[last]
            if tags.group[own] != tags.group[last] or gap > NEIGHBOURS or gap < -NEIGHBOURS:
                begin = 1
    begins[i] = begin


@exact_kernel
def write_starts(first: int, begins: wp.array(dtype=int), numbers: wp.array(dtype=int), starts: wp.array(dtype=int)):
    """Writes the start of each group. Item: a place of the sorted rays. numbers: inclusive sums of `begins`."""
    i = first + wp.tid()
    if begins[i] != 0:
        starts[numbers[i] - 1] = i


@exact_kernel
def count_packets(first: int, rays: int, packet: int, starts: wp.array(dtype=int), packets: wp.array(dtype=int)):
    """Counts the packets of a group. Item: a group."""
    group = first + wp.tid()
    end = int(rays)
    if group + 1 < starts.shape[0]:
        end = starts[group + 1]
    packets[group] = (end - starts[group] + packet - 1) / packet


@exact_kernel
def place_rays(
    first: int,
    packet: int,
    order: wp.array(dtype=int),
    numbers: wp.array(dtype=int),
    starts: wp.array(dtype=int),
    packets: wp.array(dtype=int),
    places: wp.array(dtype=int),
):
    """Puts a ray into its place. Item: a place of the sorted rays. packets: exclusive sums over the groups."""
    i = first + wp.tid()
    group = numbers[i] - 1
    places[packets[group] * packet + i - starts[group]] = order[i]


@exact_kernel
def fill_places(first: int, rays: RayBatch, places: wp.array(dtype=int), arranged: RayBatch):
    """Copies a ray to its place; a place without a ray gets no direction and misses. Item: a place."""
    place = first + wp.tid()
    i = places[place]
    direction = wp.vec3()
    if i >= 0:
        direction = rays.directions[i * rays.direction_stride]
        if rays.origin_stride != 0:
            arranged.origins[place] = rays.origins[i]
        if rays.t_min_stride != 0:
            arranged.t_min[place] = rays.t_min[i]
        if rays.t_max_stride != 0:
            arranged.t_max[place] = rays.t_max[i]
    arranged.directions[place] = direction


def find_places(order: PacketOrder, tags: RayTags, count: int, packet: int, device: wp.Device) -> wp.array:
    """(M,) int32 number of the ray in each place of the packets, `NO_RAY` in places without one; M is a multiple of `packet`.

    Args:
        order: the order.
        tags: what is known of the rays, in arrays on the device.
        count: number of rays.
        packet: rays of a packet.
        device: device of the tags.
    """
    if count == 0:
        return wp.empty(0, dtype=int, device=device)
    keys = wp.empty(2 * count, dtype=wp.int64, device=device)
    sorted_rays = wp.empty(2 * count, dtype=int, device=device)  # twice the room: the sort needs it
    launch(write_keys, count, [tags, order.by_kind, order.by_group, keys, sorted_rays], device=device, chunk=4096)
    if order.sorts:
        wp.utils.radix_sort_pairs(keys, sorted_rays, count)
    begins, numbers = (wp.empty(count, dtype=int, device=device) for _ in range(2))
    launch(mark_begins, count, [tags, order.adjacent, keys, sorted_rays, begins], device=device, chunk=4096)
    wp.utils.array_scan(begins, numbers, inclusive=True)
    groups = int(numbers[count - 1 : count].numpy()[0])
    starts, packets, sums = (wp.empty(groups, dtype=int, device=device) for _ in range(3))
    launch(write_starts, count, [begins, numbers, starts], device=device, chunk=4096)
    launch(count_packets, groups, [count, packet, starts, packets], device=device, chunk=4096)
    wp.utils.array_scan(packets, sums, inclusive=False)
    total = int(sums[groups - 1 : groups].numpy()[0]) + int(packets[groups - 1 : groups].numpy()[0])
    places = wp.full(total * packet, NO_RAY, dtype=int, device=device)
    launch(place_rays, count, [packet, sorted_rays, numbers, starts, sums, places], device=device, chunk=4096)
    return places
