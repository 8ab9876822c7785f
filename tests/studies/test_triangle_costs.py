"""What tests cost and where they end: operators counted in text against operators counted while they run, exits against
float64, and tests without a tree against the engine."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import wrt
from studies.triangles.isolated_tests import Beams, Soup, closest, exits, pairs
from wrt.kernels.classics.studies.derivation_counts import count_derivation
from wrt.kernels.classics.studies.komatsu_2008 import PUBLISHED
from wrt.kernels.classics.triangle import komatsu
from wrt.kernels.runtime.launch import launch
from wrt.kernels.triangle import TRIANGLE_TESTS, moeller_trumbore
from wrt.kernels.triangle.support.lane_form import LaneForm
from wrt.kernels.triangle.support.operation_counts import Operations, count_operations
from wrt.kernels.triangle.support.record_blocks import Corners, Record

CHECKED = {
    "moeller_trumbore": moeller_trumbore.EXITS,
    "komatsu": komatsu.EXITS,
    **{name: form.lanes for name, form in PUBLISHED.items() if name != "projection"},
}
"""Tests without selections, which a number type cannot count."""


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("const float a = -b + c * -d;", Operations(add=1, multiply=1)),
        ("x = (a - b) / 2.0f; // a + b", Operations(add=1, divide=1)),
        ("const float m = a < b ? a : b, n = -m;", Operations(compare=1, select=1)),
        ("(u >= 0.0f) & (v >= 0.0f) & !(u + v > 1e-3f)", Operations(add=1, compare=3)),
        ("f(a)[2] - -1.5e-7f == 0x7f800000", Operations(add=1, compare=1)),
    ],
)
def test_operators_in_text(code, expected):
    assert count_operations(code) == expected


COUNTED = """
    static int tally[5];
    struct Counted {
        float v;
        Counted(float value) : v(value) {}
        Counted operator-() const { return Counted(-v); }
        Counted operator+(Counted o) const { ++tally[0]; return Counted(v + o.v); }
        Counted operator-(Counted o) const { ++tally[0]; return Counted(v - o.v); }
        Counted operator*(Counted o) const { ++tally[1]; return Counted(v * o.v); }
        Counted operator/(Counted o) const { ++tally[2]; return Counted(v / o.v); }
        bool operator<(Counted o) const { ++tally[3]; return v < o.v; }
        bool operator>(Counted o) const { ++tally[3]; return v > o.v; }
        bool operator<=(Counted o) const { ++tally[3]; return v <= o.v; }
        bool operator>=(Counted o) const { ++tally[3]; return v >= o.v; }
        bool operator==(Counted o) const { ++tally[3]; return v == o.v; }
    };
    for (int kind = 0; kind < 5; ++kind) tally[kind] = 0;
    int passed = 0;
