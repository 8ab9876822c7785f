"""Meshes on which signs of distances differ: open, doubled, inverted, overlapping, meeting themselves, not manifold.

Each has a body that it stands for, as a function that says which points are inside of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh

import wrt

Inside = Callable[[np.ndarray], np.ndarray]


class Surface(NamedTuple):
    """A mesh and the points that are meant to be inside.

    Attributes:
        kind: a word for what is wrong with it.
        mesh: in about the box from -1.5 to 1.5.
        inside: (N, 3) points to (N,) bool.
    """

    kind: str
    mesh: wrt.TriangleMesh
    inside: Inside


def mesh_of(vertices: np.ndarray, faces: np.ndarray) -> wrt.TriangleMesh:
    return wrt.TriangleMesh(np.asarray(vertices, dtype=np.float32), np.asarray(faces, dtype=np.int32))


def in_ball(center: tuple[float, float, float] = (0.0, 0.0, 0.0), radius: float = 1.0) -> Inside:
    return lambda points: np.linalg.norm(points - np.asarray(center), axis=1) < radius


def in_box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Inside:
    return lambda points: ((points > low) & (points < high)).all(axis=1)


def either(*bodies: Inside) -> Inside:
    return lambda points: np.any([body(points) for body in bodies], axis=0)


def in_torus(points: np.ndarray) -> np.ndarray:
    return np.hypot(np.linalg.norm(points[:, :2], axis=1) - 0.9, points[:, 2]) < 0.4


def ball(center: tuple[float, float, float] = (0.0, 0.0, 0.0), radius: float = 1.0) -> trimesh.Trimesh:
    body = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return body.apply_translation(center)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    body = trimesh.creation.box(np.subtract(high, low))
    return body.apply_translation(np.mean([low, high], axis=0))


def parts(*bodies: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of several bodies, whose common vertices are not merged."""
    joined = trimesh.util.concatenate(bodies)
    return np.asarray(joined.vertices), np.asarray(joined.faces)


def cap_free(height: float) -> wrt.TriangleMesh:
    """A sphere without the cap above a height."""
    body = ball()
    return mesh_of(body.vertices, np.asarray(body.faces)[body.triangles_center[:, 2] < height])


def turned(share: float, seed: int) -> wrt.TriangleMesh:
    """A sphere some of whose triangles are turned over."""
    body, rng = ball(), np.random.default_rng(seed)
    faces = np.asarray(body.faces).copy()
    chosen = rng.random(len(faces)) < share
    faces[chosen] = faces[chosen, ::-1]
    return mesh_of(body.vertices, faces)


def without(share: float, seed: int, body: trimesh.Trimesh | None = None) -> wrt.TriangleMesh:
    """A body without some of its triangles."""
    body = body or ball()
    kept = np.random.default_rng(seed).random(len(body.faces)) >= share
    return mesh_of(body.vertices, np.asarray(body.faces)[kept])


