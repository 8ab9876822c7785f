"""Trees for known rays beside the default hierarchy: what they cost to build, and whether they pay.

    searches   finding a node's plane by projected areas, time / by surface areas; nodes of two sizes
    builds     the whole build on all threads, time / the default tree's
    traces     time to trace the rays that the trees are for, time / the default tree's, and the work counted for it

Contenders take turns; ratios are medians over the rounds. One thread's time is its processor time, which other
work on the machine disturbs less; that of several is the clock's. "ProjectedBvh" holds the whole scene in one tree for the
rays' area; "RayAwareBvh" has the default tree too, and sends each ray that belongs to the area to the area's own tree;
"areas=0" is the same with the area given in the call.

References: falcone-2024.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import atan, degrees
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from wrt.accelerators.accelerator import Accelerator
from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh
from wrt.bench.comparisons.build_comparison import BUDGET, SETTLE
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.builders.influence.influence_area import InfluenceArea, PlaneInfluenceArea, PointInfluenceArea, frame_of
from wrt.engine.executor import trace
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.engine.plan.choices import make_plan
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import use_threads
from wrt.known_rays.influence_areas import corners_of
from wrt.known_rays.ray_casters import (
    CircularCapCaster,
    PlaneCaster,
    SquareCapCaster,
    directional_shadow_rays,
    point_shadow_rays,
)
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

REFERENCE = "Bvh"
"""The tree that all figures refer to."""

GIVEN = "areas=0"
"""`wrt.known_rays.RayAwareBvh` that is told the area of all rays."""

SUN = (0.35, 0.5, -0.8)
"""Direction of the directional light."""

TRAVERSALS = ("auto", "single")
"""Packets or streams, as the engine chooses, and rays one by one."""

SIZES = (32, 256)
"""Triangles of the nodes that are searched: few, with bins for few, and many."""

ORDERED = 1 << 19
"""Triangles for whose nodes axes are ordered in a call, about."""

COUNTED = 1 << 14
"""Rays whose work is counted, at most."""

PUSHED = 1.02
"""By which areas are larger than the scene's box as seen along their rays."""


@dataclass(frozen=True)
class KnownRays:
    """Rays, and where they are known to go.

    Attributes:
        name: of the workload.
        query: "closest" or "any".
        rays: the rays.
        area: the influence area that they are of.
    """

    name: str
    query: str
    rays: Rays
    area: InfluenceArea


@dataclass(frozen=True)
class Figure:
    """A measurement; ratios are to `REFERENCE`.

    Attributes:
        question: "search", "build" or "trace".
        subject: nodes that were searched, or rays.
        traversal: of a trace; None of others.
        contender: `REFERENCE`, "ProjectedBvh", "RayAwareBvh" or `GIVEN`.
        seconds: median of the rounds.
        ratio, least, greatest: of the rounds; above 1 is slower.
        work: counted cost of single rays; above 1 is more. None but of a trace.
        items: nodes, triangles or rays.
    """

    question: str
    subject: str
    traversal: str | None
    contender: str
    seconds: float
    ratio: float
    least: float
    greatest: float
    work: float | None
    items: int


def plane_area(bounds: np.ndarray, direction: Sequence[float]) -> PlaneInfluenceArea:
    """The area of parallel rays that holds a box (2, 3)."""
    frame = frame_of(tuple(direction), None)
    places = corners_of(bounds) @ frame.T
    low, high = places.min(axis=0), places.max(axis=0)
    size, middle = PUSHED * (high - low), (low + high) / 2
    position = np.append(middle[:2], middle[2] - size[2] / 2) @ frame
    sizes = {"width": size[0], "height": size[1], "depth": size[2]}
    return PlaneInfluenceArea(position=position, direction=frame[2], up=frame[1], **sizes)


def point_area(bounds: np.ndarray, position: Sequence[float]) -> PointInfluenceArea:
    """The area of the rays through a point outside of a box (2, 3) that holds it.

    Raises:
        ValueError: some of the box is not in front of the point.
    """
    towards = bounds.mean(axis=0) - position
    frame = frame_of(tuple(towards), None)
    seen = (corners_of(bounds) - position) @ frame.T
    if seen[:, 2].min() <= 0.0:
        raise ValueError(f"the point {tuple(position)} is too near the box {bounds.tolist()}; take one farther away")
    fov = [2.0 * degrees(atan(PUSHED * tangent)) for tangent in np.abs(seen[:, :2] / seen[:, 2:]).max(axis=0)]
    near, far = 0.5 * seen[:, 2].min(), PUSHED * np.linalg.norm(seen, axis=1).max()
    return PointInfluenceArea(position=position, direction=frame[2], up=frame[1], fov=fov, near=near, far=far)


