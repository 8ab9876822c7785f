"""Chains of kernels, tile by tile: every stage sees the items that the one before has left, from any number of threads."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.runtime.launch_chain import LaunchChain, Stage


@wp.struct
class Numbers:
    values: wp.array(dtype=int)
    stop: int


@wp.kernel(enable_backward=False)
def add_one(first: int, numbers: Numbers, group: int):
    begin = (first + wp.tid()) * group
    for i in range(begin, wp.min(begin + group, numbers.stop)):
        numbers.values[i] = numbers.values[i] + 1


@wp.kernel(enable_backward=False)
def drop_thirds(first: int, size: int, stop: int, values: wp.array(dtype=int), left: wp.array(dtype=int)):
    tile = first + wp.tid()
    kept = int(0)
    for i in range(tile * size, stop):
        if values[i] % 3 != 0:
            values[tile * size + kept] = values[i]
            kept += 1
    left[tile] = kept


@wp.kernel(enable_backward=False)
def add_one_slowly(first: int, numbers: Numbers, group: int):
    begin = (first + wp.tid()) * group
    for i in range(begin, wp.min(begin + group, numbers.stop)):
        turns = int(0)
        for _ in range(1000):
            turns = (turns * 5 + numbers.values[i]) % 7
        numbers.values[i] = numbers.values[i] + wp.where(turns < 0, 2, 1)


def expected(values: np.ndarray, size: int, turns: int) -> list[list[int]]:
    """What is left of each tile."""
    tiles = [values[begin : begin + size] for begin in range(0, len(values), size)]
    for _ in range(turns):
        tiles = [tile[(tile + 1) % 3 != 0] + 1 for tile in tiles]
    return [tile.tolist() for tile in tiles]


@pytest.mark.parametrize("threads", [1, 2, 7])
@pytest.mark.parametrize("by_stages", [False, True])
def test_stages_see_what_is_left_of_their_tile(threads, by_stages):
    """Some tiles run empty before the last stage. Carried out stage by stage, or whole, the answer is the same."""
    size, turns, group = 96, 2, 32
    values = np.random.default_rng(0).integers(0, 1000, 40 * size - 5)
    values[20 * size : 30 * size] = 3 * values[20 * size : 30 * size] + 2
    numbers, tiles = Numbers(), 40
    numbers.values = wp.array(values, dtype=int, device="cpu")
    left = wp.array([size] * (tiles - 1) + [size - 5], dtype=int, device="cpu")
    chain = LaunchChain(size, left, wp.get_device("cpu"))
    with use_threads(threads):
        for _ in range(turns):
            for stage in (
                Stage(add_one, [numbers, group], group, (1, "stop")),
                Stage(drop_thirds, [size, 0, numbers.values, left], size, (2, "")),
            ):
                chain.add(stage)
                if by_stages:
                    chain.run(0, tiles, len(chain) - 1)
        if not by_stages:
            chain.run(0, 7)
            chain.run(7, tiles)
    found, counts = numbers.values.numpy(), left.numpy()
    assert [found[t * size : t * size + counts[t]].tolist() for t in range(tiles)] == expected(values, size, turns)
    assert 0 in counts
    assert counts.max() > 0
    assert (chain.seconds > 0.0).all()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("slow", [0, 1])
def test_tiles_go_the_faster_of_two_ways(threads, slow):
    """Both alternatives are tried, the faster one is taken for most tiles, and the answer is that of either."""
    size, tiles = 64, 1024
    numbers = Numbers()
    values = np.random.default_rng(1).integers(0, 1000, tiles * size)
    numbers.values = wp.array(values, dtype=int, device="cpu")
    left = wp.full(tiles, size, dtype=int, device="cpu")
    chain = LaunchChain(size, left, wp.get_device("cpu"))
    alternatives = [Stage(kernel, [numbers, size], size, (1, "stop")) for kernel in (add_one, add_one_slowly)]
    with use_threads(threads):
        assert len(chain.add(*(alternatives[::-1] if slow == 0 else alternatives))) == 2
        chain.run(0, tiles)
    np.testing.assert_array_equal(numbers.values.numpy(), values + 1)
    items = chain.items[0]
    assert items.sum() == tiles * size
    assert 8192 <= items[slow] < 0.3 * items.sum() < items[1 - slow]


def test_bad_stages():
    numbers = Numbers()
    numbers.values = wp.zeros(8, dtype=int, device="cpu")
    chain = LaunchChain(8, wp.zeros(1, dtype=int, device="cpu"), wp.get_device("cpu"))
    with pytest.raises(ValueError, match="grain of 3 items does not divide tiles of 8"):
        chain.add(Stage(add_one, [numbers, 3], 3, (1, "stop")))
    with pytest.raises(ValueError, match="1 to 2 alternatives, not 0"):
        chain.add()
