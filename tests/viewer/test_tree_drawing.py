"""`wrt.pictures.draw_tree`: the boxes that are in the tree, at their places, and the costs that its figures say."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import wrt
from wrt.scene.scene import scene_of_state
from wrt.viewer.trees.tree_levels import tree_boxes

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
pyplot = pytest.importorskip("matplotlib.pyplot")

TEAPOT = wrt.scenes.build("teapot", level=4)
MESH = wrt.TriangleMesh(TEAPOT.vertices + np.array([100.0, 0.0, 0.0]), TEAPOT.faces)


@pytest.fixture(autouse=True)
def closed():
    yield
    pyplot.close("all")


def drawn(axes):
    """(low, high) of the boxes of each level that is drawn."""
    paths = [np.array([path.vertices for path in one.get_paths()]) for one in axes.collections]
    return [(corners.min(axis=1), corners.max(axis=1)) for corners in paths]


@pytest.mark.parametrize("kind", ["bvh", "kdtree"])
@pytest.mark.parametrize(("plane", "columns"), [("xy", (0, 1)), ("xz", (0, 2)), ("yz", (1, 2))])
def test_boxes_are_those_of_the_tree(kind, plane, columns):
    """In the scene's coordinates, projected; and bars add up to the cost of all nodes."""
    scene = wrt.Scene(MESH, kind, device="cpu")
    boxes, (main, side) = tree_boxes(scene.tree), wrt.pictures.draw_tree(scene, depth=2, plane=plane)
    levels = drawn(main)
    assert len(levels) == 3
    for level, (low, high) in enumerate(levels):
        chosen = boxes.depth == level
        np.testing.assert_allclose(low, (boxes.low[chosen] + scene.center)[:, columns], atol=1e-9)
        np.testing.assert_allclose(high, (boxes.high[chosen] + scene.center)[:, columns], atol=1e-9)
    assert main.get_xlabel() == f"{plane[0]} (units of the mesh)"
    assert main.get_ylabel() == f"{plane[1]} (units of the mesh)"
    keys = [text.get_text() for text in main.get_legend().get_texts()]
    assert keys[:2] == ["level 0: 1 box", f"level 1: {len(levels[1][0])} boxes"]
    widths = np.array([bar.get_width() for bar in side.patches]).reshape(2, boxes.levels)
    np.testing.assert_allclose(widths.sum(axis=1), [boxes.cost[~boxes.is_leaf].sum(), boxes.cost[boxes.is_leaf].sum()])
    assert widths[0, 0] == pytest.approx(1.0), "every ray that meets the root's box visits the root"


def test_leaves_are_filled():
    scene = wrt.Scene(MESH, device="cpu")
    boxes, (main, _) = tree_boxes(scene.tree), wrt.pictures.draw_tree(scene, depth=tree_boxes(scene.tree).levels - 1)
    for level, collection in enumerate(main.collections):
        filled = collection.get_facecolor()[:, 3] > 0.0
        np.testing.assert_array_equal(filled, boxes.is_leaf[boxes.depth == level])


def test_trees_instances_and_given_axes():
    figure, own = pyplot.subplots(1, 2)
    scene = wrt.Scene([wrt.Instance(MESH, np.eye(4)), wrt.Instance(MESH, np.diag([2.0, 2.0, 2.0, 1.0]))], device="cpu")
    assert wrt.pictures.draw_tree(scene, axes=own) == tuple(own)
    assert sum(len(low) for low, _ in drawn(own[0])) == len(tree_boxes(scene.tree).low)
    part = scene_of_state(scene.state.parts[0])
    main, side = wrt.pictures.draw_tree(part.tree, depth=0, axes=figure.add_subplot())
    assert side is None
    assert "relative to the scene's centre" in main.get_xlabel()
    (low, _), *others = drawn(main)
    assert not others
    np.testing.assert_allclose(low[0], np.array(part.tree.low)[[0, 2]], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"depth": 99}, ValueError, r"depth is 99; the levels of this tree are 0, the root, to \d"),
        ({"depth": -1}, ValueError, "depth is -1"),
        ({"depth": 1.0}, TypeError, "depth must be an int"),
        ({"depth": True}, TypeError, "depth must be an int"),
        ({"plane": "zx"}, ValueError, "plane is 'zx'; choose from xy, xz, yz"),
        ({"axes": 3}, TypeError, "axes must be one or two axes of matplotlib"),
        ({"axes": ()}, ValueError, "not 0"),
    ],
)
def test_bad_arguments(options, error, message):
    scene = wrt.Scene(MESH, device="cpu")
    with pytest.raises(error, match=message):
        wrt.pictures.draw_tree(scene, **options)
    with pytest.raises(TypeError, match=r"scene must be a wrt\.Scene or its tree, not TriangleMesh"):
        wrt.pictures.draw_tree(MESH)
    assert not pyplot.get_fignums()


def test_matplotlib_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install \"wrt\[notebooks\]\""):
        wrt.pictures.draw_tree(wrt.Scene(MESH, device="cpu"))
