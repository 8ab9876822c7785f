"""Which rays of a picture form a packet: every ray once, and whole tiles wherever a picture of any width has room for them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.traversal.packet.rays.ray_numbers import ray_at

PACKETS = (4, 8, 12, 16, 32, 64)


def numbers_of(packet: int) -> wp.Function:
    @native.func_native(
        "packet.h",
        f"""const wrt::PacketRays<{packet}> own(rays, first);
        for (int k = 0; k < own.here; ++k) numbers.data[first + k] = own.number[k];
        if (own.whole) own.each([&](int k, int n) {{ numbers.data[first + k] = n; }});
        whole.data[first / {packet}] = own.whole ? 1 : 0;
        const wrt::PacketRow<{packet}, 4> row(rays, first, 1 << 20);
        if (row.packets > 0 && row.begin != numbers.data[first]) whole.data[first / {packet}] = -1;
        const int count = row.packets < 0 ? -2 : row.packets;
        runs.data[first / {packet}] = count;""",
    )
    def write(
        rays: wp.ref[RayBatch], first: int, numbers: wp.array(dtype=int), whole: wp.array(dtype=int), runs: wp.array(dtype=int)
    ): ...

    return write


FUNCTIONS = {packet: numbers_of(packet) for packet in PACKETS}


@exact_kernel
def write_numbers(
    first: int,
    rays: RayBatch,
    packet: int,
    numbers: wp.array(dtype=int),
    plain: wp.array(dtype=int),
    whole: wp.array(dtype=int),
    runs: wp.array(dtype=int),
):
    at = (first + wp.tid()) * packet
    for place in range(at, wp.min(at + packet, rays.count)):
        plain[place] = ray_at(rays, place, packet)
    if packet == 4:
        wp.static(FUNCTIONS[4])(rays, at, numbers, whole, runs)
    if packet == 8:
        wp.static(FUNCTIONS[8])(rays, at, numbers, whole, runs)
    if packet == 12:
        wp.static(FUNCTIONS[12])(rays, at, numbers, whole, runs)
    if packet == 16:
        wp.static(FUNCTIONS[16])(rays, at, numbers, whole, runs)
    if packet == 32:
        wp.static(FUNCTIONS[32])(rays, at, numbers, whole, runs)
    if packet == 64:
        wp.static(FUNCTIONS[64])(rays, at, numbers, whole, runs)


@pytest.mark.parametrize("packet", PACKETS)
def test_each_ray_is_in_one_packet(packet):
    """Also of pictures that are smaller than a tile; the two mappings agree, and few packets have rays of several tiles."""
    cpu, across = wp.get_device("cpu"), min(packet, 8)
    down = packet // across
    for columns in (1, 2, 3, 5, 8, 9, 12, 15, 16, 19, 23, 64, 100, 131):
        for rows in (1, 2, 3, 4, 7, 8, 9, 16, 33):
            rays, count = RayBatch(), columns * rows
            rays.count, rays.columns = count, columns
            packets = -(-count // packet)
            numbers, plain = (wp.full(count, -1, dtype=int, device=cpu) for _ in range(2))
            whole, runs = (wp.full(packets, -9, dtype=int, device=cpu) for _ in range(2))
            wp.launch(write_numbers, packets, [0, rays, packet, numbers, plain, whole, runs], device=cpu)
            found, case = numbers.numpy(), f"{columns} x {rows}"
            np.testing.assert_array_equal(found, plain.numpy(), err_msg=case)
            np.testing.assert_array_equal(np.sort(found), np.arange(count), err_msg=case)
            is_tile = whole.numpy()
            assert (is_tile >= 0).all(), case
            for number in np.flatnonzero(is_tile):
                own = found[number * packet : (number + 1) * packet].reshape(down, across)
                assert (own == own[0, 0] + np.arange(across) + columns * np.arange(down)[:, None]).all(), case
            if packet % across == 0:
                assert is_tile.sum() >= (columns // across - 1) * (rows // down), case
                assert (runs.numpy()[is_tile == 0] == 0).all(), case
