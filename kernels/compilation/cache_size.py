"""Size of the L2 cache of a core."""

from functools import cache
from pathlib import Path

CACHES = Path("/sys/devices/system/cpu/cpu0/cache")
"""Where Linux describes the caches of the first core."""

USUAL_L2 = 1 << 20
"""Size that is assumed where the system does not say: that of most current cores, 1 MiB."""

UNITS = {"K": 1 << 10, "M": 1 << 20}


@cache
def l2_bytes(caches: Path = CACHES) -> int:
    """Bytes of the L2 cache of the first core; `USUAL_L2` where the system does not say. Cached."""
    try:
        for index in sorted(caches.glob("index*")):
            if (index / "level").read_text().strip() == "2":
                text = (index / "size").read_text().strip()
                size = int(text[:-1]) * UNITS[text[-1]] if text[-1:] in UNITS else int(text)
                return size if size > 0 else USUAL_L2
    except (OSError, ValueError):
        pass
    return USUAL_L2
