# Written by `python -m tests.typed.stubs` from the table of names in wrt/__init__.py.
from wrt import cluster as cluster
from wrt import device as device
from wrt import scenes as scenes
from wrt import sensors as sensors
from wrt.accelerators.projected_bvh import ProjectedBvh as ProjectedBvh
from wrt.accelerators.ray_aware_bvh import RayAwareBvh as RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh as Bvh
from wrt.accelerators.tree_descriptions import KdTree as KdTree
from wrt.adapters.open3d_rays import RaycastingScene as RaycastingScene
from wrt.adapters.trimesh_rays import RayMeshIntersector as RayMeshIntersector
from wrt.builders.influence.influence_area import PlaneInfluenceArea as PlaneInfluenceArea
from wrt.builders.influence.influence_area import PointInfluenceArea as PointInfluenceArea
from wrt.fans.fan_scene import FanScene as FanScene
from wrt.imaging.cameras import OrthographicCamera as OrthographicCamera
from wrt.imaging.cameras import PinholeCamera as PinholeCamera
from wrt.imaging.image_files import save_image as save_image
from wrt.imaging.integrators.render_settings import RenderSettings as RenderSettings
from wrt.imaging.integrators.rendering_call import render as render
from wrt.imaging.integrators.rendering_job import Rendering as Rendering
from wrt.imaging.integrators.scene_motion import Motion as Motion
from wrt.imaging.lights.light_sources import AreaLight as AreaLight
from wrt.imaging.lights.light_sources import DirectionalLight as DirectionalLight
from wrt.imaging.lights.light_sources import PointLight as PointLight
from wrt.imaging.lights.light_sources import SpotLight as SpotLight
from wrt.imaging.lights.sky_image import Sky as Sky
from wrt.kernels.compilation.compile_progress import show_compiling as show_compiling
from wrt.kernels.runtime.launch import get_num_threads as get_num_threads
from wrt.kernels.runtime.launch import set_num_threads as set_num_threads
from wrt.known_rays.break_even import break_even as break_even
from wrt.known_rays.influence_areas import InfluenceAreas as InfluenceAreas
from wrt.known_rays.octree_analysis import OctreeAnalysis as OctreeAnalysis
from wrt.known_rays.octree_analysis import analyse_octree as analyse_octree
from wrt.known_rays.ray_casters import CircularCapCaster as CircularCapCaster
from wrt.known_rays.ray_casters import PlaneCaster as PlaneCaster
from wrt.known_rays.ray_casters import SquareCapCaster as SquareCapCaster
from wrt.known_rays.ray_casters import directional_shadow_rays as directional_shadow_rays
from wrt.known_rays.ray_casters import point_shadow_rays as point_shadow_rays
from wrt.known_rays.tree_analysis import TreeAnalysis as TreeAnalysis
from wrt.known_rays.tree_analysis import analyse as analyse
from wrt.known_rays.tree_analysis import analyse_areas as analyse_areas
from wrt.materials.material import Material as Material
from wrt.materials.material import Texture as Texture
from wrt.meshes.instance import Instance as Instance
from wrt.meshes.mesh import TriangleMesh as TriangleMesh
from wrt.meshes.node_graph import nested_meshes as nested_meshes
from wrt.meshes.skeleton import Skeleton as Skeleton
from wrt.partitioned.partitioned_scene import PartitionedScene as PartitionedScene
from wrt.planning.plan import Plan as Plan
from wrt.query.all_hits import AllHits as AllHits
from wrt.query.batches.block_rows import GeneratedRays as GeneratedRays
from wrt.query.blocks import Blocks as Blocks
from wrt.query.gradients import differentiable_hits as differentiable_hits
from wrt.query.hits import Hits as Hits
from wrt.query.verification import Verification as Verification
from wrt.rays.rays import Rays as Rays
from wrt.scene.fuzzy_scene import FuzzyScene as FuzzyScene
from wrt.scene.grouped_scene import GroupedScene as GroupedScene
from wrt.scene.instanced_scene import InstancedScene as InstancedScene
from wrt.scene.moving.skinned_scene import SkinnedScene as SkinnedScene
from wrt.scene.scene import Scene as Scene
from wrt.scene.updates import UpdatePolicy as UpdatePolicy
from wrt.shadows.area_light_visibility import AreaLightVisibility as AreaLightVisibility
from wrt.shadows.light_buffer import LightBuffer as LightBuffer
from wrt.viewer.live_view import Viewer as Viewer
from wrt.viewer.live_view import view as view
from wrt.viewer.trees.tree_drawing import draw_tree as draw_tree

__version__: str

__all__ = [
    "AllHits",
    "AreaLight",
    "AreaLightVisibility",
    "Blocks",
    "Bvh",
    "CircularCapCaster",
    "DirectionalLight",
    "FanScene",
    "FuzzyScene",
    "GeneratedRays",
    "GroupedScene",
    "Hits",
    "InfluenceAreas",
    "Instance",
    "InstancedScene",
    "KdTree",
    "LightBuffer",
    "Material",
    "Motion",
    "OctreeAnalysis",
    "OrthographicCamera",
    "PartitionedScene",
    "PinholeCamera",
    "Plan",
    "PlaneCaster",
    "PlaneInfluenceArea",
    "PointInfluenceArea",
    "PointLight",
    "ProjectedBvh",
    "RayAwareBvh",
    "RayMeshIntersector",
    "RaycastingScene",
    "Rays",
    "RenderSettings",
    "Rendering",
    "Scene",
    "Skeleton",
    "SkinnedScene",
    "Sky",
    "SpotLight",
    "SquareCapCaster",
    "Texture",
    "TreeAnalysis",
    "TriangleMesh",
    "UpdatePolicy",
    "Verification",
    "Viewer",
    "__version__",
    "analyse",
    "analyse_areas",
    "analyse_octree",
    "break_even",
    "cluster",
    "device",
    "differentiable_hits",
    "directional_shadow_rays",
    "draw_tree",
    "get_num_threads",
    "nested_meshes",
    "point_shadow_rays",
    "render",
    "save_image",
    "scenes",
    "sensors",
    "set_num_threads",
    "show_compiling",
    "view",
]
