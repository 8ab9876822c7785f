"""The interface of a ray-triangle test to the rest of the engine, and the table of tests, in which classics are rows until they
are asked for.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType

import warp as wp

from wrt.kernels.on_demand import CLASSICS
from wrt.kernels.triangle.support.lane_form import HandWritten, LaneForm, PacketForm
from wrt.kernels.triangle.support.record_blocks import VERTICES, Record


@dataclass(frozen=True)
class CrossingForms:
    """Forms of a test for counting crossings: a ray through an edge or a vertex hits exactly one of the triangles there.

    Attributes:
        intersect: as `TriangleTest.intersect`.
        block_test: as `TriangleTest.block_test`.
        line_test: as `TriangleTest.line_test`.
    """

    intersect: wp.Function
    block_test: Callable[[int], wp.Function]
    line_test: Callable[[int], wp.Function] | None = None


@dataclass(frozen=True, kw_only=True)
class TestForm:
    """The lane loops of a test and their inputs: enough to measure it (`wrt.kernels.classics.studies.bare_triangle_tests`), not
    to trace with it.

    Attributes:
        name: key in tables.
        record: per-triangle data. With `record.per_origin`, all rays of a batch must have the same origin, and the records are
            computed for it. Such a test reports only hits in front of the origin.
        ray_state: struct that `prepare` returns.
        prepare: `wp.func(origin, direction) -> ray`, once per ray.
        native: C++ struct of `kernels/native` for streams, or empty if rays are prepared and candidates tested one by one.
            `prepare` does what the function above does for L rays at once: it fills the rows from 14 on with the words of the
            ray state, in order. `test` is `intersect` for L pairs of a ray and a triangle at once. The block test has already
            found that each ray's line meets its triangle, and that result must be right: t is clamped to the triangle's box,
            which turns a NaN into a hit.
        lanes: one ray x W triangles, and W rays x one triangle.
    """

    name: str
    record: Record = VERTICES
    ray_state: type
    prepare: wp.Function
    native: str = ""
    lanes: LaneForm | HandWritten

    @property
    def needs_shared_origin(self) -> bool:
        """Whether all rays of a batch must start at the same point."""
        return self.record.per_origin

    def block_test(self, width: int) -> wp.Function:
        """`wp.func(records, block, ray, t, u, v) -> uint32` mask of the W triangles of a block that the ray's line meets."""
        return self.lanes.block_test(self.record, self.ray_state, width)

    @property
    def packet_form(self) -> PacketForm:
        """W rays x one triangle."""
        return self.lanes.packet_form


@dataclass(frozen=True, kw_only=True)
class TriangleTest(TestForm):
    """A published ray-triangle test.

    Attributes:
        name: key in `TRIANGLE_TESTS`.
        paper: authors, title, year.
        watertight: whether no ray can pass between two triangles that share an edge or a vertex.
        accurate: whether every hit is near the triangle, whatever its shape: the bound is in
            `wrt.kernels.triangle.watertight.woop_areas`. Other tests may report hits beside needles and beside triangles seen
            edge-on.
        two_sided: whether both sides of a triangle are hit.
        intersect: `wp.func(ray, triangle) -> vec3 (t, u, v)`; t is NaN for a miss. `triangle` is what `record.load` returns. It
            performs the same operations as the lane loops, in plain Warp.
        line_test: width -> `block_test` that does not write t, u and v, for streams. It may return more lanes than are
            hit, because they are tested again. None if the compiler derives it from `block_test` by removing unused results.
        crossing: the forms that count crossings exactly; None if the test has none.
        oriented: the same, with the sign of a crossing in place of u: 1 where the ray leaves through the triangle's front,
            from which the triangle is wound counter-clockwise, -1 where it comes in through it; None likewise.
        any_hit: key in `TRIANGLE_TESTS` of the test that replaces this one in any-hit queries; empty for the test itself.
        own_candidate: width -> `wp.func(records, slot, ray, slabs, t_min) -> vec3 (t, u, v)`, by which streams decide about
            what is no triangle; None for `wrt.kernels.traversal.leaf.triangle_step`.
    """

    paper: str
    watertight: bool = False
    accurate: bool = False
    two_sided: bool = True
    intersect: wp.Function
    line_test: Callable[[int], wp.Function] | None = None
    crossing: CrossingForms | None = None
    oriented: CrossingForms | None = None
    any_hit: str = ""
    own_candidate: Callable[[int], wp.Function] | None = None

    def forms(self, crossing: bool, oriented: bool = False) -> CrossingForms:
        """The forms for one ray: those that count crossings exactly if `crossing`, with their signs if `oriented`, else the
        inclusive ones."""
        if oriented:
            return self.oriented
        return self.crossing if crossing else CrossingForms(self.intersect, self.block_test, self.line_test)


@dataclass(frozen=True, kw_only=True)
class ClassicTest:
    """What the table knows of a test of `wrt.kernels.classics.triangle` without importing it.

    Attributes:
        name, paper, watertight, accurate, two_sided, needs_shared_origin: as in `TriangleTest`.
        module: name below `wrt.kernels.classics.triangle` of the module that has the test as `TEST`, or among its `TESTS`.
    """

    name: str
    paper: str
    module: str
    watertight: bool = False
    accurate: bool = False
    two_sided: bool = True
    needs_shared_origin: bool = False

    def load(self) -> TriangleTest:
        """The test itself."""
        module = import_module(f"{CLASSICS}.triangle.{self.module}")
        tests = getattr(module, "TESTS", None)
        return module.TEST if tests is None else tests[self.name]


class TriangleTestTable(MutableMapping[str, TriangleTest]):
    """Triangle tests by name. A classic is imported when it is first looked up; `rows` imports nothing.

    The tests of points (`wrt.kernels.clouds.cloud_test.TESTS`) are found by their names, but not listed: they are no choice.
    """

    def __init__(self, rows: Iterable[TriangleTest | ClassicTest]) -> None:
        self._rows = {row.name: row for row in rows}

    @property
    def rows(self) -> Mapping[str, TriangleTest | ClassicTest]:
        """Tests, and rows of those that nobody has asked for: names, papers and flags of all."""
        return MappingProxyType(self._rows)

    def __getitem__(self, name: str) -> TriangleTest:
        row = self._rows.get(name)
        if row is None:
            return import_module("wrt.kernels.clouds.cloud_test").TESTS[name]
        if isinstance(row, ClassicTest):
            row = self._rows[name] = row.load()
        return row

    def __setitem__(self, name: str, test: TriangleTest) -> None:
        self._rows[name] = test

    def __delitem__(self, name: str) -> None:
        del self._rows[name]

    def __contains__(self, name: object) -> bool:
        return name in self._rows

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)
