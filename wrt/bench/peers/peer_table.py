"""The table of contenders: wrt itself and the libraries that it is compared with.

To add a peer: write its class, add one line to `PEERS`; the command line, the tests and the report pick it up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from wrt.bench.peers.embree import Embree
from wrt.bench.peers.embree_arrays import EmbreeArrays
from wrt.bench.peers.engines import all_engines, default_engine, plain_engine
from wrt.bench.peers.open3d_peer import Open3D
from wrt.bench.peers.peer import Peer
from wrt.bench.peers.trimesh_peers import Embreex, Trimesh, TrimeshEmbreex
from wrt.bench.peers.warp_mesh_peer import WarpMesh
from wrt.kernels.compilation.cores import available_cores
from wrt.tables import lookup

PEERS: dict[str, Callable[[int, str], list[Peer]]] = {
    "wrt": lambda threads, device: [default_engine(threads, device)],
    "plain": lambda threads, device: [plain_engine(threads, device)],
    "engines": all_engines,  # type: ignore[dict-item]
    "open3d": lambda threads, device: [Open3D(threads)],
    "embree": lambda threads, device: [Embree(threads, 3), Embree(threads, 4)],
    "embree3": lambda threads, device: [Embree(threads, 3)],
    "embree4": lambda threads, device: [Embree(threads, 4)],
    "embree3-flat": lambda threads, device: [EmbreeArrays(threads, 3)],
    "embree4-flat": lambda threads, device: [EmbreeArrays(threads, 4)],
    "embreex": lambda threads, device: [Embreex()],
    "warp_mesh": lambda threads, device: [WarpMesh(device=device)],
    "trimesh": lambda threads, device: [Trimesh()],
    "trimesh_embreex": lambda threads, device: [TrimeshEmbreex()],
}
"""Contenders by the name that the command line knows; "plain" is wrt with a triangle test that leaks, "engines" are its
traversals, each by itself; "embree" is both versions of Embree, in packets that are filled before the clock starts, its best
case; "embree3-flat" and "embree4-flat" fill packets from flat arrays, and copy answers to such, while the clock runs."""

UNASKED = ("embree3-flat", "embree4-flat")
"""Peers that take part only if they are named: they are others of the table in another form."""

DEFAULT_PEERS = tuple(name for name in PEERS if name not in UNASKED)
"""Peers that take part if none is named."""


def make_peers(names: Iterable[str], threads: int, device: str) -> tuple[list[Peer], dict[str, str]]:
    """The peers that can run here, each once and wrt first whether named or not, and the reasons of those that cannot.

    Raises:
        ValueError: unknown name.
    """
    peers: dict[str, Peer] = {}
    missing: dict[str, str] = {}
    for name in dict.fromkeys(["wrt", *names]):
        for peer in lookup(PEERS, name, "peer")(threads, device):
            if peer.name in peers or peer.name in missing:
                continue
            reason = peer.available() or embreex_conflict(peer, peers.values(), threads)
            if reason is None:
                peers[peer.name] = peer
            else:
                missing[peer.name] = reason
    return list(peers.values()), missing


def embreex_conflict(peer: Peer, others: Iterable[Peer], threads: int) -> str | None:
    """Why a binding of Embree 4 cannot take part beside Embree 4 itself; None if it can.

    Its devices build with all cores, and devices of one library share threads: Embree 4 would build with all cores too.
    """
    beside = any(isinstance(other, Embree) and other.version.number == 4 for other in others)
    if peer.package != "embreex" or not beside or threads >= available_cores():
        return None
    return f"builds with all cores, as Embree 4 then would, not with {threads}; ask for it without embree and embree4"
