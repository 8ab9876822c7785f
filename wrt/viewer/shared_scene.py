"""The scene that all clients of a viewer look at: its versions, and what changes it while they look.

Pictures are made of versions. A version is a scene that nobody changes any more: a copy, which shares the state of the caller's
scene, or a scene of its own if the viewer builds another tree than the caller did. The viewer moves the caller's scene (`move`,
`show_frame`), but leaves its tree.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from copy import copy
from time import perf_counter
from typing import Any

import numpy as np

from wrt.accelerators.accelerator import Accelerator, resolve_accelerator
from wrt.kernels.runtime.launch import check_num_threads
from wrt.moving.fuzzy_scene import FuzzyScene
from wrt.scene.scene import Scene

__all__ = ["SharedScene"]


class SharedScene:
    """A scene and its versions.

    Args:
        scene: what is shown. If it was updated elsewhere, `refresh` shows that.
        animate: animate(scene, frame) moves the scene to a frame; None for `FuzzyScene.show` of such scenes.
        frames: number of frames; 0 without an animation.

    Attributes:
        scene: as given.
        frames: as given.
        frame: the frame that is shown.
        threads: for pictures; None for all.
        update_seconds: of the last move or frame, with all that made it visible.
    """

    def __init__(self, scene: Scene, animate: Callable[[Scene, int], Any] | None = None, frames: int = 0) -> None:
        if animate is None and isinstance(scene, FuzzyScene):
            animate, frames = FuzzyScene.show, scene.frame_count  # type: ignore[assignment]
        self.scene, self.frames, self.frame = scene, frames if animate else 0, 0
        self.update_seconds = 0.0
        self._animate = animate
        self._lock = threading.RLock()
        """Held during changes, which may build a tree for minutes; viewers that only look do not take it."""
        self._listening = threading.Lock()
        self._listeners: list[Callable[[], None]] = []
        self._accelerator: Accelerator | None = None
        self.threads: int | None = scene.num_threads
        self._state: Any = None
        self._current = 0, scene
        self._paused = threading.Event()
        self._paused.set()
        self._stopped = False
        self._player: threading.Thread | None = None
        self._switching = threading.Lock()
        self.refresh()

    @property
    def current(self) -> tuple[int, Scene]:
        """The newest version and its scene. Never waits for a change that is under way."""
        return self._current

    @property
    def build_seconds(self) -> float:
        """Seconds that the build of the tree took that is shown."""
        stats = getattr(self.current[1].tree, "stats", None)
        return self._measured if stats is None else sum(stats.seconds.values())

    def listen(self, listener: Callable[[], None]) -> None:
        """Calls `listener` after each new version."""
        with self._listening:
            self._listeners.append(listener)

    def forget(self, listener: Callable[[], None]) -> None:
        """Calls `listener` no more."""
        with self._listening:
            if listener in self._listeners:
                self._listeners.remove(listener)

    def refresh(self, force: bool = False) -> None:
        """Makes a version of the scene as it is now, if it has changed."""
        with self._lock:
            if self.scene.state is self._state and not force:
                return
            self._show(self._tree_of(self._accelerator), self._accelerator)
        self._tell()

    def _tell(self) -> None:
        with self._listening:
            listeners = [*self._listeners]
        for listener in listeners:
            listener()

    def _tree_of(self, accelerator: Accelerator | None) -> Scene:
        """The scene as it is now, with a tree of this description; None for its own."""
        start = perf_counter()
        if accelerator is None:
            shown = copy(self.scene)
        else:
            geometry = self.scene.instances or self.scene.meshes
            shown = Scene(
                [*geometry],
                accelerator,
                triangle_test=self.scene.triangle_test,
                device=self.scene.device,
                num_threads=self.threads,
            )
        self._measured = perf_counter() - start
        return shown

    def _show(self, shown: Scene, accelerator: Accelerator | None) -> None:
        if shown.num_threads is not None:
            shown.num_threads = None  # `threads` decides
        self._accelerator, self._state = accelerator, self.scene.state
        self._current = self._current[0] + 1, shown

    def rebuild(self, accelerator: str | Accelerator | None) -> None:
        """Shows the scene through another tree; None for its own.

        Raises:
            TypeError, ValueError: as in `wrt.Scene`. The tree that is shown then stays.
        """
        chosen = None if accelerator is None else resolve_accelerator(accelerator)
        with self._lock:
            self._show(self._tree_of(chosen), chosen)
        self._tell()

    @property
    def accelerator(self) -> Accelerator:
        """The description of the tree that is shown."""
        return self.current[1].accelerator

    def set_threads(self, count: int | None) -> None:
        """Number of threads for pictures; None for all.

        Raises:
            TypeError, ValueError: not a whole number from 1 to 1024.
        """
        with self._lock:
            self.threads = None if count is None else check_num_threads(count, "threads")
            self._current = self._current[0] + 1, self._current[1]
        self._tell()

    def move(self, index: int, transform: np.ndarray) -> None:
        """Moves an instance; errors as in `wrt.Scene.update`."""
        self._change(lambda: self.scene.update(index, transform=transform))

    def show_frame(self, frame: int) -> None:
        """Shows a frame of the animation.

        Raises:
            ValueError: there is none.
        """
        if not 0 <= frame < self.frames:
            raise ValueError(f"frame is {frame}; the animation has {self.frames} frames")

        def show() -> None:
            self._animate(self.scene, frame)
            self.frame = frame

        self._change(show)

    def _change(self, change: Callable[[], None]) -> None:
        start = perf_counter()
        with self._lock:
            change()
            self.refresh()
            self.update_seconds = perf_counter() - start

    def play(
        self,
        rate: float,
        shown: Callable[[], None] = lambda: None,
        failed: Callable[[Exception], None] = lambda error: None,
    ) -> None:
        """Shows frame after frame, from the first again after the last, until `pause` or an error.

        Args:
            rate: most frames a second.
            shown: called after each frame.
            failed: called with the error of a frame, which ends the animation.

        Raises:
            ValueError: there is no animation, or `rate` is not above 0.
        """
        if self.frames == 0:
            raise ValueError("there is no animation; give animate= and frames=, or a wrt.moving.FuzzyScene")
        if not rate > 0.0:
            raise ValueError(f"rate is {rate}; it must be above 0")
        with self._switching:
            self._end()
            self._paused.clear()
            self._player = threading.Thread(target=self._play, args=(rate, shown, failed), name="wrt-animation", daemon=True)
            self._player.start()

    def _play(self, rate: float, shown: Callable[[], None], failed: Callable[[Exception], None]) -> None:
        while not (self._paused.is_set() or self._stopped):
            start = perf_counter()
            try:
                self.show_frame((self.frame + 1) % self.frames)
            except Exception as error:  # of the caller's function
                self._paused.set()
                failed(error)
                return
            shown()
            self._paused.wait(max(0.0, start + 1.0 / rate - perf_counter()))

    @property
    def is_playing(self) -> bool:
        """Whether the animation plays."""
        return not self._paused.is_set()

    def pause(self) -> None:
        """Stops the animation at the frame that is shown."""
        if self._player is threading.current_thread():  # it ends by itself
            self._paused.set()
            return
        with self._switching:
            self._end()

    def stop(self, timeout: float) -> None:
        """Ends the animation for good; waits for the frame under way, at most this many seconds."""
        self._stopped = True
        self._paused.set()
        player = self._player
        if player is not None and player is not threading.current_thread():
            player.join(timeout)

    def _end(self) -> None:
        self._paused.set()
        if self._player is not None:
            self._player.join()
            self._player = None
