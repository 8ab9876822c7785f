"""What is asked of geometry most often, ready-made on top of the queries of a scene.

    field = wrt.analysis.signed_distance(scene, points)             # negative inside; signs that bear holes and overlaps
    inside = wrt.analysis.winding_number(scan, points) > 0.5        # generalised winding numbers, also of soups

* Fields around surfaces: `signed_distance`, `sign_rule`, `winding_number`; on grids: `distance_grid`.
* Surfaces: `sample_surface`, `thickness`, `shape_diameter`; `exposure` to the sun and the sky, `sky_directions` and
  `ambient_occlusion`; and `bake`, which keeps such values at vertices or in an image.
* Bodies in a scene: `closest_pair` of two, `clearance` of many, and the `overlapping_triangles` of two.
* Sight: `visible_faces` of a camera, `viewshed` of a terrain (`TriangleMesh.from_heightmap`).

Closest points and inside tests are methods of the scene: `Scene.closest_point`, `Scene.contains`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "BakedTexture": "wrt.analysis.baked_values",
    "ClosestPair": "wrt.analysis.mesh_pairs",
    "DistanceGrid": "wrt.analysis.distance_grids",
    "ambient_occlusion": "wrt.analysis.sky_exposure",
    "bake": "wrt.analysis.baked_values",
    "clearance": "wrt.analysis.mesh_pairs",
    "closest_pair": "wrt.analysis.mesh_pairs",
    "distance_grid": "wrt.analysis.distance_grids",
    "exposure": "wrt.analysis.sky_exposure",
    "overlapping_triangles": "wrt.analysis.mesh_pairs",
    "sample_surface": "wrt.analysis.surface_samples",
    "shape_diameter": "wrt.analysis.wall_thickness",
    "sign_rule": "wrt.analysis.signed_distances",
    "signed_distance": "wrt.analysis.signed_distances",
    "sky_directions": "wrt.analysis.sky_exposure",
    "thickness": "wrt.analysis.wall_thickness",
    "viewshed": "wrt.analysis.seen_faces",
    "visible_faces": "wrt.analysis.seen_faces",
    "winding_number": "wrt.analysis.winding_numbers",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
