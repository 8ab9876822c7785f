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
    found = wrt.device.differentiable_hits(scene, hits, origins, directions, vertices)  # for wp.Tape
    wrt.device.launch(kernel, n, [scene.handle(), out])  # your own kernels trace rays, with wrt.device.closest_hit
    scan = wrt.sensors.Lidar.preset("ouster_os1_64").scan(scene, pose)  # lidars and cameras with time, lenses and noise
    image = wrt.render(scene, wrt.PinholeCamera(640, 480, position=(0, -3, 1), look_at=(0, 0, 0)))
    viewer = wrt.view(scene, block=False)           # the same in a web browser, with the mouse as camera

What everybody needs is here. The rest is in public modules, by purpose: `wrt.analysis` (signed distances, sun and sky,
thickness), `wrt.lights`, `wrt.pictures`, `wrt.moving`, `wrt.sensors` (lidars, cameras, point clouds), `wrt.device` (programs in
Warp), `wrt.batches` (more rays than memory holds), `wrt.cluster` (several machines), `wrt.disk` (more triangles than memory
holds), `wrt.compat` (trimesh, Open3D), `wrt.scenes` (built in), `wrt.known_rays`, `wrt.results` (what methods return),
`wrt.classics`.

Names are loaded on first use, so that `import wrt` costs little more than `import warp`.
"""

from __future__ import annotations

from pathlib import Path

from wrt.lazy_names import lazy_names

__version__ = "0.2.0"

if not (Path(__file__).parent / "kernels").is_dir():
    # In a checkout, kernels/ and builders/ are siblings of this folder; in an installation, they are inside it. Python
    # started in the root of a checkout imports this folder before the installed package.
    __path__.append(str(Path(__file__).parents[1]))

_HOME = {
    "AllHits": "wrt.query.all_hits",
    "Bvh": "wrt.accelerators.tree_descriptions",
    "Hits": "wrt.query.hits",
    "Instance": "wrt.meshes.instance",
    "KdTree": "wrt.accelerators.tree_descriptions",
    "Material": "wrt.materials.material",
    "OrthographicCamera": "wrt.imaging.cameras",
    "PinholeCamera": "wrt.imaging.cameras",
    "Rays": "wrt.engine.rays.rays",
    "Scene": "wrt.scene.scene",
    "Texture": "wrt.materials.material",
    "TriangleMesh": "wrt.meshes.mesh",
    "analysis": "wrt",
    "batches": "wrt",
    "cluster": "wrt",
    "compat": "wrt",
    "device": "wrt",
    "disk": "wrt",
    "get_num_threads": "wrt.kernels.runtime.launch",
    "known_rays": "wrt",
    "lights": "wrt",
    "moving": "wrt",
    "pictures": "wrt",
    "render": "wrt.imaging.integrators.rendering_call",
    "results": "wrt",
    "save_image": "wrt.imaging.image_files",
    "scenes": "wrt",
    "sensors": "wrt",
    "set_num_threads": "wrt.kernels.runtime.launch",
    "view": "wrt.viewer.live_view",
}

_MOVED = {
    "AreaLight": "wrt.lights",
    "AreaLightVisibility": "wrt.lights",
    "Blocks": "wrt.batches",
    "CircularCapCaster": "wrt.known_rays",
    "DirectionalLight": "wrt.lights",
    "FanScene": "wrt.classics",
    "FuzzyScene": "wrt.moving",
    "GeneratedRays": "wrt.batches",
    "GroupedScene": "wrt.moving",
    "InfluenceAreas": "wrt.known_rays",
    "InstancedScene": "wrt.moving",
    "LightBuffer": "wrt.lights",
    "Motion": "wrt.moving",
    "OctreeAnalysis": "wrt.known_rays",
    "PartitionedScene": "wrt.disk",
    "Plan": "wrt.results",
    "PlaneCaster": "wrt.known_rays",
    "PlaneInfluenceArea": "wrt.known_rays",
    "PointInfluenceArea": "wrt.known_rays",
    "PointLight": "wrt.lights",
    "ProjectedBvh": "wrt.known_rays",
    "RayAwareBvh": "wrt.known_rays",
    "RayMeshIntersector": "wrt.compat",
    "RaycastingScene": "wrt.compat",
    "RenderSettings": "wrt.pictures",
    "Rendering": "wrt.pictures",
    "Skeleton": "wrt.moving",
    "SkinnedScene": "wrt.moving",
    "Sky": "wrt.lights",
    "SpotLight": "wrt.lights",
    "SquareCapCaster": "wrt.known_rays",
    "TreeAnalysis": "wrt.known_rays",
    "UpdatePolicy": "wrt.moving",
    "Verification": "wrt.results",
    "Viewer": "wrt.pictures",
    "analyse": "wrt.known_rays",
    "analyse_areas": "wrt.known_rays",
    "analyse_octree": "wrt.known_rays",
    "break_even": "wrt.known_rays",
    "differentiable_hits": "wrt.device",
    "directional_shadow_rays": "wrt.known_rays",
    "draw_tree": "wrt.pictures",
    "nested_meshes": "wrt.moving",
    "point_shadow_rays": "wrt.known_rays",
    "show_compiling": "wrt.device",
}

_BESIDE = {
    "classics": "wrt",
}
"""Public modules that are not listed at the front, because few ask for them."""

__all__ = ["__version__", *_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME | _BESIDE, _MOVED)
