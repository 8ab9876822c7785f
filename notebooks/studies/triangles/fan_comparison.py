"""Triangle fans against triangles one by one, all of them for every ray, and in trees: does sharing vertices pay?

`compare` times brute force over fans (`wrt.classics.fan_arrays.closest_by_fans`) beside brute force by Moeller and Trumbore's
test, from which the fans' is derived, with and without precomputed edges, beside the plane's rows and Havel and Herout's test.
`compare_trees` times trees with leaves of fans (`wrt.classics.FanScene`) beside those of triangles. `compare_files` reads files
of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from studies.triangles.pichler_tables import SCENES
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.bench.core.workloads import WorkloadMaker
from wrt.builders.triangle_fans import TriangleFans
from wrt.classics.fan_arrays import closest_by_fans, fans_of, on_device
from wrt.classics.fan_files import load_fans, save_fans
from wrt.classics.fan_scene import FanScene
from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.launch.traversal_launch import kernel_and_inputs, no_work
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import traversal_config
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.fan_brute_force import EDGES, NORMALS, PLANES, VERTICES, VERTICES_NORMALS, FanSet
from wrt.kernels.traversal.leaf import Counters
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

TESTS = ("moeller_trumbore", "moeller_trumbore_precomputed", "baldwin_weber", "havel_herout")
"""Triangle by triangle; the first is the reference."""


def closest(
    scene: Scene, fans: FanSet, rays: Rays, edges: bool, normals: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`closest_by_fans` with the rim as positions or relative to the centre (`edges`), and with known normals or not."""
    form = (NORMALS if normals else EDGES) if edges else (VERTICES_NORMALS if normals else VERTICES)
    return closest_by_fans(scene, fans, rays, form)


def compare(scenes: Sequence[str] = ("teapot", "stadium"), *, size: int = 24, rounds: int = 7) -> list[dict[str, Any]]:
    """Time of all rays of a view against all triangles.

    Args:
        scenes: keys in `studies.triangles.pichler_tables.SCENES`.
        size: the view has size x size pixels, a multiple of 4.
        rounds: how often each has its turn.

    Returns:
        A row for each scene and way: scene, triangles, fans, stored (vertices that describe the fans, M + 2 each, over three a
        triangle), way (a triangle test, "fans, planes" (Havel and Herout's test),
        "fans", "fans, edges" or "fans, edges, normals"), seconds, ratio, least, greatest.
    """
    rows = []
    for name in scenes:
        mesh = SCENES[name]()
        scene = Scene(mesh, "bvh", num_threads=1, device="cpu")
        rays = next(WorkloadMaker(mesh, size=size).make(("far",))).rays
        fans = fans_of(scene.state)
        timings = timed(ways(scene, fans, rays), rounds)
        for way, timing in timings.items():
            row = {"scene": name, "triangles": scene.triangle_count, "fans": len(fans), "way": way}
            row["stored"] = (len(fans.rim) + len(fans)) / (3 * scene.triangle_count)
            rows.append({**row, **ratios(timing, timings[TESTS[0]])})
    return rows


def ways(scene: Scene, fans: TriangleFans, rays: Rays) -> dict[str, Callable[[], np.ndarray]]:
    """What finds t of all rays: by each of `TESTS`, and by fans of four kinds."""

    def by_test(test: str) -> Callable[[], np.ndarray]:
        return lambda: scene.intersect(rays, traversal="brute", triangle_test=test).t

    def by_fans(form: str) -> Callable[[], np.ndarray]:
        made = on_device(scene.state, fans, form not in (VERTICES, VERTICES_NORMALS))
        return lambda: closest_by_fans(scene, made, rays, form)[0]

    runs = {test: by_test(test) for test in TESTS}
    kinds = {"fans, planes": PLANES, "fans": VERTICES, "fans, edges": EDGES, "fans, edges, normals": NORMALS}
    return runs | {name: by_fans(form) for name, form in kinds.items()}


