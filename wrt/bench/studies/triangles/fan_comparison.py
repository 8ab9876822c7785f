"""Triangle fans against triangles one by one, all of them for every ray: does sharing vertices pay?

`closest` finds the closest hits with a set of fans, as `Scene.intersect` does with a tree. `compare` times it beside brute
force by Moeller and Trumbore's test, from which the fans' is derived, with and without precomputed edges, and beside the
plane's rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.bench.core.workloads import WorkloadMaker
from wrt.bench.studies.triangles.pichler_tables import SCENES
from wrt.builders.triangle_fans import TriangleFans, build_fans
from wrt.execution.traversal_launch import BRUTE_FORCE_TESTS
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.fan_brute_force import FanSet, make_kernel
from wrt.rays.ray_buffers import to_device
from wrt.rays.rays import Rays
from wrt.scene.scene import Scene
from wrt.state.device_hits import DeviceHits

TESTS = ("moeller_trumbore", "moeller_trumbore_precomputed", "baldwin_weber")
"""Triangle by triangle; the first is the reference."""


def fans_of(scene: Scene) -> TriangleFans:
    """The fans of a scene's triangles, vertices that coincide counting as one."""
    vertices, faces = scene.device_mesh.vertices.numpy(), scene.device_mesh.faces.numpy()
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    return build_fans(same.ravel()[faces])


def on_device(scene: Scene, fans: TriangleFans, edges: bool) -> FanSet:
    """The fans with the positions of their vertices and their normals; `edges`: the rim from the fan's centre."""
    positions = np.unique(scene.device_mesh.vertices.numpy(), axis=0)
    centre, rim = positions[fans.centre], positions[fans.rim]
    from_centre = rim - np.repeat(centre, np.diff(fans.first), axis=0)
    if edges:
        rim = from_centre
    inner = np.ones(len(rim), dtype=bool)
    inner[fans.first[1:] - 1] = False
    (px, py, pz), (qx, qy, qz) = from_centre[inner].T, from_centre[np.flatnonzero(inner) + 1].T
    normal = np.stack([py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx], axis=1)
    made = FanSet()
    made.normal = wp.array(normal, dtype=wp.vec3, device=scene.device)
    made.count = len(fans)
    made.centre = wp.array(centre, dtype=wp.vec3, device=scene.device)
    made.rim = wp.array(rim, dtype=wp.vec3, device=scene.device)
    for name in ("first", "primitive", "corner"):
        setattr(made, name, wp.array(getattr(fans, name), dtype=int, device=scene.device))
    return made


def closest(
    scene: Scene, fans: FanSet, rays: Rays, edges: bool, normals: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closest hits of all rays with all fans.

    Args:
        scene: whose fans they are.
        fans: `on_device` with the same `edges`.
        rays: N rays.
        edges: as the fans were made.
        normals: whether the precomputed normals are read.

    Returns:
        t (N,) float32, inf for a miss; triangle (N,) int32, -1 for a miss; uv (N, 2) float32.
    """
    buffers = to_device(rays, scene.device, scene.center)
    hits = DeviceHits.new("closest", buffers.batch.count, scene.device)
    longest = max(1, BRUTE_FORCE_TESTS // scene.triangle_count)
    launch(
        make_kernel(edges, normals),
        buffers.batch.count,
        [fans, buffers.batch, hits.struct()],
        device=scene.device,
        chunk=64,
        longest=longest,
    )
    return hits.t.numpy(), hits.primitive.numpy(), hits.uv.numpy()


def compare(scenes: Sequence[str] = ("teapot", "stadium"), *, size: int = 24, rounds: int = 7) -> list[dict[str, Any]]:
    """Time of all rays of a view against all triangles.

    Args:
        scenes: keys in `wrt.bench.studies.triangles.pichler_tables.SCENES`.
        size: the view has size x size pixels, a multiple of 4.
        rounds: how often each has its turn.

    Returns:
        A row for each scene and way: scene, triangles, fans, stored (vertices that describe the fans, M + 2 each, over three a
        triangle), way (a triangle test, "fans", "fans, edges" or "fans, edges, normals"), seconds, ratio, least, greatest.
    """
    rows = []
    for name in scenes:
        mesh = SCENES[name]()
        scene = Scene(mesh, "bvh", num_threads=1, device="cpu")
        rays = next(WorkloadMaker(mesh, size=size).make(("far",))).rays
        fans = fans_of(scene)
        timings = timed(ways(scene, fans, rays), rounds)
        for way, timing in timings.items():
            row = {"scene": name, "triangles": scene.triangle_count, "fans": len(fans), "way": way}
            row["stored"] = (len(fans.rim) + len(fans)) / (3 * scene.triangle_count)
            rows.append({**row, **ratios(timing, timings[TESTS[0]])})
    return rows


def ways(scene: Scene, fans: TriangleFans, rays: Rays) -> dict[str, Callable[[], np.ndarray]]:
    """What finds t of all rays: by each of `TESTS`, and by fans of three kinds."""

    def by_test(test: str) -> Callable[[], np.ndarray]:
        return lambda: scene.intersect(rays, traversal="brute", triangle_test=test).t

    def by_fans(edges: bool, normals: bool = False) -> Callable[[], np.ndarray]:
        made = on_device(scene, fans, edges)
        return lambda: closest(scene, made, rays, edges, normals)[0]

    runs = {test: by_test(test) for test in TESTS}
    return runs | {"fans": by_fans(False), "fans, edges": by_fans(True), "fans, edges, normals": by_fans(True, True)}
