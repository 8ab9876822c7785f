"""Closest points of wrt beside those of other libraries: the same points, in turns.

Each contender is a function of (mesh, threads) that builds and returns a `Contending`. Distances of all are compared with those
of wrt's BVH.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.kernels.compilation.cores import available_cores
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

NEAR = 0.005
"""Standard deviation of points near the surface, in diagonals of the box."""

TOLERANCE = 1e-5
"""Distances agree within this share of the diagonal."""

BUDGET = 10.0
"""Seconds for each contender and set of points."""

SETTLE = 0.5
"""Calls shorter than this many seconds are preceded by an untimed one."""

FEW = 1000
"""Most points of contenders that take milliseconds for each."""


@dataclass(frozen=True)
class Contending:
    """A library that has built what it needs.

    Attributes:
        name: in tables.
        threads: that it uses.
        ask: points (N, 3) float32 -> a function that is timed.
        read: what that returned -> (N,) distances.
        max_points: largest number of points that it is asked for.
    """

    name: str
    threads: int
    ask: Callable[[np.ndarray], Callable[[], Any]]
    read: Callable[[Any, np.ndarray], np.ndarray]
    max_points: int | None = None


@dataclass(frozen=True)
class PointRow:
    """Figures of a contender.

    Attributes:
        points: name of the set of points.
        engine: name of the contender.
        threads: that it uses.
        speed: million points a second, of the median round.
        ratio: time a point over that of wrt's BVH, the median of rounds; None if there was no common round.
        agreement: share of the points with the same distance; None if it failed.
        error: why it failed; None if it did not.
        work: of wrt's BVH, nodes and triangles that a point visits, and those that it visits if it knows its distance.
    """

    points: str
    engine: str
    threads: int
    speed: float | None
    ratio: float | None
    agreement: float | None
    error: str | None = None
    work: dict[str, float] | None = None


def wrt_scene(mesh: TriangleMesh, threads: int, accelerator: str) -> Contending:
    """wrt itself, on the CPU."""
    scene = Scene(mesh, "bvh" if accelerator == "bvh" else "kdtree", device="cpu", num_threads=threads)
    name = f"wrt, {'BVH' if accelerator == 'bvh' else 'kd-tree'}"
    return Contending(name, threads, lambda points: lambda: scene.closest_point(points).distance, lambda found, _: found)


def open3d_scene(mesh: TriangleMesh, threads: int) -> Contending:
    """Open3D's `RaycastingScene`."""
    from open3d import core
    from open3d.t.geometry import RaycastingScene

    scene = RaycastingScene(nthreads=threads)
    scene.add_triangles(core.Tensor(mesh.vertices.astype(np.float32)), core.Tensor(mesh.faces.astype(np.uint32)))  # type: ignore[call-overload]

    def ask(points: np.ndarray) -> Callable[[], Any]:
        given = core.Tensor(points)  # type: ignore[call-overload]
        return lambda: scene.compute_closest_points(given, nthreads=threads)

    return Contending("Open3D", threads, ask, lambda found, points: apart(found["points"].numpy(), points))


def fcpw_scene(mesh: TriangleMesh, threads: int) -> Contending:
    """FCPW, vectorised, with all cores."""
    import fcpw

    scene = fcpw.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.ascontiguousarray(mesh.vertices, dtype=np.float32), 0)
    scene.set_object_triangles(np.ascontiguousarray(mesh.faces, dtype=np.int32), 0)
    scene.build(fcpw.aggregate_type.bvh_surface_area, True)

    def ask(points: np.ndarray) -> Callable[[], Any]:
        max_points = np.full(len(points), np.inf, dtype=np.float32)

        def run() -> Any:
            found = fcpw.interaction_3D_list()
            scene.find_closest_points(points, max_points, found)
            return found

        return run

    return Contending("FCPW", all_cores(), ask, lambda found, _: np.array([each.d for each in found]))


def igl_tree(mesh: TriangleMesh, threads: int) -> Contending:
    """libigl's AABB tree, with all cores; it takes and gives float64."""
    import igl

    vertices, faces, tree = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64), igl.AABB()
    tree.init(vertices, faces)

    def ask(points: np.ndarray) -> Callable[[], Any]:
        given = points.astype(np.float64)
        return lambda: tree.squared_distance(vertices, faces, given)

    return Contending("libigl", all_cores(), ask, lambda found, _: np.sqrt(found[0]))


def warp_mesh(mesh: TriangleMesh, threads: int) -> Contending:
    """`wp.Mesh` on the CPU, which Warp runs on one thread."""
    from wrt.bench.peers.warp_mesh_kernels import mesh_nearest

    vertices = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
    own = wp.Mesh(vertices, wp.array(mesh.faces.ravel(), dtype=int, device="cpu"))

    def ask(points: np.ndarray) -> Callable[[], Any]:
        given = wp.array(points, dtype=wp.vec3, device="cpu")

        def run() -> wp.array:
            found = wp.empty(len(points), dtype=wp.vec3, device="cpu")
            wp.launch(mesh_nearest, len(points), inputs=[own.id, given, found], device="cpu")
            return found

        return run

    return Contending("wp.Mesh", 1, ask, lambda found, points: apart(found.numpy(), points))


