# Written by `python -m tests.typed.stubs` from the table of names in wrt/analysis/__init__.py.
from wrt.analysis.signed_distances import sign_rule as sign_rule
from wrt.analysis.signed_distances import signed_distance as signed_distance
from wrt.analysis.winding_numbers import winding_number as winding_number

__all__ = [
    "sign_rule",
    "signed_distance",
    "winding_number",
]
