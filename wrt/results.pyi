# Written by `python -m tests.typed.stubs` from the table of names in wrt/results.py.
from wrt.builders.bvh.bvh_statistics import BvhStatistics as BvhStatistics
from wrt.builders.kdtree.kdtree_statistics import KdTreeStatistics as KdTreeStatistics
from wrt.engine.plan.plan import Plan as Plan
from wrt.materials.mesh_materials import MeshMaterials as MeshMaterials
from wrt.query.checks.inside_check import InsideCheck as InsideCheck
from wrt.query.exact_hits import PreciseHits as PreciseHits
from wrt.query.gradients import DifferentiableHits as DifferentiableHits
from wrt.query.points.closest_points import ClosestPoints as ClosestPoints
from wrt.query.points.closest_points import TrianglesWithin as TrianglesWithin
from wrt.query.points.differentiable_points import DifferentiablePoints as DifferentiablePoints
from wrt.query.points.precise_points import PreciseClosestPoints as PreciseClosestPoints
from wrt.query.verification import Fault as Fault
from wrt.query.verification import Verification as Verification
from wrt.scene.scene_statistics import SceneStatistics as SceneStatistics
from wrt.scene.updates import UpdateReport as UpdateReport

__all__ = [
    "BvhStatistics",
    "ClosestPoints",
    "DifferentiableHits",
    "DifferentiablePoints",
    "Fault",
    "InsideCheck",
    "KdTreeStatistics",
    "MeshMaterials",
    "Plan",
    "PreciseClosestPoints",
    "PreciseHits",
    "SceneStatistics",
    "TrianglesWithin",
    "UpdateReport",
    "Verification",
]
