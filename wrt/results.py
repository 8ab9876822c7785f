"""What methods return, beside `wrt.Hits` and `wrt.AllHits`. Users read these classes, and do not make them.

* Of `Scene.intersect(..., precise=True)`: `PreciseHits`; of `wrt.device.differentiable_hits`: `DifferentiableHits`.
* Of `Scene.closest_point`: `ClosestPoints`, or, with `precise=True`, `PreciseClosestPoints`; of `Scene.within`:
  `TrianglesWithin`; of `wrt.device.differentiable_points`: `DifferentiablePoints`.
* Of `Scene.explain`, and `Hits.plan`: `Plan`; of `Scene.verify`: `Verification`, with `Fault` and `InsideCheck`.
* Of `Scene.statistics`: `SceneStatistics`, whose `tree` is a `BvhStatistics` or a `KdTreeStatistics`.
* `Scene.last_update` is an `UpdateReport`, `TriangleMesh.materials` a `MeshMaterials`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "BvhStatistics": "wrt.builders.bvh.bvh_statistics",
    "ClosestPoints": "wrt.query.points.closest_points",
    "DifferentiableHits": "wrt.query.gradients",
    "DifferentiablePoints": "wrt.query.points.differentiable_points",
    "Fault": "wrt.query.verification",
    "InsideCheck": "wrt.query.checks.inside_check",
    "KdTreeStatistics": "wrt.builders.kdtree.kdtree_statistics",
    "MeshMaterials": "wrt.materials.mesh_materials",
    "Plan": "wrt.engine.plan.plan",
    "PreciseClosestPoints": "wrt.query.points.precise_points",
    "PreciseHits": "wrt.query.exact_hits",
    "SceneStatistics": "wrt.scene.scene_statistics",
    "TrianglesWithin": "wrt.query.points.closest_points",
    "UpdateReport": "wrt.scene.updates",
    "Verification": "wrt.query.verification",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
