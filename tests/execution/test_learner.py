"""What is learned from the times of calls, on made-up clocks: rates that stay, jump, drift, are noisy or equal."""

from __future__ import annotations

import faulthandler
import signal
import threading
from collections.abc import Callable

import numpy as np
import pytest

from wrt.engine.plan.learner import AGED_SHARE, CHANGED_SHARE, FEWEST_CALLS, FIRST_SECONDS, TURNS, Learner

RAYS = 10_000
Rates = Callable[[str, int], float]
"""Seconds of a call of `RAYS` rays by a way, by the number of the call."""


class Calls:
    """Calls of a learner whose ways take what a function says."""

    def __init__(self, learner: Learner, rates: Rates, ways: tuple[str, ...] = ("a", "b", "c")) -> None:
        self.learner, self.rates, self.ways = learner, rates, ways
        self.taken: list[str] = []
        self.seconds = self.best_seconds = 0.0

    def make(self, count: int) -> list[str]:
        """Makes calls; the ways that they took."""
        for _ in range(count):
            number = len(self.taken)
            way = self.learner.turn(self.ways)
            took = self.rates(way, number)
            self.learner.tell(way, RAYS, took)
            self.taken.append(way)
            self.seconds += took
            self.best_seconds += min(self.rates(one, number) for one in self.ways)
        return self.taken[-count:]


def fixed(**seconds: float) -> Rates:
    """Rates that stay."""
    return lambda way, number: seconds[way]


def test_the_best_way_is_found_in_one_trial():
    calls = Calls(Learner("b"), fixed(a=0.010, b=0.013, c=0.015))
    calls.make(1 + 3 * TURNS + 4)
    assert calls.learner.trials == 1
    assert set(calls.make(20)) == {"a"}
    assert calls.learner.rates == pytest.approx({"a": 1e-6, "b": 1.3e-6, "c": 1.5e-6})
    assert calls.learner.lost == pytest.approx((TURNS + 2) * 0.003 + TURNS * 0.005)


def test_quick_calls_are_left_to_the_guess():
    """Until they have taken as long together as a trial can save."""
    calls = Calls(Learner("b"), fixed(a=1e-5, b=2e-5, c=2e-5))
    assert set(calls.make(int(FIRST_SECONDS / 2e-5))) == {"b"}


def test_one_way_is_never_compared():
    calls = Calls(Learner("b"), fixed(b=1.0), ways=("b",))
    assert set(calls.make(50)) == {"b"}
    assert calls.learner.trials == 0


def test_a_way_may_join_later():
    calls = Calls(Learner("b"), fixed(a=0.01, b=0.02), ways=("b",))
    calls.make(5)
    calls.ways = ("b", "a")
    calls.make(2 * TURNS + 4)
    assert set(calls.make(10)) == {"a"}


def test_a_hopeless_way_has_one_turn():
    calls = Calls(Learner("a"), fixed(a=0.01, b=0.012, c=0.05))
    taken = calls.make(30)
    assert taken.count("c") == 1
    assert taken.count("b") == TURNS


def test_ties_stay_with_the_guess():
    """Another way must be faster by more than noise."""
    calls = Calls(Learner("b"), fixed(a=0.0099, b=0.01, c=0.01))
    calls.make(2000)
    assert calls.learner.best == "b"
    assert calls.learner.trials > 1


def test_trials_age():
    """While nothing changes, trials cost a small share of the time."""
    calls = Calls(Learner("a"), fixed(a=0.010, b=0.013, c=0.016))
    calls.make(5000)
    assert calls.learner.trials >= 4
    assert calls.seconds <= (1.0 + 1.2 * AGED_SHARE) * calls.best_seconds


def test_equal_ways_are_not_compared_all_the_time():
    calls = Calls(Learner("a"), fixed(a=0.01, b=0.01, c=0.01))
    calls.make(10 * FEWEST_CALLS)
    assert calls.learner.trials <= 10


@pytest.mark.parametrize("after", [0.025, 0.006])
def test_a_jump_is_noticed(after):
    """The best way becomes slower or faster at once, and another one is best: within a few calls, not within an age."""
    calls = Calls(
        Learner("a"),
        lambda way, number: {"a": 0.01 if number < 200 else after, "b": 0.012 if number < 200 else 0.5 * after, "c": 0.02}[way],
    )
    calls.make(200)
    assert calls.learner.best == "a"
    calls.make(20)
    assert calls.learner.best == "b"


def test_a_jump_that_the_rate_does_not_show_is_noticed_in_time():
    """The best way takes as long as before, but another one is faster now: the next trial by age finds it."""
    calls = Calls(Learner("a"), lambda way, number: {"a": 0.01, "b": 0.012 if number < 100 else 0.006}[way], ways=("a", "b"))
    calls.make(100)
    assert calls.learner.best == "a"
    calls.make(150)
    assert calls.learner.best == "b"


def test_a_jump_that_the_caller_tells_is_noticed_at_once():
    calls = Calls(Learner("a"), lambda way, number: {"a": 0.01, "b": 0.012 if number < 100 else 0.006}[way], ways=("a", "b"))
    calls.make(100)
    calls.learner.changed()
    calls.make(2 * TURNS + 5)
    assert calls.learner.best == "b"


