"""Published methods that are kept for measurements. Nothing here is chosen by "auto".

`FanScene` has leaves of triangle fans. Its hits differ from those of `wrt.Scene` at edges, and it does not answer all queries.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "FanScene": "wrt.classics.fan_scene",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
