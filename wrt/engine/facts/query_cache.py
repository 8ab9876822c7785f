"""What queries learn about a scene and keep for the next ones: plans, prepared queries, triangle records, a wide tree.

A scene's state never changes (`wrt.engine.facts.scene_state`); this cache beside it does. It has a lock of its own. Prepared
queries are kept with their plan (`wrt.engine.plan.plan.ChosenPlan`). Each serves one caller at a time: it is taken out and put
back, and as many are made as callers run at once.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Hashable
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from wrt.engine.free_list import FreeList

if TYPE_CHECKING:
    from wrt.kernels.triangle.support.record_blocks import Record, TriangleBlocks

MAX_PLANS = 64
"""Plans that a cache holds; one more clears them, and the queries prepared for them."""

MAX_CHOICES = 256
"""Choices that a cache holds; one more clears them."""

Origin = tuple[float, float, float]
"""A point relative to the scene's centre."""

KnownRecords = dict[tuple[str, "Record"], tuple["Origin | None", "TriangleBlocks"]]
"""Blocks by kind of tree and of record, with the origin that they were made for, if they depend on one."""

_caches: WeakSet[QueryCache] = WeakSet()


class QueryCache:
    """Plans, prepared queries, triangle records and the wide form of one scene state.

    Attributes:
        lock: guards what is not one operation on a dict or a deque.
        records: triangle records by kind of tree and record (`wrt.engine.launch.triangle_records`).
        wide: a `wrt.engine.facts.wide_trees.WideForm`, the wide form of a kd-tree; None as long as there is none.
        binary: the nodes and triangles that `wrt.engine.launch.persistent_launch` makes of a tree of width 2; None as long as
            nobody asked.
        missed_savings: what rays so far would have saved with a wide form, in triangles that it could be made of.
        calls: what usual calls on CUDA have in common, by kind of query and bounds of t (`wrt.engine.launch.device_calls`).
        tables: what kernels read of instanced meshes, by kind of tree and triangle test; a tree above its queue points, by
            kind of triangle record.
        choices: a `wrt.engine.plan.choices.Choice` and how often it will be used, by query and rays; read without a lock.
        learned: a `wrt.engine.plan.learner.Learner` by class of queries and rays; updates keep them.
        few_points: launches that are prepared for closest points to few points and wait for a caller
            (`wrt.query.points.few_points`).
        point_searches: those for closest points to many on CUDA (`wrt.query.points.kept_search`), by the type of points.
        distinct: what `SceneState.distinct` has found, one state or none; None as long as nobody asked.
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.records: KnownRecords = {}
        self.wide: Any = None
        self.binary: tuple[Any, Any] | None = None
        self.missed_savings = 0.0
        self.calls: dict[Hashable, Any] = {}
        self.tables: dict[tuple[str, str], Any] = {}
        self.few_points: deque[Any] = deque()
        self.point_searches: FreeList[Any] = FreeList()
        self.distinct: tuple[Any, ...] | None = None
        self.choices: dict[Hashable, list[Any]] = {}
        self.learned: dict[Hashable, Any] = {}
        self._plans: dict[Hashable, Any] = {}
        _caches.add(self)

    @property
    def plans(self) -> list[Any]:
        """All plans, each with the queries that are prepared for it."""
        with self.lock:
            return [*self._plans.values()]

    def plan(self, key: Hashable) -> Any | None:
        """The `wrt.engine.plan.plan.ChosenPlan` of a key; None if there is none."""
        return self._plans.get(key)

    def keep_plan(self, key: Hashable, plan: Any) -> Any:
        """Keeps a plan for the next queries of its key, and returns it."""
        with self.lock:
            if len(self._plans) >= MAX_PLANS:
                self._plans.clear()
                self.choices.clear()
                self.calls.clear()
            self._plans[key] = plan
        return plan

    def keep_choice(self, key: Hashable, choice: Any, uses: float = float("inf")) -> Any:
        """Caches a choice for a limited number of uses, and returns it. Batches of many shapes share few plans, so these are
        kept apart."""
        with self.lock:
            if len(self.choices) >= MAX_CHOICES:
                self.choices.clear()
            self.choices[key] = [choice, uses]
        return choice

    def of_moved(self) -> QueryCache:
        """A cache for the same trees elsewhere: with this one's plans, prepared queries (`PreparedQuery.fit`) and tables."""
        other = QueryCache()
        with self.lock:
            other._plans.update(self._plans)
            other.choices.update((key, kept[:]) for key, kept in self.choices.items())
        other.tables.update(self.tables)
        other.learned = self.learned
        return other

    def of_updated(self) -> QueryCache:
        """A cache for other trees of nearly the same scene: with what was learned of its queries."""
        other = QueryCache()
        other.learned = self.learned
        return other

    def clear(self) -> None:
        """Drops plans, the queries that are prepared for them, and what was chosen."""
        with self.lock:
            self._plans.clear()
            self.choices.clear()
            self.calls.clear()


def _renew_locks() -> None:
    """A lock that another thread held while the process was forked would never be released in the child."""
    for cache in _caches:
        cache.lock = threading.RLock()
        for learner in cache.learned.values():
            learner.renew_lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_locks)
