"""What a caller chose for a scene, checked."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from wrt.accelerators.accelerator import Accelerator, resolve_accelerator
from wrt.engine.facts.query_kinds import AUTO
from wrt.kernels.runtime.launch import as_device, check_num_threads, refuse_capture
from wrt.tables import lookup


@dataclass(frozen=True)
class Settings:
    """What the caller chose for a scene.

    Attributes:
        accelerator: the description of its tree.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
        device: where it lives.
        num_threads: threads on the CPU; None for `wrt.get_num_threads()`.
    """

    accelerator: Accelerator
    triangle_test: str
    device: wp.Device
    num_threads: int | None = None


def as_settings(
    accelerator: str | Accelerator, triangle_test: str, device: str | wp.Device | None, num_threads: int | None
) -> Settings:
    """The checked settings of a caller; arguments and errors as in `wrt.Scene`; RuntimeError while a graph is captured."""
    # Imported here, before any thread queries the scene: the modules of this package import one another, and threads that
    # enter it from two ends at a time fail.
    import wrt.kernels.traversal  # noqa: F401

    target = as_device(device)
    refuse_capture("building a scene", target)
    return Settings(
        accelerator=resolve_accelerator(accelerator),
        triangle_test=_as_test(triangle_test),
        device=target,
        num_threads=None if num_threads is None else check_num_threads(num_threads, "num_threads"),
    )


def _as_test(name: str) -> str:
    if name == AUTO:
        return name
    from wrt.kernels.triangle import TRIANGLE_TESTS

    return lookup(TRIANGLE_TESTS, name, "triangle_test").name
