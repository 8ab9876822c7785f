"""The greatest of the lanes of several rows, folded together, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.selection import slow

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel


@pytest.mark.parametrize("width", [8, 16, *slow(1, 2, 4)])
@pytest.mark.parametrize("count", [1, 7, 19, *slow(2, 3, 13, 16)])
def test_row_maxima(count, width, device):
    code = f"typedef const float Row[{width}]; wrt::row_maxima<{count}, {width}>((Row*)rows.data, results.data);"

    @native.func_native("lanes.h", code)
    def maxima(rows: wp.array(dtype=float), results: wp.array(dtype=float)): ...

    def reduce(rows: wp.array(dtype=float), results: wp.array(dtype=float)):
        maxima(rows, results)

    rng = np.random.default_rng(width * count)
    rows = rng.normal(size=(count, width)).astype(np.float32)
    rows[rng.random(rows.shape) < 0.1] = -np.inf
    rows[0, -1] = np.inf
    results = wp.zeros(count, dtype=float, device=device)
    wp.launch(specialised_kernel(reduce), 1, [wp.array(rows.ravel(), dtype=float, device=device), results], device=device)
    np.testing.assert_array_equal(results.numpy(), rows.max(axis=1))
