"""The architecture: no circle of imports, and a short way from a query to its kernel."""

from __future__ import annotations

import ast
import sys

import numpy as np
import pytest
from support import import_graph, query_walk

import wrt
from wrt.engine import executor
from wrt.kernels.runtime.launch import PreparedLaunch

MOST_MODULES = 8
"""Modules on the way from `Scene.intersect` to the launch of its kernel."""

MOST_HAND_OVERS = 20
"""Of the origins, from file to file, in a call whose query is prepared."""

MOST_CALLS = 60
"""Functions of wrt that such a call runs."""


def test_no_circle_of_modules():
    assert not import_graph.circle(import_graph.imports())


def test_no_circle_of_rooms():
    assert not import_graph.circle(import_graph.room_imports())


def test_a_circle_would_be_found():
    assert import_graph.circle({"a": {"b"}, "b": {"c"}, "c": {"a"}})
    assert not import_graph.circle({"a": {"b", "c"}, "b": {"c"}, "c": set()})


@pytest.mark.parametrize("count", [1, 5000])
def test_way_of_a_query(monkeypatch, count):
    """Through few modules, and from a higher one to a lower one: each imports the next, directly or through others."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu")
    rays = np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)
    scene.intersect(rays * 9, -rays)
    ways, launch = [], PreparedLaunch.run

    def run(*args, **options):
        way, frame = [], sys._getframe()
        while frame is not None and frame.f_code is not test_way_of_a_query.__code__:
            name = frame.f_globals["__name__"]
            if name.startswith("wrt.") and name not in way[-1:]:
                way.append(name)
            frame = frame.f_back
        ways.append(way[::-1])
        return launch(*args, **options)

    monkeypatch.setattr(PreparedLaunch, "run", run)
    scene.intersect(rays * 9, -rays)
    assert ways
    floor = import_graph.floors(import_graph.imports())
    monkeypatch.syspath_prepend(import_graph.ROOT / "docs")
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'wrt[test-all]'")
    import drawings

    drawn = [module for module, _, _ in drawings.QUERY][1:]  # after the scene, which inherits its queries
    for way in ways:
        way = [*way, PreparedLaunch.__module__]
        assert way[0] == "wrt.query.api"
        assert len(way) <= MOST_MODULES, way
        assert way == drawn[: len(way)], "docs/drawings.py draws another way"
        assert [floor[name] for name in way] == sorted((floor[name] for name in way), reverse=True), way


@pytest.mark.parametrize("count", [1, 5000])
def test_rays_are_handed_down(monkeypatch, count):
    """A call whose query is prepared runs few functions; the origins pass few files, and go to no room above.

    The clock of "auto" stands still. On a busy machine calls that are watched seem slow, one after the other was a turn of a
    trial, which runs more functions, and there was none to count.
    """
    monkeypatch.setattr(executor, "call_clock", lambda: lambda: 0.0)
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu")
    rays = np.random.default_rng(0).normal(size=(2, count, 3)).astype(np.float32)
    for _ in range(6):
        scene.intersect(*rays)
    walks = [query_walk.walk(scene.intersect, *rays.copy()) for _ in range(3)]
    seen = min(walks, key=lambda one: one.calls)  # "auto" times one call of four; collected garbage calls functions, too
    assert ("wrt.engine.executor", "wrt.engine.launch.prepared") in seen.hand_overs or count == 1
    assert 5 < len(seen.hand_overs) <= MOST_HAND_OVERS, seen.hand_overs
    assert 20 < seen.calls <= MOST_CALLS
    assert not seen.climbs


def test_nothing_compares_the_kind_of_a_query():
    """A query's kind is a row of a table, whose switches say what it does: no `if kind == ANY`."""
    kinds = {"CLOSEST", "ANY", "COUNT", "ALL", "EXACT", "WINDING"}
    readers = [name for name, used in import_graph.imports().items() if "wrt.engine.facts.query_kinds" in used]
    assert len(readers) > 20
    for name in readers:
        for node in ast.walk(ast.parse(import_graph.modules()[name].read_text())):
            if isinstance(node, ast.Compare) and name != "wrt.bench.peers.engines":  # which has kinds of workloads
                assert not kinds & {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}, (name, node.lineno)
