"""A wood: trees that branch recursively, on uneven ground.

Plants are a hard case for accelerators: slanted tubes whose boxes overlap, and clouds of small leaves without axis-parallel
gaps. Branching is a simplified form of Honda's model: every branch carries children at constant ratios of length and
radius. A child leaves its parent at a branching angle, rotated about it by the golden angle from one child to the next
(phyllotaxis). All parameters are jittered, and branches bend upward. One set of array operations makes all branches of one
order, over all trees.

References: honda-1971; prusinkiewicz-lindenmayer-1990.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import check_count, sheets

__all__ = ["wood"]

_SPACING = 5.5  # metres between trees
_CLEARING = 5.0  # radius without trees, around the origin
_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class _Order:
    """Parameters of the branches of one order: number per parent, size relative to it, tessellation."""

    children: int
    length: float
    radius: float
    angle: float  # degrees between child and parent
    joints: int
    sides: int


_ORDERS = (
    _Order(children=1, length=1.0, radius=1.0, angle=0.0, joints=7, sides=9),
    _Order(children=9, length=0.42, radius=0.42, angle=58.0, joints=4, sides=6),
    _Order(children=5, length=0.50, radius=0.50, angle=48.0, joints=3, sides=4),
    _Order(children=4, length=0.50, radius=0.55, angle=45.0, joints=2, sides=3),
)


@dataclass(frozen=True)
class _Branches:
    """Branches as polylines: paths (B, joints + 1, 3), radii along them (B, joints + 1), lengths (B,)."""

    paths: np.ndarray
    radii: np.ndarray
    lengths: np.ndarray


def wood(trees: int = 30, leaves: int = 12, seed: int = 0) -> TriangleMesh:
    """Broad-leaved trees, 8 to 12 m high, around a clearing at the origin; z = 0 is the ground there.

    Args:
        trees: number of trees, >= 1, with about 8,000 triangles each by default; the area of the wood grows with it.
        leaves: leaves of each twig, >= 0, with two triangles each; a tree has 180 twigs.
        seed: the same seed gives the same wood.

    Raises:
        TypeError: an argument is not a whole number.
        ValueError: trees < 1, leaves < 0 or seed < 0.
    """
    trees, leaves = check_count("trees", trees), check_count("leaves", leaves, 0)
    random = np.random.default_rng(check_count("seed", seed, 0))
    feet, half_size = _places(random, trees)
    waves = random.uniform(-1.0, 1.0, (6, 3))
    feet = np.column_stack([feet, _height(feet[:, 0], feet[:, 1], waves) - 0.15])
    branches = _trunks(random, feet)
    parts = [_terrain(half_size, waves), _tubes(branches, _ORDERS[0].sides)]
    for order in _ORDERS[1:]:
        branches = _grow(random, branches, order)
        parts.append(_tubes(branches, order.sides))
    if leaves:
        parts.append(_leaves(random, branches, leaves))
    return TriangleMesh.concatenate(parts, name="wood")


def _places(random: np.random.Generator, trees: int) -> tuple[np.ndarray, float]:
    """(trees, 2) jittered places on a square lattice, by their distance from the clearing, and half the side of the ground."""
    side = int(np.ceil(np.sqrt(trees + np.pi * (_CLEARING / _SPACING) ** 2))) + 2
    axis = (np.arange(side) - 0.5 * (side - 1)) * _SPACING
    places = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    places += random.uniform(-0.33, 0.33, places.shape) * _SPACING
    distance = np.linalg.norm(places, axis=1)
    nearest = np.argsort(np.where(distance < _CLEARING, np.inf, distance), kind="stable")
    return places[nearest[:trees]], 0.5 * side * _SPACING + 12.0


def _height(x: np.ndarray, y: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """Ground level: six sine waves, flattened towards the origin."""
    octave = 1.0 + np.arange(len(waves))
    phase = 0.11 * octave * (waves[:, 0] * x[..., None] + waves[:, 1] * y[..., None]) + np.pi * waves[:, 2]
    bumps = (0.9 * np.sin(phase) / np.sqrt(octave)).sum(axis=-1)
    distance2 = x * x + y * y
    return bumps * distance2 / (distance2 + 4.0 * _CLEARING**2)


def _terrain(half_size: float, waves: np.ndarray) -> TriangleMesh:
    """The ground in quads of about a metre."""
    axis = np.linspace(-half_size, half_size, int(2.0 * half_size) + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return sheets(np.stack([x, y, _height(x, y, waves)], axis=-1))


def _trunks(random: np.random.Generator, feet: np.ndarray) -> _Branches:
    """One trunk at each foot, nearly upright, wider at the root."""
    count = len(feet)
    lean = random.normal(0.0, 0.06, (count, 3))
    directions = _unit(lean * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0])
    lengths = random.uniform(7.0, 10.0, count)
    branches = _walk(random, feet, directions, lengths, lengths * 0.028, _ORDERS[0].joints)
    branches.radii[:, 0] *= 1.5
    return branches


def _grow(random: np.random.Generator, parents: _Branches, order: _Order) -> _Branches:
    """The children of all parents, spread over the upper part of each."""
    count, joints = len(parents.lengths), parents.radii.shape[1] - 1
    lowest = 0.3 if joints == _ORDERS[0].joints else 0.25
    steps = (np.arange(order.children) + random.uniform(0.1, 0.9, (count, order.children))) / order.children
    where = lowest + (1.0 - lowest) * steps
    joint = np.minimum((where * joints).astype(int), joints - 1)
    rows = np.arange(count)[:, None]
    low, high = parents.paths[rows, joint], parents.paths[rows, joint + 1]
    starts = low + (high - low) * (where * joints - joint)[..., None]
    along = _unit(high - low)
    turn = _GOLDEN_ANGLE * np.arange(order.children) + random.uniform(0.0, 2.0 * np.pi, (count, 1))
    turn = turn + random.normal(0.0, 0.3, turn.shape)
    side, other = _frame(along)
    away = side * np.cos(turn)[..., None] + other * np.sin(turn)[..., None]
    angle = np.radians(order.angle * (1.15 - 0.45 * where) + random.normal(0.0, 8.0, where.shape))[..., None]
    directions = along * np.cos(angle) + away * np.sin(angle)
    # Branches near the top are shorter and thinner, so that the crown is a dome.
    taper = 1.15 - 0.6 * where
    lengths = parents.lengths[:, None] * order.length * taper * random.uniform(0.8, 1.2, where.shape)
    radii = parents.radii[:, 1:2] * order.radius * taper
    shape = (-1, 3)
    return _walk(random, starts.reshape(shape), directions.reshape(shape), lengths.ravel(), radii.ravel(), order.joints)


def _walk(
    random: np.random.Generator,
    starts: np.ndarray,
    directions: np.ndarray,
    lengths: np.ndarray,
    radii: np.ndarray,
    joints: int,
) -> _Branches:
    """Extends branches joint by joint; they waver and bend upward."""
    paths = np.empty((len(starts), joints + 1, 3))
    paths[:, 0] = starts
    for joint in range(joints):
        waver = random.normal(0.0, 0.11, directions.shape)
        directions = _unit(directions + waver + [0.0, 0.0, 0.10])
        paths[:, joint + 1] = paths[:, joint] + directions * (lengths / joints)[:, None]
    return _Branches(paths, radii[:, None] * np.linspace(1.0, 0.3, joints + 1), lengths)


def _tubes(branches: _Branches, sides: int) -> TriangleMesh:
    """Tapering tubes along the paths, open at both ends."""
    side, other = _frame(_unit(branches.paths[:, -1] - branches.paths[:, 0]))
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)[::-1, None]
    circle = side[:, None, None] * np.cos(angle) + other[:, None, None] * np.sin(angle)
    circle[:, :, -1] = circle[:, :, 0]
    return sheets(branches.paths[:, :, None] + branches.radii[:, :, None, None] * circle)


def _leaves(random: np.random.Generator, twigs: _Branches, leaves: int) -> TriangleMesh:
    """Kite-shaped leaves of two triangles, folded along the middle rib, on the outer two thirds of every twig."""
    shape = (len(twigs.lengths), leaves)
    where = random.uniform(0.33, 1.0, shape)[..., None]
    starts = twigs.paths[:, None, 0] + (twigs.paths[:, None, -1] - twigs.paths[:, None, 0]) * where
    along = _unit(random.normal([0.0, 0.0, -0.2], 1.0, (*shape, 3)))
    side, up = _frame(along)
    spin = random.uniform(0.0, 2.0 * np.pi, shape)[..., None]
    across, fold = side * np.cos(spin) + up * np.sin(spin), up * np.cos(spin) - side * np.sin(spin)
    length = random.uniform(0.18, 0.34, shape)[..., None]
    tip, middle = starts + length * along, starts + 0.45 * length * along + 0.08 * length * fold
    left, right = middle - 0.3 * length * across, middle + 0.3 * length * across
    vertices = np.stack([starts, left, tip, right], axis=2).reshape(-1, 3)
    kites = 4 * np.arange(len(vertices) // 4)[:, None, None]
    return TriangleMesh(vertices, (kites + np.array([[0, 2, 1], [0, 3, 2]])).reshape(-1, 3))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _frame(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to each direction and to one another."""
    upright = np.abs(directions[..., 2:]) > 0.9
    side = _unit(np.cross(np.where(upright, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), directions))
    return side, np.cross(directions, side)
