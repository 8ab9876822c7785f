"""Animations for tests of moving scenes: a waving cloth, and a skinned walking figure.

An animation consists of the vertices of all frames, with the same faces. Both have any resolution, and are deterministic.

    animation = wrt.scenes.walking_figure(frames=24)
    scene = wrt.Scene([wrt.scenes.atrium(), animation.mesh(0)])
    scene.update(1, vertices=animation.frames[1])
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from wrt.kernels.validation import as_int, as_numbers
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.skeleton import Skeleton
from wrt.scenes.shapes import check_count, copies, lathe, sheets

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["Animation", "walking_figure", "waving_cloth"]

_JOINTS = {
    "root": (None, (0.0, 0.0, 1.0)),
    "head": ("root", (0.0, 0.0, 1.52)),
    **{f"{side} thigh": ("root", (0.0, y, 0.92)) for side, y in (("left", 0.1), ("right", -0.1))},
    **{f"{side} shin": (f"{side} thigh", (0.0, y, 0.5)) for side, y in (("left", 0.1), ("right", -0.1))},
    **{f"{side} arm": ("root", (0.0, y, 1.44)) for side, y in (("left", 0.25), ("right", -0.25))},
    **{f"{side} forearm": (f"{side} arm", (0.0, y, 1.14)) for side, y in (("left", 0.25), ("right", -0.25))},
}
"""Each bone's parent, and the joint that it rotates about in the rest pose; parents come first."""

_BLEND = 0.09  # the skin bends within this distance above and below a joint, in metres
_STRIDE = 1.3  # metres of two steps


_LIMITS = {
    "root": ((-10, 10), (-5, 5), (-10, 10)),
    "head": ((-15, 15), (-20, 20), (-45, 45)),
    "thigh": ((-15, 15), (-40, 40), (-10, 10)),
    "shin": ((0, 0), (-5, 60), (0, 0)),
    "arm": ((-20, 20), (-60, 60), (-20, 20)),
    "forearm": ((0, 0), (-60, 5), (0, 0)),
}
"""By the last word of a bone's name, least and greatest angle about the x, y and z axis, in degrees."""


@dataclass(frozen=True)
class Skin:
    """What a skinned animation is made from, for `wrt.moving.SkinnedScene`.

    Attributes:
        vertices: (V, 3) float64 in the rest pose.
        weights: (V, B) float64, shares of the bones.
        skeleton: the bones and the limits of their joints.
    """

    vertices: np.ndarray
    weights: np.ndarray
    skeleton: Skeleton


@dataclass(frozen=True)
class Animation:
    """A moving mesh.

    Attributes:
        name: a label for tables.
        frames: (F, V, 3) float64 vertices.
        faces: (T, 3) int32, shared by all frames.
        bones: (F, B, 4, 4) float64 maps from the rest pose to each frame, which the skin follows; None without bones.
        skin: the skin in the rest pose; None without bones.
    """

    name: str
    frames: np.ndarray
    faces: np.ndarray
    bones: np.ndarray | None = None
    skin: Skin | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def moved(self, offset: ArrayLike) -> Animation:
        """The same animation, shifted by `offset`, (3,)."""
        offset = as_numbers("offset", offset, (3,))
        bones = self.bones
        if bones is not None:
            bones = bones.copy()
            bones[..., :3, 3] += offset
        return replace(self, frames=self.frames + offset, bones=bones)

    def mesh(self, frame: int) -> TriangleMesh:
        """The mesh of a frame."""
        return TriangleMesh(self.frames[as_int("frame", frame, 0, len(self) - 1)], self.faces, name=self.name)


def waving_cloth(frames: int = 24, cells: int = 48) -> Animation:
    """A banner, 6 m wide and 4 m high, that hangs across the x axis of the atrium. It waves periodically, most at its lower
    edge.

    Args:
        frames: frames of a period, >= 1.
        cells: quads along each side, >= 1; 2 cells^2 triangles.

    Raises:
        TypeError, ValueError: not a whole number, or too small.
    """
    frames, cells = check_count("frames", frames), check_count("cells", cells)
    across, down = np.meshgrid(np.linspace(-3.0, 3.0, cells + 1), np.linspace(0.0, 4.0, cells + 1), indexing="ij")
    phase = 2.0 * np.pi * np.arange(frames)[:, None, None] / frames
    swell = 0.12 * down * (np.sin(1.9 * across + phase) + 0.4 * np.sin(2.0 * phase - 3.1 * down))
    points = np.stack(np.broadcast_arrays(swell, across + 0.05 * down * np.cos(phase), 5.4 - down - 0.2 * swell**2), axis=-1)
    return Animation("waving cloth", points.reshape(frames, -1, 3), sheets(points[0]).faces)


