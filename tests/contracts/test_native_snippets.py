"""C++ snippets use only names that they declare.

Warp compiles the snippets of a module in one file, behind its own headers. A name that a snippet does not declare may be found
there by chance, as long as another snippet or the next version of Warp happens to declare it.
"""

from __future__ import annotations

import ast
import gc
import inspect
from dataclasses import replace
from pathlib import Path

import pytest
import warp as wp
from support.device_modules import ROOT, device_modules
from support.native_guards import has_assembly, x86_without_guard
from support.native_names import free_names

from wrt.builders.lights.light_raster import COUNT, COVER, FILL, make_rasteriser
from wrt.engine.facts.query_kinds import QUERIES
from wrt.kernels.classics.studies.bare_triangle_tests import make_frusta
from wrt.kernels.classics.studies.distance_checks import in_range
from wrt.kernels.classics.studies.exit_counts import make_kernel as make_exit_kernel
from wrt.kernels.classics.studies.komatsu_2008 import PUBLISHED
from wrt.kernels.classics.studies.warp_packets import WAYS
from wrt.kernels.classics.studies.warp_packets import make_kernel as make_warp_kernel
from wrt.kernels.clouds.cloud_walk import make_cloud_kernel
from wrt.kernels.fields.winding_walk import make_winding_kernel
from wrt.kernels.pairs.pair_walk import make_meeting_kernel, make_nearest_kernel
from wrt.kernels.points.device_points import add_point_search
from wrt.kernels.points.exact_points import make_exact_points_kernel
from wrt.kernels.points.packed_points import make_packed_points_kernel
from wrt.kernels.points.tree_points import TASKS, TREES, PointConfig, make_points_kernel
from wrt.kernels.query.binary.binary_exact import make_binary_exact_instance_kernel, make_binary_exact_kernel
from wrt.kernels.query.binary.binary_handles import binary_handle_type, binary_instances_handle_type
from wrt.kernels.query.device_functions import handle_type, instances_handle_type
from wrt.kernels.runtime import native
from wrt.kernels.simd.box_lanes import ray_boxes
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.persistent.persistent_bvh import make_persistent_instance_kernel
from wrt.kernels.traversal.shadows.light_buffer_lanes import make_lane_kernel
from wrt.kernels.traversal.shadows.multi_frusta import make_multi_frusta_kernel
from wrt.kernels.traversal.traversal_config import PacketConfig, SingleConfig, StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level.instance_packets import make_instance_packet_kernel
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import make_packing_kernel

WIDTH = 4


def make_all_kernels() -> list[wp.Kernel]:
    """Makes kernels, without compiling them, so that every factory of snippets is called with each entry of its table."""
    config = TraversalConfig("woop", WIDTH)
    answers = [(way, tree, query) for way in TRAVERSALS.values() for tree in way.trees for query in QUERIES]
    kernels = [
        way.kernels[tree](TraversalConfig("woop", WIDTH, query)) for way, tree, query in answers if way.supports(query, tree)
    ]
    fronts = TraversalConfig("woop", WIDTH, cull_backfaces=True)
    kernels += [way.kernels["bvh"](fronts) for way in TRAVERSALS.values() if Capabilities.FRONT_FACES in way.capabilities]
    packets, streams, single = (TRAVERSALS[name].kernels for name in ("packet", "stream", "single"))
    for name, test in TRIANGLE_TESTS.items():
        kernels += [make["bvh"](TraversalConfig(name, WIDTH)) for make in (packets, streams, single)]
        kernels.append(make_packing_kernel(test.record))
    for name in CULLINGS:
        options = [PacketConfig(64, shared_origin, name) for shared_origin in (False, True)]
        kernels += [packets["bvh"](TraversalConfig("woop", WIDTH, packet=packet)) for packet in options]
    for name in MAILBOXES:
        kernels += [make["kdtree"](TraversalConfig("woop", WIDTH, mailbox=name)) for make in (packets, single)]
    for form in PUBLISHED.values():
        kernels += [make_frusta(form, WIDTH, WIDTH), make_exit_kernel(form)]
    kernels.append(single["bvh"](TraversalConfig("woop", WIDTH, stack=StackConfig(24, 64))))
    kernels.append(single["kdtree"](TraversalConfig("woop", WIDTH, single=SingleConfig(compact=2))))
    kernels.append(make_instance_packet_kernel(config, 8))
    kernels += [make_rasteriser(stage, False, True, False) for stage in (COVER, COUNT, FILL)]
    kernels.append(make_lane_kernel("woop"))
    kernels += [
        make_multi_frusta_kernel(TraversalConfig(name, WIDTH), each) for name in ("woop", "wald") for each in (False, True)
    ]
    kernels += [make(replace(config, triangle_test="discs")) for make in (make_cloud_kernel, streams["bvh"])]
    kernels += [make_winding_kernel(WIDTH), make_nearest_kernel(WIDTH), make_meeting_kernel(WIDTH)]
    kernels += [make_points_kernel(PointConfig(tree, WIDTH, task=task)) for tree in TREES for task in TASKS]
    kernels += [make_points_kernel(PointConfig(tree, WIDTH, instances=True)) for tree in TREES]
    kernels += [make_exact_points_kernel(PointConfig(tree, WIDTH, instances=each)) for tree in TREES for each in (False, True)]
    kernels.append(make_exact_points_kernel(PointConfig("bvh", WIDTH, task="some")))
    for tree in ("bvh", "kdtree"):
        add_point_search(handle_type(tree, WIDTH, 8), tree, WIDTH, False)
        add_point_search(instances_handle_type(tree, WIDTH, 8), tree, WIDTH, True)
    add_point_search(binary_handle_type(8), "binary", 2, False)
    add_point_search(binary_instances_handle_type(8), "binary", 2, True)
    kernels.append(make_packed_points_kernel(8))
    kernels += [make_warp_kernel(way, query, 8, False) for way in WAYS for query in ("closest", "any")]
    kernels += [make_persistent_instance_kernel(config, 8), make_binary_exact_kernel(8), make_binary_exact_instance_kernel(8)]
    return kernels


