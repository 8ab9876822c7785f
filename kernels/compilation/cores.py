"""Number of cores that this process may use: its affinity mask, and the CPU quota of its control group."""

import math
import os
from functools import cache
from pathlib import Path

CGROUPS = Path("/sys/fs/cgroup")
"""Mount point of the control groups."""


def available_cores() -> int:
    """Number of cores that this process may use, at least 1.

    This is the lesser of the cores in the affinity mask (`taskset`, a batch system) and the CPU quota of the control group
    (`docker --cpus`, Kubernetes limits), rounded up. Threads beyond a quota would be suspended by the scheduler while they hold
    work.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, math.ceil(min(cores, cpu_quota())))


@cache
def cpu_quota(process: Path = Path("/proc/self/cgroup"), groups: Path = CGROUPS) -> float:
    """CPU time per unit of time that the process's control groups allow: 1.5 is a core and a half; inf without a limit. Cached.

    Version 2 stores the limits of a group and of its ancestors in `cpu.max`, version 1 in `cpu.cfs_quota_us`.
    """
    try:
        lines = process.read_text().splitlines()
    except OSError:
        return math.inf
    quota = math.inf
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        root = groups if not controllers else groups / "cpu"
        group = root / path.lstrip("/")
        for folder in (group, *group.parents):
            quota = min(quota, _quota_of(folder))
            if folder == root:
                break
        quota = min(quota, _quota_of(root))  # in a container the path above may be that of the host
    return quota


def _quota_of(group: Path) -> float:
    try:
        if (group / "cpu.max").exists():
            quota, period = (group / "cpu.max").read_text().split()
        else:
            quota, period = (group / "cpu.cfs_quota_us").read_text(), (group / "cpu.cfs_period_us").read_text()
        limit = float(quota) / float(period)
    except (OSError, ValueError, ZeroDivisionError):  # no such file, or "max"
        return math.inf
    return limit if limit > 0 else math.inf
