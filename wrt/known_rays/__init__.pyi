# Written by `python -m tests.typed.stubs` from the table of names in wrt/known_rays/__init__.py.
from wrt.accelerators.projected_bvh import ProjectedBvh as ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh as RayAwareBvh
from wrt.builders.bvh.bvh_analysis import BoxMeasures as BoxMeasures
from wrt.builders.bvh.phases.split_axes import AxisChoice as AxisChoice
from wrt.builders.influence.influence_area import PlaneInfluenceArea as PlaneInfluenceArea
from wrt.builders.influence.influence_area import PointInfluenceArea as PointInfluenceArea
from wrt.known_rays.area_break_even import AreaBreakEven as AreaBreakEven
from wrt.known_rays.area_break_even import BreakEven as BreakEven
from wrt.known_rays.area_break_even import break_even as break_even
from wrt.known_rays.influence_areas import InfluenceAreas as InfluenceAreas
from wrt.known_rays.octree_analysis import OctreeAnalysis as OctreeAnalysis
from wrt.known_rays.octree_analysis import analyse_octree as analyse_octree
from wrt.known_rays.ray_casters import CircularCapCaster as CircularCapCaster
from wrt.known_rays.ray_casters import PlaneCaster as PlaneCaster
from wrt.known_rays.ray_casters import SquareCapCaster as SquareCapCaster
from wrt.known_rays.ray_casters import directional_shadow_rays as directional_shadow_rays
from wrt.known_rays.ray_casters import point_shadow_rays as point_shadow_rays
from wrt.known_rays.tree_analysis import CountedWork as CountedWork
from wrt.known_rays.tree_analysis import TreeAnalysis as TreeAnalysis
from wrt.known_rays.tree_analysis import analyse as analyse
from wrt.known_rays.tree_analysis import analyse_areas as analyse_areas

__all__ = [
    "AreaBreakEven",
    "AxisChoice",
    "BoxMeasures",
    "BreakEven",
    "CircularCapCaster",
    "CountedWork",
    "InfluenceAreas",
    "OctreeAnalysis",
    "PlaneCaster",
    "PlaneInfluenceArea",
    "PointInfluenceArea",
    "ProjectedBvh",
    "RayAwareBvh",
    "SquareCapCaster",
    "TreeAnalysis",
    "analyse",
    "analyse_areas",
    "analyse_octree",
    "break_even",
    "directional_shadow_rays",
    "point_shadow_rays",
]
