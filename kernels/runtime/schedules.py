"""Schedules: how the items of a launch are divided among threads.

A schedule decides which chunk of items a thread takes next. Results do not depend on it. The table has the methods that
Rahikainen (2013, chapter 5) describes, and work stealing. The default is "guided"; the others are for comparison (`wrt bench
scheduling`; notebooks/records/2026-11-22-scaling.md).

References:
    C. D. Polychronopoulos, D. J. Kuck: Guided self-scheduling: a practical scheduling scheme for parallel supercomputers. IEEE
        Transactions on Computers C-36(12), 1987.
    S. Parker, W. Martin, P.-P. J. Sloan, P. Shirley, B. Smits, C. Hansen: Interactive ray tracing. Symposium on Interactive 3D
        Graphics, 1999.
    M. Nunes, L. P. Santos: Workload distribution for ray tracing in multi-core systems. Encontro Portugues de Computacao
        Grafica, 2009.
    R. D. Blumofe, C. E. Leiserson: Scheduling multithreaded computations by work stealing. Journal of the ACM 46(5), 1999.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (chapter 5).
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