def trimesh_proximity(mesh: TriangleMesh, threads: int) -> Contending:
    """trimesh's `proximity.closest_point`, on one thread; asked for few points."""
    import trimesh

    own = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    ask = lambda points: lambda: trimesh.proximity.closest_point(own, points)[1]  # noqa: E731
    return Contending("trimesh", 1, ask, lambda found, _: found, FEW)


POINT_PEERS: dict[str, tuple[str, Callable[[TriangleMesh, int], Contending]]] = {
    "kdtree": ("warp", lambda mesh, threads: wrt_scene(mesh, threads, "kdtree")),
    "open3d": ("open3d", open3d_scene),
    "fcpw": ("fcpw", fcpw_scene),
    "igl": ("igl", igl_tree),
    "warp_mesh": ("warp", warp_mesh),
    "trimesh": ("rtree", trimesh_proximity),
}
"""What wrt's BVH is compared with, by the name that the command line knows: what must be importable, and the function."""


def all_cores() -> int:
    """Threads of libraries that cannot be told how many to use."""
    return available_cores()


def apart(found: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N,) distances."""
    return np.linalg.norm(found.astype(np.float64) - points, axis=1)


def sets_of_points(mesh: TriangleMesh, count: int) -> dict[str, np.ndarray]:
    """(count, 3) float32 each: uniform in the box, and on triangles, moved by `NEAR`."""
    rng, (low, high) = np.random.default_rng(1), np.asarray(mesh.bounds, dtype=np.float64)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    on = np.einsum("nij,ni->nj", chosen, rng.dirichlet([1, 1, 1], count))
    near = on + rng.normal(size=(count, 3)) * (NEAR * np.linalg.norm(high - low))
    return {"in the box": rng.uniform(low, high, (count, 3)).astype(np.float32), "near the surface": near.astype(np.float32)}


DISTRIBUTIONS = {"igl": "libigl", "fcl": "python-fcl"}
"""What to install for packages of another name."""


def missing_peers(names: Sequence[str]) -> dict[str, str]:
    """Peers that cannot run, with the reason; names: keys of `POINT_PEERS`, or packages."""
    missing = {}
    for name in names:
        package = POINT_PEERS[name][0] if name in POINT_PEERS else name
        if importlib.util.find_spec(package) is None:
            missing[name] = f"needs {package}, which is not installed: pip install {DISTRIBUTIONS.get(package, package)}"
            continue
        try:
            importlib.import_module(package)
        except (ImportError, OSError) as error:
            missing[name] = f"{package} is installed but cannot be imported: {error}"
    return missing


def compare_points(
    mesh: TriangleMesh, names: Sequence[str], count: int, rounds: int, threads: int, on_turn: Callable[[str], None]
) -> Iterator[PointRow]:
    """Builds all contenders, and times them on both sets of points.

    Args:
        mesh: what they search.
        names: keys in `POINT_PEERS`, which can run.
        count: points of a set.
        rounds: of each contender.
        threads: of those that can be told.
        on_turn: told what is under way.
    """
    made = [wrt_scene(mesh, threads, "bvh")]
    for name in names:
        on_turn(f"build {name}")
        made.append(POINT_PEERS[name][1](mesh, threads))
    scene, tolerance = (
        Scene(mesh, device="cpu", num_threads=threads),
        TOLERANCE * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0))),
    )

    def told(title: str) -> Callable[[str], None]:
        return lambda name: on_turn(f"{title}: {name}")

    for title, points in sets_of_points(mesh, count).items():
        given = {each.name: points[: each.max_points] for each in made}
        contenders = [Contender(each.name, each.ask(given[each.name]), len(given[each.name])) for each in made]
        timings = take_turns(contenders, rounds, budget=BUDGET, settle=0.5, on_turn=told(title))
        own = timings[made[0].name]
        for each in made:
            timing = timings[each.name]
            if timing.error is not None:
                yield PointRow(title, each.name, each.threads, None, None, None, timing.error)
                continue
            asked = given[each.name]
            share = float(np.mean(np.abs(each.read(timing.result, asked) - own.result[: len(asked)]) <= tolerance))
            work = visits(scene, points, own) if each is made[0] else None
            speed = timing.items / timing.median / 1e6
            yield PointRow(title, each.name, each.threads, speed, timing.ratio_to(own), share, None, work)


def visits(scene: Scene, points: np.ndarray, timing: Timing) -> dict[str, float]:
    """Nodes and triangles that a point visits, and the least: those that it visits if it knows its distance beforehand."""
    work = scene.closest_point(points, counters=True).counters
    fewest = scene.closest_point(points, max_distance=timing.result, counters=True).counters
    figures = {key: float(work[key].mean()) for key in ("nodes", "triangles")}
    return figures | {f"least {key}": float(fewest[key].mean()) for key in ("nodes", "triangles")}
