"""What published tests have in common: steps, rays that are used as they are, and the condition that three signs agree."""

import re
from dataclasses import replace

import warp as wp

from wrt.kernels.triangle import CLASSIC_TESTS
from wrt.kernels.triangle.support.lane_form import DIRECTION, ORIGIN, RESULT, LaneForm, Step
from wrt.kernels.triangle.support.record_blocks import VERTICES, Record
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import PlainRay, prepare

DECLARED = re.compile(r"([A-Za-z_]\w*)\s*=(?!=)")
"""A name that C++ declares with a value."""

StepText = tuple[str, str, str]
"""A step of a test: its exit, its code and the condition to go on, as those of `Step`."""

INSIDE = "(u >= 0.0f) & (v >= 0.0f) & (u + v <= 1.0f)"
"""C++: the weights u and v are those of a point of the triangle."""

FINITE = "t - t == 0.0f"
"""C++: t is neither infinite nor NaN."""


@wp.func
def same_sign(a: float, b: float, c: float):
    """Whether none of three numbers has the sign opposite to that of another."""
    return (a >= 0.0 and b >= 0.0 and c >= 0.0) or (a <= 0.0 and b <= 0.0 and c <= 0.0)


def same_signs(a: str, b: str, c: str) -> str:
    """C++ for `same_sign`."""
    return f"(({a} >= 0.0f) & ({b} >= 0.0f) & ({c} >= 0.0f)) | (({a} <= 0.0f) & ({b} <= 0.0f) & ({c} <= 0.0f))"


def declared(step: Step) -> list[str]:
    """The names that a step declares."""
    return list(dict.fromkeys(DECLARED.findall(step.code)))


def in_steps(*parts: StepText) -> tuple[Step, ...]:
    """The steps of a test. Each keeps t, u and v, and what later ones read and do not declare anew."""
    steps = [Step(*part) for part in parts]

    def is_kept(name: str, later: list[Step]) -> bool:
        return name in RESULT or any(step.reads([name]) and name not in declared(step) for step in later)

    return tuple(
        replace(step, keeps=tuple(name for name in declared(step) if is_kept(name, steps[number:])))
        for number, step in enumerate(steps, start=1)
    )


def published(
    name: str, intersect: wp.Function, *parts: StepText, record: Record = VERTICES, names: tuple[str, ...] = ()
) -> TriangleTest:
    """The test of a row of the table, for rays that are used as they are.

    Args:
        name: key in the table.
        intersect: one ray, one triangle.
        parts: the same as steps (`in_steps`).
        record: what the test keeps of a triangle.
        names: of the record's own floats in the steps.
    """
    return TriangleTest(
        name=name,
        paper=CLASSIC_TESTS[name].paper,
        record=record,
        ray_state=PlainRay,
        prepare=prepare,
        intersect=intersect,
        lanes=LaneForm(ray=(*ORIGIN, *DIRECTION), triangle=names, steps=in_steps(*parts)),
    )
