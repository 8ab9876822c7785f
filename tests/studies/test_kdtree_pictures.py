"""Pictures of kd-trees, and what is measured beside them."""

from __future__ import annotations

import re

import numpy as np
import pytest

import wrt
from studies.kdtrees.kdtree_claims import built_part, first_frames, planar_references
from studies.kdtrees.kdtree_comparison import compare_trees
from studies.kdtrees.kdtree_pictures import (
    color_of,
    cross_section,
    draw_comparison,
    draw_histograms,
    draw_section,
    label_points,
    leaves_of,
    rectangles,
    unbuilt_cells,
)
from wrt.builders.kdtree import KDTREE_BUILDERS

FAR = np.array([100.0, -200.0, 50.0])
BUILDERS = tuple(KDTREE_BUILDERS)


def figure_of(**options: object) -> object:
    """A figure; matplotlib takes a second to import."""
    return pytest.importorskip("matplotlib.figure").Figure(**options)


@pytest.fixture(scope="module")
def mesh() -> wrt.TriangleMesh:
    """A closed body away from the origin: pictures are in the scene's coordinates, trees are not."""
    pot = wrt.scenes.build("teapot", level=6, ground=False)
    return wrt.TriangleMesh(pot.vertices + FAR, pot.faces)


@pytest.fixture(scope="module")
def scene(mesh) -> wrt.Scene:
    return wrt.Scene(mesh, wrt.KdTree(builder="binned", width=8), device="cpu")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_section_lies_on_the_surface(mesh, axis):
    """Every end of a segment is a point of an edge of the mesh at that height; a plane beyond the mesh crosses nothing."""
    at = float(mesh.center[axis]) + 0.0137
    segments = cross_section(mesh, axis, at)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    crossed = (corners[:, :, axis].min(axis=1) < at) & (corners[:, :, axis].max(axis=1) >= at)
    assert len(segments) == crossed.sum() > 20
    kept = [other for other in range(3) if other != axis]
    low, high = corners[crossed].min(axis=1)[:, kept], corners[crossed].max(axis=1)[:, kept]
    assert (segments >= low[:, None] - 1e-4).all()
    assert (segments <= high[:, None] + 1e-4).all()
    normal = np.cross(corners[crossed][:, 1] - corners[crossed][:, 0], corners[crossed][:, 2] - corners[crossed][:, 0])
    points = np.insert(segments, axis, at, axis=2)
    off = ((points - corners[crossed][:, :1]) * normal[:, None]).sum(axis=2)
    assert np.abs(off).max() < 1e-4 * np.linalg.norm(normal, axis=1).max()
    assert len(cross_section(mesh, axis, float(mesh.bounds[1][axis]) + 1.0)) == 0


def test_cells_of_a_section_tile_it(scene, mesh):
    """Leaves that a plane meets fill the root's rectangle, and each hit in the plane lies in a cell that lists triangles."""
    boxes, triangles = leaves_of(scene)
    met, corners = rectangles(boxes, 1, float(mesh.center[1]))
    sides = corners[:, 2] - corners[:, 0]
    size = (mesh.bounds[1] - mesh.bounds[0])[[0, 2]]
    assert sides.prod(axis=1).sum() == pytest.approx(size.prod(), rel=1e-4)
    points = cross_section(mesh, 1, float(mesh.center[1])).mean(axis=1)
    inside = (points[:, None] > corners[None, :, 0]) & (points[:, None] < corners[None, :, 2])
    owner = inside.all(axis=2)
    assert owner.sum(axis=1).max() == 1
    assert owner.any(axis=1).mean() > 0.9
    assert (triangles[met][owner.argmax(axis=1)][owner.any(axis=1)] > 0).all()


def test_labels_do_not_cover_each_other():
    """Not each other, not points, and nothing outside; crowded points included."""
    figure = figure_of(figsize=(5, 4), layout="constrained")
    axes = figure.subplots()
    rng = np.random.default_rng(4)
    points = {f"{name} of trees": tuple(rng.uniform(0.4, 0.6, 2)) for name in "abcdefghijkl"}
    axes.set(xlim=(0, 1), ylim=(0, 1))
    labels = label_points(axes, points)
    boxes = [label.get_window_extent() for label in labels]
    frame = axes.get_window_extent()
    assert {label.get_text() for label in labels} == set(points)
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[i + 1 :])
        assert not any(box.contains(*axes.transData.transform(point)) for point in points.values())
        assert frame.x0 <= box.x0 < box.x1 <= frame.x1
        assert frame.y0 <= box.y0 < box.y1 <= frame.y1


