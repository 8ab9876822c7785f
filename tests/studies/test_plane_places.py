"""Planes of least cost and the medians."""

from __future__ import annotations

from studies.kdtrees.plane_places import TINY, places
from wrt.scenes import build


def test_planes_lie_between_the_medians_where_none_splits_a_triangle():
    points = places(build("random_triangles", count=300, size=TINY))
    assert points["splitting"] == 0.0
    assert points["between"] == points["weighted"] == 100.0
    scattered = places(build("random_triangles", count=300, size=0.3))
    assert scattered["nodes"] > 10
    assert scattered["splitting"] > 50.0
    assert 0.0 < scattered["between"] < 100.0
