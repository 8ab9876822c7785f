"""Ray-triangle tests: one file per published test, and the table of them.

**Contract.** A test is a `TriangleTest`: a record of floats a triangle (`wrt.kernels.triangle.records`), a struct per ray
that `prepare` makes once before a traversal, and the intersection itself in three forms that give the same bits: one ray x
one triangle in plain Warp (`intersect`), one ray x W triangles (`block_test`) and W rays x one triangle (`packet_form`) as
lane loops. A test decides whether the ray's *line* meets the triangle and where; whether that t counts is the traversal's
business, by one rule for all tests (`wrt.kernels.boxes`). A NaN anywhere must come out as a miss.

To add a test: write its file, add one line to `TRIANGLE_TESTS`; tests, command line and benchmarks pick it up.
"""

from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from wrt.kernels.triangle import komatsu, moeller_trumbore, woop
from wrt.kernels.triangle.records import CORNERS, CrossingForms, PacketForm, Record


@dataclass(frozen=True)
class TriangleTest:
    """A published ray-triangle test.

    Attributes:
        name: key in `TRIANGLE_TESTS`.
        paper: authors, title, year.
        watertight: whether no ray can pass between two triangles that share an edge or a vertex.
        accurate: whether every hit lies within `wrt.kernels.boxes.SLACK` times the ray's reach of the triangle; others may
            report hits beside needles and beside triangles that they see edge-on.
        two_sided: whether both sides of a triangle are hit.
        needs_shared_origin: whether all rays of a batch must have the same origin, for which records are made; such a test
            sees only what lies ahead.
        record: how a triangle is stored.
        ray_state: struct that `prepare` returns.
        prepare: `wp.func(origin, direction) -> ray`, once per ray.
        intersect: `wp.func(ray, loaded record) -> vec3 (t, u, v)`; t is NaN for a miss.
        block_test: width W -> `wp.func(records, block, ray, t, u, v) -> uint32` mask of lanes hit.
        packet_form: W rays x one triangle.
        crossing: the forms that count crossings exactly; None if it has none.
    """

    name: str
    paper: str
    watertight: bool
    accurate: bool
    two_sided: bool
    needs_shared_origin: bool
    record: Record
    ray_state: type
    prepare: wp.Function
    intersect: wp.Function
    block_test: Callable[[int], wp.Function]
    packet_form: PacketForm
    crossing: CrossingForms | None = None

    def forms(self, crossing: bool) -> CrossingForms:
        """The forms for one ray: those that count crossings exactly, or the inclusive ones."""
        return self.crossing if crossing else CrossingForms(self.intersect, self.block_test)


TRIANGLE_TESTS: dict[str, TriangleTest] = {
    test.name: test
    for test in (
        TriangleTest(
            name="woop",
            paper="Woop, Benthin, Wald: Watertight ray/triangle intersection (2013)",
            watertight=True,
            accurate=True,
            two_sided=True,
            needs_shared_origin=False,
            record=CORNERS,
            ray_state=woop.ShearedRay,
            prepare=woop.prepare,
            intersect=woop.intersect,
            block_test=woop.block_test,
            packet_form=woop.PACKET,
            crossing=woop.CROSSING,
        ),
        TriangleTest(
            name="moeller_trumbore",
            paper="Moeller, Trumbore: Fast, minimum storage ray/triangle intersection (1997)",
            watertight=False,
            accurate=False,
            two_sided=True,
            needs_shared_origin=False,
            record=CORNERS,
            ray_state=moeller_trumbore.PlainRay,
            prepare=moeller_trumbore.prepare,
            intersect=moeller_trumbore.intersect,
            block_test=moeller_trumbore.block_test,
            packet_form=moeller_trumbore.PACKET,
        ),
        TriangleTest(
            name="komatsu",
            paper="Komatsu, Kaeriyama, Suzuki, Takizawa, Kobayashi: A fast ray frustum-triangle intersection algorithm (2008)",
            watertight=False,
            accurate=False,
            two_sided=True,
            needs_shared_origin=True,
            record=komatsu.RECORD,
            ray_state=komatsu.ScaledRay,
            prepare=komatsu.prepare,
            intersect=komatsu.intersect,
            block_test=komatsu.block_test,
            packet_form=komatsu.PACKET,
        ),
    )
}
