"""The question about builds: wrt's builders, with one thread and with all, beside the peers' own builds.

Timed from arrays in memory until the first ray is answered, so that builds that wait for the first ray count. Every
builder has built a small mesh before, so that nothing is compiled; slow ones get fewer rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from wrt.accelerators.accelerator import Accelerator, resolve_accelerator
from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.bench.core.benchmark_results import Question, Row
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.peers.embree_arrays import EmbreeArrays
from wrt.bench.peers.engines import Engine
from wrt.bench.peers.peer import Peer
from wrt.bench.peers.peer_table import Open3D
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.engine.facts.query_kinds import AUTO
from wrt.meshes.mesh import TriangleMesh

BUDGET = 10.0
"""Seconds for each builder."""

SETTLE = 0.5
"""Calls shorter than this many seconds are preceded by an untimed one."""

SMALL = 256
"""Triangles of the mesh that warms builders up."""


def builder_peers(peers: Sequence[Peer], triangles: int, threads: int, device: str) -> list[Peer]:
    """Every builder that suits this many triangles, with all threads and with one, then the peers; Open3D with one thread too.

    Embree asked with flat arrays is left out: it is built as Embree is.
    """
    counts = dict.fromkeys((threads, 1))
    descriptions = [Bvh(builder=name) for name in BVH_BUILDERS] + kdtree_descriptions(triangles)
    found: list[Peer] = [
        Engine(count, device, name=builder_name(description), accelerator=description)
        for description in descriptions
        for count in counts
    ]
    for peer in peers:
        if isinstance(peer, Open3D):
            found += [Open3D(count) for count in counts]
        elif not isinstance(peer, (Engine, EmbreeArrays)):
            found.append(peer)
    return found


def kdtree_descriptions(triangles: int) -> list[KdTree]:
    """Every kd-tree builder that can be waited for with this many triangles."""
    return [KdTree(builder=name) for name, builder in KDTREE_BUILDERS.items() if triangles <= builder.max_triangles]


def ask_builds(
    peers: Sequence[Peer],
    mesh: TriangleMesh,
    rounds: int,
    threads: int,
    device: str,
    on_turn: Callable[[str], None] = lambda name: None,
) -> Question:
    """Times the builds; ratios refer to wrt's default builder with all threads."""
    builders = {label(peer): peer for peer in builder_peers(peers, mesh.triangle_count, threads, device)}
    small = TriangleMesh(mesh.vertices, mesh.faces[:SMALL])
    contenders = []
    for name, peer in builders.items():
        on_turn(f"warm up {name}")
        peer.build(small)
        peer.load(mesh)
        contenders.append(Contender(name, peer.construct, warm_up=lambda: None))
    timings = take_turns(contenders, rounds, budget=BUDGET, settle=SETTLE, on_turn=lambda name: on_turn(f"build {name}"))
    reference = reference_label(builders, threads)
    rows = []
    for name, peer in builders.items():
        row = Row(name, peer.threads, peer.device, peer.note, details=details(peer))
        row.details["speedup_over_one_thread"] = speedup(timings, peer)
        rows.append(row.timed(timings[name], timings[reference]))
    return Question("build", None, None, reference, rows)


def builder_name(accelerator: Accelerator) -> str:
    """How a builder is called in tables."""
    return f"wrt {accelerator.kind} {accelerator.builder}"


def label(peer: Peer) -> str:
    """A name that tells thread counts apart."""
    return f"{peer.name}, {peer.threads} thread{'s' if peer.threads > 1 else ''}"


def reference_label(builders: dict[str, Peer], threads: int) -> str:
    """wrt's default builder with all threads."""
    default = builder_name(resolve_accelerator(AUTO))
    return next(name for name, peer in builders.items() if peer.name == default and peer.threads == threads)


def speedup(timings: dict[str, Timing], peer: Peer) -> float | None:
    """How many times faster it is than with one thread, if both were timed."""
    one = timings.get(f"{peer.name}, 1 thread")
    if one is None or peer.threads == 1:
        return None
    return one.ratio_to(timings[label(peer)])


def details(peer: Peer) -> dict[str, Any]:
    """Phases and memory of wrt's builders; nothing for others."""
    if not isinstance(peer, Engine) or peer.scene is None:
        return {}
    scene = peer.scene
    triangles = scene.triangle_count
    return {
        "phases": dict(scene.tree.stats.seconds),
        "tree_bytes_per_triangle": scene.tree.bytes / triangles,
        "record_bytes_per_triangle": scene.state.record_bytes / triangles,
        "peak_bytes_per_triangle": scene.tree.stats.peak_bytes / triangles,
        "statistics": scene.statistics().to_dict(),
    }
