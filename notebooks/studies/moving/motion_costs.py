"""What it costs to follow a motion, part by part; `animation_comparison` has the whole ways.

    drift           Yang et al. 2008, Lauterbach et al. 2006: old nodes, moved triangles, against a tree built for the frame
    group_updates   Kang et al. 2013: one kd-tree and a kd-tree for each group, by the number of groups that move
    rigid_motion    Lext and Akenine-Moeller 2001, Wald et al. 2003: instances, and one tree of all copies
    fuzzy_growth    Guenther et al. 2006: fuzzy boxes by the number of frames that they cover
    thread_splits   Yang et al. 2008: threads that build beside threads that trace

All but `thread_splits`, which needs two threads and takes wall time, measure the processor time of one thread.

References: rahikainen-2013 (section 4.2, which describes all of them).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count, cycle
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from studies.moving.animation_comparison import Stage, WayFigures, answer, by_updates, follow, follow_behind
from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.builders.motion_clusters import Decomposition, fuzzy_boxes
from wrt.engine.rays.rays import Rays
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import use_threads
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.moving.fuzzy_scene import FuzzyScene, find_motion, triangle_corners
from wrt.moving.grouped_scene import GroupedScene
from wrt.scene.scene import Scene
from wrt.scenes.animations import Animation

Row = dict[str, Any]


def scattered(mesh: TriangleMesh, frames: int, distance: float, seed: int = 0) -> Animation:
    """Unstructured motion: each triangle flies straight on its own way.

    Args:
        mesh: the first frame.
        frames: number of frames.
        distance: flown by the last frame, at most, in units of the mesh.
        seed: of the ways.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    ways = np.random.default_rng(seed).uniform(-distance, distance, (len(corners), 1, 3))
    shares = np.linspace(0.0, 1.0, frames)[:, None, None, None]
    moved = (corners + shares * ways).reshape(frames, -1, 3)
    return Animation("scattered triangles", moved, np.arange(moved.shape[1], dtype=np.int32).reshape(-1, 3))


def drift(animation: Animation, accelerator: str, rays: Rays, *, rounds: int = 3) -> list[Row]:
    """How a tree with the nodes of frame 0 compares with one that is built for the frame.

    Args:
        animation: what moves.
        accelerator: "bvh" or "kdtree".
        rays: traced in every frame.
        rounds: turns of both trees.

    Returns:
        A row for each frame: frame, cost (by the surface area heuristic), tests (of triangles, by single rays), time; each over
        that of the tree built for the frame.
    """
    kept, rows = Scene(animation.mesh(0), accelerator, device="cpu", num_threads=1), []
    for frame, vertices in enumerate(animation.frames):
        kept.update(0, vertices=vertices, rebuild="never")
        built = Scene(animation.mesh(frame), accelerator, device="cpu", num_threads=1)
        times = timed({"kept": lambda: kept.intersect(rays), "built": lambda built=built: built.intersect(rays)}, rounds)
        costs = [scene.statistics().tree.sah_cost for scene in (kept, built)]
        tests = [triangle_tests(scene, rays) for scene in (kept, built)]
        row = {"frame": frame, "cost": costs[0] / costs[1], "tests": tests[0] / tests[1]}
        rows.append({**row, "time": ratios(times["kept"], times["built"])["ratio"]})
    return rows


def triangle_tests(scene: Scene, rays: Rays) -> float:
    """Triangles that a ray is tested against, on average, by single rays."""
    return float(scene.intersect(rays, traversal="single", counters=True).counters["triangles"].sum() / len(rays))


def group_updates(
    static: TriangleMesh, animation: Animation, groups: int, moving: Sequence[int], *, rounds: int = 3
) -> list[Row]:
    """Time to update kd-trees when some of many groups move.

    Args:
        static: stays.
        animation: of each group; groups stand 1.2 apart along the y axis.
        groups: how many.
        moving: numbers of groups that move.
        rounds: number of rounds per way.

    Returns:
        A row for each number and way: moving, way ("one kd-tree, built", "one kd-tree, refilled or built", "groups, built",
        "groups, refilled or built"), seconds, ratio to the first way, least, greatest.
    """
    places = [animation.moved((0.0, 1.2 * number, 0.0)) for number in range(groups)]
    meshes, rows = [static, *(place.mesh(0) for place in places)], []
    for number in moving:

        def one(rebuild: str, number: int = number) -> Callable[[], None]:
            """All moving groups are one mesh, and one update."""
            parts = [static, TriangleMesh.concatenate(meshes[1 : 1 + number]), *meshes[1 + number :]]
            scene, frames = Scene(parts, "kdtree", device="cpu"), cycle(range(len(animation)))

            def run() -> None:
                frame = next(frames)
                scene.update(1, vertices=np.concatenate([place.frames[frame] for place in places[:number]]), rebuild=rebuild)

            return run

        def many(rebuild: str, number: int = number) -> Callable[[], None]:
            scene, frames = GroupedScene(meshes, "kdtree", device="cpu"), cycle(range(len(animation)))

            def run() -> None:
                frame = next(frames)
                scene.update({1 + k: place.frames[frame] for k, place in enumerate(places[:number])}, rebuild=rebuild)

            return run

        runs = {"one kd-tree, built": one("always"), "one kd-tree, refilled or built": one("auto")}
        runs |= {"groups, built": many("always"), "groups, refilled or built": many("auto")}
        timings = timed(runs, rounds)
        rows += [
            {"moving": number, "way": way, **ratios(timing, timings["one kd-tree, built"])} for way, timing in timings.items()
        ]
    return rows


