"""A triangle test as lane loops, written once: W triangles of a block for one ray, or W rays of a packet for one triangle.

The arithmetic of a test is the same whatever the lanes hold. A `LaneForm` is that arithmetic for one ray and one triangle, as
steps of C++ over named floats. Each step ends in a condition. Lanes that fail it leave, and the next step runs if any lane
remains (an early exit saves time only if all lanes take it). Two forms are made of it, by loops over lanes that take the steps
as functions (kernels/native/triangle.h):

* `block_test`: names of the triangle are loaded from W lanes of the block, names of the ray are scalars;
* `packet_form`: names of the ray are loaded from the packet, those of the triangle are scalars.

A test that does not fit into steps (`wrt.kernels.triangle.watertight.woop` recomputes some lanes) provides both by hand. In
both cases the bits are those of the test's scalar form in plain Warp: same operations, same order, no fused multiply-add.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache

import warp as wp

from wrt.kernels.triangle.support.operation_counts import Operations, count_operations
from wrt.kernels.triangle.support.record_blocks import VERTEX_COMPONENTS, Record, native_block_test

VERTEX_NAMES = ("ax", "ay", "az", "bx", "by", "bz", "cx", "cy", "cz")
"""Names of a triangle's vertices in the steps of every test."""

RESULT = ("t", "u", "v")

PACKET_VALUES = {
    "ox": "SHARED ? origin0[0] : origin_x[k]",
    "oy": "SHARED ? origin0[1] : origin_y[k]",
    "oz": "SHARED ? origin0[2] : origin_z[k]",
    "far": "t[k]",
}
"""Where a packet stores the origins of its rays and their closest hits so far, for every test."""


RAY_NUMBERS = ("x", "y", "z", "ox", "oy", "oz", "ix", "iy", "iz", "sx", "sy")
"""Numbers of `wrt::LoadedRay` that the preparation of a test may name."""


@dataclass(frozen=True)
class PacketForm:
    """W rays x one triangle: pieces of C++ that `wrt.kernels.traversal.packet` puts into its lane loops.

    Free variables: `k` is the ray's number in the packet, `i` = k - f its lane, `corner` points at the record of the
    triangle, whose component c is `corner[c * W]`; `SHARED`, `origin0`, `origin_x` .. `origin_z` and the test's own
    components as in `wrt.kernels.traversal.packet.rays.packet_layout`; `bounds` are the packet's.

    Attributes:
        state: names of the components that the test keeps per ray.
        passes: 1, or 3 for one pass over the rays of each main axis (bit `pass` of `bounds.passes` tells which occur).
        prepare: per ray; computes the state from direction x, y, z, origin ox, oy, oz, inverse ix, iy, iz, slopes sx, sy and
            `main_x`, `main_y`.
        triangle: once per triangle and pass.
        inside: for the W rays from f on; declares `int inside[W]`, nonzero where the ray's line meets the triangle, and
            executes `continue` if no line meets it.
        hit: per ray, sets `at`, `hit_u`, `hit_v`.
        ray: for the single ray k; sets the members of `ray`, the struct that the test's `prepare` returns, which `block_test`
            reads.
        rays: once, before all else.
        pairs: C++ expression, after `rays`, of the same test for rays that have a triangle each (`WoopPairs` in
            kernels/native/woop_packets.h), for Clang on the CPU; empty for a test without it.
        headers: those of kernels/native that the pieces use.
        certain: whether a ray that passes well inside a triangle always hits it, for whatever triangle is large enough as seen
            from the ray's origin (`wrt.kernels.traversal.packet.leaves.covering_triangle`).
    """

    state: tuple[str, ...]
    passes: int
    prepare: str
    triangle: str
    inside: str
    hit: str
    ray: str
    rays: str = ""
    pairs: str = ""
    headers: str = ""
    certain: bool = False

    @property
    def triangles(self) -> str:
        """C++ expression for the test as the loops over triangles take it (kernels/native/packet_leaves.h)."""
        hit = f"[&](int i, int k) {{ float at, hit_u, hit_v; {self.hit} return wrt::TriangleHit<float>{{at, hit_u, hit_v}}; }}"
        lines = f"[&](int f, const auto& accept) {{ do {{ {self.inside} accept(inside, {hit}); }} while (false); }}"
        return f"[&](const float* corner, int pass, const auto& each) {{ {self.triangle} each({lines}); }}"

    @property
    def preparation(self) -> str:
        """C++ expression for what computes the state of ray k of a packet (kernels/native/packet_load.h)."""
        numbers = ", ".join(f"{name} = ray.{name}" for name in RAY_NUMBERS)
        names = f"const float {numbers}; const bool main_x = ray.main_x, main_y = ray.main_y;"
        return f"[=](int k, const wrt::LoadedRay& ray) {{ {names} {self.prepare} }}"


