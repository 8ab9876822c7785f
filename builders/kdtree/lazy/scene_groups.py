"""The groups of a scene as unexpanded nodes of a lazy kd-tree: groups of groups of meshes, opened where rays go (Hunt, Mark
and Fussell 2007).

**Problem.** A list of all meshes is itself a scan of the scene: with many small meshes, the top of the tree is built over all
of their boxes before any ray arrives.

**Algorithm.** The scene's graph is a tree of nodes: a mesh, or a group of at least two nodes. A cell of the kd-tree lists nodes
in place of triangles. A cell that a ray reaches, and that holds many triangles, is divided: groups are opened, the largest box
first, until the cell lists at least `OPENED` nodes, and planes are chosen by their boxes. A member whose box does not meet the
cell is dropped. If no plane divides these boxes well, twice as many are opened. When only meshes are left, the cell is built
like any other: its triangles are listed, sorted if they are many, and built.

**Why nothing is lost.** The box of a group contains those of its members, and these contain their triangles strictly. So a
triangle in a cell belongs to a node of the cell's list, before and after a group is opened.

**Data.** Triangles are numbered in the order of the graph, depth first, so a group is a range of them, as a mesh is. A cell of
few triangles is built from these ranges without opening its groups.

**Complexity.** The boxes of all nodes are computed from those of the meshes in O(nodes). Only groups on the way to cells that
rays reach are opened.

References: hunt-2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import Any

import numpy as np

from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes, widened
from wrt.builders.kdtree.lazy.triangle_clusters import Clusters

OPENED = 64
"""Least nodes of a cell that is divided by nodes. With fewer, rays come back more often to cells whose groups have two members;
with more, groups are opened that no ray reaches."""


@dataclass(frozen=True)
class SceneGroups:
    """The nodes of a scene's graph: the meshes by their numbers, then the groups, each after its members.

    Attributes:
        meshes: number of meshes, and number of the first group.
        members: the nodes in each group, at least two.
        triangles: (nodes, 2) int64, first triangle and one past the last.
        low, high: (nodes, 3) float32, boxes that strictly contain the triangles.
        area: (nodes,) float64, areas of the boxes.
    """

    meshes: int
    members: tuple[np.ndarray, ...]
    triangles: np.ndarray
    low: np.ndarray
    high: np.ndarray
    area: np.ndarray

    @classmethod
    def of(cls, boxes: MeshBoxes) -> SceneGroups | None:
        """The nodes of a scene; None if they do not divide it, as a single mesh. Meshes without triangles are left out, and so
        are groups without members; a group of one is that member."""
        filled, members = (np.diff(boxes.first) > 0).tolist(), []
        meshes = len(filled)

        def number(part: Any) -> int | None:
            if not isinstance(part, tuple):
                return part if filled[part] else None
            found = [node for node in map(number, part) if node is not None]
            if len(found) < 2:
                return found[0] if found else None
            members.append(np.array(found))
            return meshes + len(members) - 1

        number(tuple(range(meshes)) if boxes.hierarchy is None else boxes.hierarchy)
        if not members:
            return None
        low, high = widened(boxes.low, boxes.high)
        triangles = np.stack([boxes.first[:-1], boxes.first[1:]], axis=1).astype(np.int64)
        low, high, triangles = (
            np.concatenate([of_meshes, np.zeros_like(of_meshes, shape=(len(members), of_meshes.shape[1]))])
            for of_meshes in (low, high, triangles)
        )
        for node, below in enumerate(members, start=meshes):
            low[node], high[node] = low[below].min(axis=0), high[below].max(axis=0)
            triangles[node] = triangles[below[0], 0], triangles[below[-1], 1]
        x, y, z = (high.astype(np.float64) - low).T
        return cls(meshes, tuple(members), triangles, low, high, x * y + y * z + z * x)

    @property
    def root(self) -> int:
        """The group of all nodes."""
        return len(self.low) - 1

    def count(self, nodes: np.ndarray) -> int:
        """Number of triangles of some nodes."""
        return int(np.diff(self.triangles[nodes], axis=1).sum())

    def opened(self, nodes: np.ndarray, low: np.ndarray, high: np.ndarray, min_count: int) -> tuple[np.ndarray, list[int]]:
        """Replaces groups by their members, the largest box first, until there are `min_count` nodes or no groups.

        Args:
            nodes: those of a cell.
            low, high: (3,) the cell; members outside are left out.
            min_count: number of nodes from which on no group is opened.

        Returns:
            The nodes, meshes first, and the groups that were opened.
        """
        done = [node for node in nodes.tolist() if node < self.meshes]
        waiting = [(-self.area[node], node) for node in nodes.tolist() if node >= self.meshes]
        heapify(waiting)
        groups = []
        while waiting and len(done) + len(waiting) < min_count:
            groups.append(heappop(waiting)[1])
            below = self.members[groups[-1] - self.meshes]
            meets = ((self.low[below] < high) & (self.high[below] > low)).all(axis=1)
            for node in below[meets].tolist():
                if node < self.meshes:
                    done.append(node)
                else:
                    heappush(waiting, (-self.area[node], node))
        return np.array(sorted(done) + sorted(node for _, node in waiting), dtype=np.int64), groups

    def clusters(self, nodes: np.ndarray, low: np.ndarray, high: np.ndarray) -> Clusters:
        """Nodes as clusters of a cell, (3,) low to high; their cores are what is in the cell."""
        lows, highs = self.low[nodes], self.high[nodes]
        cores = (np.clip(corner, low, high) for corner in (lows, highs))
        first, ends = self.triangles[nodes].T
        return Clusters(None, first, lows, highs, *cores, are_meshes=True, ends=ends, nodes=nodes)
