"""Every kernel compiles for CUDA, on machines without a GPU too: NVRTC comes with Warp."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterable
from functools import partial

import pytest
import warp as wp
from support.algorithms import ENGINE_TESTS, OTHER_WAYS_TO_PACKETS
from support.ptx import FUSIBLE, HEAD, assert_fuses_boxes_alone, compile_to_ptx

import wrt.builders
import wrt.kernels
from wrt.builders.bvh.phases.bin_heuristic import SURFACE
from wrt.builders.bvh.phases.bvh_levels import make_search_planes
from wrt.builders.bvh.phases.bvh_subtrees import subtree_kernels
from wrt.builders.bvh.phases.cluster_merging import make_merge_clusters
from wrt.builders.bvh.phases.collapse import search_kernels
from wrt.builders.bvh.projected_binned import PROJECTED
from wrt.builders.classics.kdtree import adaptive_sampling, between_medians, medians, naive
from wrt.builders.core.subtrees import make_build_subtrees
from wrt.builders.kdtree import binned
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.reference_chunks import make_decide
from wrt.builders.lights.light_raster import COUNT, COVER, FILL, make_rasteriser
from wrt.engine.facts.query_kinds import ANY, CLOSEST, QUERIES
from wrt.kernels.answers import PLAIN, SKIPPING
from wrt.kernels.classics.studies.bare_triangle_tests import make_blocks, make_frusta, make_pairs, make_scalar
from wrt.kernels.classics.studies.dammertz_keller import TEST as DAMMERTZ_KELLER
from wrt.kernels.classics.studies.exit_counts import make_kernel as make_exit_kernel
from wrt.kernels.classics.studies.komatsu_2008 import PUBLISHED
from wrt.kernels.classics.studies.pichler_2018 import STUDIED
from wrt.kernels.classics.studies.pruning_counts import make_kernel as make_counting_kernel
from wrt.kernels.classics.studies.replayed_tests import make_kernel as make_replay_kernel
from wrt.kernels.classics.studies.replayed_tests import make_lists
from wrt.kernels.classics.studies.variants.watertight_pruning import PRUNED
from wrt.kernels.classics.studies.walk_orders import make_kernel as make_walk_kernel
from wrt.kernels.classics.triangle.ferko import VARIANTS
from wrt.kernels.clouds.cloud_walk import make_brute_cloud_kernel, make_cloud_kernel
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.points.exact_points import make_exact_points_kernel
from wrt.kernels.points.packed_points import make_packed_points_kernel
from wrt.kernels.points.tree_points import TASKS, PointConfig, make_points_kernel
from wrt.kernels.query import instance_exact, instance_gradients
from wrt.kernels.query.binary.binary_exact import make_binary_exact_instance_kernel, make_binary_exact_kernel
from wrt.kernels.runtime import options
from wrt.kernels.runtime.launch import CUDA_BLOCK
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.fan_brute_force import NORMALS, VERTICES, make_fan_kernel
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.persistent.persistent_bvh import BLOCK, BLOCKS, make_persistent_instance_kernel
from wrt.kernels.traversal.shadows import light_buffer_lanes, light_buffer_query, multi_frusta
from wrt.kernels.traversal.traversal_config import PacketConfig, SingleConfig, StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level import instance_single
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import make_packing_kernel

WHOLE, CLIPPED = KdTreeConfig(), KdTreeConfig(split_clipping=True)
SAMPLED_AGAIN = adaptive_sampling.sampling_method(KdTreeConfig(resamplings=2, empty_space="early"))
SCANNING_METHODS = (
    binned.binned_method(WHOLE),
    naive.naive_method(WHOLE),
    between_medians.between_medians_method(WHOLE),
    adaptive_sampling.sampling_method(WHOLE),
    *(medians.median_method(search, WHOLE) for search in (medians.split_space, medians.split_objects)),
)
KDTREE_METHODS = (event_method(WHOLE), event_method(CLIPPED), *SCANNING_METHODS, binned.binned_method(CLIPPED), SAMPLED_AGAIN)


def kernels_of_modules() -> dict[str, dict[str, wp.Kernel]]:
    """The kernels at the top level of Python modules by name, for each package of kernels or builders, and those with gradients
    apart."""
    found: dict[str, dict[str, wp.Kernel]] = {}
    for package in (wrt.kernels, wrt.builders):
        for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            for name, value in vars(importlib.import_module(info.name)).items():
                if isinstance(value, wp.Kernel) and value.module.name == info.name:
                    kind = " with gradients" if value.module.options["enable_backward"] else ""
                    group = found.setdefault(".".join(info.name.split(".")[1:3]) + kind, {})
                    group[f"{info.name}.{name}"] = value
    return found


@pytest.fixture(autouse=True)
def not_optimised(monkeypatch):
    """What is asked here is whether code compiles, not how fast it is: without optimising, NVRTC takes a third of the time for
    large kernels. Its precompiled headers take longer to load than Warp's header to parse."""
    monkeypatch.setattr(wp.config, "mode", "debug")
    monkeypatch.setattr(wp.config, "use_precompiled_headers", False)


