"""The nodes of a scene graph: names, parents and transforms, by which instances are moved together.

A node stands relative to its parent, and what hangs on a node moves with it. Instances hang on nodes. The graph says where they
are; moving nodes is one update of those instances (`wrt.Scene.move`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.meshes.instance import check_transform
from wrt.meshes.placement import members_of

if TYPE_CHECKING:
    import trimesh

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
            node_of += [place.get(node, NOWHERE) for node in graph_nodes(member)]  # a mesh may hang on the base frame itself
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
                if child not in number:  # the base frame may be below itself, as in files that trimesh 4.0 has read
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
            raise TypeError(f"nodes must be a dict from names to transforms, with at least one, not {nodes!r}")
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


def nested_meshes(scene: trimesh.Scene) -> list[Any]:
    """The meshes of a trimesh.Scene in the scene's space, nested as its graph: a list for each node that holds several.

        scene = wrt.Scene(wrt.moving.nested_meshes(trimesh.load("town.glb")), wrt.KdTree(builder="lazy", hierarchy="groups"))

    For scenes of one level, in which every mesh is a geometry of its own: `wrt.Scene`, `wrt.moving.GroupedScene`. Passed as it
    is, a trimesh.Scene is one of two levels, in which nodes move and meshes are shared.

    Args:
        scene: point clouds and paths in it are left out, and so are nodes that hold no mesh.

    Returns:
        `wrt.TriangleMesh`, with materials as in `from_trimesh`, and lists of such; a node's own mesh precedes what hangs on it.

    Raises:
        TypeError: it is no trimesh.Scene.
        ValueError: no triangles, or bad geometry as in `wrt.TriangleMesh`.
    """
    from wrt.meshes.instance import graph_instances, is_graph
    from wrt.meshes.mesh import TriangleMesh

    if not is_graph(scene):
        raise TypeError(f"scene must be a trimesh.Scene, not {type(scene).__name__}; pass meshes to wrt.Scene as they are")
    graph, instances = NodeGraph.of_geometry(scene), graph_instances(scene)
    known = {id(instance.mesh): TriangleMesh.from_trimesh(instance.mesh) for instance in instances}
    top: list[Any] = []
    held: list[list[Any]] = [] if graph is None else [[] for _ in graph.names]
    nodes = [NOWHERE] * len(instances) if graph is None else graph.node_of.tolist()
    for instance, node in zip(instances, nodes, strict=True):
        (top if node == NOWHERE else held[node]).append(known[id(instance.mesh)].transformed(instance.transform))
    own, of_base = [len(meshes) for meshes in held], len(top)
    for node in reversed(range(len(held))):  # members before their groups
        if held[node]:
            parent = graph.parents[node]
            above, place = (top, of_base) if parent == NOWHERE else (held[parent], own[parent])
            above.insert(place, held[node][0] if len(held[node]) == 1 else held[node])
    return top
