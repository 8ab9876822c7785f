"""wrt, "Warp Ray Tracing": ray queries against triangle meshes, on all CPU cores and on CUDA.

    mesh = wrt.TriangleMesh.load("bunny.ply")
    scene = wrt.Scene(mesh)
    hits = scene.intersect(origins, directions)     # hits.t, hits.primitive_id, hits.uv, hits.position, hits.normal
    exact = scene.intersect(origins, directions, precise=True)  # as brute force in float64
    dark = scene.occluded(origins, directions)      # bool
    lists = scene.intersect_all(origins, directions)  # every hit of each ray; scene.count, scene.contains(points)
    forest = wrt.Scene([wrt.Instance(mesh, matrix) for matrix in matrices])  # two-level scene; hits.instance_id
    seen = scene.visible(points[:, None], points)   # bool for every pair; hits.spawn(directions) for secondary rays
    print(scene.verify())                           # compares answers with brute force in float64
    found = wrt.differentiable_hits(scene, hits, origins, directions, vertices)  # for wp.Tape
    wrt.device.launch(kernel, n, [scene.handle(), ...])  # your own kernels trace rays with wrt.device.closest_hit ...
    scan = wrt.sensors.Lidar.preset("ouster_os1_64").scan(scene, pose)  # lidars and cameras with time, lenses and noise
    image = wrt.render(scene, wrt.PinholeCamera(640, 480, position=(0, -3, 1), look_at=(0, 0, 0)))
    viewer = wrt.view(scene, block=False)           # the same in a web browser, with the mouse as camera

Names are loaded on first use, so that `import wrt` costs little more than `import warp`.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

__version__ = "0.2.0"

if not (Path(__file__).parent / "kernels").is_dir():
    # In a checkout, kernels/ and builders/ are siblings of this folder; in an installation, they are inside it. Python
    # started in the root of a checkout imports this folder before the installed package.
    __path__.append(str(Path(__file__).parents[1]))

_HOME = {
    "AllHits": "wrt.query.all_hits",
    "AreaLight": "wrt.imaging.lights.light_sources",
    "AreaLightVisibility": "wrt.shadows.area_light_visibility",
    "Blocks": "wrt.query.blocks",
    "Bvh": "wrt.accelerators.tree_descriptions",
    "CircularCapCaster": "wrt.known_rays.ray_casters",
    "ClosestPoints": "wrt.query.points.closest_points",
    "DirectionalLight": "wrt.imaging.lights.light_sources",
    "GeneratedRays": "wrt.query.batches.block_rows",
    "FanScene": "wrt.fans.fan_scene",
    "FuzzyScene": "wrt.scene.fuzzy_scene",
    "GroupedScene": "wrt.scene.grouped_scene",
    "Hits": "wrt.query.hits",
    "InfluenceAreas": "wrt.known_rays.influence_areas",
    "Instance": "wrt.meshes.instance",
    "InstancedScene": "wrt.scene.instanced_scene",
    "KdTree": "wrt.accelerators.tree_descriptions",
    "LightBuffer": "wrt.shadows.light_buffer",
    "Material": "wrt.materials.material",
    "Motion": "wrt.imaging.integrators.scene_motion",
    "OctreeAnalysis": "wrt.known_rays.octree_analysis",
    "OrthographicCamera": "wrt.imaging.cameras",
    "PinholeCamera": "wrt.imaging.cameras",
    "PartitionedScene": "wrt.partitioned.partitioned_scene",
    "Plan": "wrt.planning.plan",
    "PlaneCaster": "wrt.known_rays.ray_casters",
    "PlaneInfluenceArea": "wrt.builders.influence.influence_area",
    "PointInfluenceArea": "wrt.builders.influence.influence_area",
    "PointLight": "wrt.imaging.lights.light_sources",
    "ProjectedBvh": "wrt.accelerators.projected_bvh",
    "RayAwareBvh": "wrt.accelerators.ray_aware_bvh",
    "RayMeshIntersector": "wrt.adapters.trimesh_rays",
    "RaycastingScene": "wrt.adapters.open3d_rays",
    "Rays": "wrt.rays.rays",
    "RenderSettings": "wrt.imaging.integrators.render_settings",
    "Rendering": "wrt.imaging.integrators.rendering_job",
    "Scene": "wrt.scene.scene",
    "Skeleton": "wrt.meshes.skeleton",
    "SkinnedScene": "wrt.scene.moving.skinned_scene",
    "Sky": "wrt.imaging.lights.sky_image",
    "SpotLight": "wrt.imaging.lights.light_sources",
    "SquareCapCaster": "wrt.known_rays.ray_casters",
    "Texture": "wrt.materials.material",
    "TreeAnalysis": "wrt.known_rays.tree_analysis",
    "TriangleMesh": "wrt.meshes.mesh",
    "UpdatePolicy": "wrt.scene.updates",
    "Verification": "wrt.query.verification",
    "Viewer": "wrt.viewer.live_view",
    "analyse": "wrt.known_rays.tree_analysis",
    "analyse_areas": "wrt.known_rays.tree_analysis",
    "analyse_octree": "wrt.known_rays.octree_analysis",
    "break_even": "wrt.known_rays.break_even",
    "cluster": "wrt",
    "device": "wrt",
    "differentiable_hits": "wrt.query.gradients",
    "directional_shadow_rays": "wrt.known_rays.ray_casters",
    "draw_tree": "wrt.viewer.trees.tree_drawing",
    "get_num_threads": "wrt.kernels.runtime.launch",
    "nested_meshes": "wrt.meshes.node_graph",
    "point_shadow_rays": "wrt.known_rays.ray_casters",
    "render": "wrt.imaging.integrators.rendering_call",
    "save_image": "wrt.imaging.image_files",
    "scenes": "wrt",
    "sensors": "wrt",
    "set_num_threads": "wrt.kernels.runtime.launch",
    "show_compiling": "wrt.kernels.compilation.compile_progress",
    "view": "wrt.viewer.live_view",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'wrt' has no attribute {name!r}")
    home = _HOME[name]
    value = importlib.import_module(f"wrt.{name}") if home == "wrt" else getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
