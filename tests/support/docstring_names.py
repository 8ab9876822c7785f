"""What the examples of docstrings need beyond a mesh, a scene and rays; `tests/pages/test_docstring_examples.py` runs them."""

from __future__ import annotations

TWO = "scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, trimesh.transformations.translation_matrix([1, 0, 0]))])"
MANY = "scene = wrt.Scene([wrt.Instance(mesh) for _ in range(100)])"
PLY = "trimesh.Trimesh(mesh.vertices, mesh.faces).export"
TILES = f"{PLY}('tile.ply'); paths_of_tiles = ['tile.ply']"
SUNS = "suns = np.float32([[0, 0, 1], [0, 1, 1]])"
THREADS = "from concurrent.futures import ThreadPoolExecutor; executor = pool = ThreadPoolExecutor(1)"
CLIENT = f"{THREADS}; client = SimpleNamespace(get_executor=lambda: pool)"
AREA = "PlaneInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), width=4, height=3, depth=9)"
SKIN = """
skin, walk = wrt.scenes.walking_figure(frames=2, detail=4).skin, wrt.scenes.walking_figure(frames=2, detail=4)
vertices, faces, weights = skin.vertices, walk.faces, skin.weights
parents, joints, limits = skin.skeleton.parents, skin.skeleton.joints, skin.skeleton.limits
skeleton, angles, frames = skin.skeleton, np.zeros((len(parents), 3)), walk.frames
"""
LENS = "K, distortion, extrinsics = np.float64([[900, 0, 640], [0, 900, 360], [0, 0, 1]]), [0.1, 0.01, 0, 0], np.eye(4)"
TAPE = """
@wp.kernel
def loss_of(distance: wp.array(dtype=float), measured: wp.array(dtype=float), loss: wp.array(dtype=float)):
    i = wp.tid()
    if distance[i] < 1e9:
        wp.atomic_add(loss, 0, wp.pow(distance[i] - measured[i], 2.0))

@wp.kernel
def near_of(distance: wp.array(dtype=float), loss: wp.array(dtype=float)):
    wp.atomic_add(loss, 0, distance[wp.tid()])

def tracked(values):
    return wp.array(values, dtype=wp.vec3, requires_grad=True, device=scene.device)

measured, loss = wp.zeros(50, dtype=float, device=scene.device), wp.zeros(1, requires_grad=True, device=scene.device)
origins, directions, points, vertices = (tracked(one) for one in (origins, directions, points, mesh.vertices))
"""

