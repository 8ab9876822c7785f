"""Kd-trees as pictures: sections through the cells, histograms, builders as points with labels that do not overlap.

All functions draw on axes of matplotlib that the caller made. A section is a plane across one axis of the scene; the two
others are the picture's. Lengths are the scene's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.kdtrees.kdtree_comparison import BuilderFigures
from studies.kdtrees.kdtree_growth import Growth, n_log_n
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.builders.kdtree.kdtree_statistics import KdTreeStatistics, unpack
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Boxes = tuple[np.ndarray, np.ndarray]
"""Lower and upper corners of boxes, (n, 3) each."""

PALETTE = (
    "#1f77b4",
    "#17becf",
    "#2ca02c",
    "#9467bd",
    "#8c564b",
    "#000000",
    "#7f7f7f",
    "#bcbd22",
    "#ff7f0e",
    "#e377c2",
    "#d62728",
)

GOLDEN = (5**0.5 - 1) / 2
"""A step round the colour circle that keeps away from all hues before."""

ROUND = tuple(np.arange(16) * (np.pi / 8.0))
"""Ways from a point to its label, to the right first."""

RIGHT = tuple(np.radians([0, 12, -12, 24, -24, 36, -36, 48, -48]))
"""For what ends a line that comes from the left."""

REACHES = (7.0, 12.0, 18.0, 26.0, 36.0, 48.0, 62.0)
"""How far a label may be from its point, in points of 1/72 inch."""

NEAR = 10.0
"""A label farther away is joined to its point by a line."""

WAITING = "#c8c8c8"


def color_of(name: str) -> str:
    """The colour of a builder, the same in all pictures, or of a variant of it, whose name follows after a comma.

    Builders beyond the palette get hues of their own; what is no builder is black.
    """
    from colorsys import hsv_to_rgb

    builders, builder = list(KDTREE_BUILDERS), name.partition(",")[0]
    if builder not in builders:
        return "black"
    number = builders.index(builder)
    if number < len(PALETTE):
        return PALETTE[number]
    red, green, blue = (round(255 * part) for part in hsv_to_rgb(number * GOLDEN % 1.0, 0.6, 0.75))
    return f"#{red:02x}{green:02x}{blue:02x}"


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
    if scene.state.lazy_tree is not None:
        cells = scene.state.lazy_tree.cells
        chosen[cells["node"][cells["unbuilt"]]] = False
    return (flat.low[chosen] + center, flat.high[chosen] + center), flat.triangles[chosen]


def unbuilt_cells(scene: Scene) -> Boxes:
    """The boxes of what is not built yet of a lazy scene's tree, in the scene's coordinates."""
    cells, center = scene.state.lazy_tree.cells, np.array(scene.center)
    unbuilt = cells[cells["unbuilt"]]
    return unbuilt["low"] + center, unbuilt["high"] + center


def draw_section(axes: Axes, scene: Scene, mesh: TriangleMesh, axis: int, at: float, *, most: int = 48) -> Any:
    """Cells that a plane passes through, white if empty, else the darker the more triangles, and the mesh's own section.

    Args:
        axes: to draw on.
        scene: with a kd-tree of the mesh. Of one that is built lazily, cells that wait are grey.
        mesh: its geometry.
        axis, at: the plane.
        most: triangles of the darkest cells.

    Returns:
        The cells, for a colour bar.
    """
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection, PolyCollection

    boxes, triangles = leaves_of(scene)
    met, corners = rectangles(boxes, axis, at)
    colors = colormaps["YlOrBr"].with_extremes(under="white")
    look = {"cmap": colors, "clim": (0.5, most), "edgecolors": "#4477aa", "linewidths": 0.35}
    cells = PolyCollection(corners, array=triangles[met].astype(float), **look)
    axes.add_collection(cells)
    if scene.state.lazy_tree is not None:
        _, corners = rectangles(unbuilt_cells(scene), axis, at)
        axes.add_collection(PolyCollection(corners, facecolors=WAITING, edgecolors="white", linewidths=0.35))
    axes.add_collection(LineCollection(cross_section(mesh, axis, at), colors="black", linewidths=0.7))
    low, high = mesh.bounds
    (u, v), margin = plane_axes(axis), 0.01 * mesh.extent
    axes.set(xlim=(low[u] - margin, high[u] + margin), ylim=(low[v] - margin, high[v] + margin), aspect="equal")
    axes.axis("off")
    return cells


def draw_histograms(
    sizes: Axes, depths: Axes, trees: Mapping[str, KdTreeStatistics], *, block: int = 8, blocks: int = 6
) -> None:
    """The share of leaves by their triangles, 0, 1 to `block`, and so on, the last for all larger ones; and by depth."""
    width = 0.84 / len(trees)
    for k, (name, tree) in enumerate(trees.items()):
        look = {"color": color_of(name)}
        group = np.minimum(-(-np.arange(len(tree.leaf_size_histogram)) // block), blocks)
        counts = np.bincount(group, tree.leaf_size_histogram, blocks + 1)
        label = f"{name}: {100 * tree.block_fill:.0f} %"
        sizes.bar(
            np.arange(blocks + 1) + width * (k - (len(trees) - 1) / 2), 100.0 * counts / tree.leaves, width, **look, label=label
        )
        depths.plot(np.arange(tree.max_depth + 1), 100.0 * tree.depth_histogram / tree.leaves, **look, linewidth=1.3)
    bounds = ["0", *(f"{block * k + 1}-{block * (k + 1)}" for k in range(blocks - 1)), f"> {block * (blocks - 1)}"]
    sizes.set_xticks(range(blocks + 1), bounds)
    sizes.set(xlabel="triangles of a leaf", ylabel="leaves, %")
    sizes.margins(y=0.6)
    sizes.legend(fontsize=7, ncol=2, loc="upper right", title="share of lanes filled", title_fontsize=7)
    depths.set(xlabel="depth of a leaf", ylabel="leaves, %")


def draw_comparison(axes: np.ndarray, found: Mapping[str, Sequence[BuilderFigures]], titles: Sequence[str]) -> None:
    """Time to build against SAH cost, and below against the time of all workloads (geometric mean); a column a scene.

    Args:
        axes: (2, scenes), of a figure whose layout is constrained.
        found: figures by scene.
        titles: of the columns.
    """
    values = {
        "SAH cost": lambda row: row.sah_ratio,
        "time to trace": lambda row: float(np.exp(np.mean(np.log([*row.trace_ratios.values()])))),
    }
    points, reference = {}, next(iter(found.values()))[0].builder
    for line, (label, value) in zip(axes, values.items(), strict=True):
        line[0].set_ylabel(f"{label}, {reference} = 1")
        for place, rows in zip(line, found.values(), strict=True):
            points[place] = {row.builder: (row.build_ratio, value(row)) for row in rows}
            x, y = np.array([*points[place].values()]).T
            rise = max(y.max() / y.min(), 1.2) ** 0.15
            set_log_scales(place, (x.min() / 2.0, x.max() * 2.2), (y.min() / rise, y.max() * rise))
            place.axhline(1, color="lightgray", linewidth=0.8, zorder=0)
            place.axvline(1, color="lightgray", linewidth=0.8, zorder=0)
    for place, title in zip(axes[0], titles, strict=True):
        place.set_title(title, fontsize=10)
    for place in axes[1]:
        place.set_xlabel(f"time to build, {reference} = 1")
    for place, named in points.items():
        for name, point in named.items():
            place.plot(*point, "o", color=color_of(name), markersize=5)
        label_points(place, named)


def set_log_scales(axes: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    """Logarithmic scales with plain numbers, few enough to be read."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    for axis, limits in ((axes.xaxis, across), (axes.yaxis, up)):
        (axes.set_xscale if axis is axes.xaxis else axes.set_yscale)("log")
        ratio = limits[1] / limits[0]
        steps = (
            (1, 2, 5) if ratio > 12 else (1, 1.5, 2, 3, 4, 6, 8) if ratio > 3 else (1, 1.1, 1.2, 1.4, 1.6, 1.8, 2, 2.5, 3, 8, 9)
        )
        axis.set_major_locator(FixedLocator([step * 10.0**k for k in range(-4, 5) for step in steps]))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set(xlim=across, ylim=up)


