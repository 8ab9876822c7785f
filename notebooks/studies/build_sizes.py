"""The question about sizes: how long a scene takes to build, from a thousand triangles to millions, beside the peers.

Each size is a wavy sheet. Builds are timed from arrays in memory until the first ray is answered; contenders take turns, and
have built the same sheet before.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.peers.peer import Peer
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import plane

SIZES = (1_000, 6_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000)
"""Triangles."""

SETTLE = 0.1
"""Builds shorter than so many seconds are preceded by an untimed one."""

BUDGET = 20.0
"""Seconds for each contender and size: slow ones get fewer rounds."""


@dataclass(frozen=True)
class SizeFigures:
    """What was measured of a size.

    Attributes:
        triangles: of the sheet.
        seconds: median of each contender's builds, by name.
        ratios: each contender's time / wrt's, median of the rounds: above one, wrt is faster.
    """

    triangles: int
    seconds: dict[str, float]
    ratios: dict[str, float]


def wavy_sheet(triangles: int) -> TriangleMesh:
    """A square sheet with waves, of about so many triangles."""
    sheet = plane((-1.0, -1.0), (1.0, 1.0), cells=max(1, round((triangles / 2) ** 0.5)))
    vertices = np.array(sheet.vertices, dtype=np.float32)
    x, y = vertices[:, 0], vertices[:, 1]
    vertices[:, 2] = 0.3 * np.sin(5.0 * x) * np.cos(4.0 * y) + 0.05 * np.sin(37.0 * x + 23.0 * y)
    return TriangleMesh(vertices, sheet.faces, name=f"sheet of {sheet.triangle_count:,}")


def measure_sizes(
    make: Callable[[], Sequence[Peer]], sizes: Sequence[int], rounds: int, on_turn: Callable[[str], None] = lambda name: None
) -> list[SizeFigures]:
    """Times the builds of every size.

    Args:
        make: makes the contenders, wrt first; called for each size, so that one size's scenes are gone when the next is built.
        sizes: numbers of triangles.
        rounds: turns of each contender.
        on_turn: told of each turn.
    """
    figures = []
    for size in sizes:
        mesh, peers = wavy_sheet(size), make()
        for peer in peers:
            peer.load(mesh)
        contenders = [Contender(peer.name, peer.construct) for peer in peers]
        label = f"{mesh.triangle_count:,} triangles, "
        timings = take_turns(
            contenders, rounds, budget=BUDGET, settle=SETTLE, on_turn=lambda name, at=label: on_turn(at + name)
        )
        timed = {name: timing for name, timing in timings.items() if timing.times}
        own = timings[peers[0].name]
        ratios = {name: timing.ratio_to(own) for name, timing in timed.items()}
        figures.append(SizeFigures(mesh.triangle_count, {name: timing.median for name, timing in timed.items()}, ratios))
        del peers, contenders, timings, timed, own
        gc.collect()
    return figures
