"""Instances that come and go, and nodes of a scene's graph that move: what `wrt.Scene` adds to queries and updates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from wrt.engine.facts.scene_state import SceneState, new_mark
from wrt.kernels.runtime.launch import refuse_capture, use_threads
from wrt.kernels.validation import as_bool
from wrt.meshes.instance import as_instances
from wrt.meshes.node_graph import NodeGraph

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Indices
    from wrt.meshes.instance import Geometry


class Members:
    """The instances of a `wrt.Scene` and the nodes on which they hang.

    Attributes:
        state: what queries read.
    """

    state: SceneState

    def move(self, nodes: Mapping[str, ArrayLike]) -> None:
        """Moves nodes of a scene's graph by their names, and with each all nodes below it: in one step, or not at all.

            scene = wrt.Scene(trimesh.load("robot.glb"))
            scene.move({"shoulder": turned, "wrist": bent})
            scene.node_transform("hand")

        Only the instances on these nodes are updated. An instance that `update` has moved beside the graph returns to its node
        when that is moved.

        Args:
            nodes: for each name a (4, 4) transform from the node to its parent, as in `wrt.Instance`.

        Raises:
            TypeError: not a dict from names to matrices, or an empty one.
            ValueError: a scene without a graph, an unknown name, one of several nodes, or a transform that `wrt.Instance`
                refuses. The scene is then unchanged.
        """
        self.state.require_instances("move")
        refuse_capture("move", self.state.device)
        self.state = self.state.with_nodes(nodes)

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of the nodes of the scene's graph, each after its parent; empty if the scene was made without a graph."""
        graph = getattr(self.state, "graph", None)
        return () if graph is None else graph.names

    def node_transform(self, name: str, *, to_parent: bool = False) -> np.ndarray:
        """(4, 4) float64: from a node of the scene's graph to the scene, or to its parent.

        Args:
            name: of the node.
            to_parent: whether relative to its parent, as `move` takes it.

        Raises:
            TypeError: the name is not a str.
            ValueError: a scene without a graph, an unknown name, or one of several nodes.
        """
        graph = self._graph()
        return (graph.local if as_bool("to_parent", to_parent) else graph.world)[graph.number(name)].copy()

    def node_instances(self, name: str) -> np.ndarray:
        """(M,) int64: indices of the instances that hang on a node of the scene's graph itself.

        Args:
            name: of the node.

        Raises:
            TypeError, ValueError: as `node_transform`.
        """
        graph = self._graph()
        return np.flatnonzero(graph.node_of == graph.number(name))

    def _graph(self) -> NodeGraph:
        graph = getattr(self.state, "graph", None)
        if graph is None:
            raise ValueError("the scene has no graph; make it from a trimesh.Scene")
        return graph

    def add(self, instances: Geometry) -> np.ndarray:
        """Adds instances, after those that are there. Trees of meshes stay; those of new meshes are built.

        Args:
            instances: a `wrt.Instance`, or several. Instances of one mesh object share its tree with those that are there.

        Returns:
            (M,) int64, their indices (`Hits.instance_id`).

        Raises:
            TypeError: something else than instances.
            ValueError: a scene without instances, or as `wrt.moving.InstancedScene`. The scene is then unchanged.
        """
        self.state.require_instances("add")
        refuse_capture("add", self.state.device)
        added, first = as_instances(instances), len(self.state.instances)
        with use_threads(self.state.num_threads):
            graph = self.state.graph and self.state.graph.for_instances(range(first), len(added))
            self.state = self.state.with_instances((*self.state.instances, *added), graph)
        return np.arange(first, first + len(added))

    def remove(self, index: Indices) -> None:
        """Removes instances. Later ones move up, as in a list; trees of meshes stay, unless nobody uses them any more.

        Hits from before number the triangles of instances that are gone, so queries and gradients refuse them.

        Args:
            index: index of an instance, or several.

        Raises:
            TypeError: not ints.
            ValueError: a scene without instances, no such instance, or no instance would be left. The scene is then unchanged.
        """
        self.state.require_instances("remove")
        refuse_capture("remove", self.state.device)
        gone = set(self.state.chosen(index).tolist())
        kept = [number for number in range(len(self.state.instances)) if number not in gone]
        left = tuple(self.state.instances[number] for number in kept)
        if not left:
            raise ValueError("index names all instances, and a scene has at least one; hide them with mask=0")
        with use_threads(self.state.num_threads):
            graph = self.state.graph and self.state.graph.for_instances(kept)
            self.state = replace(self.state.with_instances(left, graph), mark=new_mark())
