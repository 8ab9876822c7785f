"""What a scene keeps ready for its next queries, each for one thread at a time: as many are made as threads ask at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any

from wrt.kernels.runtime.launch import use_threads

if TYPE_CHECKING:
    from wrt.scene.scene import Scene

MOST_KEYS = 64
"""Kinds of queries that a scene keeps something ready for; with one more, all begin anew."""


def take(scene: Scene, key: Hashable, make: Callable[[], Any]) -> tuple[Any, deque[Any]]:
    """What is kept under a key, for the caller alone, and where to put it back; made if nothing is free that still suits."""
    if key not in scene.desks and len(scene.desks) >= MOST_KEYS:
        scene.desks.clear()  # what other threads hold meanwhile goes with them
    waiting = scene.desks.setdefault(key, deque())
    try:
        ready = waiting.pop()
    except IndexError:
        ready = None
    if ready is None or not ready.suits(scene):
        with use_threads(scene.num_threads):
            ready = make()
    return ready, waiting
