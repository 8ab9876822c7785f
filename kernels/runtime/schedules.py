"""Schedules: how the items of a launch are divided among threads.

A schedule decides which chunk of items a thread takes next. Results do not depend on it. The table has the methods that
Rahikainen (2013, chapter 5) describes, and work stealing. The default is "guided"; the others are for comparison (`wrt bench
scheduling`; notebooks/records/2026-11-22-scaling.md).

References: polychronopoulos-kuck-1987; parker-1999; nunes-santos-2009; blumofe-leiserson-1999; rahikainen-2013 (chapter 5).
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Schedule:
    """An entry of `SCHEDULES`.

    Attributes:
        name: its key.
        code: its number in native code (`wrt.kernels.runtime.job_queue`).
        queues: whether each thread has its own queue.
        summary: one sentence.
        source: authors and year.
    """

    name: str
    code: int
    queues: bool
    summary: str
    source: str


SCHEDULES = {
    schedule.name: schedule
    for schedule in (
        Schedule(
            "guided",
            0,
            False,
            "One shared counter, advanced by compare-and-swap; chunks shrink with the work that is left.",
            "Polychronopoulos and Kuck 1987; Nunes and Santos 2009",
        ),
        Schedule(
            "fixed",
            1,
            False,
            "One shared counter, advanced by fetch-and-add; all chunks are of one size.",
            "Parker et al. 1999",
        ),
        Schedule(
            "locked",
            2,
            False,
            "One shared queue behind a lock; chunks shrink with the work that is left.",
            "Parker et al. 1999",
        ),
        Schedule("round_robin", 3, True, "Chunk i belongs to thread i modulo the number of threads.", "Nunes and Santos 2009"),
        Schedule(
            "stealing",
            4,
            True,
            "Each thread has a contiguous share; a thread that is done takes chunks from the shares of others.",
            "Blumofe and Leiserson 1999",
        ),
    )
}
"""Schedules by name."""

DEFAULT_SCHEDULE = "guided"