def view_of(mesh: TriangleMesh, size: int) -> tuple[PinholeCamera, np.ndarray]:
    """A camera of size x size pixels and the position of a light: a built-in scene's own, or the benchmark's."""
    from wrt.bench.core.workloads import FIELD_OF_VIEW, LIGHT, WorkloadMaker
    from wrt.scenes import BUILTIN_SCENES

    if mesh.name in BUILTIN_SCENES:
        scene = BUILTIN_SCENES[mesh.name]
        return PinholeCamera(size, size, **scene.camera), np.array(scene.light)
    eye = next(WorkloadMaker(mesh, size=4).make(("far",))).origins[0]
    camera = PinholeCamera(size, size, fov=FIELD_OF_VIEW, position=eye, look_at=mesh.center, up=(0.0, 1.0, 0.0))
    return camera, mesh.center + np.array(LIGHT) * mesh.extent / 2


def areas_of(mesh: TriangleMesh) -> dict[str, InfluenceArea]:
    """Of a sun and of a lamp, both with the whole mesh in them, and of a camera.

    Raises:
        ValueError: the lamp is in the mesh's box.
    """
    camera, lamp = view_of(mesh, 4)
    bounds = np.array(mesh.bounds, dtype=np.float64)
    reach = 2.0 * float(np.linalg.norm(corners_of(bounds) - camera.position, axis=1).max())
    place = {"position": camera.position, "direction": camera.forward, "up": camera.up}
    eye = PointInfluenceArea(**place, fov=(camera.fov, camera.fov), near=1e-4 * reach, far=reach)  # of a square picture
    return {"sun": plane_area(bounds, SUN), "lamp": point_area(bounds, lamp), "camera": eye}


def known_rays(mesh: TriangleMesh, scene: Scene, size: int) -> list[KnownRays]:
    """Shadow rays of a sun and of a lamp for each pixel of a view, the view's own rays, and size * size rays of each caster.

    Args:
        mesh: what is seen.
        scene: a scene of it, for the pixels' hits.
        size: views have size x size pixels.
    """
    (camera, _), areas = view_of(mesh, size), areas_of(mesh)
    sun, lamp, eye = areas.values()
    seen = scene.intersect(camera.rays())
    cap = CircularCapCaster(position=lamp.position, direction=lamp.direction, angle=min(lamp.fov) / 2)
    return [
        KnownRays("sun shadows", ANY, directional_shadow_rays(seen, SUN), sun),
        KnownRays("lamp shadows", ANY, point_shadow_rays(seen, lamp.position), lamp),
        KnownRays("camera", CLOSEST, camera.rays(), eye),
        KnownRays("plane caster", CLOSEST, PlaneCaster.of(sun).rays(size * size), sun),
        KnownRays("square cap caster", CLOSEST, SquareCapCaster.of(lamp).rays(size * size), lamp),
        KnownRays("circular cap caster", CLOSEST, cap.rays(size * size), lamp),
    ]


def accelerators(area: InfluenceArea) -> dict[str, Accelerator]:
    """The contenders: the default tree, one tree for the area, and the default tree beside the area's own."""
    return {REFERENCE: Bvh(), "ProjectedBvh": ProjectedBvh(areas=area), "RayAwareBvh": RayAwareBvh(areas=[area])}


@dataclass(frozen=True)
class Turns:
    """How contenders are timed.

    Attributes:
        rounds: how often each is measured.
        threads: CPU threads.
        on_turn: told the name of each contender before its turn.
    """

    rounds: int = 5
    threads: int = 1
    on_turn: Callable[[str], None] = lambda name: None

    def figures(
        self, question: str, subject: str, runs: Mapping[str, Callable[[], Any]], items: int, traversal: str | None = None
    ) -> list[Figure]:
        """A figure a contender, without its work; the first is the reference."""
        contenders = [Contender(name, run) for name, run in runs.items()]
        options = {"budget": BUDGET, "settle": SETTLE, "on_turn": self.on_turn}
        clock = thread_time if self.threads == 1 else perf_counter
        with use_threads(self.threads):
            timings = take_turns(contenders, self.rounds, clock=clock, **options)
        figures = []
        for name, timing in timings.items():
            ratios = timing.ratios_to(timings[contenders[0].name])
            spread = (float(np.median(ratios)), min(ratios), max(ratios))
            figures.append(Figure(question, subject, traversal, name, timing.median, *spread, None, items))
        return figures


