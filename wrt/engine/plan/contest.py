"""A contest of plans for rays of one kind and shape: which takes the next call, and what is known of each.

What is learned belongs to a class of rays (`class_of`), and lies in the scene's cache; the plans of a contest, to a shape.

A plan takes part once its kernels are loaded. While those of the rules' plan are not compiled, single rays stand in for it
(`wrt.engine.plan.stand_ins`). A thread of the pool loads those that the kernel cache has, by tracing copies of
a few rays, when the calls have taken `LOAD_SECONDS`, or at once if `wrt tune` has found another engine than the rules. Nothing
is compiled for a contest; `wrt tune` and `wrt warm` compile.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING

from wrt.engine.plan.learner import Learner
from wrt.engine.plan.planner import chosen_plan, rival_plans
from wrt.engine.plan.stand_ins import plan_for_now
from wrt.engine.plan.tuned_choices import tuned_engine
from wrt.kernels.runtime.launch import get_num_threads

if TYPE_CHECKING:
    from wrt.engine.facts.facts import RayFacts
    from wrt.engine.facts.query_kinds import Query
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import ChosenPlan, Plan
    from wrt.kernels.compilation.compile_later import MissingKernel

LOAD_SECONDS = 0.05
"""Seconds of calls before the kernels of rivals are loaded, which takes about as long for each of them."""

QUICK_SECONDS, QUICK_CALLS = 0.001, 3
"""Of calls that take less than this, so many are not timed after one that is, unless there is a trial."""

REACH = 0.02
"""Share of the scene's diagonal by which rays that start elsewhere are others."""

MICROSECONDS = 1e6