def together(name: str, kernels: dict[str, wp.Kernel]) -> wp.Module:
    """A module with all these kernels: most of the time that a small one takes goes into Warp's header."""
    (gradients,) = {
        kernel.options.get("enable_backward", kernel.module.options["enable_backward"]) for kernel in kernels.values()
    }
    module = wp.get_module("cuda_" + re.sub(r"\W+", "_", name))
    module.options |= options.EXACT | {"enable_backward": gradients}
    for label, kernel in zip(names_in_code(kernels), kernels.values(), strict=True):
        wp.Kernel(kernel.func, key=label, module=module, options=dict(kernel.options))
    return module


def names_in_code(labels: Iterable[str]) -> list[str]:
    """Different names for labels of kernels."""
    return [re.sub(r"\W+", "_", f"kernel {number} {label}") for number, label in enumerate(labels)]


def assert_compiles(name: str, kernels: dict[str, wp.Kernel], folder) -> str:
    """All of them; returns their code."""
    text = compile_to_ptx(together(name, kernels), folder)
    entries = [head[2] for head in HEAD.finditer(text) if head[1] == "entry"]
    assert [one for one in names_in_code(kernels) if not any(entry.startswith(f"{one}_") for entry in entries)] == []
    return text


def fusing(text: str) -> list[str]:
    """The kernels and functions in which an operation may become part of a fused one."""
    starts = [*HEAD.finditer(text)]
    ends = [*(start.start() for start in starts[1:]), len(text)]
    return [start[2] for start, end in zip(starts, ends, strict=True) if FUSIBLE.search(text, start.start(), end)]


@pytest.mark.parametrize("may_fuse", [False, True])
def test_plain_operations_are_found(may_fuse, tmp_path):
    """What the tests below look for, in a function that the kernel calls: not optimised, they have no `.rn` even where Warp
    forbids to fuse them."""

    @wp.func
    def scaled(x: float, by: float):
        return by * x

    @wp.kernel(module="unique", module_options={"fuse_fp": may_fuse})
    def moved(x: wp.array(dtype=float)):
        i = wp.tid()
        x[i] = scaled(x[i], 3.0)

    assert FUSIBLE.search(compile_to_ptx(moved.module, tmp_path))


OF_MODULES = kernels_of_modules()

BVH_KERNELS = {
    "search_planes": lambda: make_search_planes(SURFACE),
    "build_subtrees": lambda: subtree_kernels(SURFACE)[0],
    "make_references": lambda: subtree_kernels(SURFACE)[1],
    "solve": lambda: search_kernels(SURFACE)[0],
    "pick_children": lambda: search_kernels(SURFACE)[1],
    "build_subtrees, known rays": lambda: subtree_kernels(PROJECTED)[0],
}

