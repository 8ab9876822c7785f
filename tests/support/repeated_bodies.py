"""Boxes whose surfaces occur several times."""

from __future__ import annotations

import numpy as np
import trimesh

import wrt

BOX = trimesh.creation.box((1, 1, 1))

VERTICES, FACES = np.asarray(BOX.vertices, dtype=np.float32), np.asarray(BOX.faces)

POINTS = np.random.default_rng(0).uniform(-0.8, 1.8, (4000, 3))

TURNED = FACES[:, ::-1]


def box_at(x: float, height: float = 1.0) -> np.ndarray:
    """Vertices of a box on the ground z = -0.5."""
    return ((VERTICES + 0.5) * [1.0, 1.0, height] + [x - 0.5, -0.5, -0.5]).astype(np.float32)


def in_box(x: float, height: float = 1.0) -> np.ndarray:
    return (np.abs(POINTS[:, :2] - (x, 0.0)) < 0.5).all(axis=1) & (np.abs(POINTS[:, 2] + 0.5 - height / 2) < height / 2)


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> wrt.TriangleMesh:
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, first, strict=False)])
    return wrt.TriangleMesh(np.concatenate([vertices for vertices, _ in parts]), faces)


def box(*more: np.ndarray, faces: np.ndarray = FACES) -> wrt.TriangleMesh:
    """A box with more faces, in vertices of their own as soups have them."""
    return joined((VERTICES, faces), *((VERTICES.astype(np.float32), extra) for extra in more))


NEXT = box_at(1.0)

MIRRORED = VERTICES * np.float32([-1, 1, 1]) + np.float32([1, 0, 0])
"""The next box, as the mirror image of the first: their common side has the same two triangles."""

SHARED = next(face for face in FACES if (VERTICES[face, 0] > 0).all())

BODIES = {
    "all twice": (box(FACES), in_box(0)),
    "all twice, other corners first": (box(np.roll(FACES, 1, axis=1)), in_box(0)),
    "one twice": (box(FACES[:1]), in_box(0)),
    "one three times": (box(FACES[3:4], FACES[3:4]), in_box(0)),
    "a side twice, and one across": (box(FACES[2:4], FACES[7:8]), in_box(0)),
    "both sides of every face": (box(TURNED), np.zeros(len(POINTS), dtype=bool)),
    "minus zero": (
        wrt.TriangleMesh(np.concatenate([VERTICES, -0.0 - -VERTICES]), np.concatenate([FACES, FACES + 8])),
        in_box(0),
    ),
    "two that touch": (joined((VERTICES, FACES), (NEXT, FACES)), in_box(0) | in_box(1)),
    "two that touch in triangles": (joined((VERTICES, FACES), (MIRRORED, TURNED)), in_box(0) | in_box(1)),
    "two that touch in triangles, one of them three times": (
        joined((VERTICES, FACES), (MIRRORED, TURNED), (VERTICES, SHARED[None])),
        in_box(0) | in_box(1),
    ),
    "one in another on the same ground": (joined((VERTICES, FACES), (box_at(0.0, 2.0), FACES)), in_box(0, 2.0) & ~in_box(0)),
}