class Contest:
    """Plans for rays of one kind and shape.

    Args:
        rays: what is known of the rays.
        query: its kind and options.
        guess: the plan of the rules.
        learner: what is learned of the class.

    Attributes:
        learner: the same.
        chosen: the plans, by engine; at first the guess alone.
        left: calls that need not be timed.
        current, shown: the plan that takes them, and as callers see it: with what was measured in its reason.
        has_asked: whether kernels of rivals were loaded, or will be.
        origin: where the first ray of coherent rays starts; None before the first call.
        reach: square of the distance from there at which rays are others; infinite for incoherent rays.
        missing: the kernel that calls do without, while another plan stands in for that of the rules; None if none does.
    """

    __slots__ = (
        "_guess",
        "_has_rivals",
        "_query",
        "_rays",
        "_ruled",
        "_shown_for",
        "_untimed",
        "chosen",
        "current",
        "has_asked",
        "learner",
        "left",
        "missing",
        "origin",
        "reach",
        "shown",
    )

    def __init__(self, rays: RayFacts, query: Query, guess: ChosenPlan, learner: Learner) -> None:
        self._rays, self._query, self._guess, self._ruled, self.learner = rays, query, guess, guess, learner
        self.chosen, self.current = {guess.name: guess}, guess
        self.missing: MissingKernel | None = None
        self.left = self._untimed = 0
        self.has_asked = self._has_rivals = False
        self.origin: tuple[float, float, float] | None = None
        self.reach = 0.0
        self.shown: Plan = guess.plan
        self._shown_for: Hashable = None

    def ways(self) -> list[str]:
        """The engines that can take part."""
        return [name for name, one in self.chosen.items() if one.ready or one is self._guess]

    def best(self, scene: SceneState) -> ChosenPlan:
        """The plan for calls that nobody times."""
        if self.learner.best not in self.chosen and self.learner.trials:
            self.find_rivals(scene)
        one = self.chosen.get(self.learner.best)
        return one if one is not None and one.ready else self._guess

    def turn(self, scene: SceneState) -> ChosenPlan:
        """The plan for the next call, which will be timed."""
        if self.learner.best not in self.chosen:
            self.find_rivals(scene)
        name = self.learner.turn(self.ways())
        one = self.chosen.get(name)
        return one if one is not None and (one.ready or one is self._guess) else self._guess

    def tell(self, chosen: ChosenPlan, rays: int, seconds: float) -> None:
        """What a call took."""
        learner = self.learner
        chosen.ready = True
        learner.tell(chosen.name, rays, seconds, 1 + self._untimed)
        expected = seconds if learner.usual is None else learner.usual * rays
        is_quick = expected < QUICK_SECONDS and not learner.is_trying and learner.best == chosen.name
        if self.missing is not None and self.missing.spend((1 + self._untimed) * seconds):
            self._follow(self._ruled, self._ruled, None)
        self.left = self._untimed = QUICK_CALLS if is_quick else 0
        self.show(chosen)

    def show(self, chosen: ChosenPlan) -> None:
        """Makes a plan the current one."""
        missing = tuple(name for name, one in self.chosen.items() if one.ready is False)
        key = chosen, self.learner.trials, missing
        if self._shown_for != key:
            self.shown = replace(chosen.plan, reason=self._reason(chosen.plan.reason, missing))
        self.current, self._shown_for = chosen, key

    def place(self, scene: SceneState, origin: tuple[float, float, float]) -> bool:
        """Remembers where the first ray starts; whether rays were elsewhere before."""
        known, self.origin = self.origin, origin
        if not self._rays.coherent:
            self.reach = float("inf")
            return False
        low, high = scene.tree.low, scene.tree.high
        self.reach = REACH * REACH * sum((float(high[k]) - float(low[k])) ** 2 for k in range(3))
        return known is not None

    def renew(self, scene: SceneState, ruled: ChosenPlan) -> None:
        """Takes what the rules say now, or what stands in for it."""
        self._follow(ruled, *plan_for_now(scene, self._rays, self._query, ruled))
        self.learner.guessed(ruled.name)
        self.left = 0

    def _follow(self, ruled: ChosenPlan, guess: ChosenPlan, missing: MissingKernel | None) -> None:
        """Takes a plan of the rules, and `guess` for the calls until others are ready."""
        if guess is not self._guess:
            ended = {guess.name} if self._guess is self._ruled else {guess.name, self._guess.name}
            others = {name: one for name, one in self.chosen.items() if name not in ended}
            self._guess, self.chosen = guess, {guess.name: guess, **others}
        self._ruled, self.missing = ruled, missing

    def wants_loading(self) -> bool:
        """Whether the kernels of rivals are to be loaded now; True once."""
        is_tuned = not self.learner.trials and self.learner.best != self.learner.guess
        if self.has_asked or (self.learner.spent < LOAD_SECONDS and not is_tuned):
            return False
        self.has_asked = True
        return True

    def find_rivals(self, scene: SceneState) -> list[ChosenPlan]:
        """Adds the other plans to `chosen`; those that are not ready."""
        if not self._has_rivals:
            self._has_rivals = True
            plans = rival_plans(scene, self._rays, self._query, self._ruled.plan)
            some = [chosen_plan(scene, plan, self._rays.count, self._query.kind) for plan in plans]
            self.chosen = {**{one.name: one for one in some}, **self.chosen}
            self.learner.keep_to(self.chosen)
        return [one for one in self.chosen.values() if not one.ready and one is not self._guess]

    def _reason(self, reason: str, missing: tuple[str, ...]) -> str:
        rates = sorted((rate, name) for name, rate in self.learner.rates.items())
        text = ", ".join(f"{name} {MICROSECONDS * rate:.3g}" for rate, name in rates)
        measured = f"; measured, in microseconds a ray: {text}" if rates else ""
        return reason + measured + (f"; not compiled: {', '.join(missing)}" if missing else "")


def class_of(rays: RayFacts, query: Query) -> Hashable:
    """The class of rays and queries that learn from one another: of the same kind, within a factor of two in number."""
    about = rays.shared_origin, rays.coherent, rays.scattered, rays.columns > 0
    return query.kind, query.triangle_test, query.cull_backfaces, rays.count.bit_length(), *about, get_num_threads()


def learner_of(scene: SceneState, rays: RayFacts, query: Query, guess: str) -> Learner:
    """What is learned of a class in a scene; at first, what `wrt tune` has stored."""
    learned, key = scene.cache.learned, class_of(rays, query)
    with scene.cache.lock:
        if key not in learned:
            learned[key] = Learner(guess)
            learned[key].best = tuned_engine(scene.facts, rays, query.kind, get_num_threads()) or guess
        return learned[key]
