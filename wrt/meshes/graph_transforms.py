"""Transforms of the nodes of a trimesh.Scene, also of those deep in its graph.

trimesh looks for the best order of the products on a node's path, in a time that grows with the cube of its length: minutes for
a thousand nodes. Long paths are multiplied here, from the top down.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

__all__ = ["graph_transform"]

LONG_PATH = 32
"""Nodes above one another up to which trimesh multiplies their transforms."""


def graph_transform(scene: Any, node: str, known: dict[str, np.ndarray]) -> np.ndarray:
    """(4, 4) float64, from a node of a trimesh.Scene to the scene.

    Args:
        scene: of the node.
        node: its name.
        known: transforms of nodes on long paths, to which those that are found are added.

    Raises:
        ValueError: the node is below itself.
    """
    forest, base = scene.graph.transforms, scene.graph.base_frame
    way, parents = [node], forest.parents
    while way[-1] in parents and way[-1] not in known and way[-1] != base:
        if len(way) > len(parents):
            raise ValueError(f"the node {node!r} of the trimesh.Scene is below itself; give it a parent that is not below it")
        way.append(parents[way[-1]])
    if len(way) <= LONG_PATH and way[-1] not in known:
        return scene.graph[node][0]
    matrix = known.get(way[-1], np.eye(4))
    for above, below in pairwise(reversed(way)):
        matrix = matrix @ forest.edge_data[above, below].get("matrix", np.eye(4))
        known[below] = matrix
    return matrix
