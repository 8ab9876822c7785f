"""Queries inside a `wp.Tape`: an error where gradients would be lost.

Tapes do not record queries: the triangle that a ray hits is a step function, and query kernels are compiled without
adjoints. A loss computed from their distances would have zero gradients. So queries refuse arrays that require gradients
while a tape records. Booleans and counts (`occluded`, `count`, `contains`, `visible`) have no gradients to lose.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import warp as wp


def tape_records() -> bool:
    """Whether the calling code is inside a `wp.Tape`. (Warp has no public function for this.)"""
    return wp._src.context.runtime.tape is not None  # type: ignore[attr-defined]


def takes_gradients(value: Any) -> bool:
    """Whether this is a Warp array with `requires_grad=True`, or a struct that holds one."""
    if isinstance(value, wp.array):
        return value.requires_grad
    if isinstance(value, wp._src.codegen.StructInstance):
        return any(takes_gradients(getattr(value, name)) for name in value._cls.vars)  # type: ignore[attr-defined]
    return False


def refuse_tape(query: str, arrays: Iterable[Any], remedy: str = "differentiable_hits") -> None:
    """Refuses arrays with gradients in a query that has none; remedy: the function of `wrt.device` that has them.

    Raises:
        ValueError: a tape records, and one of the arrays requires gradients.
    """
    if tape_records() and any(isinstance(values, wp.array) and values.requires_grad for values in arrays):
        raise ValueError(
            f"{query} has no gradients, and inside a wp.Tape these {'rays' if 'hits' in remedy else 'points'} require them; "
            "call it before the tape, or with wp.clone(array, requires_grad=False), and pass its results to "
            f"wrt.device.{remedy} inside the tape"
        )