def test_a_trial_that_was_left_is_made_anew():
    """Its turns had other rays: none of them counts."""
    calls = Calls(Learner("a"), fixed(a=0.01, b=0.012, c=0.02))
    calls.make(3)
    assert calls.learner.is_trying
    calls.learner.leave_trial()
    assert not calls.learner.is_trying
    assert calls.make(3) == ["a", "b", "c"]
    assert calls.learner.trials == 0


def test_looks_have_a_share():
    """A look at other rays is worth its time once calls have taken much longer."""
    learner = Learner("a")
    assert learner.may_look()
    learner.changed(0.001)
    assert not learner.may_look()
    learner.tell("a", RAYS, 0.1)
    assert learner.may_look()


def test_a_forked_child_has_a_new_lock():
    learner = Learner("a")
    learner._lock.acquire()
    learner.renew_lock()
    learner.tell("a", RAYS, 0.1)
    assert learner.spent == 0.1


def test_another_guess_is_followed_at_once():
    calls = Calls(Learner("a"), fixed(a=0.01, b=0.02, c=0.02))
    calls.make(100)
    calls.learner.guessed("a")
    assert set(calls.make(5)) == {"a"}
    calls.learner.guessed("c")
    assert calls.make(1) == ["c"]
    assert set(calls.make(40)[-20:]) == {"a"}, "and a trial corrects it"


def test_drift_is_followed():
    """The best way becomes slower by a thousandth a call: it is replaced when another one is faster."""
    calls = Calls(Learner("a"), lambda way, number: {"a": 0.01 * 1.001**number, "b": 0.013, "c": 0.03}[way])
    calls.make(600)
    assert calls.learner.best == "b"
    assert calls.seconds <= 1.08 * calls.best_seconds


@pytest.mark.parametrize("seed", range(5))
def test_noise(seed):
    """Other programs make a third of the calls longer, some of them tenfold; the time is nearly that of the best way."""
    rng = np.random.default_rng(seed)
    noise = np.where(rng.random(3000) < 0.33, 1.0 + rng.exponential(0.5, 3000), 1.0) * np.where(
        rng.random(3000) < 0.02, 10.0, 1.0
    )
    least = {"a": 0.013, "b": 0.010, "c": 0.0155}
    calls = Calls(Learner("a"), lambda way, number: least[way] * noise[number])
    calls.make(3000)
    assert calls.taken[-1000:].count("b") > 900
    assert calls.seconds <= 1.06 * calls.best_seconds


def test_trials_of_a_changing_scene_are_bounded():
    """Rates change again and again; trials take no more than their share."""
    calls = Calls(Learner("a"), lambda way, number: {"a": 0.01, "b": 0.013, "c": 0.018}[way] * (1.0 + number // 10 % 2))
    calls.make(3000)
    assert calls.learner.best == "a"
    assert calls.learner.lost <= 2.0 * CHANGED_SHARE * calls.learner.spent


def test_a_trial_that_was_made_in_parts():
    learner = Learner("a")
    learner.tell("a", RAYS, 0.1)
    assert learner.is_due(("a", "b"))
    learner.conclude({"a": 2e-6, "b": 1e-6}, 0.01)
    assert learner.best == "b"
    assert not learner.is_due(("a", "b"))
    assert (learner.trials, learner.lost) == (1, 0.01)


def test_a_change_is_told_once():
    learner = Learner("a")
    for seconds in (0.001, 0.001, 0.002, 0.002, 0.002):
        learner.tell("a", RAYS, seconds)
    assert learner.takes_change()
    assert not learner.takes_change()


def test_threads():
    """Several threads take turns at once; nothing is lost."""
    learner, calls, errors = Learner("b"), 400, []
    seconds = {"a": 0.010, "b": 0.013, "c": 0.015}

    def run() -> None:
        try:
            for _ in range(calls):
                way = learner.turn(("a", "b", "c"))
                learner.tell(way, RAYS, seconds[way])
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=run) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert learner.best == "a"
    assert 8 * calls * 0.010 <= learner.spent <= 8 * calls * 0.015


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="Windows has no such signals")
def test_signal_handlers_do_not_wait_for_what_they_interrupt():
    """A handler that asks and tells, in the midst of a call of its own thread: that one goes on as if nothing had happened."""
    learner, answers = Learner("a"), []

    def interrupted(names):
        for name in names:
            signal.raise_signal(signal.SIGALRM)
            yield name

    def handler(*_):
        answers.append(learner.turn(["a", "b"]))
        learner.tell("a", 1, 1.0)
        learner.conclude({"b": 1.0})
        learner.changed(1.0)
        answers.append(learner.is_due(["a", "b"]) or learner.takes_change())

    learner.tell("a", 1000, 1.0)
    before = signal.signal(signal.SIGALRM, handler)
    faulthandler.dump_traceback_later(30, exit=True)  # in place of waiting for ever
    try:
        assert learner.turn(interrupted("ab")) == "a"
        assert learner.is_trying
        assert answers == ["a", None, "a", None]
        assert not learner.is_due(interrupted("ab"))
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGALRM, before)
    assert (learner.spent, learner.looked, learner.trials) == (1.0, 0.0, 0)
    learner.tell("a", 1000, 1.0)
    assert learner.spent == 2.0
