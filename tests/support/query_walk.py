"""What one call of a query passes: calls of functions of wrt, and hand-overs of the origins from one file to another.

A hand-over is a call whose arguments, or a return whose value, hold the caller's array: itself, an array in its memory, or an
object that has such an array in its fields, up to four objects deep. Calls and returns inside a file are none, nor are those
between the caller and wrt. A climb is a hand-over to a room on a higher floor (`import_graph.floors`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from support import import_graph

DEPTH = 4
"""Objects inside one another that are searched for the array."""

NO_CARRIERS = ("MeshState", "InstancedState", "Scene", "QueryCache", "ChosenPlan", "Device", "Kernel")
"""Names of classes that hold no rays, and much else."""


class Walk(NamedTuple):
    """What a call passed.

    Attributes:
        calls: functions of wrt that were called.
        hand_overs: (from, to), names of modules, in order.
    """

    calls: int
    hand_overs: list[tuple[str, str]]

    @property
    def climbs(self) -> list[tuple[str, str]]:
        """Hand-overs to a room on a higher floor."""
        floor, room = import_graph.floors(import_graph.room_imports()), import_graph.room_of
        return [(one, other) for one, other in self.hand_overs if floor[room(other)] > floor[room(one)]]


def walk(query: Callable[..., Any], origins: np.ndarray, directions: np.ndarray) -> Walk:
    """Asks a query, and notes what it passes."""
    address, calls, hand_overs = origins.__array_interface__["data"][0], 0, []

    def note(frame: FrameType, event: str, value: Any) -> None:
        nonlocal calls
        name = _module(frame)
        if event not in ("call", "return") or name is None:
            return
        sys.setprofile(None)
        below = frame.f_back
        while below is not None and _module(below) is None and below.f_code is not walk.__code__:
            below = below.f_back
        caller = None if below is None else _module(below)
        calls += event == "call"
        code = frame.f_code
        count = code.co_argcount + code.co_kwonlyargcount + bool(code.co_flags & 4) + bool(code.co_flags & 8)
        passed = [frame.f_locals.get(key) for key in code.co_varnames[:count]] if event == "call" else [value]
        if caller not in (None, name) and any(_holds(one, address, DEPTH) for one in passed):
            hand_overs.append((caller, name) if event == "call" else (name, caller))
        sys.setprofile(note)

    sys.setprofile(note)
    try:
        query(origins, directions)
    finally:
        sys.setprofile(None)
    return Walk(calls, hand_overs)


def _module(frame: FrameType) -> str | None:
    """Name of the module of wrt that a frame is in; None for others."""
    name = frame.f_globals.get("__name__", "")
    return name if name.startswith("wrt.") else None


def _holds(value: Any, address: int, depth: int) -> bool:
    """Whether a value holds an array that begins at an address."""
    if isinstance(value, np.ndarray):
        return value.__array_interface__["data"][0] == address
    if getattr(value, "ptr", None) == address:
        return True
    if depth == 0 or isinstance(value, (str, bytes, int, float, type)) or type(value).__name__ in NO_CARRIERS:
        return False
    if isinstance(value, (tuple, list)):
        inner = [*value]
    else:
        slots = [name for base in type(value).__mro__ for name in getattr(base, "__slots__", ())]
        inner = [*getattr(value, "__dict__", {}).values(), *(getattr(value, name, None) for name in slots)]
    return any(_holds(one, address, depth - 1) for one in inner)
