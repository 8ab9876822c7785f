"""Picking: a click on the picture shows what its ray hits, and the ray's way through the tree."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.viewer.client_session import ClientSession
from wrt.viewer.trees.box_lines import draw_boxes, heat_colors

if TYPE_CHECKING:
    import viser

    from wrt.viewer.trees.tree_walk import Visit

__all__ = ["PickPanel"]

WAY, POINT = "/wrt/way", "/wrt/picked"


class PickPanel:
    """What was picked last.

    Args:
        session: the client's.

    Attributes:
        hits: of the ray that was picked last, a `wrt.Hits`; None before the first click.
        visits: the boxes on its way; empty for scenes of many trees that are not instances.
    """

    def __init__(self, session: ClientSession) -> None:
        self._session, gui = session, session.client.gui
        self.hits: Any = None
        self.visits: list[Visit] = []
        self._center = np.zeros(3)
        with gui.add_folder("Pick", expand_by_default=False):
            self._text = gui.add_markdown("Click on the picture.")
            self._shows_way = gui.add_checkbox("Way through the tree", initial_value=True)
            self._steps = gui.add_slider("Visits", min=0, max=1, step=1, initial_value=1)
        self._steps.on_update(self._redraw)
        self._shows_way.on_update(self._redraw)
        session.client.scene.on_click()(self._clicked)

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        self.pick(event.ray_origin, event.ray_direction)

    def pick(self, origin: Any, direction: Any) -> None:
        """Shows what a ray hits.

        Args:
            origin, direction: (3,) of the ray, in the coordinates of the scene.
        """
        from wrt.viewer.trees.ray_way import walk

        session, request = self._session, self._session.request
        scene = session.shared.current[1]
        origin, direction = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
        self.hits = hits = scene.intersect(origin, direction, triangle_test=request.triangle_test)
        self._center = scene.center
        try:
            self.visits = walk(scene.state, origin, direction)
        except ValueError:
            self.visits = []
        self._text.content = self._described(origin, direction)
        if hits.is_hit:
            extent = float(np.linalg.norm(np.ptp(scene.bounds, axis=0)))
            position = tuple(map(float, hits.position))
            session.client.scene.add_icosphere(POINT, 0.004 * extent, color=(255, 60, 0), position=position, cast_shadow=False)
        else:
            session.client.scene.remove_by_name(POINT)
        self._steps.max = max(1, len(self.visits))
        self._steps.value = max(1, len(self.visits))
        self._draw()

    def _described(self, origin: np.ndarray, direction: np.ndarray) -> str:
        hits = self.hits
        way = described(self.visits)
        if not hits.is_hit:
            return f"**Nothing is hit.**  \nway: {way}"
        rows = (
            f"**triangle {int(hits.primitive_id)}** of mesh {int(hits.geometry_id)}, instance {int(hits.instance_id)}",
            f"t {float(hits.t):.7g}",
            "u, v " + ", ".join(f"{value:.6f}" for value in hits.uv),
            "position " + ", ".join(f"{value:.6g}" for value in hits.position),
            "normal " + ", ".join(f"{value:.4f}" for value in hits.normal),
            f"way: {way}",
        )
        return "  \n".join(rows)

    def _redraw(self, event: Any) -> None:
        self._draw()

    def _draw(self) -> None:
        """Draws the first visits: early ones blue, late ones red."""
        count = int(self._steps.value) if self._shows_way.value else 0
        shown = self.visits[:count]
        colors = heat_colors(np.arange(len(shown)) / max(len(self.visits) - 1, 1))
        draw_boxes(self._session.client, WAY, [visit.corners for visit in shown], colors, self._center)


def described(visits: list[Visit]) -> str:
    """The traversal path of a ray in figures."""
    if not visits:
        return "none: the ray misses the scene's box, or the scene has many trees"
    entered = {visit.instance: None for visit in visits if visit.instance >= 0}
    of_instances = [visit for visit in visits if visit.is_instance]
    leaves = [visit for visit in visits if visit.is_leaf and not visit.is_instance]
    inner = len(visits) - len(leaves) - len(of_instances)
    tests = sum(len(visit.triangles) for visit in leaves)
    through = f"instances {', '.join(map(str, entered))}; " if entered else ""
    return f"{through}{inner} inner nodes, {len(leaves)} leaves, {tests} triangle tests"
