"""Sizes of the caches of a core."""

from functools import cache
from pathlib import Path

CACHES = Path("/sys/devices/system/cpu/cpu0/cache")
"""Where Linux describes the caches of the first core."""

USUAL_L2, USUAL_L3 = 1 << 20, 1 << 25
"""Sizes that are assumed where the system does not say: those of most current CPUs, 1 MiB and 32 MiB."""

UNITS = {"K": 1 << 10, "M": 1 << 20}


@cache
def l2_bytes(caches: Path = CACHES) -> int:
    """Bytes of the L2 cache of the first core; `USUAL_L2` where the system does not say. Cached."""
    return cache_bytes("2", caches) or USUAL_L2


@cache
def l3_bytes(caches: Path = CACHES) -> int:
    """Bytes of the L3 cache that the first core shares with others; `USUAL_L3` where the system does not say. Cached."""
    return cache_bytes("3", caches) or USUAL_L3


def cache_bytes(level: str, caches: Path) -> int:
    """Bytes of a cache of the first core; 0 where the system does not say."""
    try:
        for index in sorted(caches.glob("index*")):
            if (index / "level").read_text().strip() == level:
                text = (index / "size").read_text().strip()
                return max(int(text[:-1]) * UNITS[text[-1]] if text[-1:] in UNITS else int(text), 0)
    except (OSError, ValueError):
        pass
    return 0
