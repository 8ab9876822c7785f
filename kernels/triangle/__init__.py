"""Ray-triangle tests: one file per published test, and the table of all tests.

**Contract** (`wrt.kernels.triangle.support.triangle_contract`). A test is a `TriangleTest`. It consists of a record of floats
per triangle (`wrt.kernels.triangle.support.record_blocks`), a per-ray struct that `prepare` computes once before a traversal,
and the intersection in three forms that return the same bits: one ray x one triangle in plain Warp (`intersect`); and,
generated from one piece of C++ (`wrt.kernels.triangle.support.lane_form`), one ray x W triangles (`block_test`) and W rays x
one triangle (`packet_form`). A test decides whether and where the ray's *line* meets the triangle. The traversal decides
whether that t counts, by one rule for all tests (`wrt.kernels.simd.boxes`). A NaN in any input must give a miss.

To add a test, write its file and add one line to `TRIANGLE_TESTS`. The tests, the command line and the benchmarks read the
table. `wrt.kernels.classics.triangle` has the tests that "auto" never chooses; the table imports one when it is looked up.

**How the tests are related.** Most tests evaluate the same sums of products in a different order. Signed volumes of the ray and
the edges: `pluecker`, `segura_feito`, and for rays with a common origin `benthin` and `komatsu`. Cramer's rule:
`moeller_trumbore`, with the fewest operations `kensler_shirley`, with the division last `jimenez`, with precomputed data
`moeller_trumbore_precomputed`. Plane first: `badouel`, with precomputed data `wald`, `baldwin_weber` and `shevtsov`, and
without projection `havel_herout`.
"""

from typing import Any

from wrt.kernels.triangle import moeller_trumbore, wald
from wrt.kernels.triangle.support.triangle_contract import ClassicTest, TriangleTest, TriangleTestTable
from wrt.kernels.triangle.watertight import woop

__all__ = ("CLASSIC_TESTS", "TRIANGLE_TESTS", "TriangleTest")

_KOMATSU = "Komatsu, Kaeriyama, Suzuki, Takizawa, Kobayashi: A fast ray frustum-triangle intersection algorithm"
_FERKO = "Pichler: Fast CPU Ray-Triangle Intersection Method, after Ferko and Ferko (2018)"
_FERKO_VARIANTS = (
    "utm",
    "utm_bounds",
    *(f"prune{fold}{order}" for fold in (3, 4) for order in ("", "_probability", "_weights", "_no_circle")),
    "hybrid",
)


def _classic(name: str, paper: str, module: str = "", **flags: Any) -> ClassicTest:
    """The row of a test of `wrt.kernels.classics.triangle`, whose module is called as the test unless it is given."""
    return ClassicTest(name=name, paper=paper, module=module or name, **flags)


TRIANGLE_TESTS = TriangleTestTable(
    (
        woop.TEST,
        moeller_trumbore.TEST,
        _classic(
            "moeller_trumbore_precomputed",
            f"{_KOMATSU}, 2.2 (2008)",
        ),
        _classic("kensler_shirley", "Kensler, Shirley: Optimizing ray-triangle intersection via automated search (2006)"),
        _classic("badouel", "Badouel: An efficient ray-polygon intersection (1990)"),
        wald.TEST,
        _classic("baldwin_weber", "Baldwin, Weber: Fast ray-triangle intersections by coordinate transformation (2016)"),
        _classic(
            "shevtsov", "Shevtsov, Soupikov, Kapustin: Ray-triangle intersection algorithm for modern CPU architectures (2007)"
        ),
        _classic("havel_herout", "Havel, Herout: Yet faster ray-triangle intersection (using SSE4) (2010)"),
        _classic("pluecker", "Amanatides, Choi: Ray tracing triangular meshes (1997)"),
        _classic("segura_feito", "Segura, Feito: Algorithms to test ray-triangle intersection. Comparative study (2001)"),
        _classic(
            "jimenez", "Jimenez, Segura, Feito: A robust segment/triangle intersection algorithm for interference tests (2010)"
        ),
        _classic("benthin", "Benthin: Realtime ray tracing on current CPU architectures (2006)", needs_shared_origin=True),
        _classic(
            "komatsu",
            f"{_KOMATSU} (2008)",
            needs_shared_origin=True,
        ),
        *(_classic(f"ferko_{name}", _FERKO, module="ferko") for name in _FERKO_VARIANTS),
    )
)
"""Triangle tests by name."""

CLASSIC_TESTS: dict[str, ClassicTest] = {row.name: row for row in TRIANGLE_TESTS.rows.values() if isinstance(row, ClassicTest)}
"""The rows of tests that "auto" never chooses, as they are before one is imported."""
