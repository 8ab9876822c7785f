# Written by `python -m tests.typed.stubs` from the table of names in wrt/results.py.
from wrt.planning.plan import Plan as Plan
from wrt.query.verification import Verification as Verification

__all__ = [
    "Plan",
    "Verification",
]
