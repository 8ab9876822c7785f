"""Triangle tests without a tree, from Python: what is timed, where tests end, and what they answer.

Soup        triangles, and what each test computes of them beforehand
closest     all rays of frusta, or one by one, against all triangles
exits       where tests end, lane by lane and vector by vector
pairs       ray i against triangle i
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.classics.studies.bare_triangle_tests import make_blocks, make_frusta, make_pairs, make_scalar
from wrt.kernels.classics.studies.dammertz_keller import ScalarTest
from wrt.kernels.classics.studies.exit_counts import make_kernel as make_exits
from wrt.kernels.runtime.launch import launch
from wrt.kernels.triangle.support.block_packing import pack_blocks
from wrt.kernels.triangle.support.operation_counts import Operations
from wrt.kernels.triangle.support.record_blocks import Record, TriangleBlocks
from wrt.kernels.triangle.support.triangle_contract import TestForm

CPU = "cpu"


@dataclass(frozen=True)
class Exits:
    """Where tests of one kind ended.

    Attributes:
        names: what is known at each exit; the last one is "hit".
        tests: pairs of a ray and a triangle that ended there, in the order of `names`.
        vectors: groups of pairs whose last pair ended there.
    """

    names: tuple[str, ...]
    tests: tuple[int, ...]
    vectors: tuple[int, ...]

    @property
    def hit_rate(self) -> float:
        """Share of the pairs that are hits."""
        return self.tests[-1] / sum(self.tests)

    def operations(self, steps: tuple[Operations, ...], of_vectors: bool = False) -> float | None:
        """Arithmetic operations a test on the average, if lanes leave alone or (`of_vectors`) together; None if unknown."""
        if not steps:
            return None
        counts = self.vectors if of_vectors else self.tests
        done = sum(step.arithmetic * sum(counts[number:]) for number, step in enumerate(steps))
        return done / sum(counts)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, shares in place of counts."""
        tests, vectors = (np.array(counts) / sum(counts) for counts in (self.tests, self.vectors))
        return {
            "tests": sum(self.tests),
            "hit_rate": self.hit_rate,
            "exits": [
                {"exit": name, "tests": float(a), "vectors": float(b)}
                for name, a, b in zip(self.names, tests, vectors, strict=True)
            ],
        }