"""


def instrumented(form: LaneForm) -> wp.Kernel:
    """A kernel that runs the steps of a form, one after the other, on numbers that count what is done to them."""
    text = COUNTED
    names = [*(value.name for value in form.ray), *form.components]
    text += "".join(f"    const Counted {name}({0.3 + 0.7 * k}f);\n" for k, name in enumerate(names))
    for number, step in enumerate(form.steps):
        code = re.sub(r"\bfloat\b", "Counted", f"{step.code}; passed += ({step.passes}) ? 1 : 0;")
        text += re.sub(r"(?<![\w.])(\d+\.\d*f)", r"Counted(\1)", code)
        text += f"\n    for (int kind = 0; kind < 5; ++kind) counts.data[{5 * number} + kind] = tally[kind];\n"

    @wp.func_native(text + "    return passed;\n")
    def run_steps(counts: wp.array(dtype=int)) -> int: ...

    def count(first: int, counts: wp.array(dtype=int)):
        run_steps(counts)

    return wp.kernel(count, module="unique", enable_backward=False)


@pytest.mark.parametrize("name", CHECKED)
def test_operations_as_carried_out(name):
    """The same steps, compiled with a number type that counts: what the text says is what is done."""
    form = CHECKED[name]
    counts = wp.zeros(5 * len(form.steps), dtype=int, device="cpu")
    launch(instrumented(form), 1, [counts], device=wp.get_device("cpu"))
    done = np.diff(counts.numpy().reshape(-1, 5), axis=0, prepend=0)
    for step, row in zip(form.steps, done.tolist(), strict=True):
        assert Operations(*row) == step.operations


def test_komatsus_table_1():
    """Operations of a test, without the divisions for u and v that the paper leaves out and without what finds a bad t."""
    for name, expected in (("moeller", 34), ("pluecker", 21), ("proposed", 17)):
        done = sum(PUBLISHED[name].lanes.operations, Operations())
        assert done.arithmetic - 2 - 1 == expected
        assert PUBLISHED[name].record.test_bytes == {"moeller": 48, "pluecker": 52, "proposed": 40}[name]
    assert sum(PUBLISHED["projection"].lanes.operations, Operations()).arithmetic == 23, "the paper says 22"
    assert PUBLISHED["projection"].record.test_bytes == 40


@pytest.mark.parametrize("name", PUBLISHED)
def test_derivations_are_counted_as_they_run(name, soup_and_rays):
    """The counted run gives the bits of the compiled one; what depends on the origin is told apart from the rest."""
    soup, _ = soup_and_rays
    record = PUBLISHED[name].record
    packed = soup.records(record, 1).numpy().reshape(len(soup), -1)[:, 9:]
    for number in (0, 7, 202):
        derived = count_derivation(record, soup.corners[number], soup.origin)
        np.testing.assert_array_equal(derived.values.view(np.int32), packed[number].view(np.int32))
    expected = {"moeller": (15, 0), "projection": (36, 0), "pluecker": (15, 41), "proposed": (15, 26)}[name]
    assert (derived.per_triangle.arithmetic, derived.per_origin.arithmetic) == expected


@wp.func
def derive_twice(corners: Corners, origin: wp.vec3):
    """One difference, written twice, and a product of the triangle alone."""
    first = corners.a[0] - origin[0]
    second = corners.a[0] - origin[0]
    return wp.vec3(first, second, corners.b[1] * corners.b[1])


def test_a_count_is_that_of_the_source():
    """The precomputation in Komatsu's Table 1 was the paper's own number, whatever the code did."""
    derived = count_derivation(Record(3, derive_twice, per_origin=True), np.eye(3), np.ones(3))
    assert (derived.per_triangle, derived.per_origin) == (Operations(multiply=1), Operations(add=2))
    nothing = count_derivation(TRIANGLE_TESTS["moeller_trumbore"].record, np.eye(3), np.ones(3))
    assert nothing.per_triangle == nothing.per_origin == Operations()


def test_projection_leaves_behind_the_closest_hit():
    """Wald's first exit: of triangles one behind the other, hit or missed behind the first, only nearer ones go on."""
    near, far, beside = ([[-1, -1, z], [3, -1, z], [-1, 3, z]] for z in (1.0, 2.0, 3.0))
    beside = [[x + 9, y, z] for x, y, z in beside]
    rays = Beams(np.zeros((1, 3)), np.float32([[0, 0, 1], [0, 0, -1]]))
    expected = {"near first": ((near, far, beside), (5, 0, 0, 0, 1)), "far first": ((far, near, beside), (4, 0, 0, 0, 2))}
    expected["beside first"] = ((beside, near), (2, 1, 0, 0, 1))
    for name, (corners, ends) in expected.items():
        found = exits(PUBLISHED["projection"], Soup(np.array(corners)), rays)
        assert found.tests == ends, name


def test_every_test_tells_its_exits():
    for test in TRIANGLE_TESTS.values():
        assert len(test.lanes.exits) >= 1
        assert all(step.arithmetic + step.compare > 0 for step in test.lanes.operations)


@pytest.fixture(scope="module")
def soup_and_rays():
    """Triangles on both sides of an eye, and a bundle of rays in groups of 16."""
    rng = np.random.default_rng(4)
    corners = 2 * rng.normal(size=(203, 1, 3)) + 0.6 * rng.normal(size=(203, 3, 3))
    origin = np.float32([0.25, -0.5, 2.0])
    directions = rng.normal(size=(8, 1, 3)) * [0.4, 0.4, 0.0] + 0.05 * rng.normal(size=(8, 16, 3)) + [0, 0, -1]
    return Soup(corners, origin), Beams(origin[None], directions.reshape(-1, 3))


def weights(soup: Soup, rays: Beams) -> tuple[np.ndarray, ...]:
    """N . D and the products of each direction with the planes of the edges opposite a, b and c, (rays, triangles), float64."""
    a, b, c = np.moveaxis(soup.corners.astype(np.float64) - np.float64(soup.origin), 1, 0)
    planes = (np.cross(b - a, c - a), np.cross(b, c), np.cross(c, a), np.cross(a, b))
    return tuple(rays.directions.numpy().astype(np.float64) @ plane.T for plane in planes)


def first_failure(*conditions: np.ndarray) -> np.ndarray:
    """Number of the first condition that does not hold; their number if all do."""
    return np.argmin(np.stack([*conditions, np.zeros_like(conditions[0])]), axis=0)


