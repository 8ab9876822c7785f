"""For programs in Warp: ray queries inside your own kernels, on the CPU and on CUDA, and hits with gradients.

    import warp as wp
    import wrt

    @wrt.device.kernel
    def thickness(first: int, scene: wrt.device.SceneHandle, points: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
        i = first + wp.tid()
        down = wp.vec3(0.0, 0.0, -1.0)
        hit = wrt.device.first_hit(scene, points[i], down, 0.0, wp.inf)
        while hit.primitive_id >= 0:
            leaves = wrt.device.next_hit(scene, points[i], down, hit, wp.inf)
            out[i] += wp.where(leaves.primitive_id >= 0, leaves.t - hit.t, 0.0)
            hit = wrt.device.next_hit(scene, points[i], down, leaves, wp.inf)

    wrt.device.launch(thickness, len(points), [scene.handle(), points, out])

A kernel receives a scene as `scene.handle()`, the scene in its present state, in a parameter of type `SceneHandle`. For one
ray at a time, it can call:

* `closest_hit(scene, origin, direction, t_min, t_max)`: a `Hit` with the fields t, primitive_id, geometry_id, instance_id and
  uv, bit for bit as `Scene.intersect` returns them;
* `any_hit(...)`: a bool, as `Scene.occluded`; `count_hits(...)`: an int, as `Scene.count`;
* `first_hit(...)`, then `next_hit(scene, origin, direction, hit, t_max)` until it misses: all hits, as
  `Scene.intersect_all`. Each call is a new search from the previous hit on: nothing is stored, and the number of hits is
  not limited;
* `hit_where(accept)` makes a function: the first hit of a ray that a `wp.func` of yours accepts;
* `closest_point(scene, point, max_distance)`: a `Hit` whose t is the distance, as `Scene.closest_point`;
* `position(scene, hit)`, `normal(scene, hit)`, `faces(scene, hit, direction)`, `spawn(scene, hit, direction)`: as in
  `wrt.Hits`;
* `seeing(scene, mask, environment)`: in a scene of instances, the handle for rays that see those instances only, as `mask` and
  `environment` of `Scene.intersect`. `Scene.handle(mask=..., environment=...)` chooses for all rays.

Positions are in the scene's coordinates, vec3 or vec3d; the functions subtract the scene's centre in float64. A kernel that
calls them must be made by `kernel`, or by `wp.kernel` with the same options: without gradients, which these functions do
not have, and without fused multiply-add, which would change hits and let rays slip between triangles. Other kernels are
refused. A kernel is compiled once for each kind, width and depth (in steps of eight levels) of tree that it is launched
with. Results are the same on every device.

More functions for programs in Warp: `differentiable_hits` and `differentiable_points` give hits and closest points with
gradients for a `wp.Tape`, `show_compiling` shows the progress of compiling, and `set_auto` chooses how "auto" finds the fastest
engine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.engine.launch.persistent_launch import binary_parts, binary_tree
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.plan.plan import Plan, stack_levels
from wrt.kernels.layout.binary_nodes import WIDTH
from wrt.kernels.points.device_points import add_point_search, closest_point
from wrt.kernels.query.binary.binary_handles import binary_handle_type, binary_instances_handle_type
from wrt.kernels.query.device_filters import hit_where
from wrt.kernels.query.device_functions import (
    TRIANGLE_TEST,
    Hit,
    any_hit,
    check_options,
    closest_hit,
    count_hits,
    faces,
    first_hit,
    handle_type,
    instances_handle_type,
    is_handle,
    next_hit,
    normal,
    position,
    seeing,
    spawn,
)
from wrt.kernels.runtime import launch as launching
from wrt.kernels.validation import as_int
from wrt.lazy_names import lazy_names
from wrt.meshes.instance import EVERY, MAX_MASK, check_environment, check_mask
from wrt.tapes import takes_gradients, tape_records

if TYPE_CHECKING:  # these are the names of `_HOME`, for type checkers
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.choices import get_auto as get_auto
    from wrt.engine.plan.choices import set_auto as set_auto
    from wrt.kernels.compilation.compile_progress import show_compiling as show_compiling
    from wrt.query.gradients import differentiable_hits as differentiable_hits
    from wrt.query.points.differentiable_points import differentiable_points as differentiable_points

_HOME = {
    "differentiable_hits": "wrt.query.gradients",
    "differentiable_points": "wrt.query.points.differentiable_points",
    "get_auto": "wrt.engine.plan.choices",
    "set_auto": "wrt.engine.plan.choices",
    "show_compiling": "wrt.kernels.compilation.compile_progress",
}

__all__ = [
    "Hit",
    "SceneHandle",
    "any_hit",
    "closest_hit",
    "closest_point",
    "count_hits",
    "faces",
    "first_hit",
    "hit_where",
    "kernel",
    "launch",
    "next_hit",
    "normal",
    "position",
    "seeing",
    "spawn",
    *_HOME,
]

if not TYPE_CHECKING:  # type checkers refuse names that are not there
    __getattr__, __dir__ = lazy_names(__name__, _HOME)

SceneHandle = Any
"""Type of a kernel parameter that takes a scene's handle. (Scenes with different kinds of tree have different handle types.)"""

