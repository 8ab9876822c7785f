"""A plan: how a query is answered, by which traversal, triangle test and options."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from wrt.engine.facts.wide_trees import wide_tree
from wrt.engine.free_list import FreeList
from wrt.kernels.answers import ANSWERS, MASKED, PLAIN
from wrt.kernels.runtime.launch import CUDA_BLOCK
from wrt.kernels.traversal import TRAVERSALS, Traversal
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.traversal_config import (
    PacketConfig,
    SingleConfig,
    StackConfig,
    StreamConfig,
    TraversalConfig,
)
from wrt.kernels.triangle import TRIANGLE_TESTS

if TYPE_CHECKING:
    import warp as wp

    from wrt.builders.tree import Bvh, KdTree
    from wrt.engine.facts.scene_state import SceneState


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How a query is answered. `dataclasses.replace` makes variants, which queries take as their `traversal`.

    Attributes:
        accelerator: kind of the scene's tree, "bvh" or "kdtree"; "none" if every triangle is tested.
        traversal: key in `wrt.kernels.traversal.TRAVERSALS`.
        triangle_test: key in `wrt.kernels.triangle.TRIANGLE_TESTS`.
        width: triangles tested at once, and children of a node.
        coherent: whether coherence detection found neighbouring rays to be similar.
        shared_origin: whether all rays start at the same point.
        reason: why the traversal was chosen.
        packet: rays of a packet; 1 if every ray is traced on its own.
        culling: key in `wrt.kernels.traversal.packet.CULLINGS`; empty without packets.
        non_temporal: whether packets write closest hits by non-temporal stores, past the caches.
        stream: rays of a stream; 1 without streams.
        mailbox: key in `wrt.kernels.traversal.mailbox.MAILBOXES`; "none" for trees that store each triangle in one leaf.
        reorder: the order in which rays are traced (`wrt.kernels.query.ordering.ray_order`): "none", as given; "cells", by cell
            of the origin and octant of the direction; "tiles", the pixels of an image tile by tile, in packets.
        cull_backfaces: whether rays hit only the front of triangles.
    """

    accelerator: str
    traversal: str
    triangle_test: str
    width: int
    coherent: bool
    shared_origin: bool
    reason: str
    packet: int = 1
    culling: str = ""
    non_temporal: bool = False
    stream: int = 1
    mailbox: str = "none"
    reorder: str = "none"
    cull_backfaces: bool = False

    @property
    def is_wide(self) -> bool:
        """Whether the wide form of the scene's kd-tree is traversed."""
        return Capabilities.WIDE_FORM in traversal_of(self).capabilities

    @property
    def engine(self) -> str:
        """The traversal, and the culling of packets."""
        return f"{self.traversal}, {self.culling}" if self.culling else self.traversal

    def __str__(self) -> str:
        parts = [self.accelerator, self.traversal]
        if self.packet > 1:
            parts += [f"packets of {self.packet}", f"{self.culling} culling"]
        if self.non_temporal:
            parts.append("non-temporal stores")
        if self.stream > 1:
            parts.append(f"streams of {self.stream}")
        if self.mailbox != "none":
            parts.append(f"{self.mailbox} mailbox")
        if self.reorder != "none":
            parts.append(f"in {self.reorder}")
        if self.cull_backfaces:
            parts.append("front faces only")
        return ", ".join([*parts, self.triangle_test, f"width {self.width}"]) + f": {self.reason}"