def test_a_lazy_tree_is_drawn_with_what_waits(tmp_path):
    """Built leaves and waiting cells fill the scene together; a view builds a part, all of what it sees among it."""
    stadium = wrt.scenes.build("teapot_in_stadium", level=16)
    rays = wrt.PinholeCamera(32, 32, fov=58, position=(1.7, 3.6, 1.6), look_at=(0, 60, 12), up=(0, 0, 1)).rays()
    scene = wrt.Scene(stadium, wrt.KdTree(builder="lazy"), device="cpu")
    scene.intersect(rays)
    part = built_part(scene, rays)
    assert 0 < part.built_cells < part.cells
    assert 0 < part.seen <= part.triangles < 0.8
    (low, high), _ = leaves_of(scene)
    waiting = unbuilt_cells(scene)
    volume = sum((high - low).prod(axis=1).sum() for low, high in ((low, high), waiting))
    assert volume == pytest.approx((stadium.bounds[1] - stadium.bounds[0]).prod(), rel=1e-4)
    figure = figure_of()
    cells = draw_section(figure.subplots(), scene, stadium, 2, 1.0)
    assert 0 < len(cells.get_paths()) < len(low)
    figure.savefig(tmp_path / "section.png")
    exact, lazy = first_frames(stadium, rays, ("binned", "lazy"), rounds=1)
    assert exact.ratio == 1.0
    assert min(lazy.build, lazy.first) > 0


def test_comparison_and_histograms(mesh, scene, tmp_path):
    trees = {"sweep": wrt.KdTree(builder="sweep"), "spatial_median, in turn": wrt.KdTree(builder="spatial_median")}
    rows = compare_trees(mesh, trees, rounds=1, size=16, traversal="single")
    assert [row.builder for row in rows] == [*trees]
    assert rows[0].build_ratio == rows[0].sah_ratio == 1.0 != rows[1].sah_ratio
    assert color_of("none of them") == "black"
    assert color_of("spatial_median, in turn") == color_of("spatial_median") != color_of("sweep")
    figure = figure_of(layout="constrained")
    axes = figure.subplots(2, 2)
    draw_comparison(axes[:, :1], {"pot": rows}, ["pot"])
    assert {text.get_text() for text in axes[0, 0].texts} == set(trees)
    statistics = scene.statistics().tree
    draw_histograms(*axes[:, 1], {"binned": statistics})
    assert sum(bar.get_height() for bar in axes[0, 1].patches) == pytest.approx(100.0)
    assert axes[0, 1].patches[0].get_height() == pytest.approx(100.0 * statistics.empty_leaves / statistics.leaves)
    assert sum(axes[1, 1].lines[0].get_ydata()) == pytest.approx(100.0)
    figure.savefig(tmp_path / "comparison.png")


def test_planar_references():
    """Three parallel squares: whichever planes the tree has, the square in each is listed once and touched from both sides."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    sheets = [np.insert(square, 0, x, axis=1) for x in (0.0, 1.0, 2.0)]
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(3)])
    mesh = wrt.TriangleMesh(np.concatenate(sheets), faces)
    scene = wrt.Scene(mesh, wrt.KdTree(builder="sweep", width=1, block_cost=20.0), device="cpu")
    tree = scene.statistics().tree
    assert tree.leaves > 1
    assert planar_references(scene, mesh) == (6, tree.references, 6 + 2 * (tree.leaves - 1))


def test_a_builder_more_has_a_colour_of_its_own(monkeypatch):
    """The colours were as many as the builders, and one builder more broke the import of all pictures."""
    more = [f"new_{number}" for number in range(8)]
    for name in more:
        monkeypatch.setitem(KDTREE_BUILDERS, name, KDTREE_BUILDERS["binned"])
    colours = [color_of(name) for name in KDTREE_BUILDERS]
    assert len(set(colours)) == len(colours) == len(BUILDERS) + len(more)
    assert [color_of(name) for name in BUILDERS] == colours[: len(BUILDERS)]
    assert all(re.fullmatch("#[0-9a-f]{6}", colour) for colour in colours)
