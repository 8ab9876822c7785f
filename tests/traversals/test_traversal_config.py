"""Kernels are cached by the whole config: equal configs share a kernel, and every option of a family makes another."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.traversal_config import (
    PacketConfig,
    SingleConfig,
    StackConfig,
    StreamConfig,
    TileConfig,
    TraversalConfig,
)

FAMILIES = {
    ("single", "bvh"): {"stack": StackConfig(24, 64)},
    ("single", "kdtree"): {"single": SingleConfig(pair_words=3, scalar_test=True, compact=2)},
    ("packet", "bvh"): {"packet": PacketConfig(16, True, "none", True), "stack": StackConfig(24, 64)},
    ("mlrta", "kdtree"): {"tiles": TileConfig(2, 8, 3)},
    ("stream", "bvh"): {"stream": StreamConfig(256)},
}
"""For each traversal and kind of tree, values that are not the default for every option of the families that it reads."""


@pytest.mark.parametrize(("traversal", "tree"), FAMILIES)
def test_every_option_is_part_of_the_key(traversal, tree):
    make = TRAVERSALS[traversal].kernels[tree]
    plain = TraversalConfig("woop", 4)
    assert make(plain) is make(TraversalConfig("woop", 4, packet=PacketConfig(), stream=StreamConfig()))
    kernels = [make(plain)]
    for family, values in FAMILIES[traversal, tree].items():
        for field in fields(values):
            value = getattr(values, field.name)
            assert value != field.default
            changed = replace(plain, **{family: replace(getattr(plain, family), **{field.name: value})})
            kernels.append(make(changed))
    assert len(set(kernels)) == len(kernels)