def test_exits_are_counted(soup_and_rays):
    """Alone and together, against float64."""
    soup, rays = soup_and_rays
    facing, alpha, beta, gamma = weights(soup, rays)
    a = soup.corners[:, 0].astype(np.float64) - np.float64(soup.origin)
    normal = np.cross(soup.corners[:, 1] - soup.corners[:, 0], soup.corners[:, 2] - soup.corners[:, 0])
    side = np.where((normal * a).sum(axis=1) < 0, -1, 1)
    expected = {
        "proposed": first_failure(facing < 0, -beta >= 0, -gamma >= 0, -alpha >= 0),
        "komatsu": first_failure(side * alpha >= 0, side * beta >= 0, side * gamma >= 0, side * facing > 0),
    }
    forms = {"proposed": PUBLISHED["proposed"], "komatsu": replace(TRIANGLE_TESTS["komatsu"], lanes=komatsu.EXITS)}
    for name, ends in expected.items():
        if name == "proposed":
            ends[ends == 4] = 5  # "no distance" is nobody's end
        found = exits(forms[name], soup, rays, group_rays=16)
        kinds = len(found.names)
        assert found.tests == tuple(np.bincount(ends.ravel(), minlength=kinds))
        last = ends.reshape(8, 16, -1).max(axis=1)
        assert found.vectors == tuple(np.bincount(last.ravel(), minlength=kinds))
        assert len(np.unique(ends)) == (5 if name == "proposed" else 4), "all of them, but for triangles seen edge-on"
        steps = forms[name].lanes.operations
        cost = np.concatenate([np.cumsum([step.arithmetic for step in steps]), [sum(s.arithmetic for s in steps)]])
        assert found.operations(steps) == pytest.approx(cost[ends].mean())
        assert found.operations(steps, of_vectors=True) == pytest.approx(cost[last].mean())
        blocks = exits(forms[name], soup, rays, group_triangles=8)
        assert blocks.tests == found.tests
        padded = np.pad(ends, ((0, 0), (0, 5)), constant_values=0).reshape(128, -1, 8).max(axis=2)
        assert blocks.vectors == tuple(np.bincount(padded.ravel(), minlength=kinds))


def test_exits_of_every_test(soup_and_rays):
    """Whatever a test's steps are: it has as many hits as float64 finds, and ends once for each pair."""
    soup, rays = soup_and_rays
    _, alpha, beta, gamma = weights(soup, rays)
    corners = soup.corners.astype(np.float64) - np.float64(soup.origin)
    side = np.sign(np.linalg.det(corners))
    ahead = np.stack([side * alpha, side * beta, side * gamma]).min(axis=0) > 0
    behind = np.stack([side * alpha, side * beta, side * gamma]).max(axis=0) < 0
    assert ahead.sum() > 100
    assert behind.any()
    for test in TRIANGLE_TESTS.values():
        found = exits(test, soup, rays, group_rays=16)
        assert found.tests[-1] == ahead.sum() + (0 if test.needs_shared_origin else behind.sum()), test.name
        assert sum(found.tests) == ahead.size
        assert sum(found.vectors) == ahead.size // 16


def test_tests_alone_find_what_the_engine_finds(soup_and_rays):
    """Frusta, blocks and pairs of all tests without a tree; with joined exits the same bits; one-sided ones half of it."""
    soup, rays = soup_and_rays
    mesh = wrt.TriangleMesh(soup.corners.reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3))
    hits = wrt.Scene(mesh, device="cpu").intersect(np.float32(soup.origin), rays.directions.numpy(), traversal="brute")
    forms = {name: TRIANGLE_TESTS[name] for name in ("woop", "moeller_trumbore", "komatsu")}
    forms["one by one"] = replace(forms["komatsu"], lanes=komatsu.EXITS)
    answers = {}
    for name, form in forms.items():
        t, found = (values.copy() for values in closest(form, soup, rays, frustum=16, width=4)())
        np.testing.assert_array_equal(found, hits.primitive_id, err_msg=name)
        np.testing.assert_allclose(t, hits.t, rtol=1e-5, err_msg=name)
        answers[name] = t
    np.testing.assert_array_equal(answers["komatsu"], answers["one by one"])
    assert hits.is_hit.any()
    assert not hits.is_hit.all()
    t, found = closest(PUBLISHED["projection"], soup, rays, frustum=16, width=4)()
    np.testing.assert_array_equal(found, hits.primitive_id)
    np.testing.assert_allclose(t, hits.t, rtol=1e-4)
    for form in (PUBLISHED[name] for name in ("moeller", "pluecker", "proposed")):
        t, found = closest(form, soup, rays, frustum=16, width=4)()
        front = hits.is_hit & (found == hits.primitive_id)
        np.testing.assert_allclose(t[front], hits.t[front], rtol=1e-4)
        assert (t[~front] >= hits.t[~front]).all()
        facing, *_ = weights(soup, rays)
        seen = hits.is_hit & (np.take_along_axis(facing, np.maximum(hits.primitive_id, 0)[:, None], 1)[:, 0] < 0)
        np.testing.assert_array_equal(front, seen)
    t, found = (values.copy() for values in closest(forms["woop"], soup, rays, frustum=0, width=8)())
    np.testing.assert_array_equal(found, hits.primitive_id)
    picked = np.flatnonzero(hits.is_hit)
    one_by_one = Soup(soup.corners[hits.primitive_id[picked]], soup.origin)
    got = pairs(forms["woop"], one_by_one, Beams(np.array([soup.origin]), rays.directions.numpy()[picked]))
    np.testing.assert_array_equal(got[:, 0], t[picked])
    with pytest.raises(ValueError, match="frusta of 6"):
        closest(forms["woop"], soup, rays, frustum=6, width=4)


def test_joined_forms_refuse_other_numbers_of_steps():
    with pytest.raises(ValueError, match="do not sum to the 4 steps"):
        komatsu.EXITS.joined(2, 1)
