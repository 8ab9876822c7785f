"""One scene, asked by many Python threads at a time: every query gives what it gives alone."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from support.threads import from_threads, queries

import wrt


@pytest.mark.parametrize("kind", ["bvh", "kdtree"])
@pytest.mark.parametrize("num_threads", [1, 3])
def test_all_queries_at_a_time(kind, num_threads, device):
    teapot = wrt.scenes.build("teapot", level=3)
    geometry = [teapot, wrt.TriangleMesh(teapot.vertices + 0.4, teapot.faces)]
    expected = {name: query() for name, query in queries(wrt.Scene(geometry, kind, device=device)).items()}
    asked = queries(wrt.Scene(geometry, kind, device=device, num_threads=num_threads))

    def work(number: int) -> None:
        names = list(asked)
        for turn in range(3 * len(names)):
            name = names[(number + turn) % len(names)]
            for answer, right in zip(asked[name](), expected[name], strict=True):
                np.testing.assert_array_equal(answer, right, err_msg=name)

    from_threads(work)


def test_first_queries_at_a_time():
    """In a new process nothing is imported or loaded yet, and each thread begins with another query.

    This failed: packages whose parts import one another were entered from two ends at once, and two threads made the same
    kernel, with structs that did not fit.
    """
    code = (
        "import support.environment, sys, wrt; sys.setswitchinterval(1e-6)\n"
        "from support.threads import from_threads, queries\n"
        "asked = list(queries(wrt.Scene(wrt.scenes.build('teapot', level=3), device='cpu')).values())\n"
        "from_threads(lambda number: asked[number + 1]())\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
