"""The questions about rays: closest hits, occlusion, all hits and inside tests, asked of every contender in turn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from wrt.bench.core.agreement import Agreement, closest_agreement, lists_agreement, occlusion_agreement
from wrt.bench.core.benchmark_results import Question, Row
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.core.workloads import Workload
from wrt.bench.peers.peer import Answer, Lists, Peer, Query
from wrt.meshes.mesh import TriangleMesh

BUDGET = 10.0
"""Seconds for each contender and workload: slow ones get fewer rounds."""

SETTLE = 0.5
"""Calls shorter than this many seconds are preceded by an untimed one."""

TOLERANCE = 1e-5
"""Distances agree within this share of the box's diagonal."""


def ask(
    peers: Sequence[Peer],
    mesh: TriangleMesh,
    workloads: Iterable[Workload],
    rounds: int,
    on_turn: Callable[[str], None] = lambda name: None,
) -> Iterator[Question]:
    """Builds every peer and traces every workload with it, one after the other. The first peer is wrt, to which ratios and
    agreement refer."""
    for peer in peers:
        on_turn(f"build {peer.name}")
        peer.build(mesh)
    for workload in workloads:
        yield ask_one(peers, mesh, workload, rounds, on_turn)


def ask_one(
    peers: Sequence[Peer], mesh: TriangleMesh, workload: Workload, rounds: int, on_turn: Callable[[str], None]
) -> Question:
    """Times one workload; peers must have built the mesh."""
    queries: dict[str, Query] = {}
    contenders, rows = [], []
    for peer in peers:
        rays = workload.thinned(peer.ray_limit(mesh.triangle_count) or len(workload))
        query = peer.query(rays)
        if query is None:
            continue
        queries[peer.name] = query
        contenders.append(Contender(peer.name, query.run, len(rays)))
        rows.append(Row(peer.name, peer.threads, peer.device, peer.note, rays=len(rays)))
    reference = contenders[0].name
    timings = take_turns(
        contenders, rounds, budget=BUDGET, settle=SETTLE, on_turn=lambda name: on_turn(f"{workload.name} {name}")
    )
    if (error := timings[reference].error) is not None:
        raise RuntimeError(f"{reference} failed on {workload.name!r}, so there is nothing to compare with: {error}")
    expected = queries[reference].read(timings[reference].result)
    for row in rows:
        timing = timings[row.name]
        row.timed(timing, timings[reference])
        if timing.error is None:
            row.agreement = compare(queries[row.name], timing, expected, workload, mesh)
    return Question(workload.query, workload.name, len(workload), reference, rows)


def compare(
    query: Query, timing: Timing, expected: Answer | Lists | np.ndarray, workload: Workload, mesh: TriangleMesh
) -> Agreement:
    """A contender's answer beside wrt's."""
    chosen = workload.chosen(timing.items)
    answer = query.read(timing.result)
    if isinstance(answer, np.ndarray):
        return occlusion_agreement(answer, expected[chosen])  # type: ignore[index]
    if isinstance(answer, Lists):
        number = np.full(len(workload), -1)
        number[chosen] = np.arange(len(chosen))
        asked = number[expected.ray] >= 0
        return lists_agreement(
            len(chosen), answer.ray, answer.primitive, number[expected.ray[asked]], expected.primitive[asked]
        )
    tolerance = TOLERANCE * mesh.extent
    return closest_agreement(answer.primitive, answer.t, expected.primitive[chosen], expected.t[chosen], tolerance)
