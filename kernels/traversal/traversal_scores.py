"""How well traversals suit a query: what "auto" compares.

Every entry of `wrt.kernels.traversal.TRAVERSALS` that "auto" may choose has a score: a function of a `Situation`, which returns
a number and the reason for choosing the traversal, or None where another one is always better. Among the entries that can
answer the query, "auto" takes the one with the highest score. A score decides about speed alone and never about hits.

The traversal of single rays scores everywhere. The numbers below make the first guess, which calls of many rays on the CPU then
measure against others (`wrt.engine.plan.contest`). So they are few, and but for any hits the same on all CPUs
(notebooks/records/2026-11-28-auto.md).
"""

from collections.abc import Callable
from typing import NamedTuple

from wrt.kernels.answers import ANSWERS

RAYS_PER_TRIANGLE = 0.125
"""Rays per triangle from which coherent rays are traced in packets where no sample of them was traced: they are few, or still
to be made (notebooks/records/2026-11-21-plans.md; through instances, notebooks/records/2026-11-21-instances.md); in a kd-tree,
if they start at one point (notebooks/records/2026-11-23-few-rays.md).
"""

CROWDED_CELLS = 2.0
"""The same in a kd-tree for rays that start at different points (notebooks/records/2026-11-23-few-rays.md)."""

MIN_SAMPLED = 2048
"""Number of rays from which a sample pays, and comparing plans: a sample takes as long as some hundred rays."""

MIN_SAMPLED_THROUGH_INSTANCES = 8192
"""The same through instances, where packets have to save the time to set them up: such queries are not prepared
(notebooks/records/2026-11-22-auto.md).
"""

GREATEST_SHARE = 0.24
"""Greatest `Overlap.share` with which rays stay together: packets are then faster."""

MANY_TRIANGLES = 50_000
"""Triangles from which interleaved walks are faster than streams."""

MANY_LANES, MANY_OCCLUDERS, MANY_RAYS = 16, 250_000, 1 << 16
"""Lanes with which an instruction compacts the lists of streams, and triangles from which interleaved walks are faster there
for any hits: of coherent rays, and of at least this many others (notebooks/records/2026-11-28-lost-speed.md)."""

RAYS_PER_INSTANCE = 1 << 15
"""Rays per instance from which sorting rays by instance pays."""


class Overlap(NamedTuple):
    """What a sample of packets shares (`wrt.kernels.query.ordering.packet_overlap`).

    Attributes:
        share: different steps of the sampled rays of a packet over all their steps, from 1 / `SAMPLED_RAYS` (all rays take the
            same way) to 1.
        steps: nodes and leaves that a ray visits.
    """

    share: float
    steps: float


COHERENT_REASON, INCOHERENT_REASON = "neighbouring rays are coherent", "neighbouring rays are incoherent"

SINGLE_RAYS, PERSISTENT_THREADS, BY_PLANES, STREAMS, INTERLEAVED_RAYS, PACKETS = 1.0, 1.5, 2.0, 3.0, 3.5, 4.0
"""Scores: of single rays; of persistent CUDA threads; of packets and lockstep lanes on the planes of a
kd-tree; of streams on the boxes of a BVH or of the wide form of a kd-tree; of interleaved walks of a BVH; of packets on boxes.
A traversal that may be slower than one with a lower score declines.
"""


class Situation(NamedTuple):
    """What a score depends on.

    Attributes:
        query: key in `wrt.kernels.answers.ANSWERS`.
        cull_backfaces: whether rays hit only the front of triangles.
        is_cuda: whether the query runs on CUDA.
        tree: kind of the scene's trees, "bvh" or "kdtree".
        lanes: children of a node.
        triangles: number of triangles, in all instances.
        instances: number of instances; 0 in scenes of one level.
        own_spaces: whether each tree of the scene has its own coordinate space.
        has_wide_form: whether a kd-tree has a wide form, or rays so far would have paid for making it.
        rays: number of rays.
        few: whether the rays are so few that detecting their coherence takes as long as tracing them.
        coherent: whether neighbouring rays are similar.
        shared_origin: whether all rays start at the same point.
        overlap: what a sample of packets shares; None if none was traced.
    """

    query: str
    cull_backfaces: bool
    is_cuda: bool
    tree: str
    lanes: int
    triangles: int
    instances: int
    own_spaces: bool
    has_wide_form: bool
    rays: int
    few: bool
    coherent: bool
    shared_origin: bool
    overlap: Overlap | None = None

    @property
    def prefers_single(self) -> bool:
        """Whether rays are traced one by one, whatever they look like."""
        return self.is_cuda or self.own_spaces or self.few

    @property
    def tests_each_hit(self) -> bool:
        """Whether hits are tested one by one: all of them are reported, or some are discarded."""
        return not ANSWERS[self.query].nearest or self.cull_backfaces

    @property
    def kinds_of_hits(self) -> str:
        """What is found by testing hits one by one."""
        return "front faces" if ANSWERS[self.query].nearest else "all hits"

    @property
    def suits_instance_packets(self) -> bool:
        """Whether packets can carry out the query through instances, for rays that may be alike enough."""
        return self.coherent and self.tree == "bvh" and ANSWERS[self.query].nearest and not self.cull_backfaces

    @property
    def needs_sample(self) -> bool:
        """Whether only a sample tells if packets are faster."""
        if self.prefers_single or self.tests_each_hit or not self.coherent or not (self.tree == "bvh" or self.has_wide_form):
            return False
        return self.rays >= (MIN_SAMPLED_THROUGH_INSTANCES if self.instances else MIN_SAMPLED)

    @property
    def crowds_cells(self) -> bool:
        """Whether coherent rays are so numerous that packets are faster than single rays in the cells of a kd-tree."""
        return self.rays >= (RAYS_PER_TRIANGLE if self.shared_origin else CROWDED_CELLS) * self.triangles

    @property
    def has_many_triangles(self) -> bool:
        """Whether interleaved walks are faster than streams."""
        fills_lists = self.lanes >= MANY_LANES and (self.coherent or self.rays >= MANY_RAYS)
        occludes = fills_lists and ANSWERS[self.query].rules.ends_at_first
        return self.triangles >= (MANY_OCCLUDERS if occludes else MANY_TRIANGLES)

    @property
    def stays_together(self) -> bool:
        """Whether the rays of a packet take so much the same way that packets are faster."""
        if self.overlap is not None:
            return self.overlap.share <= GREATEST_SHARE
        return self.rays >= RAYS_PER_TRIANGLE * self.triangles and (self.shared_origin or not self.instances)


