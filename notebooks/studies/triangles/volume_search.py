"""A search for the cheapest form of a ray-triangle test by volumes, after Kensler and Shirley (2006).

**Idea.** t and the weights u and v are ratios of volumes that the ray's direction d, vectors s from a vertex to its origin, and
edges span. A volume is a triple product x . (y x z), which can be computed from any of its three cross products. Different
volumes may share vectors and cross products. A *form* chooses for each volume its vectors and its cross product.

**Search.** Kensler and Shirley encode forms as bit strings and let a genetic algorithm minimise the measured time. There are
few forms, so this search counts the operations of each of them, every vector and cross product once. Forms of least cost are
then code (`lane_form`), to be timed.

**Signs.** Exchanging two vectors of a volume changes its sign, which costs nothing; it is kept in the form.

References: kensler-shirley-2006.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from studies.triangles.isolated_tests import Beams, Run, Soup, closest, traced
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.kernels.classics.studies.bare_triangle_tests import make_blocks
from wrt.kernels.classics.studies.distance_checks import in_range
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.lane_form import DIRECTION, ORIGIN, LaneForm, Step
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.kernels.triangle.support.vectors import PlainRay, crossed, dotted, minus, prepare

EDGES = {"e0": ("b", "a"), "e1": ("c", "b"), "e2": ("c", "a")}
"""Edge vectors: end and beginning."""

STARTS = {"sa": ("a", "o"), "sb": ("b", "o"), "sc": ("c", "o")}
"""Vectors from the ray's origin to a vertex."""

NORMALS = {("e0", "e2"): 1, ("e0", "e1"): 1, ("e2", "e1"): 1}
"""Pairs of edges, and the sign by which their cross product is (b - a) x (c - a)."""

Volume = tuple[str, str, str]
"""x . (y x z): the dot product's other vector, and the two that are crossed, in alphabetical order."""


@dataclass(frozen=True)
class Form:
    """A way to compute a test: for the determinant, t, u and v, the volume and its sign."""

    det: tuple[int, Volume]
    t: tuple[int, Volume]
    u: tuple[int, Volume]
    v: tuple[int, Volume]

    @property
    def volumes(self) -> tuple[tuple[int, Volume], ...]:
        """All four."""
        return self.det, self.t, self.u, self.v

    @property
    def crosses(self) -> list[tuple[str, str]]:
        """The cross products, each once."""
        return sorted({volume[1:] for _, volume in self.volumes})

    @property
    def vectors(self) -> list[str]:
        """The differences of points, each once."""
        return sorted({name for _, volume in self.volumes for name in volume} - {"d"})

    @property
    def operations(self) -> int:
        """Additions, multiplications and the division: three for a difference, nine for a cross product, five for a dot
        product, and three to scale t, u and v.
        """
        return 3 * len(self.vectors) + 9 * len(self.crosses) + 5 * len({volume for _, volume in self.volumes}) + 3 + 1


def groupings(sign: int, x: str, y: str, z: str) -> list[tuple[int, Volume]]:
    """The three ways to compute sign * x . (y x z)."""
    found = []
    for one, two, three in ((x, y, z), (y, z, x), (z, x, y)):
        swap = two > three
        found.append((-sign if swap else sign, (one, *sorted((two, three)))))
    return found


def forms() -> Iterator[Form]:
    """All forms: which two edges make the normal, which vertex belongs to the origin, which cross product is taken."""
    dets = [way for (p, q), sign in NORMALS.items() for way in groupings(sign, "d", p, q)]
    heights = [way for (p, q), sign in NORMALS.items() for s in STARTS for way in groupings(sign, s, p, q)]
    # u is the volume of d, the edge a c and a start on it; v that of d, the edge a b and a start on it
    us = [way for s in ("sa", "sc") for way in groupings(-1, "d", s, "e2")]
    vs = [way for s in ("sa", "sb") for way in groupings(1, "d", s, "e0")]
    for det, t, u, v in product(dets, heights, us, vs):
        yield Form(det, t, u, v)


def cheapest() -> list[Form]:
    """The forms with the fewest operations."""
    every = list(forms())
    least = min(form.operations for form in every)
    return [form for form in every if form.operations == least]


def lane_form(form: Form) -> LaneForm:
    """The code of a form, for blocks and packets."""
    points = EDGES | STARTS
    vectors = "".join(minus(name, *points[name]) for name in form.vectors)
    crosses = "".join(crossed(f"{p}{q}", p, q) for p, q in form.crosses)
    value = {
        name: f"{'-' if sign < 0 else ''}{dotted(f'{p}{q}', x)}"
        for name, (sign, (x, p, q)) in zip(("det", "t", "u", "v"), form.volumes, strict=True)
    }
    code = f"""
        {vectors}{crosses}
        const float scale = 1.0f / ({value["det"]});
        const float t = ({value["t"]}) * scale, u = ({value["u"]}) * scale, v = ({value["v"]}) * scale;
    """
    passes = "(u >= 0.0f) & (v >= 0.0f) & (u + v <= 1.0f) & (t - t == 0.0f)"
    return LaneForm(ray=(*ORIGIN, *DIRECTION), steps=(Step(exit="beside the triangle", code=code, passes=passes),))


def as_test(form: Form) -> TestForm:
    """A form to be measured (`isolated_tests`)."""
    crosses = ", ".join(f"{p} x {q}" for p, q in form.crosses)
    return TestForm(name=crosses, ray_state=PlainRay, prepare=prepare, lanes=lane_form(form))


def compare_forms(*, triangles: int = 2048, rays: int = 2048, width: int = 16, rounds: int = 7) -> list[dict[str, Any]]:
    """Time of the cheapest forms, and of the entries of the table of this kind, on random triangles; and of Wald's test with t
    compared by floats and by integers (`wrt.kernels.classics.studies.distance_checks`).

    Returns:
        A row for each: way, operations (None for those of the table), seconds, ratio to Moeller and Trumbore's entry (for
        distances: to floats), least, greatest.
    """
    soup, beams = random_soup(triangles, rays)
    tests = {name: TRIANGLE_TESTS[name] for name in ("moeller_trumbore", "kensler_shirley")}
    counted = {as_test(form).name: form.operations for form in cheapest()}
    tests |= {own.name: own for own in map(as_test, cheapest())}
    runs = {name: closest(test, soup, beams, frustum=0, width=width) for name, test in tests.items()}
    runs |= {f"wald, {way}": distances(soup, beams, way == "integers", width) for way in ("floats", "integers")}
    timings, rows = timed(runs, rounds), []
    for name, timing in timings.items():
        reference = timings["wald, floats" if name.startswith("wald") else "moeller_trumbore"]
        rows.append({"way": name, "operations": counted.get(name), **ratios(timing, reference)})
    return rows


def random_soup(triangles: int, rays: int) -> tuple[Soup, Beams]:
    """Triangles of random corners in a unit cube, and rays of all directions from within."""
    rng = np.random.default_rng(5)
    corners = rng.random((triangles, 1, 3)) + 0.2 * rng.normal(size=(triangles, 3, 3))
    return Soup(corners), Beams(rng.random((rays, 3)), rng.normal(size=(rays, 3)))


def distances(soup: Soup, rays: Beams, integers: bool, width: int) -> Run:
    """What tests all rays against all triangles by Wald's test, t compared by floats or by integers."""
    test = TRIANGLE_TESTS["wald"]
    kernel = make_blocks(test, width, in_range(width, integers))
    return traced(kernel, soup.records(test.record, width), len(soup), rays)
