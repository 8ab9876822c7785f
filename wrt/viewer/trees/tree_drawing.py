"""A tree as a drawing: the boxes of its nodes in a plane, level by level, and what each level costs.

The cost is what the surface area heuristic expects: a ray that meets the root's box meets a box within it with the ratio of
their surface areas as probability. Summed over a level, that is the number of its nodes that such a ray visits, and of the
blocks of its leaves whose triangles are tested, if nothing ends the ray before.

References: goldsmith-salmon-1987; macdonald-booth-1990.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.builders.tree import Bvh, KdTree
from wrt.kernels.validation import as_int
from wrt.viewer.trees.tree_levels import TreeBoxes, tree_boxes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_tree"]

PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
"""Planes by their names: the axes of space to the right and upward."""

MAX_BOXES = 3000
"""Boxes of the levels that are drawn if no depth is given."""

MAX_POINTS = 20_000
"""Vertices of the meshes that are drawn behind the boxes."""

WIDEST, THINNEST = 2.5, 0.5
"""Widths of the lines of the root and of the deepest level that is drawn, in points."""


def draw_tree(
    scene: Any, *, depth: int | None = None, plane: str = "xz", axes: Axes | Sequence[Axes] | None = None
) -> tuple[Axes, Axes | None]:
    """Draws the boxes of a tree's nodes, projected to a plane, and the expected cost of each level. Needs matplotlib.

        wrt.pictures.draw_tree(scene, depth=3, plane="xz")[0].figure.savefig("tree.png")

    Boxes of one level have one colour; leaves are filled. Dots behind them are vertices of the meshes. Beside them stands, for
    each level of the whole tree, how many nodes a ray that meets the root's box is expected to visit, and how many blocks of
    triangles to test, by the surface area heuristic. A block has as many triangles as kernels test at a time.

    Of a scene of instances, it is the tree above the instances; `scene.state.parts[0].tree` is that of the first mesh. A lazy
    tree is drawn as far as rays have completed it.

    Args:
        scene: a scene with one tree, or the tree itself (`Scene.tree`), whose coordinates are relative to the scene's centre.
        depth: the deepest level of which boxes are drawn, from 0, the root alone; None for all levels that have no more than
            3,000 boxes together.
        plane: "xy", "xz" or "yz": the axes to the right and upward.
        axes: of matplotlib: one for the boxes, which leaves out the costs, or two; None for a new figure.

    Returns:
        The axes with the boxes, and those with the costs, or None for these.

    Raises:
        ImportError: matplotlib is missing.
        TypeError: neither a scene with a tree nor a tree, depth is not an int, or axes are not of matplotlib.
        ValueError: the tree has no such level, an unknown plane, or other than one or two axes.
    """
    tree, center, meshes = _parts_of(scene)
    if plane not in PLANES:
        raise ValueError(f"plane is {plane!r}; choose from {', '.join(PLANES)}")
    boxes = tree_boxes(tree)
    deepest = _deepest(boxes, depth)
    main, side = _axes(axes)
    _draw_boxes(main, boxes, deepest, center, PLANES[plane])
    _draw_vertices(main, meshes, PLANES[plane])
    kind, place = type(tree).__mro__[-2].__name__, "" if np.any(center) or meshes else ", relative to the scene's centre"
    leaves = int(boxes.is_leaf.sum())
    main.set_title(f"{kind} of width {tree.width}: {len(boxes.low) - leaves:,} inner nodes, {leaves:,} leaves")
    main.set(xlabel=f"{plane[0]} (units of the mesh{place})", ylabel=f"{plane[1]} (units of the mesh{place})", aspect="equal")
    if side is not None:
        _draw_costs(side, boxes, deepest)
    return main, side


def _parts_of(scene: Any) -> tuple[Bvh | KdTree, np.ndarray, Sequence[Any]]:
    """The tree, what its coordinates are relative to, and the meshes in it.

    Raises:
        TypeError: there is no tree of the kinds that can be drawn.
    """
    if isinstance(scene, Bvh | KdTree):
        return scene, np.zeros(3), ()
    tree = getattr(scene, "tree", None)
    if not isinstance(tree, Bvh | KdTree):
        raise TypeError(f"scene must be a wrt.Scene or its tree, not {type(scene).__name__}")
    meshes = () if getattr(scene, "instances", ()) else scene.meshes
    return tree, np.asarray(scene.center, dtype=np.float64), meshes


def _deepest(boxes: TreeBoxes, depth: int | None) -> int:
    """The deepest level to draw.

    Raises:
        TypeError, ValueError: as in `draw_tree`.
    """
    last = boxes.levels - 1
    if depth is None:
        few = np.cumsum(np.bincount(boxes.depth)) <= MAX_BOXES
        return max(int(few.sum()) - 1, 0)
    depth = as_int("depth", depth)
    if not 0 <= depth <= last:
        raise ValueError(f"depth is {depth}; the levels of this tree are 0, the root, to {last}")
    return depth


def _axes(axes: Any) -> tuple[Axes, Axes | None]:
    """The axes for the boxes and for the costs.

    Raises:
        ImportError, TypeError, ValueError: as in `draw_tree`.
    """
    try:
        from matplotlib import pyplot
        from matplotlib.axes import Axes
    except ImportError as error:
        raise ImportError('draw_tree needs matplotlib: pip install "wrt[notebooks]"') from error
    if axes is None:
        _, (main, side) = pyplot.subplots(1, 2, figsize=(11, 5), width_ratios=(2, 1), layout="constrained")
        return main, side
    given = [axes] if isinstance(axes, Axes) else list(np.ravel(axes))
    if not all(isinstance(one, Axes) for one in given):
        raise TypeError(f"axes must be one or two axes of matplotlib, as in matplotlib.pyplot.subplots, or None, not {axes!r}")
    if len(given) not in (1, 2):
        raise ValueError(f"axes must be one, for the boxes, or two, for the costs as well, not {len(given)}")
    return given[0], (given[1] if len(given) == 2 else None)


def _colors(count: int) -> np.ndarray:
    """(count, 4) a colour for each level."""
    from matplotlib import colormaps

    return colormaps["viridis"](np.linspace(0.0, 0.9, count))


def _draw_boxes(axes: Axes, boxes: TreeBoxes, deepest: int, center: np.ndarray, plane: tuple[int, int]) -> None:
    """Draws the levels down to the deepest one, and a key of their colours. Higher levels lie above."""
    from matplotlib.collections import PolyCollection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Any] = []
    for level, color in enumerate(_colors(deepest + 1)):
        chosen = np.flatnonzero(boxes.depth == level)
        low, high = ((corner[chosen] + center)[:, plane] for corner in (boxes.low, boxes.high))
        corners = np.stack([low, np.c_[high[:, 0], low[:, 1]], high, np.c_[low[:, 0], high[:, 1]]], axis=1)
        faces = np.where(boxes.is_leaf[chosen, None], [*color[:3], 0.18], 0.0)
        width = WIDEST + (THINNEST - WIDEST) * level / max(deepest, 1)
        style: dict[str, Any] = {"edgecolors": [color], "facecolors": faces, "linewidths": width}
        axes.add_collection(PolyCollection(corners, zorder=3.0 - level / (deepest + 1), **style))  # type: ignore[arg-type]
        name = f"level {level}: {len(chosen):,} box{'' if len(chosen) == 1 else 'es'}"
        keys.append(Line2D([], [], color=color, linewidth=width, label=name))
    if boxes.is_leaf[boxes.depth <= deepest].any():
        keys.append(Patch(facecolor=(0.3, 0.3, 0.3, 0.25), label="leaf"))
    axes.autoscale_view()
    axes.legend(handles=keys, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4, fontsize="small", frameon=False)


def _draw_vertices(axes: Axes, meshes: Sequence[Any], plane: tuple[int, int]) -> None:
    """Draws vertices that triangles use, as many as can be told apart."""
    points = [mesh.vertices[mesh.referenced] for mesh in meshes]
    if points:
        every = np.concatenate(points)
        shown = every[:: -(-len(every) // MAX_POINTS)]
        axes.plot(*shown[:, plane].T, ".", color="0.7", markersize=1.0, zorder=1)


def _draw_costs(axes: Axes, boxes: TreeBoxes, deepest: int) -> None:
    """Draws the expected visits and tests of all levels, the root on top; those whose boxes are drawn have their colours."""
    levels = np.arange(boxes.levels)
    visits, tests = (
        np.bincount(boxes.depth[chosen], boxes.cost[chosen], boxes.levels) for chosen in (~boxes.is_leaf, boxes.is_leaf)
    )
    axes.barh(levels, visits, color="0.45", label=f"inner nodes visited: {visits.sum():.3g}")
    axes.barh(levels, tests, left=visits, color="tab:orange", label=f"blocks of triangles tested: {tests.sum():.3g}")
    axes.set(xlabel="expected number for a ray\nthat meets the root's box", ylabel="level", title="cost by level")
    axes.set_ylim(boxes.levels - 0.5, -0.5)
    axes.yaxis.get_major_locator().set_params(integer=True)  # type: ignore[call-arg]
    if deepest < boxes.levels - 1:
        axes.axhline(deepest + 0.5, color="0.6", linewidth=0.8, linestyle=":", label="boxes are drawn down to here")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), fontsize="small", frameon=False)