def rigid_motion(mesh: TriangleMesh, copies: Sequence[int], camera: PinholeCamera, *, rounds: int = 3) -> list[Row]:
    """Copies of a mesh that turn: as instances, and as one mesh.

    Args:
        mesh: at the origin.
        copies: numbers of copies, in a square grid.
        camera: looks at the grid.
        rounds: number of rounds per way.

    Returns:
        A row for each number and way: copies, way ("built", "refitted", "instances"), update and trace (seconds), same (share
        of rays with the same triangle as in the built tree).
    """
    rows, rays, low = [], camera.rays(), mesh.bounds
    step = 1.1 * float((low[1] - low[0]).max())
    for number in copies:
        across = int(np.ceil(np.sqrt(number)))

        def places(turn: int, number: int = number, across: int = across) -> np.ndarray:
            maps, angle = np.tile(np.eye(4), (number, 1, 1)), 0.05 * turn + np.arange(number)
            maps[:, 0, 0] = maps[:, 1, 1] = np.cos(angle)
            maps[:, 1, 0], maps[:, 0, 1] = np.sin(angle), -np.sin(angle)
            maps[:, :2, 3] = step * (np.stack(np.divmod(np.arange(number), across), axis=1) - (across - 1) / 2)
            return maps

        def spread(maps: np.ndarray) -> np.ndarray:
            return (np.einsum("nij,vj->nvi", maps[:, :3, :3], mesh.vertices) + maps[:, None, :3, 3]).reshape(-1, 3)

        faces = np.concatenate([mesh.faces + k * mesh.vertex_count for k in range(number)])
        scenes: dict[str, Scene] = {
            way: Scene(TriangleMesh(spread(places(0)), faces), device="cpu", num_threads=1) for way in ("built", "refitted")
        }
        scenes["instances"] = Scene([Instance(mesh, matrix) for matrix in places(0)], device="cpu", num_threads=1)
        turns = count(1)

        def update(way: str, scenes: dict[str, Scene] = scenes, turns: Any = turns) -> Callable[[], None]:
            def run() -> None:
                maps = places(next(turns))
                if way == "instances":
                    scenes[way].update(range(len(maps)), transform=maps)
                else:
                    scenes[way].update(0, vertices=spread(maps), rebuild="always" if way == "built" else "never")

            return run

        updates = timed({way: update(way) for way in scenes}, rounds)
        for way, scene in scenes.items():  # the same turn in all of them
            scene.update(range(number), transform=places(1)) if way == "instances" else scene.update(
                0, vertices=spread(places(1))
            )
        traces = timed({way: lambda scene=scene: scene.intersect(rays) for way, scene in scenes.items()}, rounds)
        seen = {way: hit_triangles(scene, rays, mesh.triangle_count) for way, scene in scenes.items()}
        rows += [
            {"copies": number, "way": way, "update": updates[way].median, "trace": traces[way].median}
            | {"same": float((seen[way] == seen["built"]).mean())}
            for way in scenes
        ]
    return rows


def hit_triangles(scene: Scene, rays: Rays, triangles: int) -> np.ndarray:
    """(N,) triangles of the closest hits, numbered through all copies of this many triangles; -1 for none."""
    hits = scene.intersect(rays)
    if not scene.instances:
        return hits.primitive_id
    return np.where(hits.is_hit, hits.instance_id.astype(np.int64) * triangles + hits.primitive_id, -1)


