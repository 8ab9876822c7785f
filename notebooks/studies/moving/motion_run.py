"""Figures on moving scenes that pages quote: parts of `motion_costs` on the scenes of the notebook `dynamic`, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from studies.moving import motion_costs as motion
from studies.moving.animation_comparison import Stage, compare_ways
from wrt.imaging.cameras import PinholeCamera
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scene.updates import UpdatePolicy
from wrt.scenes import atrium
from wrt.scenes.animations import Animation, walking_figure

Row = dict[str, Any]

WAYS = ("static and moving kdtree", "groups, kdtree")
"""Bikker's two trees, and groups under an upper tree."""


def camera(
    size: int, fov: float = 60, position: Sequence[float] = (-6, -3.5, 2), look_at: Sequence[float] = (0, 0, 1.6)
) -> PinholeCamera:
    """A view of the court."""
    return PinholeCamera(size, size, fov=fov, position=position, look_at=look_at, up=(0.0, 0.0, 1.0))


def rebuilds(animation: Animation, still: Sequence[TriangleMesh], tree: str, tolerance: float) -> dict[str, float]:
    """What updates did: frames "kept", built again "in parts" or whole ("built")."""
    scene, actions = Scene([*still, animation.mesh(0)], tree, num_threads=1, device="cpu"), []
    for vertices in animation.frames[1:]:
        scene.update(len(still), vertices=vertices, rebuild=UpdatePolicy(tolerance=tolerance))
        actions.append(scene.last_update.action)
    return {
        name: float(actions.count(action)) for name, action in (("kept", "kept"), ("in parts", "subtrees"), ("built", "built"))
    }


def motion_tables(rounds: int) -> dict[str, list[Row]]:
    """Tables "rebuilds", "instances", "groups", "ways" and "threads"."""
    court, walk = atrium(), walking_figure(frames=24, detail=16).moved((-2.0, -3.0, -0.5))
    alone = walk.moved((2.0, 3.0, 0.5))
    kept = [
        {"motion": name, "tree": tree, "tolerance": "1.3"} | rebuilds(animation, still, tree, 1.3)
        for name, animation, still in (("figure", alone, ()), ("figure in the court", walk, (court,)))
        for tree in ("bvh", "kdtree")
    ]
    grid = camera(192, 45, (-12.0, -12.0, 8.0), (0.0, 0.0, 0.5))
    rigid = motion.rigid_motion(walking_figure(1, 8).mesh(0), (1, 9, 36, 100), grid, rounds=rounds)
    grouped = motion.group_updates(court, walking_figure(4, 8), 16, (1, 4, 16), rounds=rounds)
    stage = Stage(court, type(walk)(walk.name, walk.frames[::4], walk.faces, walk.bones[::4], walk.skin))
    ways = compare_ways(stage, camera(256), WAYS, rounds=rounds)
    split = motion.thread_splits(
        Stage(court, type(walk)(walk.name, walk.frames[::6], walk.faces)), [camera(256), camera(512)], rounds=rounds
    )
    return {
        "rebuilds": kept,
        "instances": [
            {"copies": str(row["copies"]), "way": row["way"], "update": float(row["update"]), "trace": float(row["trace"])}
            for row in rigid
        ],
        "groups": [{"moving": str(row["moving"]), "way": row["way"], "speed": 1.0 / row["ratio"]} for row in grouped],
        "ways": [
            {
                "way": row.way,
                "update": float(sum(row.update) / len(row.update)),
                "trace": float(sum(row.trace) / len(row.trace)),
            }
            for row in ways
            if row.way in WAYS
        ],
        "threads": [
            {"case": f"{row['accelerator']}, {row['rays']:,} rays", "turns": float(row["turns"]), "split": float(row["split"])}
            for row in split
        ],
    }


def drifts(*, rounds: int = 3) -> list[Row]:
    """Nodes of the first frame around the triangles of later ones, against trees built for the frame (Yang et al. 2008)."""
    walk = walking_figure(frames=12, detail=16)
    close = camera(160, 32, (-2.6, -2.6, 1.6), (0.0, 0.0, 0.9))
    return [{"tree": tree} | row for tree in ("bvh", "kdtree") for row in motion.drift(walk, tree, close.rays(), rounds=rounds)]


def fuzzy_boxes(*, rounds: int = 3) -> list[Row]:
    """Fuzzy boxes by the number of frames that they cover (Günther et al. 2006)."""
    close = camera(160, 32, (-2.6, -2.6, 1.6), (0.0, 0.0, 0.9))
    return motion.fuzzy_growth(walking_figure(frames=24, detail=10), (1, 4, 12, 24), close.rays(), rounds=rounds)
