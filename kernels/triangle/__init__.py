"""Ray-triangle tests: one file per published test, and the table of all tests.

**Contract** (`wrt.kernels.triangle.support.triangle_contract`). A test is a `TriangleTest`. It consists of a record of floats
per triangle (`wrt.kernels.triangle.support.record_blocks`), a per-ray struct that `prepare` computes once before a traversal,
and the intersection in three forms that return the same bits: one ray x one triangle in plain Warp (`intersect`); and,
generated from one piece of C++ (`wrt.kernels.triangle.support.lane_form`), one ray x W triangles (`block_test`) and W rays x
one triangle (`packet_form`). A test decides whether and where the ray's *line* meets the triangle. The traversal decides
whether that t counts, by one rule for all tests (`wrt.kernels.simd.boxes`). A NaN in any input must give a miss.

To add a test, write its file and add one line to `TRIANGLE_TESTS`. The tests, the command line and the benchmarks read the
table.

**How the tests are related.** Most tests evaluate the same sums of products in a different order. Signed volumes of the ray and
the edges: `pluecker`, `segura_feito`, and for rays with a common origin `benthin` and `komatsu`. Cramer's rule:
`moeller_trumbore`, with the fewest operations `kensler_shirley`, with the division last `jimenez`, with precomputed data
`moeller_trumbore_precomputed`. Plane first: `badouel`, with precomputed data `wald`, `baldwin_weber` and `shevtsov`, and
without projection `havel_herout`.
"""

from wrt.kernels.triangle import (
    badouel,
    baldwin_weber,
    benthin,
    ferko,
    havel_herout,
    jimenez,
    kensler_shirley,
    komatsu,
    moeller_trumbore,
    moeller_trumbore_precomputed,
    pluecker,
    segura_feito,
    shevtsov,
    wald,
)
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.watertight import woop

TRIANGLE_TESTS: dict[str, TriangleTest] = {
    test.name: test
    for test in (
        woop.TEST,
        moeller_trumbore.TEST,
        moeller_trumbore_precomputed.TEST,
        kensler_shirley.TEST,
        badouel.TEST,
        wald.TEST,
        baldwin_weber.TEST,
        shevtsov.TEST,
        havel_herout.TEST,
        pluecker.TEST,
        segura_feito.TEST,
        jimenez.TEST,
        benthin.TEST,
        komatsu.TEST,
        *ferko.TESTS,
    )
}