class Soup:
    """Triangles to be tested one by one.

    Args:
        corners: (F, 3, 3), anything that becomes float32.
        origin: (3,), where the rays of tests that need a shared origin start.
    """

    def __init__(self, corners: np.ndarray, origin: np.ndarray | None = None) -> None:
        self.corners = np.ascontiguousarray(corners, dtype=np.float32)
        self.origin = tuple(map(float, np.zeros(3) if origin is None else np.asarray(origin, dtype=np.float32)))
        self.vertices = wp.array(self.corners.reshape(-1, 3), dtype=wp.vec3, device=CPU)
        faces = np.arange(3 * len(self), dtype=np.int32).reshape(-1, 3)
        self.faces = wp.array(faces, dtype=wp.vec3i, device=CPU)
        self._packed: dict[tuple[Record, int], TriangleBlocks] = {}

    def __len__(self) -> int:
        """Number of triangles."""
        return len(self.corners)

    def pack(self, record: Record, width: int) -> TriangleBlocks:
        """The records, made again at each call."""
        ids = np.full(-(-len(self) // width) * width, -1, dtype=np.int32)
        ids[: len(self)] = np.arange(len(self))
        primitive = wp.array(ids, dtype=int, device=CPU)
        return pack_blocks(record, self.vertices, self.faces, primitive, width, self.origin)

    def records(self, record: Record, width: int) -> wp.array:
        """The records, made once."""
        if (record, width) not in self._packed:
            self._packed[record, width] = self.pack(record, width)
        return self._packed[record, width].records


@dataclass
class Beams:
    """Rays on the device.

    Attributes:
        origins: (N, 3) or (1, 3), which all rays share.
        directions: (N, 3).
    """

    origins: Any
    directions: Any
    count: int = field(init=False)
    stride: int = field(init=False)

    def __post_init__(self) -> None:
        origins = np.ascontiguousarray(self.origins, dtype=np.float32)
        directions = np.ascontiguousarray(self.directions, dtype=np.float32)
        self.count, self.stride = len(directions), int(len(origins) > 1)
        self.origins = wp.array(origins, dtype=wp.vec3, device=CPU)
        self.directions = wp.array(directions, dtype=wp.vec3, device=CPU)


Run = Callable[[], tuple[np.ndarray, np.ndarray]]
"""Runs tests and returns (t, id) of the closest hits; inf and -1 for a miss."""


def closest(test: TestForm | ScalarTest, soup: Soup, rays: Beams, *, frustum: int, width: int) -> Run:
    """What tests all rays against all triangles.

    Args:
        test: whose forms are compiled.
        soup: triangles.
        rays: from one origin, that of the soup, if `frustum` is positive or the test needs it; a multiple of `frustum`.
        frustum: rays that go together, a multiple of the width, `width` of them in lanes; 0: each ray alone, `width`
            triangles in lanes.
        width: lanes; 0: triangles one by one, by the scalar form.
    """
    if frustum and (frustum % width or rays.count % frustum or rays.stride):
        raise ValueError(f"{rays.count} rays do not make frusta of {frustum} in lanes of {width} from one origin")
    kernel = make_frusta(test, frustum, width) if frustum else make_blocks(test, width) if width else make_scalar(test)
    return traced(kernel, soup.records(test.record, max(width, 1)), len(soup), rays, max(frustum, 1))


def traced(kernel: wp.Kernel, records: wp.array, triangles: int, rays: Beams, group: int = 1) -> Run:
    """What launches a kernel of `wrt.kernels.classics.studies.bare_triangle_tests` that finds closest hits; group: rays of an
    item."""
    t, found = wp.empty(rays.count, dtype=float, device=CPU), wp.empty(rays.count, dtype=int, device=CPU)
    inputs = [records, triangles, rays.origins, rays.stride, rays.directions, t, found]

    def run() -> tuple[np.ndarray, np.ndarray]:
        launch(kernel, rays.count // group, inputs, device=wp.get_device(CPU), chunk=1)
        return t.numpy(), found.numpy()

    return run


def exits(test: TestForm, soup: Soup, rays: Beams, *, group_rays: int = 1, group_triangles: int = 1) -> Exits:
    """Where the tests of all rays against all triangles end; groups as in `wrt.kernels.classics.studies.exit_counts`."""
    names = (*test.lanes.exits, "hit")
    groups = rays.count // group_rays
    counts = wp.zeros((groups, 2 * len(names)), dtype=int, device=CPU)
    records = soup.records(test.record, 1)
    sizes = [group_rays, group_triangles]
    far = wp.full(rays.count, np.inf, dtype=float, device=CPU)
    inputs = [records, len(soup), 1, rays.origins, rays.stride, rays.directions, *sizes, far, counts]
    launch(make_exits(test), groups, inputs, device=wp.get_device(CPU), chunk=1)
    totals = counts.numpy().sum(axis=0, dtype=np.int64).tolist()
    return Exits(names, tuple(totals[: len(names)]), tuple(totals[len(names) :]))


def pairs(test: TestForm | ScalarTest, soup: Soup, rays: Beams) -> np.ndarray:
    """(N, 3) float32 (t, u, v) of ray i and triangle i, t NaN for a miss."""
    out = wp.empty(rays.count, dtype=wp.vec3, device=CPU)
    inputs = [soup.records(test.record, 1), rays.origins, rays.stride, rays.directions, out]
    launch(make_pairs(test), rays.count, inputs, device=wp.get_device(CPU))
    return out.numpy()