Score = Callable[[Situation], tuple[float, str] | None]
"""The score of a traversal and the reason for choosing it; None if it declines."""


def score_single(situation: Situation) -> tuple[float, str] | None:
    """Single rays suit every situation; others may suit it better."""
    if situation.is_cuda:
        return SINGLE_RAYS, "one CUDA thread per ray"
    if situation.own_spaces:
        return SINGLE_RAYS, "each tree has its own coordinate space"
    if situation.few:
        return SINGLE_RAYS, "few rays"
    if situation.instances:
        reason = "two levels, one ray at a time"
        small = situation.suits_instance_packets and situation.shared_origin
        return SINGLE_RAYS, f"{reason}: triangles are small" if small else reason
    if situation.tests_each_hit:
        return SINGLE_RAYS, f"the traversal that finds {situation.kinds_of_hits} on a kd-tree"
    return SINGLE_RAYS, f"{COHERENT_REASON}, but triangles are small" if situation.coherent else "any rays"


def score_persistent(situation: Situation) -> tuple[float, str] | None:
    """On CUDA, persistent threads suit all rays (notebooks/records/2026-11-27-gpu-traversal.md)."""
    if not situation.is_cuda or situation.own_spaces:
        return None
    return PERSISTENT_THREADS, "persistent CUDA threads"


def score_lockstep(situation: Situation) -> tuple[float, str] | None:
    """Lanes of a vector suit incoherent rays on the planes of a kd-tree."""
    if situation.prefers_single or situation.coherent:
        return None
    return BY_PLANES, INCOHERENT_REASON


def score_packet(situation: Situation) -> tuple[float, str] | None:
    """Packets suit coherent rays."""
    if situation.prefers_single or not situation.coherent:
        return None
    if situation.instances:
        suits = situation.suits_instance_packets and situation.stays_together
        return (PACKETS, f"two levels, {COHERENT_REASON}") if suits else None
    if situation.tree == "bvh":
        return score_box_packet(situation)
    return (BY_PLANES, COHERENT_REASON) if situation.crowds_cells else None


def score_wide_packet(situation: Situation) -> tuple[float, str] | None:
    """The same on the wide form of a kd-tree, if there is one."""
    return score_box_packet(situation) if situation.has_wide_form else None


def score_box_packet(situation: Situation) -> tuple[float, str] | None:
    """Packets on boxes suit coherent rays that stay together."""
    suits = situation.coherent and situation.stays_together and not situation.prefers_single
    return (PACKETS, COHERENT_REASON) if suits else None


def score_stream(situation: Situation) -> tuple[float, str] | None:
    """Streams suit many rays of any kind on a BVH; through instances, if each of these meets many rays."""
    if situation.prefers_single or situation.tree != "bvh":
        return None
    if not situation.instances:
        return score_box_stream(situation)
    if situation.rays < RAYS_PER_INSTANCE * situation.instances or (
        situation.suits_instance_packets and situation.shared_origin
    ):
        return None
    return STREAMS, "two levels, rays sorted by instance"


def score_wide_stream(situation: Situation) -> tuple[float, str] | None:
    """The same on the wide form of a kd-tree, if there is one."""
    return score_box_stream(situation) if situation.has_wide_form else None


def score_box_stream(situation: Situation) -> tuple[float, str] | None:
    """Streams on boxes suit many rays of any kind."""
    if situation.prefers_single:
        return None
    if situation.tests_each_hit:
        return STREAMS, f"{situation.kinds_of_hits} of many rays"
    return STREAMS, reason_for_streams(situation)


def score_interleaved(situation: Situation) -> tuple[float, str] | None:
    """Interleaved walks suit rays that streams suit, if there are enough triangles for the rays to part."""
    if situation.prefers_single or situation.tests_each_hit or situation.instances or situation.tree != "bvh":
        return None
    return (INTERLEAVED_RAYS, reason_for_streams(situation)) if situation.has_many_triangles else None


def reason_for_streams(situation: Situation) -> str:
    """Why rays are not traced in packets."""
    return f"{COHERENT_REASON}, but triangles are small" if situation.coherent else INCOHERENT_REASON