def compare_searches(
    mesh: TriangleMesh, area: InfluenceArea, subject: str, sizes: Sequence[int] = SIZES, *, rounds: int = 7
) -> list[Figure]:
    """Time to find a node's plane on one thread, by projected and by surface areas; both try all axes."""
    from studies.known_rays.node_searches import Searches

    figures = []
    for size in (size for size in sizes if size <= mesh.triangle_count):
        nodes = {name: Searches(mesh, size, accelerators(area)[name]) for name in (REFERENCE, "ProjectedBvh")}
        runs = {name: searches.run for name, searches in nodes.items()}
        figures += Turns(rounds).figures("search", f"{subject}, {size} triangles", runs, nodes[REFERENCE].count)
    return figures


def compare_axis_orders(mesh: TriangleMesh, area: InfluenceArea, subject: str, *, rounds: int = 7) -> list[Figure]:
    """Time to order a node's axes on one thread: by the longest side, the reference, and by how they face the rays."""
    from studies.known_rays.node_searches import AxisOrders

    repeats = max(1, ORDERED // mesh.triangle_count)
    nodes = {order: AxisOrders(mesh, area, order, repeats) for order in ("longest", "facing")}
    runs = {order: found.run for order, found in nodes.items()}
    return Turns(rounds).figures("axes", subject, runs, repeats * nodes["longest"].count)


def compare_builds(mesh: TriangleMesh, areas: Mapping[str, InfluenceArea], turns: Turns) -> list[Figure]:
    """Time from a mesh in memory to a scene."""
    figures = []
    for subject, area in areas.items():
        runs = {
            name: partial(Scene, mesh, accelerator, device="cpu", num_threads=turns.threads)
            for name, accelerator in accelerators(area).items()
        }
        figures += turns.figures("build", subject, runs, mesh.triangle_count)
    return figures


def compare_traces(
    mesh: TriangleMesh, turns: Turns, *, size: int = 1024, traversals: Sequence[str] = TRAVERSALS
) -> list[Figure]:
    """Time to trace, and the work counted.

    Args:
        mesh: what is traced.
        turns: how it is timed.
        size: each workload has size * size rays.
        traversals: "auto", "single" or others of `Scene.intersect`.
    """
    options = {"device": "cpu", "num_threads": turns.threads}
    default = Scene(mesh, Bvh(), **options)
    figures = []
    for known in known_rays(mesh, default, size):
        scenes = {name: Scene(mesh, accelerator, **options) for name, accelerator in accelerators(known.area).items()}
        work = {name: work_of(scene, known) for name, scene in scenes.items()}
        work[GIVEN] = work["RayAwareBvh"]
        for traversal in traversals:
            runs = {name: partial(ask, scene, known, traversal) for name, scene in scenes.items()}
            runs[GIVEN] = partial(ask, scenes["RayAwareBvh"], known, traversal, areas=0)
            found = turns.figures("trace", known.name, runs, len(known.rays), traversal)
            figures += [replace(figure, work=work[figure.contender] / work[REFERENCE]) for figure in found]
    return figures


def ask(scene: Scene, known: KnownRays, traversal: str, **options: Any) -> Any:
    """Asks a scene a workload's question."""
    query = scene.occluded if known.query == ANY else scene.intersect
    return query(known.rays, traversal=traversal, **options)


def work_of(scene: Scene, known: KnownRays) -> float:
    """Counted cost of single rays: nodes and blocks of triangles by the scene's cost model, those of all its trees together."""
    with use_threads(scene.num_threads):
        rays = thinned(known.rays, COUNTED)
        buffers = to_device(rays, scene.device, scene.center)
        _, work = trace(
            scene.state, make_plan(scene.state, buffers, "single", "auto", known.query), buffers, known.query, counters=True
        )
    counted, cost = work.numpy(), scene.accelerator.config(scene.tree.width).cost
    nodes, triangles = (float(counted[name].sum(dtype=np.float64)) for name in ("nodes", "triangles"))
    return cost.traversal * nodes + cost.block * triangles / scene.tree.width


def thinned(rays: Rays, count: int) -> Rays:
    """At most this many of the rays, evenly picked."""
    shape = (*rays.shape, 3)
    chosen = np.unique(np.linspace(0, len(rays) - 1, count).astype(int))
    origins, directions = (np.broadcast_to(a, shape).reshape(-1, 3)[chosen] for a in (rays.origins, rays.directions))
    return Rays(origins, directions, rays.t_min, rays.t_max)
