"""Every kernel compiles for CUDA, on machines without a GPU too: NVRTC comes with Warp."""

from __future__ import annotations

import importlib
import pkgutil
import re

import pytest
import warp as wp
from conftest import ENGINE_TESTS, OTHER_WAYS_TO_PACKETS

import wrt.builders
import wrt.kernels
from wrt.builders.bvh.phases.bin_heuristic import SURFACE
from wrt.builders.bvh.phases.bvh_levels import make_search_planes
from wrt.builders.bvh.phases.bvh_subtrees import make_build_subtrees as make_bvh_subtrees
from wrt.builders.bvh.phases.collapse import make_pick_children, make_solve
from wrt.builders.bvh.projected_binned import PROJECTED
from wrt.builders.classics.kdtree import adaptive_sampling, between_medians, medians, naive
from wrt.builders.core.subtrees import make_build_subtrees
from wrt.builders.kdtree import binned
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.reference_chunks import make_decide
from wrt.builders.lights.light_raster import COUNT, COVER, FILL, make_rasteriser
from wrt.engine.facts.query_kinds import ANY, CLOSEST, QUERIES
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
from wrt.kernels.clouds.cloud_test import DISC, SPHERE
from wrt.kernels.clouds.cloud_walk import make_brute_cloud_kernel, make_cloud_kernel
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.points.exact_points import make_exact_points_kernel
from wrt.kernels.points.tree_points import TASKS, TREES, PointConfig, make_points_kernel
from wrt.kernels.query import instance_exact, instance_gradients
from wrt.kernels.runtime.launch import CUDA_BLOCK
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.fan_brute_force import NORMALS, VERTICES, make_fan_kernel
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.persistent.persistent_bvh import BLOCK, BLOCKS
from wrt.kernels.traversal.shadows import light_buffer_lanes, light_buffer_query, multi_frusta
from wrt.kernels.traversal.traversal_config import PacketConfig, SingleConfig, StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level import instance_single
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import make_packing_kernel

ARCHITECTURE = 75

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


def modules_with_kernels() -> list[str]:
    """Python modules that define kernels at their top level."""
    names = []
    for package in (wrt.kernels, wrt.builders):
        for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            module = importlib.import_module(info.name)
            if any(isinstance(v, wp.Kernel) and v.module.name == info.name for v in vars(module).values()):
                names.append(info.name)
    return names


FUSIBLE = re.compile(r"\b(?:fma\.rn|mad|mul|add|sub)\.f32")
"""A multiply-add in one, or an operation without `.rn`, which later steps may make one of: it breaks watertightness and the
equality of devices."""

HEAD = re.compile(r"^(?:\.\w+ )*\.(entry|func) *(?:\([^)]*\))?\s*([\w$]+)\s*\(", re.MULTILINE)
"""The head of a kernel or of a function, declared or defined."""

CALL = re.compile(r"\bcall(?:\.uni)?\s*(?:\([^)]*\),)?\s*([\w$]+)")


@pytest.fixture(autouse=True)
def not_optimised(monkeypatch):
    """What is asked here is whether code compiles, not how fast it is: without optimising, NVRTC takes a third of the time for
    large kernels. Its precompiled headers take longer to load than Warp's header to parse."""
    monkeypatch.setattr(wp.config, "mode", "debug")
    monkeypatch.setattr(wp.config, "use_precompiled_headers", False)


def compile_to_ptx(module, folder) -> str:
    """The code of a module's kernels and of the functions that they call, themselves or by others: NVRTC, not optimising, keeps
    all functions of Warp's header."""
    wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=folder, use_ptx=True)
    (text,) = (path.read_text() for path in folder.glob("*.ptx"))
    heads = list(HEAD.finditer(text))
    ends = [*(head.start() for head in heads[1:]), len(text)]
    bodies = {head[2]: text[head.start() : end] for head, end in zip(heads, ends, strict=True) if "{" in text[head.end() : end]}
    found = [head[2] for head in heads if head[1] == "entry"]
    for name in found:  # grows
        found += (set(CALL.findall(bodies[name])) & bodies.keys()) - set(found)
    return "\n".join(map(bodies.get, found))


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


@pytest.mark.parametrize("name", modules_with_kernels())
def test_module(name, tmp_path):
    assert ".entry" in compile_to_ptx(importlib.import_module(name), tmp_path)


@pytest.mark.parametrize("method", KDTREE_METHODS, ids=lambda method: method.search.key)
def test_kdtree_subtrees(method, tmp_path):
    assert ".entry" in compile_to_ptx(make_build_subtrees(method).module, tmp_path)


@pytest.mark.parametrize("method", SCANNING_METHODS, ids=lambda method: method.search.key)
def test_kdtree_levels(method, tmp_path):
    assert ".entry" in compile_to_ptx(make_decide(method.memory, method.search).module, tmp_path)


