"""The question about sizes: how long a scene takes to build, from a thousand triangles to millions, beside the peers.

Each size is a wavy sheet. Builds are timed from arrays in memory until the first ray is answered; contenders take turns, and
have built the same sheet before.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from studies.study_options import number, several, show, study
from wrt.bench.commands.command_options import progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_report import new_table, times
from wrt.bench.core.benchmark_results import machine
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.peers.peer import Peer
from wrt.bench.peers.peer_table import make_peers
from wrt.cli.number_types import Whole
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import plane

SIZES = (1_000, 6_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000)
"""Triangles."""

BUILDING = ("embree", "open3d", "embreex", "warp_mesh")
"""Peers whose builds are timed, all that are found unless some are asked for."""

SETTLE = 0.1
"""Builds shorter than this many seconds are preceded by an untimed one."""

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
    """A square sheet with waves, of about this many triangles."""
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
        rounds: number of rounds per contender.
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


@study("build-sizes")
@click.option("--triangles", "sizes", multiple=True, type=Whole(2), help="Of a sheet; repeat. [1,000 to 3,000,000]")
@several("--peer", "names", (*BUILDING, "embree3", "embree4"))
@number("--rounds", 7, "Rounds per contender.")
def build_sizes_command(
    sizes: tuple[int, ...], names: tuple[str, ...], rounds: int, threads: int, json_file: Path | None
) -> None:
    """Builds sheets of a thousand to millions of triangles, until the first ray is answered, beside the peers."""

    def make() -> list[Any]:
        return make_peers(names or BUILDING, threads, "cpu")[0]

    missing = make_peers(names or BUILDING, threads, "cpu")[1]
    with progress() as on_turn, usage_errors():
        figures = measure_sizes(make, sizes or SIZES, rounds, on_turn)
    print_sizes(figures, threads, table_console(140))
    for name, reason in missing.items():
        click.echo(f"left out: {name} ({reason})")
    write_json(json_file, {"machine": machine("cpu"), "threads": threads, "sizes": [asdict(row) for row in figures]})


def print_sizes(figures: Sequence[SizeFigures], threads: int, console: Any) -> None:
    """A line a size, a column a contender."""
    names = [*figures[0].seconds]
    table = new_table((), ("triangles", *names))
    for row in figures:
        cells = [f"{row.seconds[name] * 1e3:.3g} ({times(row.ratios[name])})" if name in row.seconds else "-" for name in names]
        table.add_row(f"{row.triangles:,}", *cells)
    show(console, f"Build by size, {threads} thread{'s' * (threads > 1)}, ms (time / wrt)", table)
