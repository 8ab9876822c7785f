"""Rays that packets like, and plans for packets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import wrt
import wrt.engine.plan.planner
from wrt.engine.plan.plan import Plan


def beams(mesh: wrt.TriangleMesh, count: int, own_origins: bool, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Narrow beams of 64 rays each, from outside, from inside, along the axes, in planes of faces; some rays are bad."""
    rng = np.random.default_rng(seed)
    low, high = mesh.bounds
    size = high - low + 1e-6
    if own_origins:
        eyes = rng.uniform(low - 0.5 * size, high + 0.5 * size, (count, 1, 3))
        corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count)]]
        eyes[::5, 0] = corners[::5, 0]
        origins = eyes + rng.normal(size=(count, 64, 3)) * size * rng.choice([0.0, 0.01, 0.2], (count, 1, 1))
    else:
        origins = np.broadcast_to(low + size * (0.4, 0.6, 1.3), (count, 64, 3))
    targets = rng.uniform(low, high, (count, 1, 3)) + rng.normal(size=(count, 64, 3)) * size * 0.02
    directions = targets - origins
    kind = rng.integers(0, 6, count)
    axes = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], (count, 1)) * size.max()
    directions[kind == 0] = axes[kind == 0, None]  # all parallel: components of 0
    flat = kind == 1
    directions[flat, :, 0] = 0.0  # within a plane
    if own_origins:
        origins[flat, :, 0] = mesh.vertices[rng.integers(0, mesh.vertex_count, int(flat.sum()))][:, None, 0]
    bad = rng.random((count, 64))
    directions[bad < 0.01] = np.nan
    directions[(bad >= 0.01) & (bad < 0.02)] = 0.0
    origins = origins.reshape(-1, 3) if own_origins else origins[0, 0]
    return origins.astype(np.float32), directions.reshape(-1, 3).astype(np.float32)


def packet_plan(scene: wrt.Scene, rays: wrt.Rays, triangle_test: str, **changes: object) -> Plan:
    plan = scene.explain(rays, traversal="packet", triangle_test=triangle_test)
    return replace(plan, **{"packet": 4 * plan.width, **changes})


def ragged(origins: np.ndarray, directions: np.ndarray) -> wrt.Rays:
    """The rays without the last five, so that the last packet is not full."""
    return wrt.Rays(origins if origins.ndim == 1 else origins[:-5], directions[:-5])