kernel: Callable[[Callable], wp.Kernel] = partial(
    wp.kernel, module="unique", enable_backward=False, module_options={"fuse_fp": False}
)
"""`wp.kernel` with the options that ray queries need: the decorator for kernels that call them."""


def launch(
    kernel: wp.Kernel,
    count: int,
    inputs: Sequence[Any],
    *,
    device: str | wp.Device | None = None,
    num_threads: int | None = None,
    chunk: int = 256,
) -> None:
    """Runs a kernel over the items 0 .. count - 1, on the CPU with all threads. (`wp.launch` uses one CPU thread.)

    On the CPU the items are divided into chunks; the result must not depend on how. On CUDA this is a single launch. Inside
    a `wp.Tape`, a kernel with gradients is launched once, and the tape records it; kernels that call ray queries have no
    gradients.

    Args:
        kernel: its first parameter is `first: int`; it works on item `first + wp.tid()`.
        count: number of items.
        inputs: the kernel's other arguments.
        device: device of the arguments; None for Warp's default device.
        num_threads: number of CPU threads; None for `wrt.get_num_threads()`.
        chunk: on the CPU, the smallest number of items for which a launch of its own (about 20 us) pays.

    Raises:
        TypeError: `kernel` is not a kernel or has another first parameter; `num_threads` is not an int.
        ValueError: there is no such device, or `num_threads` is out of range; an array on another device; a kernel with a
            scene among its inputs was not made by `kernel`; inside a `wp.Tape`, an array requires gradients and the kernel has
            none.
    """
    if not isinstance(kernel, wp.Kernel):
        raise TypeError(f"kernel must be made by wrt.device.kernel or wp.kernel, not {type(kernel).__name__}")
    if not kernel.adj.args or kernel.adj.args[0].label != "first":
        raise TypeError(f"kernel {kernel.key!r} needs `first: int` as its first parameter, the first item of a chunk")
    count, chunk = as_int("count", count, 0), as_int("chunk", chunk, 1)
    if num_threads is not None:
        num_threads = launching.check_num_threads(num_threads, "num_threads")
    target = launching.as_device(device)
    differentiable = has_backward(kernel)
    if any(map(is_handle, inputs)):
        check_options(f"kernel {kernel.key!r}", differentiable, kernel.module.options["fuse_fp"])
    if tape_records():
        if differentiable:  # one launch, which the tape keeps
            wp.launch(kernel, dim=count, inputs=[0, *inputs], device=target)
            return
        if any(map(takes_gradients, inputs)):
            raise ValueError(
                f"kernel {kernel.key!r} is compiled without gradients, and inside a wp.Tape some of its arrays require them; "
                "launch it before the tape, or pass wp.clone(array, requires_grad=False); to differentiate hits, call "
                "wrt.device.differentiable_hits inside the tape"
            )
    check_devices(kernel, inputs, target)
    if kernel.is_generic:
        kernel = kernel.add_overload(kernel.infer_argument_types([0, *inputs]))
        launching.load_changed(kernel, target)
    with launching.use_threads(num_threads):
        launching.launch(kernel, count, inputs, device=target, chunk=chunk)