@pytest.fixture(scope="module")
def snippets():
    """All native functions of kernels/ and builders/, by file and name; a factory has made several of some."""
    device_modules()
    kept = make_all_kernels(), ray_boxes(WIDTH), [in_range(WIDTH, integers) for integers in (False, True)]
    found: dict[tuple[str, str], list[wp.Function]] = {}
    gc.unfreeze()
    for function in gc.get_objects():
        if isinstance(function, wp.Function) and function.native_snippet is not None:
            code = inspect.unwrap(function.func).__code__
            path = Path(code.co_filename).resolve()  # an editable install may link to the file
            if path.is_relative_to(ROOT / "kernels") or path.is_relative_to(ROOT / "builders"):
                found.setdefault((str(path.relative_to(ROOT)), code.co_name), []).append(function)
    yield found
    del kept


def test_snippets_declare_their_names(snippets):
    wrong = set()
    for (path, name), functions in snippets.items():
        for function in functions:
            parameters = inspect.signature(function.func).parameters
            macros = native.read_header("loops.h") if isinstance(function, native.NativeFunction) else ""
            wrong |= {f"{path}, {name}: {free}" for free in free_names(macros + function.native_snippet, parameters)}
    assert not wrong, "names that no snippet declares:\n" + "\n".join(sorted(wrong))


def test_snippets_are_for_every_cpu(snippets):
    """Instructions are builtins, because Warp's Clang has no assembler, and those of x86-64 are compiled for that alone."""
    for name, functions in snippets.items():
        for code in {function.native_snippet for function in functions}:
            assert not has_assembly(code), f"{name} has an instruction in assembly"
            assert not x86_without_guard(code), f"{name}: {x86_without_guard(code)}"
            assert "#include" not in code, name


def test_every_snippet_is_checked(snippets):
    """A snippet of a factory that `make_all_kernels` does not call would go unchecked."""
    written = set()
    for path in [*(ROOT / "kernels").rglob("*.py"), *(ROOT / "builders").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and any("func_native" in ast.unparse(mark) for mark in node.decorator_list):
                written.add((str(path.relative_to(ROOT)), node.name))
    assert len(written) > 100
    assert written <= snippets.keys(), f"call their factories in make_all_kernels: {sorted(written - snippets.keys())}"


@pytest.mark.parametrize(
    ("snippet", "free"),
    [
        ("return values.data[i] + k;", {"k"}),
        ("int a = 1, *b = nullptr; for (int j = 0, n = a; j < n; ++j) values.data[j] = b[c];", {"c"}),
        ("WRT_FOR_LANES(j) values.data[j] = 0;", {"WRT_FOR_LANES", "j"}),
        ("#define EACH(j) for (int j = 0; j < W; ++j)\n EACH(j) values.data[j] = 0;", {"W"}),
        ("#define PAIR(x) const float x##_low = 0.0f, x##_high = 1.0f\n PAIR(t); return t_low + t_high + t;", {"t"}),
        ("#if defined(__CUDA_ARCH__)\n return __popc(i);\n#else\n return popcount(i);\n#endif", {"popcount"}),
        ("auto twice = [](const int* p, unsigned at) { return 2 * p[at] + outer; }; return twice(&i, 0u);", {"outer"}),
        ("enum { FIRST, SECOND = 3 }; typedef void (*entry_t)(int); const entry_t f = (entry_t)FIRST; f(THIRD);", {"THIRD"}),
        ('struct Row { float x; }; Row row{1e-3f}; /* y */ wp::vec_t<3, wp::int32> v; v[0] = row.x; // z "w"', set()),
        ("const float ends[2] = {low, 1.0f}; return (int)ends[0];", {"low"}),
        ("static_assert(__builtin_offsetof(wrt::Row, x) == 8 * size);", {"size"}),
    ],
)
def test_free_names(snippet, free):
    assert free_names(snippet, ("values", "i")) == free