def draw_growth(axes: Sequence[Axes], grown: Sequence[Growth]) -> None:
    """Seconds against triangles on the first axes, time / (n log2 n) in nanoseconds on the second."""
    for place, unit in zip(axes, ("seconds to build", "ns / (n log2 n)"), strict=True):
        ends = {}
        for growth in grown:
            scale = [1.0 if unit.startswith("seconds") else 1e9 / n_log_n(n) for n in growth.triangles]
            values = [s * factor for s, factor in zip(growth.seconds, scale, strict=True)]
            place.loglog(growth.triangles, values, color=color_of(growth.builder), marker="o", markersize=3)
            ends[growth.builder] = growth.triangles[-1], values[-1]
        sizes = [size for growth in grown for size in growth.triangles]
        place.set(xlabel="triangles", ylabel=unit, xlim=(min(sizes) / 1.3, max(sizes) * 6))
        label_points(place, ends, ways=RIGHT)


def label_points(
    axes: Axes, points: Mapping[str, tuple[float, float]], *, ways: Sequence[float] = ROUND, size: float = 7.5
) -> list[Any]:
    """Writes each point's name beside it, in the nearest place where it covers no other name and no point.

    Args:
        axes: with their final scales, limits and place in the figure.
        points: (x, y) by name, in the axes' units.
        ways: from a point to its label, as angles; the first are tried first.
        size: of letters, in points.

    Returns:
        The labels. Where there is no free place, a label covers as little as it can.
    """
    from matplotlib.patheffects import withStroke

    figure = axes.figure
    figure.draw_without_rendering()
    pixels, frame = figure.dpi / 72.0, np.array(axes.get_window_extent().get_points()).ravel()
    places = {name: axes.transData.transform(point) for name, point in points.items()}
    taken = [np.concatenate([place - 4 * pixels, place + 4 * pixels]) for place in places.values()]
    labels, halo = [], [withStroke(linewidth=2.0, foreground="white")]
    for name in sorted(points, key=lambda name: -places[name][1]):
        color = color_of(name)
        look = {"fontsize": size, "color": color, "ha": "center", "va": "center", "in_layout": False, "path_effects": halo}
        label = axes.annotate(name, points[name], (0, 0), textcoords="offset points", **look)
        extent = label.get_window_extent()
        half = np.array([extent.width, extent.height]) / 2.0 + 1.0
        places_for = candidates(places[name], half, pixels, ways)
        offset, box, _ = min(places_for, key=lambda place: (covered(place[1], taken, frame), place[2]))
        taken.append(box)
        label.set_position(offset / pixels)
        gap = np.sign(offset) * np.maximum(np.abs(offset) - half, 0.0)
        if np.linalg.norm(gap) > NEAR * pixels:
            line = {"color": color, "linewidth": 0.5, "alpha": 0.7, "zorder": 0}
            ends = axes.transData.inverted().transform([places[name], places[name] + gap])
            axes.plot(*ends.T, scalex=False, scaley=False, **line)
        labels.append(label)
    return labels


def candidates(
    place: np.ndarray, half: np.ndarray, pixels: float, ways: Sequence[float]
) -> list[tuple[np.ndarray, np.ndarray, int]]:
    """Where a label of a size may be: its offset from the point, its box (x0, y0, x1, y1), and its rank; all in pixels."""
    found = []
    for reach in REACHES:
        for turn in ways:
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
