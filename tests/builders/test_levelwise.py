"""The build that CUDA has in place of `in_place`, by levels alone, on the CPU: node for node the same tree."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from support.built_kdtrees import boxes_of
from support.meshes import SCENES
from support.ptx import FUSIBLE, compile_to_ptx

import wrt
from wrt.accelerators.cuda_trees import is_built_on
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.kdtree import in_place
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.levelwise import grid_sums, level_memory, levelwise_build
from wrt.builders.tree import StopRules
from wrt.kernels.runtime.workspace import release

CARD = SimpleNamespace(is_cpu=False, is_cuda=True)

CONFIGS = {
    "textbook": KdTreeConfig(cost=SurfaceAreaCost(width=1)),
    "blocks": KdTreeConfig(),
    "mailbox": KdTreeConfig(cost=SurfaceAreaCost(width=4, unit=1, mailbox=True), stop=StopRules(bad_splits=3)),
    "automatic": KdTreeConfig(cost=SurfaceAreaCost(width=2, traversal=0.0), stop=StopRules(termination="automatic")),
    "fixed": KdTreeConfig(stop=StopRules(termination="fixed", max_depth=9, leaf_triangles=3, least_size=0.01)),
    "one leaf": KdTreeConfig(stop=StopRules(max_depth=0)),
}


def assert_same_tree(mesh: wrt.TriangleMesh, config: KdTreeConfig) -> int:
    """Equal to the bit; returns the number of nodes."""
    boxes = boxes_of(mesh)
    found, expected = levelwise_build.build(boxes, config), in_place.build(boxes, config)
    np.testing.assert_array_equal(found.nodes.numpy(), expected.nodes.numpy())
    np.testing.assert_array_equal(found.primitive.numpy(), expected.primitive.numpy())
    assert (found.low, found.high, found.width) == (expected.low, expected.high, expected.width)
    return len(found.nodes)


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("name", SCENES)
def test_levels_alone_give_the_tree_of_levels_and_subtrees(name, config):
    assert (assert_same_tree(SCENES[name](), CONFIGS[config]) > 1) == (config != "one leaf") or name == "degenerate"


@pytest.mark.parametrize("count", [1, 2, 3, 40, 250])
def test_ties_are_decided_alike(count):
    """Corners on few points: many equal positions, flat boxes and equal costs."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        corners = rng.integers(0, seed + 1, (count, 1, 3)) + rng.integers(0, 3, (count, 3, 3)) - 2
        mesh = wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3))
        assert_same_tree(mesh, CONFIGS["textbook" if seed % 2 else "mailbox"])


def test_arrays_that_are_too_small_are_made_anew(monkeypatch):
    """As on a mesh whose triangles multiply from level to level."""
    monkeypatch.setattr(level_memory, "GROWTH", 1.0)
    monkeypatch.setattr(levelwise_build, "EXPECTED", 0.5)
    monkeypatch.setattr(levelwise_build, "MAX_KEPT", 0)
    release()
    launched = []
    run = grid_sums.Grid.run
    monkeypatch.setattr(grid_sums.Grid, "run", lambda self, kernel, *rest: run(self, launched.append(kernel) or kernel, *rest))
    for name in ("needles", "wood"):
        assert_same_tree(SCENES[name](), CONFIGS["textbook"])
    moves = [kernel.key == "move_events" for kernel in launched]
    assert any(one and other for one, other in pairwise(moves))


def test_kernels_compile_for_cuda(tmp_path):
    """And nothing fuses, so that costs have the bits of the CPU."""
    for number, kernel in enumerate(levelwise_build.KERNELS):
        (tmp_path / str(number)).mkdir()
        assert not FUSIBLE.search(compile_to_ptx(kernel.module, tmp_path / str(number)))


@pytest.mark.parametrize(
    ("tree", "expected"),
    [
        (wrt.KdTree(), True),
        (wrt.KdTree(mailbox=True, width=8), True),
        (wrt.KdTree(split_clipping=True), False),
        (wrt.KdTree(cell_tests="leaves"), False),
        (wrt.KdTree(empty_space="late"), False),
        (wrt.KdTree(layout="van_emde_boas"), False),
        (wrt.KdTree(builder="nested"), False),
        (wrt.KdTree(builder="lazy"), False),
    ],
)
def test_trees_of_scenes_on_cuda_are_built_there(tree, expected):
    """Those that this build makes, and nothing changes afterwards."""
    assert is_built_on(tree, CARD, 2) == expected


def test_too_many_triangles_are_refused():
    levelwise_build.check_count(levelwise_build.MAX_TRIANGLES)
    with pytest.raises(ValueError, match=r"a mesh of 178,956,971 triangles, .* takes 178,956,970 at most; take wrt.KdTree"):
        levelwise_build.check_count(levelwise_build.MAX_TRIANGLES + 1)
