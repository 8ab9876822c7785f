"""What is computed on ARM and on this CPU: groups of cases, each with the hashes of its results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import support.environment  # noqa: F401 (before wrt)
from bits.digests import digest
from bits.hit_bits import hit_hashes
from bits.tree_bits import builds, tree_hashes
from support.meshes import SCENES

import wrt
from wrt.imaging.integrators import INTEGRATORS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS

Hashes = Iterator[tuple[str, str, str]]
"""(case, engine, hash)."""

THREADS = 4


def groups() -> dict[str, Callable[[], Hashes]]:
    """Functions by name. Those of hits and trees give the cases of `tests/bits`."""
    names = [name for name, _ in builds(SCENES["grid"]())]
    return {
        **{f"hits by {name}": partial(hit_hashes, ("teapot",), (name,), ("woop",)) for name in TRAVERSALS},
        **{f"triangle test {name}": partial(hit_hashes, ("grid",), ("single",), (name,)) for name in TRIANGLE_TESTS},
        **{f"tree {name}": partial(tree_hashes, ("grid",), (1, THREADS), (name,)) for name in names},
        **{f"picture {name}": partial(picture, name) for name in INTEGRATORS},
        "points": points,
        "scan": scan,
        "instances": instances,
    }


ALWAYS = ("hits by single", "tree bvh binned", "tree kdtree in_place")
"""Groups of every sample."""


def chosen(number: int, turn: int) -> dict[str, Callable[[], Hashes]]:
    """One group in `number`, others in each of `number` turns, and those of every sample."""
    drawn = [*groups()][turn % number :: number]
    return {name: compute for name, compute in groups().items() if name in ALWAYS or name in drawn}


def picture(integrator: str) -> Hashes:
    mesh = wrt.scenes.build("cornell_box")
    camera = wrt.PinholeCamera.framing(mesh, 24, 18)
    found = wrt.render(wrt.Scene(mesh, device="cpu"), camera, integrator=integrator, samples=2)
    yield f"picture {integrator}", "auto", digest(found)


def points() -> Hashes:
    mesh = SCENES["teapot"]()
    some = np.random.default_rng(3).normal(size=(2000, 3)).astype(np.float32)
    for kind in ("bvh", "kdtree"):
        found = wrt.Scene(mesh, kind, device="cpu").closest_point(some)
        yield "closest points", kind, digest(found.distance, found.primitive_id, found.uv, found.feature)
    yield "signed distances", "bvh", digest(wrt.analysis.signed_distance(wrt.Scene(mesh, device="cpu"), some[:200]))


def scan() -> Hashes:
    scene = wrt.Scene(SCENES["atrium"](), device="cpu")
    pose = np.eye(4)
    pose[:3, 3] = np.mean(scene.bounds, axis=0)
    found = wrt.sensors.Lidar.preset("velodyne_vlp16").scan(scene, pose, seed=1)
    yield "scan", "auto", digest(found.range, found.intensity, found.position)


def instances() -> Hashes:
    mesh = SCENES["teapot"]()
    placed = [wrt.Instance(mesh, np.diag([s, s, s, 1.0])) for s in (0.5, 1.0, 1.5)]
    scene = wrt.Scene(placed, device="cpu")
    rng = np.random.default_rng(5)
    origins = rng.normal(size=(2000, 3)).astype(np.float32) * 4
    hits = scene.intersect(origins, -origins)
    yield "instances", "auto", digest(hits.t, hits.primitive_id, hits.uv, hits.instance_id)
