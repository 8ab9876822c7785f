"""What a ray-triangle test costs on paper: floating-point operations, read off the text of its steps.

The steps of a `LaneForm` are straight-line C++: selects instead of branches, no loops, no calls that compute. Each operator
that is written is therefore carried out once a lane, and counting operators in the text counts the operations of a test.
Tests that are written by hand declare theirs.
"""

import re
from dataclasses import dataclass

TOKEN = re.compile(r"//[^\n]*|0x[0-9a-fA-F]+u?|\d+\.?\d*(?:[eE][-+]?\d+)?f?|[A-Za-z_]\w*|<<|>>|<=|>=|==|!=|&&|\|\||\S")
"""Comments, numbers, names, operators."""

OPERAND_ENDS = re.compile(r"[\w.)\]]$")
"""What an operand ends with: a sign after anything else is a sign, not an operation."""

KINDS = {"+": "add", "-": "add", "*": "multiply", "/": "divide", "?": "select"}
KINDS |= dict.fromkeys(("<", ">", "<=", ">=", "==", "!="), "compare")


@dataclass(frozen=True)
class Operations:
    """Numbers of operations; a change of sign is none.

    Attributes:
        add: additions and subtractions.
        multiply: multiplications.
        divide: divisions.
        compare: comparisons.
        select: choices between two numbers.
    """

    add: int = 0
    multiply: int = 0
    divide: int = 0
    compare: int = 0
    select: int = 0

    @property
    def arithmetic(self) -> int:
        """Additions, multiplications and divisions, which is what papers count."""
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