def check_devices(kernel: wp.Kernel, inputs: Sequence[Any], device: wp.Device) -> None:
    """Refuses arrays that a device cannot read: repeated launches are packed without Warp's own checks.

    Raises:
        ValueError: there is one.
    """
    for argument, value in zip(kernel.adj.args[1:], inputs, strict=False):
        if isinstance(value, wp.array) and value.device != device and not wp.can_access(device, value):
            raise ValueError(
                f"argument {argument.label!r} of kernel {kernel.key!r} is on {value.device}, and the launch on {device}; copy "
                f"it there with .to({str(device)!r})"
            )


def has_backward(kernel: wp.Kernel) -> bool:
    """Whether a kernel is compiled with gradients."""
    own = kernel.options.get("enable_backward")
    return bool(kernel.module.options["enable_backward"] if own is None else own)


def handle_of(scene: SceneState, mask: int | None = None, environment: int | None = None) -> Any:
    """The kernel argument for a scene: `Scene.handle`."""
    scene.require("handle")
    scene.require_opaque("a handle")
    if mask is not None or environment is not None:
        scene.require_instances("mask and environment of a handle")
    mask = MAX_MASK if mask is None else check_mask(mask)
    environment = EVERY if environment is None else check_environment(environment)
    scene.complete()
    plan = Plan(
        accelerator=scene.accelerator.kind,
        traversal="single",
        triangle_test=TRIANGLE_TEST,
        width=scene.width,
        coherent=False,
        shared_origin=False,
        reason="inside a kernel",
    )
    levels = stack_levels(scene.tree.depth) if plan.accelerator == "bvh" or scene.instances else 0
    binary = walks_binary(scene)
    make: Any
    if scene.instances:
        make = partial(instances_handle_type, plan.accelerator, plan.width)
        kind = launching.specialise(binary_instances_handle_type if binary else make, levels)  # type: ignore[arg-type]
        handle = kind()
        handle.top, handle.parts = scene.upper(), binary_parts(scene) if binary else scene.lower(plan, None)
        handle.mask, handle.environment = wp.uint32(mask), environment
    else:
        make = partial(handle_type, plan.accelerator, plan.width, shared_leaves=scene.shares_leaves)
        kind = launching.specialise(binary_handle_type if binary else make, levels)  # type: ignore[arg-type]
        handle = kind()
        own = binary_tree(scene) if binary else (scene.tree.struct(), records_of(scene, plan, None))
        handle.tree, handle.triangles = own
    tree = "binary" if binary else plan.accelerator
    launching.specialise(partial(add_point_search, kind, tree, plan.width), bool(scene.instances))  # type: ignore[arg-type]
    handle.mesh = scene.device_mesh
    fill_gaps(handle, scene.device)
    return handle


def walks_binary(scene: SceneState) -> bool:
    """Whether rays of users' kernels walk the layout of persistent threads, which is made for CUDA."""
    is_plain = not (scene.only_single or scene.area_trees is not None or any(part.shares_leaves for part in scene.parts))
    return scene.device.is_cuda and is_plain and scene.accelerator.kind == "bvh" and scene.width == WIDTH


def fill_gaps(struct: Any, device: wp.Device) -> None:
    """Fills unset arrays of a struct with empty ones: the backward pass of a `wp.Tape` visits each array."""
    for name, variable in struct._cls.vars.items():
        value = getattr(struct, name)
        if value is None:
            kind = variable.type
            setattr(struct, name, wp.empty((0,) * kind.ndim, dtype=kind.dtype, device=device))
        elif hasattr(value, "_cls"):
            fill_gaps(value, device)
