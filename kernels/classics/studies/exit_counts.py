"""Counts at which exit tests end, from the same steps that the engine compiles.

A test of a ray and a triangle ends at the step whose condition fails, or with a hit. Lanes run in lockstep: a vector ends at
the step at which its last lane ends. The kernels count both, for groups of any shape: frusta of R rays x one triangle, one ray
x G triangles, or R x G. The first count bounds what early exits can save; the second is what they save in lockstep. Tests
that leave behind the closest hit so far find the one before the test, within a group, too.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.triangle.support.lane_form import FAR, LaneForm
from wrt.kernels.triangle.support.record_blocks import VERTEX_COMPONENTS
from wrt.kernels.triangle.support.triangle_contract import TestForm


@cache
def exit_of(test: TestForm) -> wp.Function:
    """`wp.func(records, slot, width, ray, far, i) -> int`: the step at which a test ends; the number of steps for a hit.

    `far[i]` is the closest hit of ray i so far, for a form that reads it.
    """
    if isinstance(test.lanes, LaneForm):
        return exit_of_form(test.lanes, test.ray_state)
    RayState, intersect, load = test.ray_state, test.intersect, test.record.load

    @wp.func
    def end(records: wp.array(dtype=float), slot: int, width: int, ray: RayState, far_of: wp.array(dtype=float), i: int):
        hit = intersect(ray, load(records, slot, width))
        return wp.where(hit[0] == hit[0], 1, 0)

    return end


@cache
def exit_of_form(form: LaneForm, ray_state: type) -> wp.Function:
    """As `exit_of`, from the steps of a form."""
    RayState, components = ray_state, form.components
    text = f"    constexpr int COMPONENTS = {VERTEX_COMPONENTS + len(form.triangle)}, i = 0;\n"
    text += "    const float* r = &records.data[(size_t)(slot / width) * (COMPONENTS * width) + slot % width];\n"
    scalars = {value.name: "far_of.data[ray_number]" if value == FAR else value.scalar for value in form.ray}
    text += "".join(f"    const float {name} = {scalar};\n" for name, scalar in scalars.items())
    text += "".join(f"    float kept_{name}[1];\n" for name in form.kept())
    for number, step in enumerate(form.steps):
        code = form.lane_code(
            number, lambda step: [f"const float {n} = r[{components[n]} * width];" for n in step.reads(components)]
        )
        text += f"    {{\n{code}\n        if (!({step.passes})) return {number};\n    }}\n"
    text += f"    {'far_of.data[ray_number] = kept_t[0];' if FAR in form.ray else ''}\n    return {len(form.steps)};\n"

    @native.func_native("lanes.h", text)
    def end(
        records: wp.array(dtype=float), slot: int, width: int, ray: RayState, far_of: wp.array(dtype=float), ray_number: int
    ) -> int: ...

    return end


@cache
def make_kernel(test: TestForm) -> wp.Kernel:
    """Counts where the tests of groups of rays against all triangles end.

    One item is a group of `group_rays` rays. It writes a row of `counts`: first the number of tests per end, then the number of
    groups of `group_rays` x `group_triangles` tests per end of their last test. The last group of triangles may be smaller.
    `far_of` holds infinity for each ray, and afterwards its closest hit if the form reads it.
    """
    prepare, end = test.prepare, exit_of(test)
    ends = len(test.lanes.exits) + 1

    def count_exits(
        first: int,
        records: wp.array(dtype=float),
        triangles: int,
        width: int,
        origins: wp.array(dtype=wp.vec3),
        origin_stride: int,
        directions: wp.array(dtype=wp.vec3),
        group_rays: int,
        group_triangles: int,
        far_of: wp.array(dtype=float),
        counts: wp.array2d(dtype=int),
    ):
        item = first + wp.tid()
        for block in range(0, triangles, group_triangles):
            last = int(0)
            for k in range(group_rays):
                i = item * group_rays + k
                ray = prepare(origins[i * origin_stride], directions[i])
                for slot in range(block, wp.min(block + group_triangles, triangles)):
                    here = end(records, slot, width, ray, far_of, i)
                    counts[item, here] = counts[item, here] + 1
                    last = wp.max(last, here)
            counts[item, wp.static(ends) + last] = counts[item, wp.static(ends) + last] + 1

    return specialised_kernel(count_exits)