class ChosenPlan:
    """A plan for one kind of query, and the queries that are prepared for it.

    Attributes:
        plan: as chosen or given.
        carried_out: the plan as the kind of query carries it out (`plan_for_query`).
        prepares: whether such queries can be prepared.
        missed_savings: time that a wide form of the scene's kd-tree would have saved each ray, over the time to make it for one
            triangle.
        prepared: the queries that no caller holds, by the layout of their rays.
        ready: whether its kernels are loaded, or False if they would have to be compiled; None if nobody looked.
    """

    __slots__ = ("carried_out", "missed_savings", "plan", "prepared", "prepares", "ready")

    def __init__(self, plan: Plan, carried_out: Plan, prepares: bool, missed_savings: float) -> None:
        self.plan, self.carried_out, self.prepares, self.missed_savings = plan, carried_out, prepares, missed_savings
        self.prepared: FreeList[Any] = FreeList()
        self.ready: bool | None = None

    @property
    def name(self) -> str:
        """The plan's engine."""
        return self.plan.engine

    def __del__(self) -> None:
        for prepared in self.prepared.items():
            prepared.retire()


def traversal_config(plan: Plan, scene: SceneState, query: str, counters: bool) -> TraversalConfig:
    """The specialisation of the traversal that carries out a plan."""
    traversal = traversal_of(plan)
    families: dict[str, Any] = {}
    if Capabilities.PACKETS in traversal.capabilities:
        able = Capabilities.NON_TEMPORAL in traversal.capabilities and not scene.instances
        non_temporal = plan.non_temporal and able and ANSWERS[query].rules.shortens
        families["packet"] = PacketConfig(plan.packet, plan.shared_origin, plan.culling, non_temporal)
    if Capabilities.STREAMS in traversal.capabilities:
        families["stream"] = StreamConfig(plan.stream)
    if traversal.walks_boxes(plan.accelerator) or (scene.only_single and traversal.walks_tree):
        levels = stack_levels(walked_tree(plan, scene).depth)
        families["stack"] = StackConfig(levels, CUDA_BLOCK if scene.device.is_cuda else 0)
    if traversal.walks_tree and ANSWERS[query].rules.once:
        families["shared_leaves"] = scene.shares_leaves
    return TraversalConfig(
        plan.triangle_test,
        plan.width,
        query,
        plan.coherent,
        counters,
        plan.mailbox,
        plan.cull_backfaces,
        variant=PLAIN if scene.alpha_masks is None else MASKED,
        **families,
    )


def config_for_layout(config: TraversalConfig, plan: Plan, scene: SceneState) -> TraversalConfig:
    """The specialisation for the order of the tree's nodes: single rays walk pairs for their nearest hits, if there are any."""
    able = plan.accelerator == "kdtree" and Capabilities.NODE_ORDERS in traversal_of(plan).capabilities
    alone = able and not (scene.instances or scene.only_single)
    if alone and config.answer.nearest and scene.tree.pairs is not None:
        return replace(config, single=SingleConfig(pair_words=1))
    return config


def stack_levels(depth: int) -> int:
    """Levels of the traversal stack: the tree's depth rounded up to a multiple of 8, so that few specialisations serve all
    trees.
    """
    return -(-depth // 8) * 8


def kernel_factory(plan: Plan, scene: SceneState) -> Callable[[TraversalConfig], wp.Kernel]:
    """The factory of the kernel that carries out a plan on the scene's tree."""
    if scene.only_single and plan.accelerator != "none":
        return scene.tree.kernel_factory
    if scene.facts.points and plan.traversal in scene.tree.kernels:
        return scene.tree.kernels[plan.traversal]
    return traversal_of(plan).on[plan.accelerator].make_kernel


def traversal_of(plan: Plan) -> Traversal:
    """The plan's entry in the table of traversals."""
    return TRAVERSALS[plan.traversal]


def plan_for_query(plan: Plan, query: str) -> Plan:
    """The plan as a query runs it: a triangle test may name another test for any-hit queries."""
    other = TRIANGLE_TESTS[plan.triangle_test].any_hit
    return replace(plan, triangle_test=other) if ANSWERS[query].rules.ends_at_first and other else plan


def walked_tree(plan: Plan, scene: SceneState) -> KdTree | Bvh:
    """The tree that a plan's kernel walks: the scene's tree, or its wide form."""
    return wide_tree(scene) if plan.is_wide else scene.tree
