"""Short runs timed on one thread by its processor time, which others on the machine do not disturb."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import thread_time
from typing import Any

import numpy as np

from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.kernels.runtime.launch import use_threads

SETTLE = 0.02
"""Calls shorter than this many seconds are preceded by an untimed one."""


def timed(runs: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, Timing]:
    """Contenders in turn, on one thread, by its processor time."""
    with use_threads(1):
        return take_turns([Contender(name, run) for name, run in runs.items()], rounds, settle=SETTLE, clock=thread_time)


def ratios(timing: Timing, reference: Timing) -> dict[str, float]:
    """Median seconds, and time / the reference's time: median, least and greatest of the rounds."""
    quotients = [own / other for own, other in zip(timing.times, reference.times, strict=True)]
    return {
        "seconds": timing.median,
        "ratio": float(np.median(quotients)),
        "least": min(quotients),
        "greatest": max(quotients),
    }