RASTERISERS = {
    f"{name} {stage}": (stage, by_box, fronts)
    for stage in (COVER, COUNT, FILL)
    for name, by_box, fronts in (("by triangle", False, True), ("by box", True, False))
}

OTHERS = {
    "subtrees of kd-trees": lambda: {f"{i} {m.search.key}": make_build_subtrees(m) for i, m in enumerate(KDTREE_METHODS)},
    "levels of kd-trees": lambda: {
        f"{i} {m.search.key}": make_decide(m.memory, m.search) for i, m in enumerate(SCANNING_METHODS)
    },
    "placement": lambda: {f"shift {dtype.__name__}": make_shift(dtype) for dtype in (wp.vec3, wp.vec3d)},
    "builders of BVHs": lambda: {name: make() for name, make in BVH_KERNELS.items()},
    "builders of light buffers": lambda: {n: make_rasteriser(*given, given[0] == FILL) for n, given in RASTERISERS.items()},
    "packing": lambda: {f"pack {name}": make_packing_kernel(test.record) for name, test in TRIANGLE_TESTS.items()},
}
"""Kernels on which no hit depends to the bit: what builders do may fuse."""


@pytest.mark.parametrize("package", OF_MODULES)
def test_modules(package, tmp_path):
    assert_compiles(package, OF_MODULES[package], tmp_path)


@pytest.mark.parametrize("name", OTHERS)
def test_builders(name, tmp_path):
    assert_compiles(name, OTHERS[name](), tmp_path)


POINTS = [
    *((tree, "nearest", instances) for tree in ("bvh", "kdtree") for instances in (False, True)),
    *(("bvh", task, False) for task in TASKS if task not in ("nearest", "packets")),
]
PACKED_POINTS = {
    "threads": lambda: make_packed_points_kernel(24),
    "instances": lambda: make_points_kernel(points("binary", "counted", True)),
    "lists": lambda: make_points_kernel(points("binary", "some", False)),
    "exact": lambda: make_exact_points_kernel(points("binary", "nearest", False)),
}
EXACT_POINTS = (("kdtree", "nearest", False), ("bvh", "nearest", True), ("kdtree", "some", True))


SHADOW_KERNELS = {
    "light_buffer": lambda: light_buffer_query.make_light_buffer_kernel(TraversalConfig("woop", 2, "any")),
    "light_buffer, fronts": lambda: light_buffer_query.make_light_buffer_kernel(
        TraversalConfig("wald", 2, "any", cull_backfaces=True)
    ),
    "light_buffer in lanes": lambda: light_buffer_lanes.make_lane_kernel("woop"),
    "multi_frusta": lambda: multi_frusta.make_multi_frusta_kernel(TraversalConfig("woop", 2, "any"), True),
    "multi_frusta, wald": lambda: multi_frusta.make_multi_frusta_kernel(TraversalConfig("wald", 2, "any"), False),
}


ANSWERS = [
    (name, tree, test.name, query)
    for name, way in TRAVERSALS.items()
    for tree in way.trees
    for test in map(TRIANGLE_TESTS.get, ENGINE_TESTS)
    for query in (QUERIES if test.name == "woop" else ("closest",))
    if way.supports(query, tree) and Capabilities.WIDE_FORM not in way.capabilities  # wide forms have the kernels of a BVH
    if way.takes_test(test.name)
    if test.name == "woop" or (tree == way.trees[0] and name not in OTHER_WAYS_TO_PACKETS)
]
"""All queries with one test; one query with the others, once for each way to meet leaves."""


def test_persistent_threads_have_bounded_registers(tmp_path):
    config = TraversalConfig("woop", 2, cull_backfaces=True, stack=StackConfig(24))
    text = compile_to_ptx(TRAVERSALS["persistent"].kernels["bvh"](config).module, tmp_path)
    assert_fuses_boxes_alone(text)
    assert re.search(rf"\.maxntid {BLOCK}\b", text)
    assert re.search(rf"\.minnctapersm {BLOCKS}\b", text)