def fuzzy_growth(animation: Animation, lengths: Sequence[int], rays: Rays, *, clusters: int = 12, rounds: int = 3) -> list[Row]:
    """Fuzzy boxes of the first frames of an animation.

    Args:
        animation: what moves; with bones or without.
        lengths: numbers of frames, from the first one.
        rays: traced in the middle one of these frames, one by one.
        clusters: largest number that is looked for.
        rounds: number of rounds per tree.

    Returns:
        A row for each number and kind of clusters ("one cluster", "found", "found, best rest pose", "bones"): frames, clusters
        (kind), number (of clusters), seconds (of finding them), building (seconds), area (of a fuzzy box over that of the
        triangle's own box, means), tests (of triangles) and time, over those of a BVH built for the frame, kdtree_time: the
        same with kd-trees, over a kd-tree.
    """
    rows = []
    for length in lengths:
        meshes, middle = [animation.mesh(frame) for frame in range(length)], length // 2
        static = {kind: Scene(meshes[middle], kind, device="cpu", num_threads=1) for kind in ("bvh", "kdtree")}
        for kind, options in clusterings(animation, length, clusters).items():
            with use_threads(1):
                start = thread_time()
                motion = find_motion(meshes, **options)
                found = thread_time()
                fuzzy = {"bvh": fuzzy_scene(meshes, motion, Bvh())}
                built = thread_time()
            fuzzy["kdtree"] = fuzzy_scene(meshes, motion, KdTree())
            runs = {}
            for tree, scene in fuzzy.items():
                scene.show(middle)
                runs[tree, "fuzzy"] = lambda scene=scene: scene.intersect(rays)
                runs[tree, "static"] = lambda scene=static[tree]: scene.intersect(rays, traversal="single")
            timings = timed(runs, rounds)
            slower = {tree: ratios(timings[tree, "fuzzy"], timings[tree, "static"])["ratio"] for tree in fuzzy}
            tests = [triangle_tests(scene, rays) for scene in (fuzzy["bvh"], static["bvh"])]
            row = {"frames": length, "clusters": kind, "number": motion.matrices.shape[1], "seconds": found - start}
            row |= {"building": built - found, "area": area_growth(meshes, motion), "tests": tests[0] / tests[1]}
            rows.append({**row, "time": slower["bvh"], "kdtree_time": slower["kdtree"]})
    return rows


def clusterings(animation: Animation, length: int, clusters: int) -> dict[str, Row]:
    """Ways to find clusters: arguments of `find_motion`."""
    found = {
        "one cluster": {"clusters": 1, "transforms": None, "rest": 0},
        "found": {"clusters": clusters, "transforms": None, "rest": 0},
        "found, best rest pose": {"clusters": clusters, "transforms": None, "rest": "best"},
    }
    if animation.bones is not None:
        found["bones"] = {"clusters": 0, "transforms": animation.bones[:length], "rest": 0}
    return found


def fuzzy_scene(meshes: list[TriangleMesh], motion: Decomposition, accelerator: Bvh | KdTree) -> FuzzyScene:
    """The scene of clusters that have been found."""
    maps = np.zeros((*motion.matrices.shape[:2], 4, 4))
    maps[..., :3, :3], maps[..., :3, 3], maps[..., 3, 3] = motion.matrices, motion.origins, 1.0
    frames = np.array([mesh.vertices for mesh in meshes])
    options = {"transforms": maps, "accelerator": accelerator, "device": "cpu", "num_threads": 1}
    return FuzzyScene(frames, meshes[0].faces, **options)


def area_growth(meshes: list[TriangleMesh], motion: Decomposition) -> float:
    """Mean area of triangles' fuzzy boxes, over the mean area of their own boxes in all frames."""
    corners = np.array([triangle_corners(mesh, np.zeros(3)) for mesh in meshes], dtype=np.float64)
    area = np.empty(len(motion.labels))
    for c in range(motion.matrices.shape[1]):
        own = motion.labels == c
        low, high = fuzzy_boxes(corners[:, :, own], motion.matrices[:, c], motion.origins[:, c])
        area[own] = box_areas(high - low)
    return float(area.mean() / box_areas(corners[:, 1] - corners[:, 0]).mean())


def box_areas(size: np.ndarray) -> np.ndarray:
    """Half the areas of boxes. size: (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(size, dtype=np.float64), -1, 0)
    return x * y + y * z + z * x


def thread_splits(stage: Stage, cameras: Sequence[PinholeCamera], *, rounds: int = 3) -> list[Row]:
    """Two threads that first build and then trace, and a thread that builds beside one that traces the last frame's tree.

    Args:
        stage: what moves, and where; the whole tree is built for each frame.
        cameras: views that are traced.
        rounds: turns; the best time of each frame counts.

    Returns:
        A row for each accelerator and camera: accelerator, rays, turns, split (seconds a frame, wall time), same (least share
        of the rays, over frames, with the same triangle at the same t as in a tree built for the frame).
    """
    rows = []
    with use_threads(2):
        for camera in cameras:
            meshes = [stage.meshes(frame) for frame in range(len(stage.animation))]
            expected = [answer(Scene(parts, device="cpu"), camera) for parts in meshes]
            for accelerator in ("bvh", "kdtree"):
                turns, show = WayFigures("in turns", 0.0), by_updates(accelerator, "always")(stage)
                for _ in range(rounds):
                    follow(show, camera, expected, turns, perf_counter)
                split = follow_behind(stage, camera, expected, rounds, accelerator)
                row = {"accelerator": accelerator, "rays": camera.width * camera.height}
                row |= {"turns": 1.0 / turns.frames_per_second, "split": 1.0 / split.frames_per_second}
                rows.append({**row, "same": min(turns.same_bits, split.same_bits)})
    return rows
