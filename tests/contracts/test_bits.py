"""Hits and trees have the bits that were kept when they were last meant to change; `python -m tests.bits` compares all."""

from __future__ import annotations

import pytest
from bits import digests
from bits.hit_bits import hit_hashes
from bits.tree_bits import tree_hashes

from wrt.kernels.compilation.target import lane_width
from wrt.state.query_kinds import ANY, CLOSEST

BUILDS = ("kdtree in_place", "kdtree binned", "bvh binned")


@pytest.mark.width
def test_hits_have_their_bits():
    """At any width, on any tree, by any traversal."""
    kept = digests.read()["hits"]
    found = list(hit_hashes(["teapot", "grid"], ["single", "stream", "packet"], ["woop"], (CLOSEST, ANY)))
    assert len(found) == 24
    for case, engine, value in found:
        assert value == kept[case], f"{case}: {engine}"


@pytest.mark.width
def test_trees_have_their_bits():
    kept = digests.read().get(f"trees {lane_width()}")
    if kept is None:
        pytest.skip(f"no trees of {lane_width()} lanes are kept")
    for case, threads, value in tree_hashes(["grid", "needles"], [1, 2], BUILDS):
        assert value == kept[case], f"{case}: {threads}"


def test_a_change_of_one_bit_is_a_difference():
    kept = digests.read()
    (case, value), *_ = kept["hits"].items()
    assert digests.differences({"hits": {case: value}}, kept) == []
    assert digests.differences({"hits": {case: value[:-1]}}, kept) == [f"hits: {case}: {value[:-1]}, kept is {value}"]
    assert digests.differences({"hits": {"new": value}}, kept) == [f"hits: new: {value}, none is kept"]
