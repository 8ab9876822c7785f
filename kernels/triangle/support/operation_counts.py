"""Floating-point operations of a ray-triangle test, counted in the text of its steps.

The steps of a `LaneForm` are straight-line C++: selects instead of branches, no loops, no calls that compute. Each written
operator is therefore executed once per lane, and the number of operators in the text is the number of operations of a test.
Tests that are written by hand declare theirs.
"""

import re
from dataclasses import dataclass

TOKEN = re.compile(r"//[^\n]*|0x[0-9a-fA-F]+u?|\d+\.?\d*(?:[eE][-+]?\d+)?f?|[A-Za-z_]\w*|<<|>>|<=|>=|==|!=|&&|\|\||\S")
"""Comments, numbers, names, operators."""

OPERAND_ENDS = re.compile(r"[\w.)\]]$")
"""End of an operand. A sign after anything else is unary and is not counted."""

KINDS = {"+": "add", "-": "add", "*": "multiply", "/": "divide", "?": "select"}
KINDS |= dict.fromkeys(("<", ">", "<=", ">=", "==", "!="), "compare")


@dataclass(frozen=True)
class Operations:
    """Numbers of operations. A change of sign does not count.

    Attributes:
        add: additions and subtractions.
        multiply: multiplications.
        divide: divisions.
        compare: comparisons.
        select: selections between two numbers.
    """

    add: int = 0
    multiply: int = 0
    divide: int = 0
    compare: int = 0
    select: int = 0

    @property
    def arithmetic(self) -> int:
        """Additions, multiplications and divisions, which are what papers count."""
        return self.add + self.multiply + self.divide

    def __add__(self, other: "Operations") -> "Operations":
        return Operations(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))


def count_operations(code: str) -> Operations:
    """Counts the operators in C++ without branches, loops and pointers."""
    counts = dict.fromkeys(Operations.__dataclass_fields__, 0)
    before = ""
    for token in TOKEN.findall(code):
        if token.startswith("//"):
            continue
        kind = KINDS.get(token)
        if kind is not None and (token not in "+-" or (OPERAND_ENDS.search(before) and before != "return")):
            counts[kind] += 1
        before = token
    return Operations(**counts)