def answers(traversal: str) -> dict[str, wp.Kernel]:
    """The kernels of a traversal for `ANSWERS`."""
    return {
        f"{tree} {test} {query}": TRAVERSALS[traversal].kernels[tree](
            TraversalConfig(test, 2, query, counters=query == "closest", packet=PacketConfig(4))
        )
        for name, tree, test, query in ANSWERS
        if name == traversal
    }


FUSING = [name for name, way in TRAVERSALS.items() if Capabilities.PERSISTENT in way.capabilities]


@pytest.mark.parametrize("traversal", dict.fromkeys(name for name, *_ in ANSWERS if name not in FUSING))
def test_traversal(traversal, tmp_path):
    assert fusing(assert_compiles(traversal, answers(traversal), tmp_path)) == []


@pytest.mark.parametrize(("traversal", "case"), [(name, case) for name in FUSING for case in answers(name)])
def test_persistent_threads(traversal, case, tmp_path):
    text = compile_to_ptx(answers(traversal)[case].module, tmp_path)
    assert ".entry" in text
    assert_fuses_boxes_alone(text)


@pytest.mark.parametrize("query", QUERIES)
def test_persistent_threads_through_instances(query, tmp_path):
    """Answers are those of one level; rays that skip a triangle, and culling, are compiled with some of them."""
    nearest = query in (CLOSEST, ANY)
    config = TraversalConfig(
        "woop", 2, query, cull_backfaces=nearest, variant=SKIPPING if nearest else PLAIN, stack=StackConfig(24)
    )
    text = compile_to_ptx(make_persistent_instance_kernel(config, 8).module, tmp_path)
    assert ".entry" in text
    assert_fuses_boxes_alone(text)


@pytest.mark.parametrize("make", [make_binary_exact_kernel, make_binary_exact_instance_kernel])
def test_persistent_threads_in_float64(make, tmp_path):
    text = compile_to_ptx(make(24).module, tmp_path)
    assert ".entry" in text
    assert_fuses_boxes_alone(text)
    assert not re.search(r"\b(?:fma\.rn|mad|mul|add|sub)\.f64", text)


SKIPPED = TraversalConfig("woop", 2, "count", variant=SKIPPING, stack=StackConfig(8))
EXACT = TraversalConfig("woop", 2, "exact", stack=StackConfig(8))
THROUGH_INSTANCES = {
    "closest": lambda: instance_single.make_instance_kernel(TraversalConfig("woop", 2, stack=StackConfig(8)), "bvh", 8),
    "skip": lambda: instance_single.make_instance_kernel(SKIPPED, "bvh", 8),
    "precise": lambda: instance_exact.make_exact_instance_kernel(EXACT, "bvh", 8),
}


def test_gradients_through_instances(tmp_path):
    """Sums of gradients may fuse: no hit depends on them."""
    kernel = instance_gradients.make_instance_gradient_kernel(wp.vec3, wp.vec3, wp.vec3d, wp.transformf, False)
    assert ".entry" in compile_to_ptx(kernel.module, tmp_path)


@pytest.mark.parametrize("query", [CLOSEST, ANY])
def test_stacks_in_shared_memory(query, tmp_path):
    """As a scene on CUDA asks for them: nothing but the block's memory holds waiting children."""
    config = TraversalConfig("woop", 2, query, stack=StackConfig(24, CUDA_BLOCK))
    text = compile_to_ptx(TRAVERSALS["single"].kernels["bvh"](config).module, tmp_path)
    words = 2 * (config.stack.levels * (config.width - 1) + 1) * CUDA_BLOCK
    assert re.search(rf"\.shared\b.*\[{4 * words}\]", text)
    assert not FUSIBLE.search(text)


def single(config: TraversalConfig, tree: str = "bvh") -> wp.Kernel:
    """Single rays through a tree."""
    return TRAVERSALS["single"].kernels[tree](config)


def points(tree: str, task: str, instances: bool) -> PointConfig:
    return PointConfig(tree, 2, 1, task, instances)


