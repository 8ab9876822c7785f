"""Ray-triangle tests: one file per published test, and the table of them.

**Contract** (`wrt.kernels.triangle.contract`). A test is a `TriangleTest`: a record of floats a triangle
(`wrt.kernels.triangle.records`), a struct per ray that `prepare` makes once before a traversal, and the intersection itself in
three forms that give the same bits: one ray x one triangle in plain Warp (`intersect`), and, from one piece of C++
(`wrt.kernels.triangle.lane_form`), one ray x W triangles (`block_test`) and W rays x one triangle (`packet_form`). A test
decides whether the ray's *line* meets the triangle and where; whether that t counts is the traversal's business, by one rule
for all tests (`wrt.kernels.boxes`). A NaN anywhere must come out as a miss.

To add a test: write its file, add one line to `TRIANGLE_TESTS`; tests, command line and benchmarks pick it up.
"""

from wrt.kernels.triangle import (
    baldwin_weber,
    ferko,
    komatsu,
    moeller_trumbore,
    moeller_trumbore_precomputed,
    shevtsov,
    wald,
    woop,
)
from wrt.kernels.triangle.contract import TriangleTest

TRIANGLE_TESTS: dict[str, TriangleTest] = {
    test.name: test
    for test in (
        woop.TEST,
        moeller_trumbore.TEST,
        moeller_trumbore_precomputed.TEST,
        wald.TEST,
        shevtsov.TEST,
        baldwin_weber.TEST,
        komatsu.TEST,
        *ferko.TESTS,
    )
}
