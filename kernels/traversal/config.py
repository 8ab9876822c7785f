"""What a traversal kernel is specialised for, and what its caller may ask of it."""

from dataclasses import dataclass

CLOSEST = "closest"
ANY = "any"
QUERIES = (CLOSEST, ANY)
"""Closest hit (t, primitive, uv), or only whether there is any hit."""


@dataclass(frozen=True)
class TraversalConfig:
    """The key of one specialisation: a kernel is made and compiled once for each distinct value.

    Attributes:
        triangle_test: key in `TRIANGLE_TESTS`.
        width: triangles a block, 1 to 16.
        query: "closest" or "any".
        coherent: whether neighbouring rays are expected to take the same way through the tree; only speed depends on it.
        counters: whether work per ray is counted (`wrt.kernels.traversal.counters`).
    """

    triangle_test: str
    width: int
    query: str = CLOSEST
    coherent: bool = True
    counters: bool = False