@dataclass(frozen=True)
class HandWritten:
    """Both lane loops of a test, written out.

    Attributes:
        make_block_test: width W -> `wp.func(records, block, ray, t, u, v) -> uint32` mask of the lanes whose triangle the
            ray's line meets; t, u, v (`wp.ref` of W floats) are valid there.
        packet_form: W rays x one triangle.
        operations: those of a test that misses, and those that a hit adds; empty if they were not counted.
        exits: as `Step.exit`. A single exit, because the exits inside the code are not distinguished.
    """

    make_block_test: Callable[[int], wp.Function]
    packet_form: PacketForm
    operations: tuple[Operations, ...] = ()
    exits: tuple[str, ...] = ("the line passes beside the triangle",)

    def block_test(self, record: Record, ray_state: type, width: int) -> wp.Function:
        """One ray x W triangles."""
        return self.make_block_test(width)


@dataclass(frozen=True)
class RayValue:
    """A number of the ray that steps may name.

    Attributes:
        name: name in the steps.
        scalar: C++ expression that reads it from `ray`, the struct that the test's `prepare` returns.
        packet: C++ expression over the names of `PacketForm.prepare` that computes the number, which the packet then stores.
            Empty for the origin and `far`, which packets already store.
    """

    name: str
    scalar: str
    packet: str = ""


ORIGIN = tuple(RayValue(f"o{axis}", f"ray.origin.c[{i}]") for i, axis in enumerate("xyz"))
"""ox, oy, oz, of a struct with an `origin`."""

DIRECTION = tuple(RayValue(f"d{axis}", f"ray.direction.c[{i}]", axis) for i, axis in enumerate("xyz"))
"""dx, dy, dz, of a struct with a `direction`."""

FAR = RayValue("far", "ray.far")
"""Where the ray ends: at its closest hit so far. Only published forms of tests read it (`wrt.kernels.classics.studies`), which
have this exit; in the engine the traversal compares t."""


@dataclass(frozen=True)
class Step:
    """A part of a test up to an exit.

    Attributes:
        exit: a short description of the rays that leave here.
        code: C++ statements that declare `const float`s; selects instead of branches.
        passes: C++ condition without branches (`&`, not `&&`); must be false for NaN.
        keeps: names declared here that later steps read.
    """

    exit: str
    code: str
    passes: str
    keeps: tuple[str, ...] = ()

    def reads(self, names: Iterable[str]) -> list[str]:
        """The given names that occur in the step."""
        words = set(re.findall(r"[A-Za-z_]\w*", self.code + self.passes))
        return [name for name in names if name in words]

    @property
    def operations(self) -> Operations:
        """Number of operations of the step."""
        return count_operations(f"{self.code};{self.passes}")


