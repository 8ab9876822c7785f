"""Random numbers of noise: those of the generator's authors."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.runtime.launch import launch
from wrt.kernels.sensors.philox import random_words


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_known_answers(device, counter, key, expected):
    """Those that the authors publish with the generator."""
    counters = wp.array(np.array([counter], dtype=np.uint32), dtype=wp.vec4ui, device=device)
    words = wp.empty_like(counters)
    launch(random_words, 1, [wp.vec2ui(*key), counters, words], device=counters.device)
    assert tuple(words.numpy()[0]) == expected
