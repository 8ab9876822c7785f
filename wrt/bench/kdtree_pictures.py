"""Kd-trees as pictures: sections through the cells, histograms, builders as points with labels that do not overlap.

All functions draw on axes of matplotlib that the caller made. A section is a plane across one axis of the scene; the two
others are the picture's. Lengths are the scene's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.builders.kdtree.statistics import KdTreeStatistics, unpack
from wrt.mesh import TriangleMesh
from wrt.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Boxes = tuple[np.ndarray, np.ndarray]
"""Lower and upper corners of boxes, (n, 3) each."""

PALETTE = ("#1f77b4", "#17becf", "#2ca02c", "#9467bd", "#8c564b", "#000000", "#7f7f7f", "#bcbd22", "#ff7f0e", "#e377c2", "#d62728")

COLORS = dict(zip(KDTREE_BUILDERS, PALETTE, strict=True))
"""Every builder's own, in all pictures."""

REACHES = (7.0, 12.0, 18.0, 26.0, 36.0, 48.0, 62.0)
"""How far a label may be from its point, in points of 1/72 inch."""

NEAR = 13.0
"""A label farther away is joined to its point by a line."""

WAITING = "#c8c8c8"


def plane_axes(axis: int) -> tuple[int, int]:
    """The picture's horizontal and vertical axis, for a section across `axis`; z is up if it can be."""
    return tuple(other for other in range(3) if other != axis)


def cross_section(mesh: TriangleMesh, axis: int, at: float) -> np.ndarray:
    """Where triangles cross the plane: (n, 2, 2) segments, in the picture's coordinates.

    Args:
        mesh: triangles; those that lie in the plane, or touch it from above, are left out.
        axis: 0, 1 or 2, across which the plane lies.
        at: its coordinate.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    below = corners[:, :, axis] < at
    crossed = below.any(axis=1) & ~below.all(axis=1)
    corners, below = corners[crossed], below[crossed]
    turn = np.where(below.sum(axis=1) == 1, np.argmax(below, axis=1), np.argmin(below, axis=1))
    alone, *others = (corners[np.arange(len(corners)), (turn + k) % 3] for k in range(3))
    share = [(at - alone[:, axis]) / (other[:, axis] - alone[:, axis]) for other in others]
    ends = [alone + s[:, None] * (other - alone) for s, other in zip(share, others, strict=True)]
    return np.stack(ends, axis=1)[:, :, plane_axes(axis)]


def rectangles(boxes: Boxes, axis: int, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Boxes that the plane passes through, and how: their numbers, (n,), and (n, 4, 2) corners in the picture's coordinates."""
    low, high = boxes
    met = np.flatnonzero((low[:, axis] <= at) & (at < high[:, axis]))
    u, v = plane_axes(axis)
    corners = [(low, low), (high, low), (high, high), (low, high)]
    return met, np.stack([np.stack([a[met, u], b[met, v]], axis=1) for a, b in corners], axis=1)


def leaves_of(scene: Scene) -> tuple[Boxes, np.ndarray]:
    """The leaves of a scene's kd-tree that are built: their boxes, in the scene's coordinates, and their triangles."""
    flat, center = unpack(scene.tree), np.array(scene.center)
    chosen = flat.is_leaf.copy()
    if scene.growing is not None:
        cells = scene.growing.cells
        chosen[cells["node"][cells["waiting"]]] = False
    return (flat.low[chosen] + center, flat.high[chosen] + center), flat.triangles[chosen]


def waiting_cells(scene: Scene) -> Boxes:
    """The boxes of what is not built yet of a lazy scene's tree, in the scene's coordinates."""
    cells, center = scene.growing.cells, np.array(scene.center)
    waiting = cells[cells["waiting"]]
    return waiting["low"] + center, waiting["high"] + center