@dataclass(frozen=True)
class LaneForm:
    """The arithmetic of a test.

    Attributes:
        ray: numbers of the ray.
        steps: in order; the last one, or those before it, declare `t`, `u` and `v`.
        triangle: names of the record's own floats, in order; the vertices are ax ay az bx by bz cx cy cz.
        packet_setup: C++ before the `packet` expressions of `ray`.
        apart: of a form made by `joined`, the form with all exits, which `wrt.kernels.classics.studies.exit_counts` counts.
    """

    ray: tuple[RayValue, ...]
    steps: tuple[Step, ...]
    triangle: tuple[str, ...] = ()
    packet_setup: str = ""
    apart: "LaneForm | None" = None

    @property
    def exits(self) -> tuple[str, ...]:
        """A description of the rays that leave, for each step."""
        return tuple(step.exit for step in self.steps)

    @property
    def operations(self) -> tuple[Operations, ...]:
        """Number of operations of each step."""
        return tuple(step.operations for step in self.steps)

    def joined(self, *counts: int) -> "LaneForm":
        """The same test with fewer exits: each count joins that many consecutive steps into one. Same arithmetic, same bits.

        Lanes leave together or not at all, so an exit that few vectors take costs more than it saves.

        Raises:
            ValueError: the counts do not sum to the number of steps.
        """
        if sum(counts) != len(self.steps):
            raise ValueError(f"counts {counts} do not sum to the {len(self.steps)} steps of the form")
        steps, first = [], 0
        for count in counts:
            group, later = self.steps[first : first + count], self.steps[first + count :]
            names = (name for step in group for name in step.keeps)
            kept = tuple(name for name in names if name in RESULT or any(step.reads([name]) for step in later))
            exits, passes = (step.exit for step in group), (f"({step.passes})" for step in group)
            steps.append(Step(" or ".join(exits), "\n".join(step.code for step in group), " & ".join(passes), kept))
            first += count
        return replace(self, steps=tuple(steps), apart=self.apart or self)

    def block_test(self, record: Record, ray_state: type, width: int) -> wp.Function:
        """One ray x W triangles; see `HandWritten`."""
        if len(self.triangle) != record.own:
            raise ValueError(f"the form names {len(self.triangle)} floats of a record of {record.own}")
        return make_block_test(self, ray_state, width)

    @property
    def packet_form(self) -> PacketForm:
        """W rays x one triangle."""
        kept = [value for value in self.ray if value.packet]
        prepare = "".join(f"        ray_{value.name}[k] = {value.packet};\n" for value in kept)
        return PacketForm(
            state=tuple(f"ray_{value.name}" for value in kept),
            passes=1,
            prepare=self.packet_setup + prepare,
            triangle="".join(f"            const float {n} = corner[{c} * W];\n" for n, c in self.components.items()),
            inside=self.packet_steps(),
            hit="at = kept_t[i]; hit_u = kept_u[i]; hit_v = kept_v[i];",
            ray="".join(f"    {value.scalar} = {source};\n" for value, source in zip(self.ray, self.sources, strict=True)),
            headers="triangle.h",
        )

    @property
    def sources(self) -> tuple[str, ...]:
        """C++ expressions for the numbers of ray k of a packet, in the order of `ray`."""
        return tuple(f"ray_{value.name}[k]" if value.packet else PACKET_VALUES[value.name] for value in self.ray)

    @property
    def components(self) -> dict[str, int]:
        """Component of the record for each name of the triangle that a step reads."""
        numbers = dict(zip((*VERTEX_NAMES, *self.triangle), range(VERTEX_COMPONENTS + len(self.triangle)), strict=True))
        return {name: numbers[name] for name in numbers if any(step.reads([name]) for step in self.steps)}

    def kept(self) -> tuple[str, ...]:
        """Names that later steps read."""
        return tuple(dict.fromkeys((*(name for step in self.steps for name in step.keeps), *RESULT)))

    def lane_code(self, number: int, declare: Callable[[Step], list[str]]) -> str:
        """C++ for one lane and one step: loads, arithmetic, stores."""
        step = self.steps[number]
        before = dict.fromkeys(name for earlier in self.steps[:number] for name in earlier.keeps)
        lines = [*declare(step), *(f"const float {name} = kept_{name}[i];" for name in step.reads(before)), step.code.strip()]
        stored = set(step.keeps)
        if number == len(self.steps) - 1:
            stored |= {name for name in RESULT if name not in before}
        return "\n".join([*lines, *(f"kept_{name}[i] = {name};" for name in sorted(stored))])

    def packet_steps(self) -> str:
        """C++ of `PacketForm.inside`."""
        return f"int inside[W];\n{self.memory()}{self.packet_loops()}"

    def packet_loops(self) -> str:
        """C++ that fills what `packet_steps` declares."""
        values = {value.name: source for value, source in zip(self.ray, self.sources, strict=True)}

        def declare(step: Step) -> list[str]:
            return ["const int k = f + i;", *(f"const float {name} = {values[name]};" for name in step.reads(values))]

        return f"if (!wrt::packet_steps<W>(inside{self.step_functions(declare)})) continue;\n"

    def memory(self) -> str:
        """C++ of the arrays that keep what later steps read."""
        return "".join(f"float kept_{name}[W];\n" for name in self.kept())

    def step_functions(self, declare: Callable[[Step], list[str]]) -> str:
        """C++: for each step a comma and a function of the lane, for the loops of kernels/native/triangle.h."""
        return "".join(
            f",\n[&](int i) {{\n{self.lane_code(number, declare)}\nreturn {step.passes};\n}}"
            for number, step in enumerate(self.steps)
        )


@cache
def make_block_test(form: LaneForm, ray_state: type, width: int) -> wp.Function:
    """One ray x W triangles, by a loop over lanes for each step."""
    components = form.components

    def declare(step: Step) -> list[str]:
        return [f"const float {name} = r[{components[name]} * W + i];" for name in step.reads(components)]

    text = f"constexpr int W = {width}, COMPONENTS = {VERTEX_COMPONENTS + len(form.triangle)};\n"
    text += "const float* r = &records.data[(size_t)block * (COMPONENTS * W)];\n"
    text += "".join(f"const float {value.name} = {value.scalar};\n" for value in form.ray) + form.memory()
    text += f"const unsigned mask = wrt::block_steps<W>(~0u{form.step_functions(declare)});\nif (!mask) return mask;\n"
    text += "WRT_FOR_LANES(i) { t.c[i] = kept_t[i]; u.c[i] = kept_u[i]; v.c[i] = kept_v[i]; }\nreturn mask;\n"
    return native_block_test(ray_state, width, text)
