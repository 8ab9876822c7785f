"""The life of a session, as states; one lock guards them, and `Life.move` is the only way from one to another.

What each state means:

    ARRIVED    a browser is there; nothing runs for it yet.
    WATCHING   its thread makes pictures.
    LEAVING    the browser has gone, the viewer closes, or the thread has failed: what is under way ends.
    LEFT       nothing runs, and nothing is held. The end.
"""

from __future__ import annotations

import threading
from enum import Enum

__all__ = ["Life", "SessionState"]


class SessionState(Enum):
    """Where a session is in its life."""

    ARRIVED = "arrived"
    WATCHING = "watching"
    LEAVING = "leaving"
    LEFT = "left"


NEXT = {
    SessionState.ARRIVED: (SessionState.WATCHING, SessionState.LEFT),
    SessionState.WATCHING: (SessionState.LEAVING,),
    SessionState.LEAVING: (SessionState.LEFT,),
    SessionState.LEFT: (),
}
"""The states that may follow each."""


class Life:
    """The state of a session; any thread may ask and move."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._state = SessionState.ARRIVED

    @property
    def state(self) -> SessionState:
        """The state now."""
        with self._changed:
            return self._state

    @property
    def is_over(self) -> bool:
        """Whether no picture is wanted any more."""
        return self.state in (SessionState.LEAVING, SessionState.LEFT)

    def move(self, before: SessionState, after: SessionState) -> bool:
        """Goes from one state to another; does nothing, and returns False, if the state is not `before`.

        Of several threads that try the same, one succeeds.

        Raises:
            ValueError: `after` never follows `before`.
        """
        if after not in NEXT[before]:
            raise ValueError(f"no session goes from {before.value} to {after.value}")
        with self._changed:
            if self._state is not before:
                return False
            self._state = after
            self._changed.notify_all()
            return True

    def wait(self, state: SessionState, timeout: float) -> bool:
        """Waits until a state is entered, at most this many seconds; returns whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self._state is state, timeout)
