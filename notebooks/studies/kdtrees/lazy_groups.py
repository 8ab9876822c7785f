"""What groups of groups of meshes save a lazy kd-tree: how much of a scene is opened, sorted and built for a view.

    district        a scene of nested groups: blocks of houses of parts
    first_views     scene, first view and the same view again, by the hierarchy that the tree starts from

References: hunt-2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.builders.kdtree.kdtree_config import GRID, GROUPS, MESHES
from wrt.engine.rays.rays import Rays
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

HOUSE = 8.0
"""Length of a house's side."""

BLOCK = 60.0
"""Length of a block's side with a street."""


def district(blocks: int, houses: int = 16, parts: int = 20, detail: int = 1, seed: int = 0) -> list[list[list[TriangleMesh]]]:
    """Blocks x blocks groups of houses, each a group of parts: balls of 20 * 4^detail triangles anywhere in the house."""
    import trimesh

    rng, side = np.random.default_rng(seed), int(np.ceil(houses**0.5))
    ball = trimesh.creation.icosphere(subdivisions=detail)
    pattern = np.stack(np.divmod(np.arange(houses), side), axis=1) * (BLOCK - 12.0) / side

    def house(x: float, y: float) -> list[TriangleMesh]:
        size = HOUSE * rng.uniform(0.05, 0.25, (parts, 1, 1))
        place = np.array([x, y, 0.0]) + HOUSE * rng.random((parts, 1, 3))
        return [TriangleMesh(points, ball.faces) for points in ball.vertices * size + place]

    corners = np.stack(np.divmod(np.arange(blocks * blocks), blocks), axis=1) * BLOCK
    return [[house(*(corner + at)) for at in pattern] for corner in corners]


def street_view(blocks: int, size: int) -> Rays:
    """Size x size rays from the middle of a district, down a street."""
    u, v = np.meshgrid(np.linspace(-0.4, 0.4, size), np.linspace(-0.35, 0.25, size))
    directions = np.stack([np.ones_like(u), u, v], axis=-1)
    return Rays(np.array([blocks // 2 * BLOCK - 6.0, (blocks // 2) * BLOCK - 4.0, 6.0]), directions)


def first_views(
    geometry: Any, rays: Rays, hierarchies: Sequence[str] = (GRID, MESHES, GROUPS), *, rounds: int = 5
) -> list[dict[str, Any]]:
    """Makes a scene and traces a view, from each hierarchy in turn.

    Args:
        geometry: meshes, in nested sequences.
        rays: the view.
        hierarchies: keys in `wrt.builders.kdtree.kdtree_config.HIERARCHIES`.
        rounds: how often each is measured.

    Returns:
        A row for each: hierarchy; groups, opened (their number, and those that were opened); sorted (length of all sorts, in
        triangles); cells, unbuilt; references (built); hits (share); and medians in milliseconds: scene (with the start of its
        tree), first, again, both (scene and first).
    """
    spent: dict[str, list[tuple[float, ...]]] = {name: [] for name in hierarchies}
    rows = {}

    def show(name: str) -> None:
        times = [perf_counter()]
        scene = Scene(geometry, KdTree(builder="lazy", hierarchy=name), device="cpu")
        times.append(perf_counter())
        for _ in range(2):
            hits = scene.intersect(rays)
            times.append(perf_counter())
        spent[name].append(tuple(np.diff(times).tolist()))
        rows[name] = {"hierarchy": name} | opened_part(scene) | {"hits": float(hits.is_hit.mean())}

    take_turns([Contender(name, lambda name=name: show(name)) for name in hierarchies], rounds)
    for name, row in rows.items():
        turns = [(*turn, turn[0] + turn[1]) for turn in spent[name][1:]]  # the first warmed up
        times = (1e3 * median(column) for column in zip(*turns, strict=True))
        row |= zip(("scene", "first", "again", "both"), times, strict=True)
    return list(rows.values())


def compare_hierarchies(*, blocks: int = 8, size: int = 128, rounds: int = 5) -> list[dict[str, Any]]:
    """A view into a district of blocks x blocks groups of meshes, in lazy kd-trees from each hierarchy."""
    return first_views(district(blocks), street_view(blocks, size), rounds=rounds)


def opened_part(scene: Scene) -> dict[str, int]:
    """Counts of a scene's lazy tree, as in `first_views`."""
    tree = scene.state.lazy_tree
    cells = tree.cells[tree.cells["clusters"] > 0]
    return {
        "groups": 0 if tree.groups is None else len(tree.groups.members),
        "opened": len(tree.opened),
        "sorted": tree.sorted_triangles,
        "cells": len(cells),
        "unbuilt": int(cells["unbuilt"].sum()),
        "references": int((scene.tree.primitive.numpy() >= 0).sum()),
    }
