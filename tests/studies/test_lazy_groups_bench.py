"""The study of lazy kd-trees from groups: what it counts is what the trees did."""

from __future__ import annotations

from studies.kdtrees.lazy_groups import district, first_views, street_view
from wrt.builders.kdtree.lazy import lazy_kdtree
from wrt.meshes.placement import hierarchy_of


def test_first_views(monkeypatch):
    """Four blocks of four houses: groups are opened on demand, nothing is sorted, and all trees find the same."""
    monkeypatch.setattr(lazy_kdtree, "LARGE", 200)
    monkeypatch.setattr(lazy_kdtree, "OPENED", 4)
    geometry = district(2, houses=4, parts=5, detail=1)
    assert hierarchy_of(geometry)[1][0] == (20, 21, 22, 23, 24)
    rows = {row["hierarchy"]: row for row in first_views(geometry, street_view(2, 16), rounds=1)}
    assert len({row["hits"] for row in rows.values()}) == 1
    assert 0.02 < rows["groups"]["hits"] < 1.0
    assert [row["groups"] for row in rows.values()] == [0, 0, 21]
    assert 0 < rows["groups"]["opened"] <= 21
    assert rows["groups"]["sorted"] == 0 < rows["grid"]["sorted"]
    assert 0 < rows["groups"]["unbuilt"] < rows["groups"]["cells"]
    assert all(row["both"] > row["first"] > 0.0 for row in rows.values())
