"""What a `wp.Tape` may expect of queries: gradients where there are some, and an error where they would be lost.

Queries are not recorded on tapes: which triangle a ray meets is a step function, and their kernels are compiled without
adjoints. A loss that reads their distances would have gradients of 0. So what would lose gradients refuses to run while a tape
records. Booleans and counts (`occluded`, `count`, `contains`, `visible`) have none to lose.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import warp as wp


def tape_records() -> bool:
    """Whether the calling code is inside a `wp.Tape`. (Warp has no public name for that.)"""
    return wp._src.context.runtime.tape is not None


def takes_gradients(value: Any) -> bool:
    """Whether it is a Warp array made with `requires_grad=True`, or a struct that holds one."""
    if isinstance(value, wp.array):
        return value.requires_grad
    if isinstance(value, wp._src.codegen.StructInstance):
        return any(takes_gradients(getattr(value, name)) for name in value._cls.vars)
    return False


def refuse_tape(query: str, arrays: Iterable[Any]) -> None:
    """Keeps a query that passes no gradients on from losing those of its rays.

    Raises:
        ValueError: a tape records, and one of the arrays takes gradients.
    """
    if any(isinstance(values, wp.array) and values.requires_grad for values in arrays) and tape_records():
        raise ValueError(
            f"{query} passes no gradients on, and inside a wp.Tape these rays take some; call it before the tape, or with "
            "wp.clone(array, requires_grad=False), and pass its hits to wrt.differentiable_hits inside the tape"
        )
