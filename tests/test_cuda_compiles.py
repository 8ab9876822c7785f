"""Every kernel compiles for CUDA, on machines without a GPU too: NVRTC comes with Warp."""

from __future__ import annotations

import importlib
import pkgutil

import pytest
import warp as wp

import wrt.builders
import wrt.kernels
from wrt.builders.kdtree import adaptive_sampling, binned, medians, naive
from wrt.builders.kdtree.event_lists import EVENTS
from wrt.builders.kdtree.subtrees import make_build_subtrees
from wrt.kernels.packet import CULLINGS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.config import QUERIES, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.packing import make_kernel as make_packing_kernel

ARCHITECTURE = 75

KDTREE_METHODS = (EVENTS, binned.METHOD, naive.METHOD, medians.SPACE, medians.OBJECTS, adaptive_sampling.METHOD)


def modules_with_kernels() -> list[str]:
    """Python modules that define kernels at their top level."""
    names = []
    for package in (wrt.kernels, wrt.builders):
        for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            module = importlib.import_module(info.name)
            if any(isinstance(v, wp.Kernel) and v.module.name == info.name for v in vars(module).values()):
                names.append(info.name)
    return names


def compile_to_ptx(module, folder) -> str:
    wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=folder, use_ptx=True)
    (text,) = (path.read_text() for path in folder.glob("*.ptx"))
    return text


@pytest.mark.parametrize("name", modules_with_kernels())
def test_module(name, tmp_path):
    assert ".entry" in compile_to_ptx(importlib.import_module(name), tmp_path)


@pytest.mark.parametrize("method", KDTREE_METHODS, ids=lambda method: method.search.key)
def test_kdtree_subtrees(method, tmp_path):
    assert ".entry" in compile_to_ptx(make_build_subtrees(method).module, tmp_path)


@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("triangle_test", TRIANGLE_TESTS)
@pytest.mark.parametrize(("traversal", "tree"), [(name, tree) for name, way in TRAVERSALS.items() for tree in way.trees])
def test_traversal(traversal, tree, triangle_test, query, tmp_path):
    config = TraversalConfig(triangle_test, 2, query, counters=query == "closest", packet=4)
    kernel = TRAVERSALS[traversal].kernels[tree](config)
    text = compile_to_ptx(kernel.module, tmp_path)
    assert ".entry" in text
    assert "fma.rn.f32" not in text, "a fused multiply-add breaks watertightness and the equality of devices"


@pytest.mark.parametrize("shared_origin", [False, True])
@pytest.mark.parametrize("culling", CULLINGS)
def test_culling(culling, shared_origin, tmp_path):
    config = TraversalConfig("woop", 2, packet=4, shared_origin=shared_origin, culling=culling)
    text = compile_to_ptx(TRAVERSALS["packet"].kernels["bvh"](config).module, tmp_path)
    assert ".entry" in text
    assert "fma.rn.f32" not in text


@pytest.mark.parametrize("triangle_test", TRIANGLE_TESTS)
def test_packing(triangle_test, tmp_path):
    assert ".entry" in compile_to_ptx(make_packing_kernel(TRIANGLE_TESTS[triangle_test].record).module, tmp_path)
