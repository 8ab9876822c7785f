"""Hits and trees have the bits that were kept when they were last meant to change; `python -m tests.bits` compares all."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import conftest
import pytest
from bits import digests
from bits.tree_bits import tree_hashes

from wrt.kernels.compilation.target import lane_width

TESTS = Path(__file__).parents[1]

BUILDS = ("kdtree in_place", "kdtree binned", "bvh binned")


AS_USERS = """
import json
import warp as wp
from bits.hit_bits import hit_hashes
from wrt.state.query_kinds import ANY, CLOSEST

engines = ["single", "stream", "packet", "interleaved"]
hashes = list(hit_hashes(["teapot", "grid"], engines, ["woop"], (CLOSEST, ANY)))
print(json.dumps([hashes, wp.config.cpu_compiler_flags]))
"""


@pytest.mark.width
def test_hits_have_their_bits():
    """At any width, on any tree, by the traversals that users run first, compiled as theirs are."""
    paths = [str(folder) for folder in (TESTS, TESTS.parent)]
    environment = os.environ | {conftest.AS_USERS: "1", "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run([sys.executable, "-c", AS_USERS], env=environment, capture_output=True, text=True, check=True)
    found, flags = json.loads(done.stdout.splitlines()[-1])
    assert "-O1" not in flags
    assert "-mllvm=-inline-threshold=9000" in flags
    kept = digests.read()["hits"]
    assert len(found) == 28
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