def walking_figure(frames: int = 24, detail: int = 16) -> Animation:
    """A figure, 1.8 m high, that takes two steps along the x axis. Its skin follows ten bones, two of them near a joint.

    Args:
        frames: frames of two steps, >= 1.
        detail: corners of the limbs' circles and half the rings along them, >= 3; about 35 detail^2 triangles.

    Raises:
        TypeError, ValueError: not a whole number, or too small.
    """
    frames, detail = check_count("frames", frames), check_count("detail", detail, 3)
    skin, weights = _skin(detail)
    bones = np.array([_pose(2.0 * np.pi * number / frames) for number in range(frames)])
    points = np.concatenate([skin.vertices, np.ones((skin.vertex_count, 1))], axis=1)
    moved = np.einsum("fbij,vj->fbvi", bones[:, :, :3], points)
    limits = [_LIMITS[name.split()[-1]] for name in _JOINTS]
    parents = [-1 if parent is None else [*_JOINTS].index(parent) for parent, _ in _JOINTS.values()]
    skeleton = Skeleton(np.array(parents), np.array([joint for _, joint in _JOINTS.values()]), np.array(limits))
    made = Skin(skin.vertices.astype(np.float64), weights, skeleton)
    return Animation("walking figure", np.einsum("vb,fbvi->fvi", weights, moved), skin.faces, bones, made)


def _pose(phase: float) -> np.ndarray:
    """(B, 4, 4) maps of the bones from the rest pose; phase: within two steps, in radians."""
    angles = {"root": 0.04 * np.sin(2.0 * phase), "head": -0.04 * np.sin(2.0 * phase)}
    for side, own in (("left", phase), ("right", phase + np.pi)):
        angles[f"{side} thigh"], angles[f"{side} shin"] = -0.5 * np.sin(own), 0.35 - 0.35 * np.sin(own - 1.1)
        angles[f"{side} arm"], angles[f"{side} forearm"] = 0.45 * np.sin(own), -0.3 + 0.2 * np.sin(own)
    maps: dict[str, np.ndarray] = {}
    for name, (parent, joint) in _JOINTS.items():
        turn, c, s = np.eye(4), np.cos(angles[name]), np.sin(angles[name])
        turn[0, [0, 2]], turn[2, [0, 2]] = (c, s), (-s, c)
        turn[:3, 3] = joint - turn[:3, :3] @ joint
        maps[name] = turn if parent is None else maps[parent] @ turn
    start = np.eye(4)
    start[0, 3], start[2, 3] = _STRIDE * (phase / (2.0 * np.pi) - 0.5), 0.02 * np.cos(2.0 * phase)
    return np.array([start @ one for one in maps.values()])


def _skin(detail: int) -> tuple[TriangleMesh, np.ndarray]:
    """The mesh in the rest pose, and (V, B) weights of the bones."""
    numbers = {name: number for number, name in enumerate(_JOINTS)}
    parts = [_limb("root", None, 0.0, (0.88, 1.5), (0.15, 0.2), detail)]
    parts.append(_limb("head", None, 0.0, (1.53, 1.8), (0.1, 0.11), detail))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        parts.append(_limb(f"{side} thigh", f"{side} shin", 0.1 * sign, (0.04, 0.95), (0.05, 0.085), detail))
        parts.append(_limb(f"{side} arm", f"{side} forearm", 0.25 * sign, (0.84, 1.47), (0.035, 0.055), detail))
    weights = []
    for mesh, upper, lower in parts:
        own = np.zeros((mesh.vertex_count, len(numbers)))
        share = np.zeros(mesh.vertex_count)
        if lower is not None:
            share = np.clip((_JOINTS[lower][1][2] + _BLEND - mesh.vertices[:, 2]) / (2.0 * _BLEND), 0.0, 1.0)
            own[:, numbers[lower]] = share
        own[:, numbers[upper]] += 1.0 - share
        weights.append(own)
    return TriangleMesh.concatenate([mesh for mesh, _, _ in parts], name="walking figure"), np.concatenate(weights)


def _limb(
    upper: str, lower: str | None, y: float, heights: tuple[float, float], radii: tuple[float, float], detail: int
) -> tuple[TriangleMesh, str, str | None]:
    """An upright rounded tube, and the bones that move it.

    Args:
        upper, lower: the bones; lower is None if there is only one.
        y: position along the y axis.
        heights: heights of its ends.
        radii: radii at the lower and the upper end.
        detail: as in `walking_figure`.
    """
    along = np.linspace(0.0, 1.0, 2 * detail + 1)
    radius = (radii[0] + (radii[1] - radii[0]) * along) * np.sqrt(1.0 - (2.0 * along - 1.0) ** 8)
    mesh = lathe(np.stack([radius, heights[0] + (heights[1] - heights[0]) * along], axis=1), detail)
    return copies(mesh, (0.0, y, 0.0)), upper, lower