def compare_trees(scenes: Sequence[str] = ("teapot", "stadium"), *, size: int = 128, rounds: int = 7) -> list[dict[str, Any]]:
    """Time of single rays of a view through trees with leaves of fans, and of triangles.

    Args:
        scenes, rounds: as in `compare`.
        size: the view has size x size pixels, a multiple of 4.

    Returns:
        A row for each scene and way: scene, triangles, fans, way ("bvh" and "kdtree" of triangles, tested W at once; "bvh, one
        by one", leaves of triangles tested one by one; "fans, bvh", "fans, kdtree" and "fans, bvh, planes"), seconds, ratio to
        "bvh, one by one", least, greatest.
    """
    rows = []
    for name in scenes:
        mesh = SCENES[name]()
        rays = next(WorkloadMaker(mesh, size=size).make(("far",))).rays
        fans = {
            "fans, bvh": FanScene(mesh, "bvh", num_threads=1, device="cpu"),
            "fans, bvh, planes": FanScene(mesh, "bvh", form=PLANES, num_threads=1, device="cpu"),
            "fans, kdtree": FanScene(mesh, "kdtree", num_threads=1, device="cpu"),
        }
        trees = {kind: Scene(mesh, kind, num_threads=1, device="cpu") for kind in ("bvh", "kdtree")}
        runs = {way: partial(scene.intersect, rays) for way, scene in fans.items()}
        tests = {"traversal": "single", "triangle_test": TESTS[0]}
        runs |= {kind: partial(scene.intersect, rays, **tests) for kind, scene in trees.items()}
        runs[ONE_BY_ONE] = one_by_one(trees["bvh"], rays)
        timings = timed(runs, rounds)
        for way, timing in timings.items():
            row = {"scene": name, "triangles": mesh.triangle_count, "fans": len(fans["fans, bvh"].fans), "way": way}
            rows.append({**row, **ratios(timing, timings[ONE_BY_ONE])})
    return rows


ONE_BY_ONE = "bvh, one by one"


def one_by_one(scene: Scene, rays: Rays) -> Callable[[], DeviceHits]:
    """Traces single rays whose leaves test triangles one by one, by the scalar test."""
    buffers = to_device(rays, scene.device, scene.center)
    plan = make_plan(scene.state, buffers, "single", TESTS[0], CLOSEST)
    config = traversal_config(plan, scene.state, CLOSEST, False)
    config = replace(config, single=replace(config.single, scalar_test=True))
    hits = DeviceHits.new(CLOSEST, buffers.count, scene.device)
    work = no_work(Counters, scene.device.alias)
    kernel, inputs = kernel_and_inputs(scene.state, plan, config, buffers.batch, hits.struct(), work)

    def trace() -> DeviceHits:
        launch(kernel, buffers.count, inputs, device=scene.device)
        return hits

    return trace


def compare_files(folder: Path, scenes: Sequence[str] = ("teapot", "stadium"), *, rounds: int = 7) -> list[dict[str, Any]]:
    """Size and loading time of a file of fans, and of a file of separate triangles (3 M vertices).

    Returns:
        A row for each scene: scene, triangles, fans, bytes and seconds of both files ("fan_bytes", "triangle_bytes",
        "fan_seconds", "triangle_seconds").
    """
    rows = []
    for name in scenes:
        mesh = SCENES[name]()
        scene = FanScene(mesh, device="cpu")
        save_fans(folder / "fans.npz", scene.fans, np.unique(scene.state.device_mesh.vertices.numpy(), axis=0))
        np.savez(
            folder / "triangles.npz", vertices=scene.state.device_mesh.vertices.numpy()[scene.state.device_mesh.faces.numpy()]
        )
        timings = timed({"fan": lambda: load_fans(folder / "fans.npz"), "triangle": lambda: load_triangles(folder)}, rounds)
        row = {"scene": name, "triangles": mesh.triangle_count, "fans": len(scene.fans)}
        for kind, timing in timings.items():
            row[f"{kind}_bytes"] = (folder / f"{kind}s.npz").stat().st_size
            row[f"{kind}_seconds"] = ratios(timing, timing)["seconds"]
        rows.append(row)
    return rows


def load_triangles(folder: Path) -> TriangleMesh:
    """The mesh of a file of separate triangles."""
    with np.load(folder / "triangles.npz") as file:
        vertices = file["vertices"]
    return TriangleMesh(vertices.reshape(-1, 3), np.arange(3 * len(vertices), dtype=np.int32).reshape(-1, 3))
