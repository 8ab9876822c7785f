"""The clock for comparing calls of kernels on the CPU."""

import time
from collections.abc import Callable

from wrt.kernels.runtime.launch import get_num_threads

FINE = 1e-5
"""Seconds: a coarser clock cannot time calls."""

_thread_clock = time.thread_time if time.get_clock_info("thread_time").resolution <= FINE else time.perf_counter


def call_clock() -> Callable[[], float]:
    """A clock in seconds, for calls with the number of threads that the caller has now.

    A call on one thread is timed by the CPU time of the thread, in which other programs take no part.
    """
    return _thread_clock if get_num_threads() == 1 else time.perf_counter