SETUPS = {
    "wrt/__init__.py:": f"""
{PLY}('bunny.ply'); vertices = wp.array(wrt.TriangleMesh.load('bunny.ply').vertices, dtype=wp.vec3, device=scene.device)
origins, directions = (wp.array(one, dtype=wp.vec3, device=scene.device) for one in (origins, directions))
@wrt.device.kernel
def kernel(first: int, scene: wrt.device.SceneHandle, out: wp.array(dtype=float)):
    i = first + wp.tid()
    out[i] = wrt.device.closest_hit(scene, wp.vec3(0.0, 0.0, float(i)), wp.vec3(0.0, 0.0, 1.0), 0.0, wp.inf).t
n = 4; out = wp.zeros(n, dtype=float, device=scene.device)
""",
    "wrt/analysis/__init__.py:": "scan = scene",
    "wrt/analysis/baked_values.py:bake": """
uv = np.random.default_rng(0).uniform(size=(mesh.triangle_count, 3, 2))
scene = wrt.Scene(mesh.with_materials(wrt.Material(), uv=uv))
""",
    "wrt/analysis/mesh_pairs.py:closest_pair": TWO,
    "wrt/analysis/mesh_pairs.py:clearance": TWO,
    "wrt/analysis/mesh_pairs.py:overlapping_triangles": TWO,
    "wrt/analysis/seen_faces.py:viewshed": "heights = np.random.default_rng(0).uniform(0, 9, (130, 90))",
    "wrt/analysis/sky_exposure.py:exposure": "floor, sun, month = scene.points_on([0]), origins[:24], np.arange(24) // 2 + 1",
    "wrt/analysis/surface_samples.py:sample_surface": "scene = wrt.Scene(trimesh.creation.box())",
    "wrt/analysis/winding_numbers.py:winding_number": "scan = scene",
    "wrt/batches.py:": "def make(first, count): return np.zeros(3), np.ones((count, 3))\nedges = np.linspace(0, 9, 5)",
    "wrt/cluster/__init__.py:": SUNS,
    "wrt/cluster/dask_arrays.py:map_points": "import dask.array; points = dask.array.from_array(points)",
    "wrt/cluster/dask_arrays.py:map_rays": (
        "import dask.array; origins, directions = (dask.array.from_array(one) for one in (origins, directions))"
    ),
    "wrt/cluster/job.py:Job": f"{SUNS}; {THREADS}",
    "wrt/cluster/parquet_files.py:ParquetColumns": """
import pyarrow.parquet
columns = dict(zip(("x", "y", "z", "dx", "dy", "dz"), np.hstack([origins, directions]).T))
pyarrow.parquet.write_table(pyarrow.table(columns), "rays.parquet")
""",
    "wrt/compat/__init__.py:": "mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)",
    "wrt/compat/torch_scene.py:TorchScene": """
import torch
origins, directions = torch.tensor(origins).requires_grad_(), torch.tensor(directions)
""",
    "wrt/compat/trimesh_proximity.py:ProximityQuery": "mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)",
    "wrt/compat/trimesh_proximity.py:for_all_meshes": f"{PLY}('model.ply')",
    "wrt/device.py:": """
points = wp.array(points, dtype=wp.vec3, device=scene.device)
out = wp.zeros(len(points), dtype=float, device=scene.device)
""",
    "wrt/disk/__init__.py:": TILES,
    "wrt/disk/partitioned_scene.py:PartitionedScene": TILES,
    "wrt/imaging/integrators/scene_motion.py:Motion": "before = after = mesh.vertices; matrix = other = np.eye(4)",
    "wrt/instances/members.py:Members.move": """
robot = trimesh.Scene()
for parent, name in (("world", "shoulder"), ("shoulder", "wrist"), ("wrist", "hand")):
    robot.add_geometry(trimesh.creation.box(), name, name, parent_node_name=parent)
robot.export("robot.glb")
turned = bent = trimesh.transformations.rotation_matrix(0.5, [1, 0, 0])
""",
    "wrt/known_rays/area_break_even.py:": f"scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[wrt.known_rays.{AREA}]))",
    "wrt/known_rays/octree_analysis.py:analyse_octree": f"areas = [wrt.known_rays.{AREA}]",
    "wrt/lights/sky_image.py:Sky": "array = np.ones((4, 8, 3))",
    "wrt/meshes/instance.py:Instance": f"{PLY}('tree.ply')",
    "wrt/meshes/node_graph.py:nested_meshes": "trimesh.Scene([trimesh.creation.box()]).export('town.glb')",
    "wrt/moving/__init__.py:": f"building = curtain = mesh\n{SKIN}",
    "wrt/moving/fuzzy_scene.py:FuzzyScene": SKIN,
    "wrt/moving/grouped_scene.py:GroupedScene": """
building = curtain = torso = left_arm = left_hand = right_arm = right_hand = mesh
curtain_vertices = hand_vertices = mesh.vertices
""",
    "wrt/moving/skinned_scene.py:SkinnedScene": SKIN,
    "wrt/query/api.py:Queries.occluded": "toward_light = d = (0.3, 0.2, 1.0)",
    "wrt/query/batches/block_queries.py:BlockQueries.intersect_blocks": f"""
np.save("origins.npy", origins); direction = (0, 0, 1); nearest, t = np.zeros(50, np.float32), np.zeros(50, np.float32)
{CLIENT}
""",
    "wrt/query/batches/block_queries.py:BlockQueries.closest_point_blocks": (
        "np.save('points.npy', points); distance = np.zeros(len(points), np.float32)"
    ),
    "wrt/query/batches/block_rows.py:GeneratedRays": THREADS,
    "wrt/query/batches/weighted_sums.py:WeightedSum": f"{SUNS}; month = np.array([0, 6]); hours = 1.0",
    "wrt/query/blocks.py:Blocks": f"nearest = np.zeros(50, np.float32); {SUNS}",
    "wrt/query/blocks.py:Blocks.write": "dark = np.zeros(50, bool)",
    "wrt/query/gradients.py:differentiable_hits": TAPE,
    "wrt/query/hits.py:Hits.faces": "sun = (0.3, 0.2, 1.0)",
    "wrt/query/hits.py:Hits.interpolate": "temperature = mesh.vertices[:, 2]",
    "wrt/query/points/differentiable_points.py:differentiable_points": TAPE.replace("loss_of", "unused").replace(
        "near_of", "loss_of"
    ),
    "wrt/query/points/point_queries.py:PointQueries.points_on": """
triangles, samples, sun = np.arange(20), mesh.vertices[mesh.faces[:20]].mean(axis=1), (0.3, 0.2, 1.0)
""",
    "wrt/scene/scene.py:Scene.update": """
scene, forest = wrt.Scene([mesh] * 5), wrt.Scene([wrt.Instance(mesh) for _ in range(100)])
points, matrix, matrices = mesh.vertices, np.eye(4), [np.eye(4)] * 100
others = points
""",
    "wrt/scene/scene.py:Scene.updating": "next_frame = mesh.vertices * 2",
    "wrt/scene/scene.py:Scene.filtered": "is_glass = np.arange(mesh.triangle_count) < 9",
    "wrt/sensors/__init__.py:": f"{MANY}; body = trajectory = wrt.sensors.Trajectory([0, 0.1], [[0, 0, 5], [1, 0, 5]]); {LENS}",
    "wrt/sensors/camera_poses.py:pose_from_opengl": "camera = sensor; blender_camera = SimpleNamespace(matrix_world=np.eye(4))",
    "wrt/sensors/files/bag_files.py:write_bag": "scans, images = [lidar.scan(scene, pose)], [sensor.capture(scene, pose)]",
    "wrt/sensors/files/point_files.py:write_points": "scan = lidar.scan(scene, pose)",
    "wrt/sensors/files/point_reading.py:read_points": """
wrt.sensors.write_points("map.laz", lidar.scan(scene, pose).to_structured())
""",
    "wrt/sensors/image_sensor.py:Camera": LENS,
    "wrt/sensors/image_sensor.py:Camera.render": "camera = sensor",
    "wrt/sensors/rigs/rig.py:Rig": "camera, on_roof, in_front, labels, step = sensor, np.eye(4), np.eye(4), [7], 0",
    "wrt/viewer/live_view.py:Viewer.add_points": "viewer = wrt.view(scene, port=0, block=False)",
    "wrt/viewer/live_view.py:view": "moved = mesh.vertices * 2",
    "wrt/viewer/trees/tree_drawing.py:draw_tree": """
import matplotlib
matplotlib.use("Agg")
scene = wrt.Scene(wrt.scenes.build("teapot", level=4))
""",
}
"""Code that runs before an example, by its file and name."""

