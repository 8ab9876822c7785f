"""Ray-triangle tests: one file per published test, and the table of them.

**Contract** (`wrt.kernels.triangle.support.triangle_contract`). A test is a `TriangleTest`: a record of floats a triangle
(`wrt.kernels.triangle.support.record_blocks`), a struct per ray that `prepare` makes once before a traversal, and the
intersection itself in three forms that give the same bits: one ray x one triangle in plain Warp (`intersect`), and, from one
piece of C++ (`wrt.kernels.triangle.support.lane_form`), one ray x W triangles (`block_test`) and W rays x one triangle
(`packet_form`). A test decides whether the ray's *line* meets the triangle and where; whether that t counts is the traversal's
business, by one rule for all tests (`wrt.kernels.simd.boxes`). A NaN anywhere must come out as a miss.

To add a test: write its file, add one line to `TRIANGLE_TESTS`; tests, command line and benchmarks pick it up.

**Kin.** Most tests are one sum of products in different clothes. Volumes that ray and edges span: `pluecker`, `segura_feito`,
and for rays of one origin `benthin` and `komatsu`. Cramer's rule: `moeller_trumbore`, with the fewest operations
`kensler_shirley`, with data computed beforehand `moeller_trumbore_precomputed`. The plane first: `badouel`, with data `wald`,
`baldwin_weber`, `shevtsov`, and without projection `havel_herout`.

**Not here.** The segment test of Jimenez, Segura and Feito (A robust segment/triangle intersection algorithm for interference
tests, Computational Geometry 43(5), 2010): of the sources that this table follows none gives its definition, only that it
finds t first, then the barycentric coordinates, and shares what neighbours have in common.
"""

from wrt.kernels.triangle import (
    badouel,
    baldwin_weber,
    benthin,
    ferko,
    havel_herout,
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
        benthin.TEST,
        komatsu.TEST,
        *ferko.TESTS,
    )
}
