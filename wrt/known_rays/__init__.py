"""Scenes whose rays are known before: influence areas, trees for them, ray casters, and the analysis of trees.

sun = wrt.known_rays.PlaneInfluenceArea((0, 0, 50), (0, 0, -1), width=100, height=100, depth=60)
scene = wrt.Scene(mesh, wrt.known_rays.ProjectedBvh([sun]))
print(wrt.known_rays.break_even(scene, rays.origins, rays.directions))     # whether the areas pay
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "AreaBreakEven": "wrt.known_rays.area_break_even",
    "AxisChoice": "wrt.builders.bvh.phases.split_axes",
    "BoxMeasures": "wrt.builders.bvh.bvh_analysis",
    "BreakEven": "wrt.known_rays.area_break_even",
    "CircularCapCaster": "wrt.known_rays.ray_casters",
    "CountedWork": "wrt.known_rays.tree_analysis",
    "InfluenceAreas": "wrt.known_rays.influence_areas",
    "OctreeAnalysis": "wrt.known_rays.octree_analysis",
    "PlaneCaster": "wrt.known_rays.ray_casters",
    "PlaneInfluenceArea": "wrt.builders.influence.influence_area",
    "PointInfluenceArea": "wrt.builders.influence.influence_area",
    "ProjectedBvh": "wrt.accelerators.projected_bvh",
    "RayAwareBvh": "wrt.accelerators.ray_aware_bvh",
    "SquareCapCaster": "wrt.known_rays.ray_casters",
    "TreeAnalysis": "wrt.known_rays.tree_analysis",
    "analyse": "wrt.known_rays.tree_analysis",
    "analyse_areas": "wrt.known_rays.tree_analysis",
    "analyse_octree": "wrt.known_rays.octree_analysis",
    "break_even": "wrt.known_rays.area_break_even",
    "directional_shadow_rays": "wrt.known_rays.ray_casters",
    "point_shadow_rays": "wrt.known_rays.ray_casters",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
