"""The nodes of a scene graph: names, parents and transforms, by which instances are moved together.

A node stands relative to its parent, and what hangs on a node moves with it. Instances hang on nodes. The graph says where they
are; moving nodes is one update of those instances (`wrt.Scene.move`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from wrt.meshes.instance import check_transform
from wrt.meshes.placement import members_of

NOWHERE = -1
"""Parent of a node that stands in the scene itself, and node of an instance that hangs on none."""


@dataclass(frozen=True)
class NodeGraph:
    """Nodes, each after its parent.

    Attributes:
        names: of the nodes.
        parents: (K,) number of each node's parent, smaller than its own; `NOWHERE` for none.
        local: (K, 4, 4) float64, from each node to its parent.
        node_of: (I,) the node on which each instance of the scene hangs; `NOWHERE` for none.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    local: np.ndarray
    node_of: np.ndarray

    @classmethod
    def of_geometry(cls, geometry: Any) -> NodeGraph | None:
        """The nodes of all trimesh.Scenes in what a scene is made of (`wrt.meshes.instance.as_instances`); None if there are
        none."""
        from wrt.meshes.instance import graph_nodes, is_graph

        names, parents, local, node_of = [], [], [], []
        for member in members_of(geometry):
            if not is_graph(member):
                node_of.append(NOWHERE)
                continue
            own = cls.of_trimesh(member)
            parents += [NOWHERE if parent == NOWHERE else parent + len(names) for parent in own.parents.tolist()]
            place = {name: len(names) + number for number, name in enumerate(own.names)}
            names += own.names
            local += list(own.local)
            node_of += [place[node] for node in graph_nodes(member)]
        if not names:
            return None
        return cls(tuple(names), np.array(parents), np.array(local), np.array(node_of))

    @classmethod
    def of_trimesh(cls, scene: Any) -> NodeGraph:
        """The nodes of a trimesh.Scene below its base frame, without instances."""
        forest = scene.graph.transforms
        children: dict[Any, list[Any]] = {}
        for child, parent in forest.parents.items():
            children.setdefault(parent, []).append(child)
        order, number = [], {scene.graph.base_frame: NOWHERE}
        waiting = [scene.graph.base_frame]
        while waiting:
            for child in children.get(waiting.pop(), ()):
                number[child] = len(order)
                order.append(child)
                waiting.append(child)
        edges = [forest.edge_data[forest.parents[node], node].get("matrix", np.eye(4)) for node in order]
        local = np.array(edges, dtype=np.float64).reshape(-1, 4, 4)
        return cls(tuple(map(str, order)), np.array([number[forest.parents[node]] for node in order]), local, np.zeros(0, int))

    @cached_property
    def numbers(self) -> dict[str, list[int]]:
        """The nodes of each name."""
        found: dict[str, list[int]] = {}
        for number, name in enumerate(self.names):
            found.setdefault(name, []).append(number)
        return found

    @cached_property
    def world(self) -> np.ndarray:
        """(K, 4, 4) float64, from each node to the scene."""
        found = self.local.copy()
        for number, parent in enumerate(self.parents.tolist()):
            if parent != NOWHERE:
                found[number] = found[parent] @ self.local[number]
        return found

    def number(self, name: Any) -> int:
        """The node of a name.

        Raises:
            TypeError: the name is not a str.
            ValueError: there is no such node, or there are several.
        """
        if not isinstance(name, str):
            raise TypeError(f"names of nodes are str, not {type(name).__name__}")
        found = self.numbers.get(name, [])
        if len(found) != 1:
            some = ", ".join(self.names[:8]) + (" ..." if len(self.names) > 8 else "")
            which = "is not in the scene's graph" if not found else f"is the name of {len(found)} nodes"
            raise ValueError(f"node {name!r} {which}; the nodes are {some}")
        return found[0]

    def moved(self, nodes: Mapping[str, Any]) -> tuple[NodeGraph, np.ndarray]:
        """The graph with new transforms of some nodes, relative to their parents, and the instances that move with them.

        Raises:
            TypeError, ValueError: as `wrt.Scene.move`.
        """
        if not isinstance(nodes, Mapping) or not nodes:
            raise TypeError("nodes must be a dict from names to transforms, with at least one")
        local, changed = self.local.copy(), np.zeros(len(self.names), dtype=bool)
        for name, matrix in nodes.items():
            number = self.number(name)
            local[number], changed[number] = check_transform(matrix, f"nodes[{name!r}]"), True
        for number, parent in enumerate(self.parents.tolist()):
            changed[number] |= parent != NOWHERE and changed[parent]
        hang = self.node_of != NOWHERE
        rows = np.flatnonzero(hang & changed[np.where(hang, self.node_of, 0)])
        return replace(self, local=local), rows

    def for_instances(self, kept: Sequence[int], added: int = 0) -> NodeGraph:
        """The same nodes for other instances: some of those that were there, then so many that hang on no node."""
        return replace(self, node_of=np.concatenate([self.node_of[list(kept)], np.full(added, NOWHERE)]))
