"""Hits and trees have the bits that were kept when they were last meant to change; `python -m tests.bits` compares all."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from bits import digests
from bits.tree_bits import tree_hashes
from support.environment import AS_USERS

from wrt import revisions
from wrt.kernels.compilation.target import lane_width

TESTS = Path(__file__).parents[1]

FAMILIES = (("trees", " bvh"), ("trees", " kdtree"), ("pictures", ""))
BUILDS = ("kdtree in_place", "kdtree binned", "bvh binned")


FIRST_ENGINES = """
import json
import support.environment
import warp as wp
from bits.hit_bits import hit_hashes
from wrt.engine.facts.query_kinds import ANY, CLOSEST

engines = ["single", "stream", "packet", "interleaved"]
hashes = list(hit_hashes(["teapot", "grid"], engines, ["woop"], (CLOSEST, ANY)))
print(json.dumps([hashes, wp.config.cpu_compiler_flags]))
"""


@pytest.mark.width
def test_hits_have_their_bits():
    """At any width, on any tree, by the traversals that users run first, compiled as theirs are."""
    paths = [str(folder) for folder in (TESTS, TESTS.parent)]
    environment = os.environ | {AS_USERS: "1", "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run([sys.executable, "-c", FIRST_ENGINES], env=environment, capture_output=True, text=True, check=True)
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


def test_hashes_are_those_of_the_revisions():
    """Hashes that change without a revision would leave stale trees, samples and jobs in use."""
    kept, known = digests.read(), digests.recorded()
    assert digests.faults_of_revisions(kept, known) == []
    assert set(digests.family_digests(kept)) == set(known)
    of_widths = {f"{results} {width}{kind}" for results, kind in FAMILIES for width in (8, 16)}
    assert {"hits", *of_widths} <= set(known)


@pytest.mark.parametrize(
    ("family", "raised"),
    [
        ("hits", lambda patch: patch.setattr(revisions, "ANSWER_REVISION", 99)),
        ("pictures 8", lambda patch: patch.setattr(revisions, "SAMPLE_REVISION", 99)),
        ("trees 16 bvh", lambda patch: patch.setitem(revisions.TREE_REVISION, "bvh", 99)),
        ("trees 16 kdtree", lambda patch: patch.setitem(revisions.TREE_REVISION, "kdtree", 99)),
    ],
)
def test_changed_hashes_need_a_raised_revision(tmp_path, monkeypatch, family, raised):
    path = tmp_path / "hashes.json"
    kept = digests.read()
    assert digests.write(kept, path) == []
    before = path.read_bytes()
    group = family if family in kept else family.rpartition(" ")[0]
    case = next(case for case in kept[group] if digests.family_of(group, case) == family)
    changed = {group: {case: "0" * 16}}

    by_hand = {**kept, group: kept[group] | changed[group]}
    assert [line.split(":")[0] for line in digests.faults_of_revisions(by_hand, digests.recorded(path))] == [family]
    (refused,) = digests.write(changed, path)
    assert refused.startswith(f"{family}: 1 hashes changed, such as {case}: raise the revision")
    assert path.read_bytes() == before
    assert digests.write({group: {"new bvh": "1" * 16}}, path) == [], "a new case changes no results"

    before_raise = digests.recorded(path)[family]["revision"]
    raised(monkeypatch)
    stale = digests.faults_of_revisions(digests.read(path), digests.recorded(path))
    assert any(line.startswith(f"{family}: recorded at revision {before_raise}, and wrt/revisions.py has 99") for line in stale)
    assert digests.write(changed, path) == []
    assert digests.recorded(path)[family]["revision"] == 99
    assert digests.read(path)[group][case] == "0" * 16


def test_a_change_of_one_bit_is_a_difference():
    kept = digests.read()
    (case, value), *_ = kept["hits"].items()
    assert digests.differences({"hits": {case: value}}, kept) == []
    assert digests.differences({"hits": {case: value[:-1]}}, kept) == [f"hits: {case}: {value[:-1]}, kept is {value}"]
    assert digests.differences({"hits": {"new": value}}, kept) == [f"hits: new: {value}, none is kept"]
