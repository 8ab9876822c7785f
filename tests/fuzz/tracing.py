"""Scenes of any finite mesh: refused with a clear error, or every tree answers as brute force does, to the bit.

Meshes smaller than `wrt.query.verification.MIN_EXTENT` become scenes, but answers are not compared: products of
float32 underflow,
and the forms of the triangle test may then differ. `Scene.verify` names that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import wrt
from wrt.meshes.placement import MAX_COORDINATE, MAX_EXTENT
from wrt.query.verification import MIN_EXTENT

from . import floats
from .building import KDTREES
from .cases import Case, WrongAnswer

RAYS = 24

BVHS = (
    {"builder": "binned"},
    {"builder": "sweep"},
    {"builder": "binned", "reinsertion": 2},
    {"builder": "binned", "width": 2, "max_leaf_triangles": 1},
)

TRAVERSALS = {"bvh": ("single", "stream", "packet"), "kdtree": ("single", "lockstep", "stream", "packet")}

COUNTING = {"bvh": ("single", "stream"), "kdtree": ("single",)}


def make_case(rng: np.random.Generator) -> Case:
    """One to three meshes, some rays, a tree, ways through it, and perhaps where the first mesh moves to."""
    kind = str(rng.choice(["bvh", "kdtree"]))
    options: dict[str, Any] = {"kind": kind, "tree": dict((BVHS if kind == "bvh" else KDTREES)[rng.integers(len(BVHS))])}
    if kind == "kdtree":
        options["tree"] = dict(KDTREES[rng.integers(len(KDTREES))])
    options["traversal"] = str(rng.choice(TRAVERSALS[kind]))
    options["counting"] = str(rng.choice(COUNTING[kind]))
    options["form"] = str(rng.choice(["meshes", "grouped", "instances"], p=[0.8, 0.1, 0.1]))
    options["ask"] = str(rng.choice(["closest", "any", "count"], p=[0.6, 0.2, 0.2]))
    arrays = {}
    for number in range(int(rng.choice([1, 2, 3], p=[0.8, 0.1, 0.1]))):
        vertices, faces = floats.shared(rng, floats.finite_corners(rng))
        if rng.random() < 0.7:
            vertices = fitted(rng, vertices)
        if rng.random() < 0.2:  # vertices that no triangle uses
            vertices = np.concatenate([vertices, np.nan_to_num(floats.special(rng, (2, 3)), posinf=3e38, neginf=-3e38)])
        arrays |= {f"vertices{number}": vertices, f"faces{number}": faces}
    if rng.random() < 0.25:
        moved = np.nan_to_num(floats.NUMBERS[rng.integers(len(floats.NUMBERS))](rng, arrays["vertices0"].shape), posinf=1.0)
        arrays["moved"] = fitted(rng, moved) if rng.random() < 0.7 else moved
    if options["form"] == "instances":
        arrays["transform"] = transform(rng)
    arrays["ray_bits"] = rng.integers(0, 1 << 32, (RAYS, 4), dtype=np.uint32)
    return Case("rays", options, arrays)


def fitted(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """The points, brought to a size that a scene takes, at some place, in float32 or float64."""
    points = np.nan_to_num(points.astype(np.float64))
    size = 2.0 ** rng.integers(-30, 37)
    largest = np.abs(points).max()
    points = points / (largest or 1.0) * (0.49 * size)
    if rng.random() < 0.3:
        points = points + rng.normal(size=3) * size * 2.0 ** rng.integers(0, 20)
    return points if rng.random() < 0.5 else points.astype(np.float32)


def transform(rng: np.random.Generator) -> np.ndarray:
    """An affine map, of any scale or an ordinary one."""
    matrix = np.eye(4)
    scale = 2.0 ** rng.integers(-120, 120) if rng.random() < 0.3 else 2.0 ** rng.integers(-5, 5)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * scale
    matrix[:3, 3] = rng.normal(size=3) * 2.0 ** rng.integers(-20, 130)
    return matrix


def run_case(case: Case) -> str:
    """Makes the scene and compares it with brute force; moves it, and compares again."""
    arrays, options = case.arrays, case.options
    count = sum(name.startswith("faces") for name in arrays)
    meshes = [wrt.TriangleMesh(arrays[f"vertices{i}"], arrays[f"faces{i}"]) for i in range(count)]
    with np.errstate(all="ignore"):
        try:
            scene = make_scene(meshes, options, arrays)
        except ValueError as error:
            if options["form"] != "instances" and is_admitted(meshes):
                raise WrongAnswer(f"refused without need: {error}") from error
            return "refused"
        if options["form"] != "instances" and not is_admitted(meshes):
            raise WrongAnswer("accepted what float32 cannot hold")
        if 0.0 < np.ptp(scene.bounds, axis=0).max() < MIN_EXTENT:
            return "too small to compare"
        before = compare(scene, options, arrays["ray_bits"])
        if "moved" in arrays and options["form"] != "instances":
            move(scene, meshes, options, arrays, before)
    return "answered"


def make_scene(meshes: list[wrt.TriangleMesh], options: dict[str, Any], arrays: dict[str, np.ndarray]) -> wrt.Scene:
    """The scene that the options describe."""
    tree = (wrt.Bvh if options["kind"] == "bvh" else wrt.KdTree)(**options["tree"])
    if options["form"] == "grouped" and options["kind"] == "bvh":
        return wrt.moving.GroupedScene(meshes, tree, device="cpu")
    if options["form"] == "instances":
        return wrt.Scene([wrt.Instance(meshes[0]), *(wrt.Instance(m, arrays["transform"]) for m in meshes)], tree, device="cpu")
    return wrt.Scene(meshes, tree, device="cpu")


def is_admitted(meshes: list[wrt.TriangleMesh]) -> bool:
    """Whether the triangles' corners spread no further than scenes take."""
    points = np.concatenate([mesh.vertices[mesh.faces].reshape(-1, 3) for mesh in meshes]).astype(np.float64)
    return bool(np.abs(points).max() <= MAX_COORDINATE and np.ptp(points, axis=0).max() <= MAX_EXTENT)


