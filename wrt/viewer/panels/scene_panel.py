"""The controls that all clients share: the tree, threads, the animation, and the instances, which are moved by a gizmo."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.kernels.compilation.cores import available_cores
from wrt.viewer.shared_scene import SharedScene

if TYPE_CHECKING:
    import viser

__all__ = ["ScenePanel"]

OWN = "as given"
KINDS = ("bvh", "kdtree")
GIZMO = "/wrt/gizmo"
GIZMO_PIXELS = 120.0
"""Length of its arrows. The size of the scene would say nothing about that of an instance."""

PLOT_EVERY = 0.5
"""Seconds between changes of the plot of frames."""

PLOTTED = 60
"""Builds and frames of the plot."""


class ScenePanel:
    """The shared controls.

    Args:
        server: of all clients.
        shared: the scene.

    Attributes:
        gizmo: that moves an instance; None if there is none.
    """

    gizmo: viser.TransformControlsHandle | None = None

    def __init__(self, server: viser.ViserServer, shared: SharedScene) -> None:
        self._server, self._shared = server, shared
        self._building = threading.Lock()
        self._builds: list[float] = []
        self._made: Any = None
        gui = server.gui
        threads = shared.threads or available_cores()
        with gui.add_folder("Scene (shared)", expand_by_default=False):
            self._tree = gui.add_dropdown("Tree", [OWN, *KINDS], initial_value=OWN)
            self._builder = gui.add_dropdown("Builder", [OWN], initial_value=OWN, disabled=True)
            self._threads = gui.add_slider("Threads", min=1, max=max(2, available_cores()), step=1, initial_value=threads)
            self._text = gui.add_markdown("")
            self._plot = self._new_plot(gui)
        self._tree.on_update(self._choose_tree)
        self._builder.on_update(self._choose_builder)
        self._threads.on_update(self._choose_threads)
        if shared.frames:
            self._add_animation(gui)
        if shared.scene.instances:
            self._add_gizmo(gui)
        self._describe()

    def _new_plot(self, gui: Any) -> Any:
        from viser import uplot

        series = (uplot.Series(label="build"), uplot.Series(label="ms", stroke="#2a6fdb", width=2))
        return gui.add_uplot((np.zeros(1), np.zeros(1)), series, title="the last builds", aspect=2.0)

    def _choose_tree(self, event: Any) -> None:
        kind = self._tree.value
        names = [OWN] if kind == OWN else [*builders_of(kind)]
        self._builder.options = names
        self._builder.disabled = kind == OWN
        self.rebuild()

    def _choose_builder(self, event: Any) -> None:
        self.rebuild()

    def rebuild(self) -> None:
        """Builds the tree that the controls name; says why if it cannot be built."""
        kind, builder = self._tree.value, self._builder.value
        with self._building:
            if builder not in self._builder.options or (kind == OWN) != (builder == OWN):
                return  # the two controls change one after the other
            try:
                made = None if kind == OWN else (Bvh if kind == "bvh" else KdTree)(builder=builder)
                if made == self._made:
                    return
                self._shared.rebuild(made)
                self._made = made
            except (ValueError, TypeError, MemoryError) as error:
                self._text.content = f"**{type(error).__name__}**: {error}"
                return
            self._builds = [*self._builds, 1e3 * self._shared.build_seconds][-PLOTTED:]
        self._plot.data = np.arange(len(self._builds), dtype=np.float64), np.array(self._builds)
        self._describe()

    def _choose_threads(self, event: Any) -> None:
        self._shared.set_threads(int(self._threads.value))

    def _describe(self) -> None:
        scene = self._shared.current[1]
        self._text.content = (
            f"{scene.triangle_count:,} triangles, {scene.accelerator.kind}, {scene.bytes / 1e6:.1f} MB, "
            f"built in {1e3 * self._shared.build_seconds:.1f} ms"
        )

    def _add_animation(self, gui: Any) -> None:
        from viser import uplot

        with gui.add_folder("Animation (shared)"):
            self._play = gui.add_checkbox("Play", initial_value=False)
            self._frame = gui.add_slider("Frame", min=0, max=max(1, self._shared.frames - 1), step=1, initial_value=0)
            self._rate = gui.add_slider("Frames a second", min=0.5, max=60, step=0.5, initial_value=24)
            self._frame_text = gui.add_markdown("")
            series = (uplot.Series(label="frame"), uplot.Series(label="ms", stroke="#2a6fdb", width=2))
            self._frame_plot = gui.add_uplot((np.zeros(1), np.zeros(1)), series, title="updates of the last frames", aspect=2.0)
        self._updates: deque[float] = deque(maxlen=PLOTTED)
        self._plotted = 0.0
        self._play.on_update(self._switch)
        self._rate.on_update(self._switch)
        self._frame.on_update(self._choose_frame)

    def play(self, rate: float) -> None:
        """Plays the animation, as the controls do; errors as in `SharedScene.play`."""
        self._shared.play(float(rate), self._frame_shown, self._failed)
        self._play.value = True  # first: a change of the rate does what this says
        self._rate.value = min(max(round(2.0 * rate) / 2.0, 0.5), 60.0)

    def _failed(self, error: Exception) -> None:
        """The animation has ended with an error."""
        self._play.value = False
        self._frame_text.content = f"**{type(error).__name__}**: {error}"

    def pause(self) -> None:
        """Stops it."""
        self._shared.pause()
        if self._shared.frames:
            self._play.value = False

    def _switch(self, event: Any) -> None:
        if self._play.value:
            self._shared.play(float(self._rate.value), self._frame_shown, self._failed)
        else:
            self._shared.pause()

    def _choose_frame(self, event: Any) -> None:
        if event.client is not None and not self._shared.is_playing:  # moved by a hand, not by the animation
            self._shared.show_frame(int(self._frame.value))
            self._frame_shown()

    def _frame_shown(self) -> None:
        self._frame.value = self._shared.frame
        self._frame_text.content = f"frame {self._shared.frame}, updated in {1e3 * self._shared.update_seconds:.1f} ms"
        self._updates.append(1e3 * self._shared.update_seconds)
        if perf_counter() - self._plotted >= PLOT_EVERY or not self._shared.is_playing:
            self._plotted = perf_counter()
            self._frame_plot.data = np.arange(len(self._updates), dtype=np.float64), np.array(self._updates)

    def _add_gizmo(self, gui: Any) -> None:
        count = len(self._shared.scene.instances)
        with gui.add_folder("Instances (shared)"):
            self._moves = gui.add_checkbox("Move", initial_value=False)
            self._instance = gui.add_slider("Instance", min=0, max=max(1, count - 1), step=1, initial_value=0)
            self._moved_text = gui.add_markdown("")
        self._moves.on_update(self._place_gizmo)
        self._instance.on_update(self._place_gizmo)

    def _place_gizmo(self, event: Any) -> None:
        from viser.transforms import SO3

        if not self._moves.value:
            self._server.scene.remove_by_name(GIZMO)
            self.gizmo = None
            return
        index = min(int(self._instance.value), len(self._shared.scene.instances) - 1)
        instance = self._shared.scene.instances[index]
        turn, stretch = polar(np.asarray(instance.transform, dtype=np.float64)[:3, :3])
        gizmo = self._server.scene.add_transform_controls(
            GIZMO,
            scale=GIZMO_PIXELS,
            fixed=True,
            translation_limits=((-1e30, 1e30),) * 3,
            position=tuple(map(float, np.asarray(instance.transform)[:3, 3])),  # type: ignore[arg-type]
            wxyz=tuple(map(float, SO3.from_matrix(turn).wxyz)),  # type: ignore[arg-type]
            depth_test=False,
        )

        def moved(event: Any) -> None:
            matrix = np.eye(4)
            matrix[:3, :3] = SO3(np.asarray(gizmo.wxyz)).as_matrix() @ stretch
            matrix[:3, 3] = gizmo.position
            try:
                self._shared.move(index, matrix)
            except ValueError as error:  # too far away
                self._moved_text.content = f"**{error}**"
                return
            self._moved_text.content = f"instance {index}, updated in {1e3 * self._shared.update_seconds:.1f} ms"

        gizmo.on_update(moved)
        self.gizmo = gizmo


def builders_of(kind: str) -> Iterable[str]:
    """The names of the builders of a kind of tree; imported when they are asked for, which no first picture does."""
    if kind == "bvh":
        from wrt.builders.bvh import BVH_BUILDERS

        return BVH_BUILDERS
    from wrt.builders.kdtree import KDTREE_BUILDERS

    return KDTREE_BUILDERS


def polar(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation and what remains: matrix = rotation @ remainder."""
    u, _, v = np.linalg.svd(matrix)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return turn, turn.T @ matrix