def cracked(width: float) -> wrt.TriangleMesh:
    """A sphere of separate triangles, each a little smaller: cracks along every edge."""
    corners = np.asarray(ball().triangles)
    middle = corners.mean(axis=1, keepdims=True)
    return mesh_of((middle + (corners - middle) * (1.0 - width)).reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def noisy(size: float) -> wrt.TriangleMesh:
    """A sphere of separate triangles that are moved apart at random: they meet each other, and have gaps."""
    corners = np.asarray(ball().triangles)
    corners = corners + np.random.default_rng(4).normal(size=(len(corners), 1, 3)) * size
    return mesh_of(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def scanned() -> wrt.TriangleMesh:
    """Two sides of a sphere, as two scans see it, that overlap in the middle."""
    body = ball()
    height, faces = body.triangles_center[:, 2], np.asarray(body.faces)
    shrunk = np.asarray(body.vertices) * 0.995
    return mesh_of(
        np.concatenate([body.vertices, shrunk]),
        np.concatenate([faces[height > -0.2], faces[height < 0.2] + len(body.vertices)]),
    )


def with_sheet() -> wrt.TriangleMesh:
    """A sphere with a disc across it."""
    body, disc = ball(), trimesh.creation.cylinder(radius=0.99, height=0.0, sections=48)
    top = np.asarray(disc.faces)[disc.face_normals[:, 2] > 0.5]
    return mesh_of(np.concatenate([body.vertices, disc.vertices]), np.concatenate([body.faces, top + len(body.vertices)]))


def with_fin() -> wrt.TriangleMesh:
    """A box with a triangle that stands on one of its edges: three triangles at that edge."""
    body = box((-1, -1, -1), (1, 1, 1))
    edge = np.flatnonzero((body.vertices[:, 0] > 0) & (body.vertices[:, 1] > 0))
    vertices = np.concatenate([body.vertices, [[1.6, 1.6, 0.0]]])
    return mesh_of(vertices, np.concatenate([body.faces, [[edge[0], edge[1], len(vertices) - 1]]]))


def coil(turns: float) -> tuple[wrt.TriangleMesh, Inside]:
    """A closed tube along a curve that passes through itself."""
    t = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    path = np.stack([np.sin(t), np.sin(turns * t) * 0.8, 0.1 * np.cos(t)], axis=1)
    along = np.gradient(np.concatenate([path[-2:], path, path[:2]]), axis=0)[2:-2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other, angle = np.cross(side, along), np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    vertices = (path[:, None] + 0.25 * ring).reshape(-1, 3)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(240), np.arange(24), indexing="ij"))
    a, b = i * 24 + j, (i + 1) % 240 * 24 + j
    c, d = (i + 1) % 240 * 24 + (j + 1) % 24, i * 24 + (j + 1) % 24
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    faces = faces if mesh.volume > 0 else faces[:, ::-1]
    fine = np.stack([np.sin(s := np.linspace(0, 2 * np.pi, 1500)), np.sin(turns * s) * 0.8, 0.1 * np.cos(s)], axis=1)
    return mesh_of(vertices, faces), lambda points: np.array([np.linalg.norm(fine - p, axis=1).min() < 0.25 for p in points])


def surfaces() -> dict[str, Surface]:
    """30 of them by name."""
    sphere, torus = ball(), trimesh.creation.torus(0.9, 0.4, major_sections=64, minor_sections=32)
    faces, inner = np.asarray(sphere.faces), ball(radius=0.5)
    left, right = ball((-0.45, 0, 0), 0.8), ball((0.45, 0, 0), 0.8)
    both = either(in_ball((-0.45, 0, 0), 0.8), in_ball((0.45, 0, 0), 0.8))
    stairs = [((-1.0, -1.0, -1.0), (1.0, 1.0, 0.0)), ((-1.0, -1.0, 0.0), (0.0, 1.0, 1.0))]
    touching = [((-1.0, -1.0, -1.0), (0.0, 0.0, 1.0)), ((0.0, 0.0, -1.0), (1.0, 1.0, 1.0))]
    flipped_right = right.copy()
    flipped_right.invert()
    hollow = inner.copy()
    hollow.invert()
    eight, in_eight = coil(2.0)
    three, in_three = coil(3.0)
    whole = in_ball()
    shell: Inside = lambda points: whole(points) & ~in_ball(radius=0.5)(points)  # noqa: E731
    many = [ball(tuple(p), 0.6) for p in np.random.default_rng(2).uniform(-0.7, 0.7, (6, 3))]
    in_many = either(*(in_ball(tuple(body.centroid), 0.6) for body in many))
    return {
        "sphere": Surface("closed", mesh_of(sphere.vertices, faces), whole),
        "torus": Surface("closed", mesh_of(torus.vertices, torus.faces), in_torus),
        "separate triangles": Surface("closed", cracked(0.0), whole),
        "hollow": Surface("closed", mesh_of(*parts(sphere, hollow)), shell),
        "inverted": Surface("inverted", mesh_of(sphere.vertices, faces[:, ::-1]), whole),
        "inverted torus": Surface("inverted", mesh_of(torus.vertices, np.asarray(torus.faces)[:, ::-1]), in_torus),
        "hollow, both outwards": Surface("inverted", mesh_of(*parts(sphere, inner)), shell),
        "1% turned over": Surface("turned over", turned(0.01, 1), whole),
        "20% turned over": Surface("turned over", turned(0.2, 2), whole),
        "half turned over": Surface("turned over", turned(0.5, 3), whole),
        "one triangle missing": Surface("open", mesh_of(sphere.vertices, faces[1:]), whole),
        "5% missing": Surface("open", without(0.05, 1), whole),
        "30% missing": Surface("open", without(0.3, 2), whole),
        "torus, 10% missing": Surface("open", without(0.1, 3, torus), in_torus),
        "small cap missing": Surface("open", cap_free(0.9), whole),
        "large cap missing": Surface("open", cap_free(0.5), whole),
        "cracks": Surface("open", cracked(0.05), whole),
        "wide cracks": Surface("open", cracked(0.3), whole),
        "10% turned over, 10% missing": Surface(
            "open", mesh_of(sphere.vertices, turned(0.1, 5).faces[np.random.default_rng(6).random(len(faces)) > 0.1]), whole
        ),
        "two scans": Surface("open", scanned(), whole),
        "noise": Surface("open", noisy(0.02), whole),
        "doubled": Surface("doubled", mesh_of(sphere.vertices, np.concatenate([faces, faces])), whole),
        "doubled, vertices apart": Surface("doubled", mesh_of(*parts(sphere, ball(radius=1.0005))), whole),
        "a third doubled": Surface("doubled", mesh_of(sphere.vertices, np.concatenate([faces, faces[::3]])), whole),
        "two spheres": Surface("overlapping", mesh_of(*parts(left, right)), both),
        "six spheres": Surface("overlapping", mesh_of(*parts(*many)), in_many),
        "one of two inverted": Surface("overlapping", mesh_of(*parts(left, flipped_right)), both),
        "figure of eight": Surface("meets itself", eight, in_eight),
        "coil": Surface("meets itself", three, in_three),
        "boxes with a common wall": Surface(
            "not manifold", mesh_of(*parts(*(box(*one) for one in stairs))), either(*(in_box(*one) for one in stairs))
        ),
        "boxes with a common edge": Surface(
            "not manifold", mesh_of(*parts(*(box(*one) for one in touching))), either(*(in_box(*one) for one in touching))
        ),
        "a fin on an edge": Surface("not manifold", with_fin(), in_box((-1, -1, -1), (1, 1, 1))),
        "a sheet inside": Surface("not manifold", with_sheet(), whole),
    }