@pytest.mark.parametrize("dtype", [wp.vec3, wp.vec3d])
def test_placement(dtype, tmp_path):
    assert ".entry" in compile_to_ptx(make_shift(dtype).module, tmp_path)


BVH_KERNELS = {
    "search_planes": make_search_planes(SURFACE),
    "build_subtrees": make_bvh_subtrees(SURFACE),
    "solve": make_solve(SURFACE),
    "pick_children": make_pick_children(SURFACE),
    "build_subtrees, known rays": make_bvh_subtrees(PROJECTED),
}


@pytest.mark.parametrize("name", BVH_KERNELS)
def test_bvh_builder(name, tmp_path):
    assert ".entry" in compile_to_ptx(BVH_KERNELS[name].module, tmp_path)


POINTS = [
    *((tree, "nearest", instances) for tree in TREES for instances in (False, True)),
    *(("bvh", task, False) for task in TASKS if task != "nearest"),
]


@pytest.mark.parametrize(("tree", "task", "instances"), POINTS)
def test_points(tree, task, instances, tmp_path):
    text = compile_to_ptx(make_points_kernel(PointConfig(tree, 2, 1, task, instances)).module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


@pytest.mark.parametrize(
    ("tree", "task", "instances"), [("kdtree", "nearest", False), ("bvh", "nearest", True), ("kdtree", "some", True)]
)
def test_exact_points(tree, task, instances, tmp_path):
    text = compile_to_ptx(make_exact_points_kernel(PointConfig(tree, 2, 1, task, instances)).module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


def test_shared_leaves(tmp_path):
    config = TraversalConfig("woop", 2, "count", shared_leaves=True)
    text = compile_to_ptx(TRAVERSALS["single"].kernels["bvh"](config).module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


@pytest.mark.parametrize("stage", [COVER, COUNT, FILL])
def test_light_buffer_builder(stage, tmp_path):
    assert ".entry" in compile_to_ptx(make_rasteriser(stage, False, True, stage == FILL).module, tmp_path)
    assert ".entry" in compile_to_ptx(make_rasteriser(stage, True, False, stage == FILL).module, tmp_path / "by_box")


@pytest.mark.parametrize("make", [make_cloud_kernel, make_brute_cloud_kernel])
@pytest.mark.parametrize("components", [SPHERE, DISC])
def test_clouds(make, components, tmp_path):
    text = compile_to_ptx(make(TraversalConfig("woop", 2), components).module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


SHADOW_KERNELS = {
    "light_buffer": lambda: light_buffer_query.make_light_buffer_kernel(TraversalConfig("woop", 2, "any")),
    "light_buffer, fronts": lambda: light_buffer_query.make_light_buffer_kernel(
        TraversalConfig("wald", 2, "any", cull_backfaces=True)
    ),
    "light_buffer in lanes": lambda: light_buffer_lanes.make_lane_kernel("woop"),
    "multi_frusta": lambda: multi_frusta.make_multi_frusta_kernel(TraversalConfig("woop", 2, "any"), True),
    "multi_frusta, wald": lambda: multi_frusta.make_multi_frusta_kernel(TraversalConfig("wald", 2, "any"), False),
}


@pytest.mark.parametrize("name", SHADOW_KERNELS)
def test_shadows(name, tmp_path):
    text = compile_to_ptx(SHADOW_KERNELS[name]().module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


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


BOX_PLANES = 12
"""Fused multiply-adds in a node's step: a plane each of the boxes of two children; one, where their function is not inlined."""


def assert_fuses_boxes_alone(text: str) -> None:
    """Of persistent threads: the step of a node fuses, and nothing else does."""
    fused = FUSIBLE.findall(text)
    assert set(fused) == {"fma.rn.f32"}
    assert len(fused) in (1, BOX_PLANES)


def test_persistent_threads_have_bounded_registers(tmp_path):
    config = TraversalConfig("woop", 2, cull_backfaces=True, stack=StackConfig(24))
    text = compile_to_ptx(TRAVERSALS["persistent"].kernels["bvh"](config).module, tmp_path)
    assert_fuses_boxes_alone(text)
    assert re.search(rf"\.maxntid {BLOCK}\b", text)
    assert re.search(rf"\.minnctapersm {BLOCKS}\b", text)


@pytest.mark.parametrize(("traversal", "tree", "triangle_test", "query"), ANSWERS)
def test_traversal(traversal, tree, triangle_test, query, tmp_path):
    config = TraversalConfig(triangle_test, 2, query, counters=query == "closest", packet=PacketConfig(4))
    kernel = TRAVERSALS[traversal].kernels[tree](config)
    text = compile_to_ptx(kernel.module, tmp_path)
    assert ".entry" in text
    if Capabilities.PERSISTENT in TRAVERSALS[traversal].capabilities:
        assert_fuses_boxes_alone(text)
    else:
        assert not FUSIBLE.search(text)


SKIPPING = TraversalConfig("woop", 2, "count", skipping=True, stack=StackConfig(8))
EXACT = TraversalConfig("woop", 2, "exact", stack=StackConfig(8))
THROUGH_INSTANCES = {
    "closest": lambda: instance_single.make_instance_kernel(TraversalConfig("woop", 2, stack=StackConfig(8)), "bvh", 8),
    "skip": lambda: instance_single.make_instance_kernel(SKIPPING, "bvh", 8),
    "precise": lambda: instance_exact.make_exact_instance_kernel(EXACT, "bvh", 8),
    "gradients": lambda: instance_gradients.make_instance_gradient_kernel(wp.vec3, wp.vec3, wp.vec3d, wp.transformf, False),
}


@pytest.mark.parametrize("name", THROUGH_INSTANCES)
def test_instances(name, tmp_path):
    text = compile_to_ptx(THROUGH_INSTANCES[name]().module, tmp_path)
    assert ".entry" in text
    assert name == "gradients" or not FUSIBLE.search(text)  # sums of gradients may fuse: no hit depends on them


@pytest.mark.parametrize("query", [CLOSEST, ANY])
def test_stacks_in_shared_memory(query, tmp_path):
    """As a scene on CUDA asks for them: nothing but the block's memory holds waiting children."""
    config = TraversalConfig("woop", 2, query, stack=StackConfig(24, CUDA_BLOCK))
    text = compile_to_ptx(TRAVERSALS["single"].kernels["bvh"](config).module, tmp_path)
    words = 2 * (config.stack.levels * (config.width - 1) + 1) * CUDA_BLOCK
    assert re.search(rf"\.shared\b.*\[{4 * words}\]", text)
    assert not FUSIBLE.search(text)


@pytest.mark.parametrize("shared_origin", [False, True])
@pytest.mark.parametrize("culling", CULLINGS)
def test_culling(culling, shared_origin, tmp_path):
    config = TraversalConfig("woop", 2, packet=PacketConfig(4, shared_origin, culling))
    text = compile_to_ptx(TRAVERSALS["packet"].kernels["bvh"](config).module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


@pytest.mark.parametrize("triangle_test", [name for name in TRIANGLE_TESTS if name not in ENGINE_TESTS])
def test_triangle_test(triangle_test, tmp_path):
    """The other tests by what CUDA uses: one ray, W triangles."""
    text = compile_to_ptx(TRAVERSALS["single"].kernels["bvh"](TraversalConfig(triangle_test, 2)).module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)


@pytest.mark.parametrize("triangle_test", TRIANGLE_TESTS)
def test_packing(triangle_test, tmp_path):
    assert ".entry" in compile_to_ptx(make_packing_kernel(TRIANGLE_TESTS[triangle_test].record).module, tmp_path)


@pytest.mark.parametrize(
    "make",
    [
        lambda: make_fan_kernel(VERTICES),
        lambda: make_fan_kernel(NORMALS),
        lambda: make_counting_kernel(VARIANTS["ferko_prune4_weights"], 1),
        lambda: TRAVERSALS["single"].kernels["bvh"](
            TraversalConfig("ferko_utm_bounds", 2, single=SingleConfig(scalar_test=True))
        ),
        lambda: make_frusta(PUBLISHED["proposed"], 4, 2),
        lambda: make_blocks(TRIANGLE_TESTS["woop"], 2),
        lambda: make_pairs(TRIANGLE_TESTS["komatsu"]),
        lambda: make_exit_kernel(PUBLISHED["moeller"]),
        lambda: make_exit_kernel(PUBLISHED["projection"]),
        lambda: make_scalar(DAMMERTZ_KELLER),
        lambda: make_blocks(PRUNED, 2),
        lambda: make_replay_kernel(STUDIED["sphere_parametric"], True),
        lambda: make_lists(9),
        lambda: make_walk_kernel("sorted", 2, TRIANGLE_TESTS["woop"], True),
        lambda: TRAVERSALS["single"].kernels["kdtree"](TraversalConfig("woop", 2, single=SingleConfig(compact=3))),
    ],
    ids=[
        *("fans", "fan_normals", "comparisons", "one_by_one", "frusta", "blocks", "pairs", "exits", "exits_in_range"),
        *("subdivision", "pruned_blocks", "replay", "lists", "walk", "compact_subtrees"),
    ],
)
def test_for_measurements(make, tmp_path):
    text = compile_to_ptx(make().module, tmp_path)
    assert ".entry" in text
    assert not FUSIBLE.search(text)
