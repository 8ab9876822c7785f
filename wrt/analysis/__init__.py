"""What is asked of geometry most often, ready-made on top of the queries of a scene.

    field = wrt.analysis.signed_distance(scene, points)             # negative inside; signs that bear holes and overlaps
    inside = wrt.analysis.winding_number(scan, points) > 0.5        # generalised winding numbers, also of soups

* Fields around surfaces: `signed_distance`, `sign_rule`, `winding_number`.

Closest points and inside tests are methods of the scene: `Scene.closest_point`, `Scene.contains`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "sign_rule": "wrt.analysis.signed_distances",
    "signed_distance": "wrt.analysis.signed_distances",
    "winding_number": "wrt.analysis.winding_numbers",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