def rays_of(scene: wrt.Scene, bits: np.ndarray) -> wrt.Rays:
    """Rays that follow from some bits: to points, corners and edges of triangles, along axes, in planes, and of raw bits."""
    rng = np.random.default_rng(bits.ravel())
    low, high = scene.bounds
    size = (high - low).max() or 1.0
    origins = rng.uniform(low - 0.5 * size, high + 0.5 * size, (len(bits), 3))
    if not scene.instances:
        mesh = scene.meshes[0]
        corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, len(bits))]].astype(np.float64)
    else:
        corners = rng.uniform(low, high, (len(bits), 3, 3))
    weights = rng.dirichlet((1, 1, 1), len(bits))
    kind = rng.integers(0, 7, len(bits))
    weights[kind == 1] = [1.0, 0.0, 0.0]
    weights[kind == 2] = [0.5, 0.5, 0.0]
    directions = np.einsum("nk,nki->ni", weights, corners) - origins
    axes = np.eye(3)[rng.integers(0, 3, len(bits))] * rng.choice([-1.0, 1.0], (len(bits), 1))
    directions[kind == 3] = (axes * size)[kind == 3]
    origins[kind == 4] = corners[kind == 4, 0]
    directions[kind == 5] = (corners[:, 1] - corners[:, 0])[kind == 5]
    if rng.random() < 0.5:
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    raw = bits[:, :3].view(np.float32).astype(np.float64)
    directions[kind == 6] = raw[kind == 6]
    origins = np.nan_to_num(origins)
    return wrt.Rays(origins, directions.astype(np.float32).astype(np.float64))


def compare(scene: wrt.Scene, options: dict[str, Any], bits: np.ndarray) -> Any:
    """Asks the tree and brute force; returns what they say."""
    rays, ask = rays_of(scene, bits), options["ask"]
    traversal = options["traversal"]
    if scene.instances:  # brute force knows none: what is tried is that nothing breaks, and that two ways agree
        hits = scene.intersect(rays, traversal="single")
        return equal("occluded", scene.occluded(rays, traversal="single"), hits.is_hit)
    if ask == "count":
        return equal("count", scene.count(rays, traversal=options["counting"]), scene.count(rays, traversal="brute"))
    if ask == "any":
        return equal("occluded", scene.occluded(rays, traversal=traversal), scene.occluded(rays, traversal="brute"))
    hits = scene.intersect(rays, traversal=traversal)
    expected = scene.intersect(rays, traversal="brute")
    for name in ("primitive_id", "geometry_id", "t", "uv"):
        equal(name, getattr(hits, name), getattr(expected, name))
    return hits.primitive_id


def equal(name: str, found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Compares to the bit."""
    if found.tobytes() != expected.tobytes():
        rows = np.flatnonzero((found != expected).reshape(len(found), -1).any(axis=1))
        first = int(rows[0]) if len(rows) else -1
        raise WrongAnswer(f"{name} of ray {first}: {found[first]}, brute force {expected[first]}; {len(rows)} rays")
    return found


def move(
    scene: wrt.Scene, meshes: list[wrt.TriangleMesh], options: dict[str, Any], arrays: dict[str, Any], before: Any
) -> None:
    """Moves the first mesh: answered as brute force does, or refused, and the scene is as it was."""
    try:
        scene.update(0, vertices=arrays["moved"])
    except ValueError as error:
        if is_admitted([wrt.TriangleMesh(arrays["moved"], arrays["faces0"]), *meshes[1:]]):
            raise WrongAnswer(f"an update is refused without need: {error}") from error
        equal("what is asked after a refused update", compare(scene, options, arrays["ray_bits"]), before)
        return
    if not 0.0 < np.ptp(scene.bounds, axis=0).max() < MIN_EXTENT:
        compare(scene, options, arrays["ray_bits"])
