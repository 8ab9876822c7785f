"""What methods return, beside `wrt.Hits` and `wrt.AllHits`. Users read these classes, and do not make them."""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "Plan": "wrt.planning.plan",
    "Verification": "wrt.query.verification",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
