"""Vector arithmetic of triangle tests, in Warp and as the C++ of lane loops: same operations, same order, same bits.

Sums run from left to right. Exchanging the factors of a cross product negates it exactly, because products commute and
a - b = -(b - a) in floating point.
"""

from typing import Any

import warp as wp


@wp.struct
class PlainRay:
    """A ray's origin and direction, unchanged."""

    origin: wp.vec3
    direction: wp.vec3


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """Stores origin and direction; computes nothing."""
    ray = PlainRay()
    ray.origin = origin
    ray.direction = direction
    return ray


@wp.func
def miss():
    """The result for a ray whose line misses the triangle: (t, u, v) with t NaN."""
    return wp.vec3(wp.nan, 0.0, 0.0)


@wp.func
def cross(p: Any, q: Any):
    """p x q for vec3 or vec3d."""
    return type(p)(p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])


@wp.func
def dot(p: Any, q: Any):
    """p . q for vec3 or vec3d."""
    return (p[0] * q[0] + p[1] * q[1]) + p[2] * q[2]


@wp.func
def three(values: Any, first: int):
    """Three floats of a record, starting at number `first`, as a vector."""
    return wp.vec3(values[first], values[first + 1], values[first + 2])


@wp.func_native("""
    const double power = __builtin_bit_cast(double, __builtin_bit_cast(long long, size) & 0x7ff0000000000000LL);
    return power > 0.0 ? 1.0 / power : size + 1.0;
""")
def scale_to_one(size: wp.float64) -> wp.float64:
    """The power of two that scales a size to between 1 and 2; 1 for 0, NaN for NaN."""


@wp.func
def largest(v: wp.vec3d):
    """Largest absolute component."""
    return wp.max(wp.abs(v[0]), wp.max(wp.abs(v[1]), wp.abs(v[2])))


def names(vector: str) -> tuple[str, str, str]:
    """Names of a vector's components in the steps of a `LaneForm`."""
    return f"{vector}x", f"{vector}y", f"{vector}z"


def minus(result: str, p: str, q: str) -> str:
    """C++ that declares result = p - q."""
    return f"const float {', '.join(f'{result}{a} = {p}{a} - {q}{a}' for a in 'xyz')};\n"


def plus(result: str, p: str, q: str) -> str:
    """C++ that declares result = p + q."""
    return f"const float {', '.join(f'{result}{a} = {p}{a} + {q}{a}' for a in 'xyz')};\n"


def crossed(result: str, p: str, q: str) -> str:
    """C++ that declares result = p x q, as `cross`."""
    parts = (f"{result}{a} = {p}{b} * {q}{c} - {p}{c} * {q}{b}" for a, b, c in ("xyz", "yzx", "zxy"))
    return f"const float {', '.join(parts)};\n"


def dotted(p: str, q: str) -> str:
    """C++ expression p . q, as `dot`."""
    return f"(({p}x * {q}x + {p}y * {q}y) + {p}z * {q}z)"
