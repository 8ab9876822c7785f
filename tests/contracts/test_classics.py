"""Classics: what "auto" never chooses is imported only when it is asked for, and the tables tell the truth about it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields

from support import import_graph

from wrt.kernels.on_demand import CLASSICS, OnDemand
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.triangle import CLASSIC_TESTS, TRIANGLE_TESTS
from wrt.kernels.triangle.support.triangle_contract import ClassicTest, TriangleTest

READERS = ("wrt.bench.", "wrt.cli.catalogue", f"{CLASSICS}.")
"""Who may import classics by name: benchmarks, the list of all algorithms, and they each other."""

ENGINE = {"woop", "moeller_trumbore", "wald"}
"""Triangle tests that are no classics."""

QUERIES = """
import sys
import numpy as np
import wrt

mesh = wrt.scenes.build("teapot", level=2)
origins, directions = np.zeros((4, 3)), np.eye(3)[[0, 1, 2, 0]]
for kind in ("bvh", "kdtree"):
    scene = wrt.Scene(mesh, kind)
    view = wrt.PinholeCamera(64, 64, position=(0, -10, 0), look_at=(0, 0, 0)).rays()
    random = np.random.default_rng(1).normal(size=(2, 40_000, 3))
    for rays in (view, wrt.Rays(*random)):
        for query in ("closest", "any", "count", "all"):
            scene.explain(rays, query=query)
    scene.intersect(origins, directions)
print([name for name in sys.modules if name.startswith("wrt.kernels.classics")])
"""


def test_auto_imports_no_classic():
    run = subprocess.run([sys.executable, "-c", QUERIES], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == "[]"


def test_no_module_of_the_engine_imports_a_classic():
    for module, used in import_graph.imports().items():
        if not module.startswith(READERS) and module != CLASSICS:
            assert not [name for name in used if name.startswith(CLASSICS)], module


def test_rows_of_triangle_tests_are_right():
    """What the table says of a classic before it is imported is what the test itself says."""
    assert CLASSIC_TESTS.keys() == TRIANGLE_TESTS.keys() - ENGINE
    for name, row in CLASSIC_TESTS.items():
        test = TRIANGLE_TESTS[name]
        assert isinstance(test, TriangleTest)
        for field in fields(ClassicTest):
            if field.name != "module":
                assert getattr(test, field.name) == getattr(row, field.name), f"{name}: {field.name}"


def test_auto_chooses_no_classic():
    for traversal in TRAVERSALS.values():
        if any(isinstance(make, OnDemand) for make in traversal.kernels.values()):
            assert traversal.score is None, traversal.name
    for culling in CULLINGS.values():
        if any(isinstance(getattr(culling, field.name), OnDemand) for field in fields(culling)):
            assert max(*culling.scores, *culling.filtered_scores) == 0.0, culling.name
