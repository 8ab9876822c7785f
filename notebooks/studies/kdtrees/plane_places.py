"""Where the planes of least cost lie: between the spatial and the object median, as MacDonald and Booth derived, or not (1990).

The derivation assumes that a plane splits no object. Of a tree of exact search, every inner node is looked at: its plane is the
best of all, so it is the best along its axis.

References: macdonald-booth-1990; rahikainen-2013 (section 4.1).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wrt.accelerators.tree_descriptions import KdTree
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scenes import build

Row = dict[str, Any]

TINY = 1e-5
"""Edge of the triangles of `points`, in edges of the box that holds them: next to no plane splits one."""

SLACK = 1e-5
"""How far from the medians a plane may lie, in edges of the node: planes and boxes are float32."""

MESHES: dict[str, Callable[[], TriangleMesh]] = {
    "points": lambda: build("random_triangles", count=10_000, size=TINY),
    "teapot": lambda: build("teapot", level=12, ground=False),
    "atrium": lambda: build("atrium", detail=1),
    "wood": lambda: build("wood", trees=3),
}


def compare_places() -> list[Row]:
    """Shares of the nodes of exact trees, one triangle a block, whose plane lies between the medians.

    Returns:
        A row for each of `MESHES`: scene, nodes (inner ones), and in per cent of them: between (the plane lies between the
        medians), weighted (the same by surface area, as rays meet nodes), splitting (the plane splits a triangle's box).
    """
    return [{"scene": name} | places(make()) for name, make in MESHES.items()]


def places(mesh: TriangleMesh) -> Row:
    """The row of one mesh, without its name."""
    scene = Scene(mesh, KdTree(builder="sweep", width=1, empty_factor=1.0), device="cpu")
    flat, primitive = unpack(scene.tree), scene.tree.primitive.numpy()
    corners = (mesh.vertices - np.array(scene.center)).astype(np.float32)[mesh.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    below: dict[int, np.ndarray] = {}
    found = []
    for node in reversed(range(len(flat.axis))):
        if flat.is_leaf[node]:
            below[node] = primitive[flat.first_block[node] :][: flat.triangles[node]]
            continue
        own = below[node] = np.union1d(below.pop(flat.left[node]), below.pop(flat.right[node]))
        axis, plane = flat.axis[node], flat.position[node]
        start, end = flat.low[node, axis], flat.high[node, axis]
        first, last = low[own, axis], high[own, axis]
        slack, sides = SLACK * (end - start), flat.high[node] - flat.low[node]
        order = np.argsort(np.maximum(first, start) + np.minimum(last, end), kind="stable")
        middle, spatial = order[[(len(own) - 1) // 2, len(own) // 2]], 0.5 * (start + end)
        is_between = min(spatial, first[middle].min()) - slack <= plane <= max(spatial, last[middle].max()) + slack
        is_splitting = bool(((first < plane - slack) & (last > plane + slack)).any())
        found.append((is_between, is_splitting, sides[0] * sides[1] + sides[1] * sides[2] + sides[2] * sides[0]))
    between, splitting, areas = (np.array(values, dtype=np.float64) for values in zip(*found, strict=True))
    shares = {"between": between.mean(), "weighted": np.average(between, weights=areas), "splitting": splitting.mean()}
    return {"nodes": len(found)} | {name: 100.0 * float(share) for name, share in shares.items()}