def cullings(culling: str) -> dict[str, wp.Kernel]:
    """Packets with a culling, with an origin that is shared and with origins of their own."""
    return {
        f"{culling} {'shared' if shared else 'own'}": TRAVERSALS["packet"].kernels["bvh"](
            TraversalConfig("woop", 2, packet=PacketConfig(4, shared, culling))
        )
        for shared in (False, True)
    }


MEASURED = {
    "fans": lambda: make_fan_kernel(VERTICES),
    "fan_normals": lambda: make_fan_kernel(NORMALS),
    "comparisons": lambda: make_counting_kernel(VARIANTS["ferko_prune4_weights"], 1),
    "one_by_one": lambda: TRAVERSALS["single"].kernels["bvh"](
        TraversalConfig("ferko_utm_bounds", 2, single=SingleConfig(scalar_test=True))
    ),
    "frusta": lambda: make_frusta(PUBLISHED["proposed"], 4, 2),
    "blocks": lambda: make_blocks(TRIANGLE_TESTS["woop"], 2),
    "pairs": lambda: make_pairs(TRIANGLE_TESTS["komatsu"]),
    "exits": lambda: make_exit_kernel(PUBLISHED["moeller"]),
    "exits_in_range": lambda: make_exit_kernel(PUBLISHED["projection"]),
    "subdivision": lambda: make_scalar(DAMMERTZ_KELLER),
    "pruned_blocks": lambda: make_blocks(PRUNED, 2),
    "replay": lambda: make_replay_kernel(STUDIED["sphere_parametric"], True),
    "lists": lambda: make_lists(9),
    "walk": lambda: make_walk_kernel("sorted", 2, TRIANGLE_TESTS["woop"], True),
    "compact_subtrees": lambda: TRAVERSALS["single"].kernels["kdtree"](
        TraversalConfig("woop", 2, single=SingleConfig(compact=3))
    ),
}

EXACT_KERNELS = {
    "points": lambda: {f"points {' '.join(map(str, one))}": make_points_kernel(points(*one)) for one in POINTS},
    "exact points": lambda: {
        f"exact points {' '.join(map(str, one))}": make_exact_points_kernel(points(*one)) for one in EXACT_POINTS
    },
    "clouds": lambda: {
        f"{make.__name__} {part}": make(TraversalConfig(part, 2))
        for make in (make_cloud_kernel, make_brute_cloud_kernel)
        for part in ("spheres", "discs")
    },
    "shared leaves": lambda: {"shared leaves": single(TraversalConfig("woop", 2, "count", shared_leaves=True))},
    "shadows": lambda: {name: make() for name, make in SHADOW_KERNELS.items()},
    "instances": lambda: {f"instances, {name}": make() for name, make in THROUGH_INSTANCES.items()},
    **{f"{culling} culling": partial(cullings, culling) for culling in CULLINGS},
    # the other triangle tests by what CUDA uses: one ray, W triangles
    "triangle tests": lambda: {t: single(TraversalConfig(t, 2)) for t in TRIANGLE_TESTS if t not in ENGINE_TESTS},
    "measurements": lambda: {name: make() for name, make in MEASURED.items()},
    "clusters": lambda: {"clusters": make_merge_clusters()},
}
"""Kernels in which nothing may fuse: their answers are the same on all devices."""


@pytest.mark.parametrize("name", EXACT_KERNELS)
def test_nothing_fuses(name, tmp_path):
    assert fusing(assert_compiles(name, EXACT_KERNELS[name](), tmp_path)) == []


@pytest.mark.parametrize("name", PACKED_POINTS)
def test_boxes_of_points_alone_fuse(name, tmp_path):
    """Of points in nodes of 64 bytes: two sums of squares a box, in each of the steps or in a function."""
    text = compile_to_ptx(PACKED_POINTS[name]().module, tmp_path)
    fused = FUSIBLE.findall(text)
    assert set(fused) == {"fma.rn.f32"}
    assert len(fused) in (1, 2, 4)
