"""Helper threads that stay on their core while they sleep, for virtual machines.

**Problem.** Where virtual cores have been idle for some milliseconds, Linux was seen to put a thread that wakes on the core of
the thread that woke it, while others are idle. Both then share that core for longer than most jobs take: a query after a pause,
as in an interactive program, takes as long as with one thread.

**Idea.** A helper that goes to sleep restricts itself to the core on which it is, so it wakes there. No two sleepers have the
same one. Once awake a helper may run wherever it could before. If its cores are not those it has chosen, somebody else has
restricted it, and that remains.

**Moving sleepers.** A thread that wakes helpers may itself have come to a sleeper's core, where the sleeper would have to wait
for it. So it first moves that sleeper to its other cores. Meanwhile the sleeper's state is locked, so if it wakes it sees
whether it was moved.

**Limits.** For virtual machines of up to `MAX_CORES` cores: on 16 it gained nothing, and it is not for cores of the machine
itself, among which the system chooses well. A helper whose core is taken by another program starts late; its job then goes on
without it.

The code is in kernels/native/core_pinning.h: `pin` and `unpin` for sleepers, `move_sleepers_away` for those who wake them.

Figures: notebooks/records/2026-11-23-sleeping-helpers.md and 2026-11-24-making-way.md.
"""

MAX_CORES = 4
"""Greatest number of cores with which helpers stay. Measured with 2, where it helps, and with 16, where it does not."""

SLEEPER_WORDS, MAX_SLEEPERS = 2, 64
"""64-bit words of a sleeper in the job queue, and the greatest number of helpers that stay. A word with all their cores
follows."""
