"""Every public callable that takes a number, a switch or a few numbers: what the tests of types vary.

Each row of `calls` has the name of the callable, a function of the arguments to try that returns something to compare, and the
plain values of these arguments; the rows stand in `calls_of_*.py` by subject. `FOR_THE_LIBRARY` lists what has such parameters,
too, but is called by wrt itself.
"""

from __future__ import annotations

from collections.abc import Iterator

from support.call_objects import Call
from support.calls_of_analysis import analysis_calls
from support.calls_of_jobs import job_calls
from support.calls_of_known_rays import known_ray_calls
from support.calls_of_pictures import picture_calls
from support.calls_of_queries import query_calls
from support.calls_of_scenes import built_in_calls, scene_calls, tree_calls
from support.calls_of_sensors import sensor_calls


def calls() -> Iterator[Call]:
    """All rows. Numbers of two and of four are exact in every type of float."""
    yield from scene_calls()
    yield from query_calls()
    yield from analysis_calls()
    yield from tree_calls()
    yield from known_ray_calls()
    yield from picture_calls()
    yield from sensor_calls()
    yield from job_calls()
    yield from built_in_calls()


FOR_THE_LIBRARY = {
    "answers and reports": (
        "AreaLight CameraImages ClosestPair DistanceGrid JobStatus LidarScan OctreeAnalysis Plan TreeAnalysis Verification "
        "InfluenceAreas BuiltinScene Blocks Viewer PartitionedHits QueryTraffic AreaBreakEven BreakEven CountedWork "
        "BvhStatistics KdTreeStatistics Fault InsideCheck MeshMaterials.numbers SceneStatistics UpdateReport"
    ),
    "what trees and scenes ask of descriptions": (
        "Bvh.build Bvh.config Bvh.kernels KdTree.build KdTree.config KdTree.config_for KdTree.start ProjectedBvh.build "
        "ProjectedBvh.config RayAwareBvh.build RayAwareBvh.build_local RayAwareBvh.config Instance.moved GeneratedRays.rows"
    ),
    "what jobs, pictures and scans ask of their parts": (
        "Blocks.ranges Blocks.run_pieces Histogram.part Reduction.part Motion.move Wave Camera.beams Lidar.device_beams "
        "LidarPattern.cut LidarPattern.order_of_returns OrthographicCamera.rays_on PinholeCamera.rays_on Trajectory.at_rest "
        "Trajectory.check_covers ProcessPool.shutdown WeightedSum.check WeightedSum.part"
    ),
    "needs Dask": "map_points map_rays",
    "needs PyTorch": "TorchScene.intersect",
    "needs matplotlib": "draw_tree",
    "needs a browser": "view Viewer.play Viewer.add_points",
    "rows and columns of a finished analysis": "OctreeAnalysis.cut",
}
"""Public callables that are not tried, by the reason."""