LARGE = {
    "wrt/__init__.py:": {"640, 480": "64, 48"},
    "wrt/analysis/baked_values.py:bake": {'to="texture")': 'to="texture", resolution=16, rays=4)'},
    "wrt/analysis/distance_grids.py:distance_grid": {"256": "64"},
    "wrt/analysis/surface_samples.py:sample_surface": {"0.02)": "0.2)"},
    "wrt/batches.py:": {"10**9": "1000"},
    "wrt/cluster/__init__.py:": {"8, threads": "1, threads"},
    "wrt/known_rays/ray_casters.py:": {"1 << 20": "1 << 8"},
    "wrt/query/batches/block_rows.py:GeneratedRays": {"10**12": "1000"},
    "wrt/query/batches/workers.py:ProcessPool": {"4": "1"},
    "wrt/scenes/__init__.py:": {"trees=100": "trees=2"},
    "wrt/sensors/image_sensor.py:Camera": {"1280, 720": "64, 36"},
    "wrt/sensors/__init__.py:": {"1280, 720": "64, 36"},
}
"""Numbers of an example that are made small here."""

NEEDS = {
    "wrt/__init__.py:": {"viser": "wrt[view]"},
    "wrt/cluster/dask_arrays.py:map_points": {"dask": "wrt[cluster-dask]"},
    "wrt/cluster/dask_arrays.py:map_rays": {"dask": "wrt[cluster-dask]"},
    "wrt/cluster/parquet_files.py:ParquetColumns": {"pyarrow": "wrt[cluster-dask]"},
    "wrt/compat/__init__.py:": {"torch": "torch"},
    "wrt/compat/torch_scene.py:TorchScene": {"torch": "torch"},
    "wrt/compat/torch_scene.py:as_tensors": {"torch": "torch"},
    "wrt/compat/trimesh_proximity.py:for_all_meshes": {"rtree": "rtree"},
    "wrt/known_rays/influence_areas.py:": {"sklearn": "wrt[cluster]"},
    "wrt/sensors/files/bag_files.py:write_bag": {"rosbags": "wrt[sensors]"},
    "wrt/sensors/files/point_reading.py:read_points": {"laspy": "wrt[sensors]"},
    "wrt/viewer/live_view.py:Viewer.add_points": {"viser": "wrt[view]"},
    "wrt/viewer/live_view.py:view": {"viser": "wrt[view]"},
    "wrt/viewer/trees/tree_drawing.py:draw_tree": {"matplotlib": "wrt[notebooks]"},
}
"""Packages without which an example is skipped, and what installs them."""
