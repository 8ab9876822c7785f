"""Updates in the background: the next frame's tree is built while rays are traced through the present one.

Yang et al. (2008) dedicate some threads to building and let the others trace the previous tree until the new one is
finished; frames switch trees between them. Here a copy of the scene is updated in a thread of its own, and the tracing
thread takes over the result in one step.

References: yang-2008 (as described by rahikainen-2013).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from threading import Thread
from typing import Any, Protocol

from wrt.kernels.runtime.launch import check_num_threads, get_num_threads


class Updatable(Protocol):
    """A `wrt.Scene`, as far as it is needed here."""

    num_threads: int | None
    state: Any

    def update(self, *args: Any, **options: Any) -> None:
        """Replaces the state."""


@contextmanager
def updating(scene: Updatable, threads: int, args: tuple[Any, ...], options: dict[str, Any]) -> Iterator[None]:
    """See `Scene.updating`."""
    own = scene.num_threads
    total = get_num_threads() if own is None else own
    building = min(check_num_threads(threads, "threads"), max(total - 1, 1))
    following = copy(scene)
    following.num_threads = building
    problems: list[BaseException] = []

    def build() -> None:
        try:
            following.update(*args, **options)
        except BaseException as problem:
            problems.append(problem)

    builder = Thread(target=build, name="wrt-update")
    builder.start()
    scene.num_threads = max(total - building, 1)
    try:
        yield
    finally:
        builder.join()
        scene.num_threads = own
    if problems:
        raise problems[0]
    following.num_threads = own
    scene.state = following.state
