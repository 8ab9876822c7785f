"""The tree inspector: boxes of a level over the picture, a BVH and a kd-tree side by side, and how rays would be traced."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.engine.facts.scene_state import SceneState
from wrt.scene.scene import Scene
from wrt.viewer.client_session import ClientSession
from wrt.viewer.trees.box_lines import box_corners, draw_boxes, heat_colors
from wrt.viewer.trees.tree_levels import MEASURES, TreeBoxes, tree_boxes

__all__ = ["TreePanel"]

SHOWN, BOTH = "of this scene", "BVH and kd-tree side by side"
OCTREE, REGIONS = "octree of areas", "regions of areas"
MAX_AREAS = 64
"""Influence areas whose trees can be chosen."""

NAMES = ("/wrt/boxes", "/wrt/other boxes")

NO_AREAS = "the tree that is shown has no influence areas"

MAX_BOXES = 2000
"""Boxes that are drawn of a level: those that cost most."""


class TreePanel:
    """The controls of the inspector.

    Args:
        session: the client's.
    """

    def __init__(self, session: ClientSession) -> None:
        self._session, gui = session, session.client.gui
        self._known: dict[tuple[int, str], tuple[TreeBoxes, np.ndarray]] = {}
        areas = session.shared.current[1].state.area_trees
        trees = [SHOWN, "bvh", "kdtree", BOTH]
        if areas is not None:
            trees += [REGIONS, OCTREE, *(f"of area {number}" for number in range(min(len(areas), MAX_AREAS)))]
        with gui.add_folder("Tree", expand_by_default=False):
            self._shows = gui.add_checkbox("Boxes", initial_value=False)
            self._tree = gui.add_dropdown("Tree", trees, initial_value=SHOWN)
            self._level = gui.add_slider("Level", min=0, max=64, step=1, initial_value=2)
            self._leaves = gui.add_checkbox("Leaves above", initial_value=False)
            self._measure = gui.add_dropdown("Colour", MEASURES, initial_value="cost")
            self._text = gui.add_markdown("")
        with gui.add_folder("Explain", expand_by_default=False):
            self._explain = gui.add_button("Explain these rays")
            self._plan = gui.add_markdown("")
        for control in (self._shows, self._tree, self._level, self._leaves, self._measure):
            control.on_update(self._changed)
        self._explain.on_click(self._explained)

    def _changed(self, event: Any) -> None:
        self.draw()

    def draw(self) -> None:
        """Draws the boxes that the controls ask for, and says what they are."""
        client = self._session.client
        if not self._shows.value:
            for name in NAMES:
                client.scene.remove_by_name(name)
            self._text.content = ""
            return
        chosen = self._tree.value
        if chosen == REGIONS:
            client.scene.remove_by_name(NAMES[1])
            self._text.content = self._draw_regions()
            return
        kinds = ("bvh", "kdtree") if chosen == BOTH else (chosen,)
        texts = []
        for place, name in enumerate(NAMES):
            if place >= len(kinds):
                client.scene.remove_by_name(name)
                continue
            try:
                boxes, center = self._boxes(kinds[place])
            except ValueError as error:
                texts.append(f"**{error}**")
                continue
            shift = np.zeros(3)
            if place:
                shift[0] = 1.1 * float(boxes.high[0, 0] - boxes.low[0, 0])
            texts.append(self._draw(name, kinds[place], boxes, center, shift))
        self._text.content = "  \n".join(texts)

    def _draw(self, name: str, kind: str, boxes: TreeBoxes, center: np.ndarray, shift: np.ndarray) -> str:
        """Draws the boxes of a tree; a description."""
        level = min(int(self._level.value), boxes.levels - 1)
        found = boxes.at_level(level, self._leaves.value, MAX_BOXES)
        values = boxes.measure(self._measure.value)[found]
        largest = float(values.max()) if len(values) else 0.0
        low, high = (corner[found] + center for corner in (boxes.low, boxes.high))
        colors = heat_colors(values / (largest or 1.0))
        draw_boxes(self._session.client, name, box_corners(low, high) + shift, colors, center)
        count = int((boxes.depth == level).sum())
        measure = "areas" if (kind, self._measure.value) == (OCTREE, "triangles") else self._measure.value
        of = f"the {len(found)} that cost most of " if count > len(found) else ""
        return (
            f"{kind}: level {level} of {boxes.levels - 1}: {of}{count} boxes, {int(boxes.is_leaf[found].sum())} leaves; "
            f"{measure} up to {largest:.3g}, mean {float(values.mean()) if len(values) else 0.0:.3g}"
        )

    def _draw_regions(self) -> str:
        """Draws where the rays of each influence area start, coloured by the triangles of its tree; a description."""
        from wrt.viewer.trees.area_boxes import region_corners

        scene = self._session.shared.current[1]
        if scene.state.area_trees is None:
            return f"**{NO_AREAS}**"
        counts = np.array(scene.state.area_trees.triangles)
        draw_boxes(
            self._session.client, NAMES[0], region_corners(scene), heat_colors(counts / counts.max()), np.asarray(scene.center)
        )
        return f"{len(counts)} influence areas, with trees of {counts.min():,} to {counts.max():,} triangles"

    def _boxes(self, kind: str) -> tuple[TreeBoxes, np.ndarray]:
        """The boxes of a tree, and the centre that they are relative to.

        Raises:
            ValueError: the scene has no such tree.
        """
        version, scene = self._session.shared.current
        if (version, kind) not in self._known:
            self._known = {key: value for key, value in self._known.items() if key[0] == version}
            if kind == OCTREE:
                from wrt.viewer.trees.area_boxes import octree_boxes

                if scene.state.area_trees is None:
                    raise ValueError(NO_AREAS)
                self._known[version, kind] = octree_boxes(scene.state.area_trees.top), np.asarray(scene.center)
            else:
                state = self._state(scene, kind)
                self._known[version, kind] = tree_boxes(tree_of(state)), np.asarray(state.center)
        return self._known[version, kind]

    def _state(self, scene: Scene, kind: Any) -> SceneState:
        if kind == SHOWN or kind == scene.accelerator.kind:
            found = scene.state
        elif kind in ("bvh", "kdtree"):
            if scene.instances:
                raise ValueError("a scene of instances has one kind of upper tree")
            found = Scene([*scene.meshes], kind, device=scene.device).state
        else:
            if scene.state.area_trees is None:
                raise ValueError(NO_AREAS)
            found = scene.state.area_trees.scenes[int(kind.rsplit(" ", 1)[1])]
        if found.lazy_tree is None and not hasattr(found.tree, "struct"):
            raise ValueError("the scene has no tree")
        if not hasattr(found.tree, "child") and not hasattr(found.tree, "nodes"):
            raise ValueError("the scene has many trees")
        return found

    def _explained(self, event: Any) -> None:
        self.explain()

    def explain(self) -> None:
        """Writes the plan for camera rays, and the figures of the tree."""
        from wrt.scene.scene_statistics import tree_figures

        request, scene = self._session.request, self._session.shared.current[1]
        rays = request.camera_of().rays()
        try:
            plan = scene.explain(rays, traversal=request.traversal, triangle_test=request.triangle_test)
            rows = [f"**camera rays:** {plan}"]
        except ValueError as error:
            rows = [f"**camera rays:** {error}"]
        rows.append(f"**tree:** {scene.accelerator}")
        try:
            figures = tree_figures(scene.statistics().tree)
            rows += [
                f"{name}: {value:,.4g}" if isinstance(value, float) else f"{name}: {value:,}" for name, value in figures.items()
            ]
        except ValueError as error:
            rows.append(str(error))
        self._plan.content = "  \n".join(rows)


def tree_of(state: SceneState) -> Any:
    """The tree of a state; of instances, the one above them."""
    if not state.instances:
        return state.tree
    from wrt.viewer.trees.instance_walk import upper_tree

    return upper_tree(state)  # type: ignore[arg-type]