def draw_section(axes: Axes, scene: Scene, mesh: TriangleMesh, axis: int, at: float, *, most: int = 32) -> Any:
    """Cells that a plane passes through, the darker the more triangles they list, and the mesh's own section.

    Args:
        axes: to draw on.
        scene: with a kd-tree of the mesh. Of one that is built lazily, cells that wait are grey.
        mesh: its geometry.
        axis, at: the plane.
        most: triangles of the darkest cells.

    Returns:
        The cells, for a colour bar.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    boxes, triangles = leaves_of(scene)
    met, corners = rectangles(boxes, axis, at)
    look = {"cmap": "YlOrBr", "edgecolors": "#4477aa", "linewidths": 0.35}
    cells = PolyCollection(corners, array=triangles[met].astype(float), clim=(0, 1.6 * most), **look)
    axes.add_collection(cells)
    if scene.growing is not None:
        _, corners = rectangles(waiting_cells(scene), axis, at)
        axes.add_collection(PolyCollection(corners, facecolors=WAITING, edgecolors="white", linewidths=0.35))
    axes.add_collection(LineCollection(cross_section(mesh, axis, at), colors="black", linewidths=0.7))
    low, high = mesh.bounds
    (u, v), margin = plane_axes(axis), 0.01 * mesh.extent
    axes.set(xlim=(low[u] - margin, high[u] + margin), ylim=(low[v] - margin, high[v] + margin), aspect="equal")
    axes.axis("off")
    return cells


def draw_histograms(sizes: Axes, depths: Axes, trees: Mapping[str, KdTreeStatistics], *, most: int = 48) -> None:
    """The share of leaves with so many triangles, the last standing for all larger ones, and the share at every depth."""
    for name, tree in trees.items():
        look = {"label": name, "color": COLORS.get(name), "where": "mid", "linewidth": 1.3}
        counts = np.bincount(np.minimum(np.arange(len(tree.leaf_size_histogram)), most), tree.leaf_size_histogram, most + 1)
        sizes.step(np.arange(most + 1), 100.0 * counts / tree.leaves, **look)
        depths.step(np.arange(tree.max_depth + 1), 100.0 * tree.depth_histogram / tree.leaves, **look)
    sizes.set(xlabel=f"triangles of a leaf ({most}: or more)", ylabel="leaves, %")
    depths.set(xlabel="depth of a leaf", ylabel="leaves, %")


def draw_points(axes: Axes, points: Mapping[str, tuple[float, float]], *, colors: Mapping[str, str] = COLORS) -> None:
    """A labelled point each; scales, limits and the figure's layout have to be settled before."""
    for name, (x, y) in points.items():
        axes.plot(x, y, "o", color=colors.get(name, "black"), markersize=5)
    label_points(axes, points, colors=colors)


def label_points(
    axes: Axes, points: Mapping[str, tuple[float, float]], *, colors: Mapping[str, str] = COLORS, size: float = 7.5
) -> list[Any]:
    """Writes each point's name beside it, in the nearest place where it covers no other name and no point.

    Args:
        axes: with their final scales, limits and place in the figure.
        points: (x, y) by name, in the axes' units.
        colors: of names; black for others.
        size: of letters, in points.

    Returns:
        The labels. Where there is no free place, a label covers as little as it can.
    """
    figure = axes.figure
    figure.draw_without_rendering()
    pixels, frame = figure.dpi / 72.0, np.array(axes.get_window_extent().get_points()).ravel()
    places = {name: axes.transData.transform(point) for name, point in points.items()}
    taken = [np.concatenate([place - 4 * pixels, place + 4 * pixels]) for place in places.values()]
    labels = []
    for name in sorted(points, key=lambda name: -places[name][1]):
        color = colors.get(name, "black")
        label = axes.annotate(name, points[name], fontsize=size, color=color, textcoords="offset points", ha="center", va="center")
        extent = label.get_window_extent()
        half = np.array([extent.width, extent.height]) / 2.0 + 1.0
        offset, box = min(candidates(places[name], half, pixels), key=lambda place: (covered(place[1], taken, frame), place[2]))[:2]
        taken.append(box)
        label.set_position(offset / pixels)
        if max(np.abs(offset) - half) > NEAR * pixels - half.min():
            line = {"color": color, "linewidth": 0.5, "alpha": 0.7, "zorder": 0}
            edge = places[name] + offset * (1.0 - half[1] / max(np.linalg.norm(offset), half[1]))
            ends = axes.transData.inverted().transform([places[name], edge])
            axes.plot(*ends.T, scalex=False, scaley=False, **line)
        labels.append(label)
    return labels


def candidates(place: np.ndarray, half: np.ndarray, pixels: float) -> list[tuple[np.ndarray, np.ndarray, int]]:
    """Where a label of a size may be: its offset from the point, its box (x0, y0, x1, y1), and its rank; all in pixels."""
    found = []
    for reach in REACHES:
        for turn in np.arange(16) * (np.pi / 8.0):
            way = np.array([np.cos(turn), np.sin(turn)])
            offset = way * (reach * pixels + half * np.abs(way))
            found.append((offset, np.concatenate([place + offset - half, place + offset + half]), len(found)))
    return found


def covered(box: np.ndarray, taken: Sequence[np.ndarray], frame: np.ndarray) -> float:
    """The area of what a box covers of others, and of what of it is outside the frame."""
    others = np.array(taken)
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    inside = np.maximum(np.minimum(box[2:], frame[2:]) - np.maximum(box[:2], frame[:2]), 0.0)
    return float(np.maximum(sides, 0.0).prod(axis=1).sum() + (box[2:] - box[:2]).prod() - inside.prod())
