"""`studies bounces`: the rays of paths with their tags, every way with the same hits, and verdicts that figures decide."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from studies import bounces as bounce_commands
from studies.__main__ import studies
from studies.bounces import print_bounces
from studies.light.bounce_claims import judge
from studies.light.bounce_comparison import WAYS, BounceFigures, compare_bounces
from studies.light.bounce_rays import REFLECTED, TRANSMITTED, materials_of, trace_paths
from wrt.imaging.integrators.wavefront import square_order
from wrt.kernels.query.ordering.packet_orders import PACKET_ORDERS


def figures(speeds: dict[str, float] | None = None) -> list[BounceFigures]:
    """Equal figures of all ways at bounces 0 to 10, but for some speeds from bounce 1 on."""
    rows = []
    for bounce in range(11):
        speed = dict.fromkeys(WAYS, 1.0) | (speeds or {} if bounce else {})
        for way in WAYS:
            ratios = {other: speed[way] / speed[other] for other in WAYS}
            rows.append(BounceFigures("box", way, bounce, 64, speed[way], ratios, 1.0, 1.0, 10.0, 20.0, 30.0, 4.0, 0.5, True))
    return rows


def test_rays_of_paths():
    """A path from every pixel that goes on; a child starts on the surface that its parent met, on the side that it says."""
    scene, bounces = trace_paths(wrt.scenes.build("teapot", level=2, ground=False), 16, 3)
    assert [rays.bounce for rays in bounces] == [0, 1, 2, 3]
    np.testing.assert_array_equal(bounces[0].sources, np.arange(256))
    assert not bounces[0].kinds.any()
    assert not bounces[0].groups.any()
    for before, rays in pairwise(bounces):
        assert 200 < len(rays.origins) <= len(before.origins)
        assert (np.diff(rays.sources) > 0).all()
        assert {*rays.groups} <= {*range(len(scene.meshes))}
        parents = np.searchsorted(before.sources, rays.sources)
        hits = scene.intersect(before.origins, before.directions)
        np.testing.assert_allclose(rays.origins, hits.position[parents], atol=1e-3)
        np.testing.assert_array_equal(rays.groups, hits.geometry_id[parents])
        normal = hits.normal[parents]
        before_sides = (before.directions[parents] * normal).sum(1)
        same_side = (rays.directions * normal).sum(1) * before_sides > 0
        np.testing.assert_array_equal(rays.kinds, np.where(same_side, TRANSMITTED, REFLECTED))
    assert any((rays.kinds == TRANSMITTED).any() for rays in bounces)
    assert len(materials_of(scene.meshes)) == len(scene.meshes)


def test_squares_of_pixels_are_packets():
    ranks = np.argsort(square_order(16, 16)).reshape(16, 16)
    np.testing.assert_array_equal(np.sort(ranks[:8, 8:].ravel()), np.arange(64, 128))
    np.testing.assert_array_equal(ranks[0, :8], np.arange(8))
    assert sorted(square_order(11, 11)) == [*range(121)]
    np.testing.assert_array_equal(square_order(9, 2), [*range(8), *range(9, 17), 8, 17])


def test_figures_of_orders():
    """The orders share their kernels; the other ways are compared with brute force elsewhere."""
    mesh, ways = wrt.scenes.build("teapot", level=2, ground=False), [*PACKET_ORDERS]
    rows = compare_bounces(mesh, "pot", size=16, bounces=1, rounds=1, ways=ways)
    assert [(row.bounce, row.way) for row in rows] == [(bounce, way) for bounce in (0, 1) for way in ways]
    assert all(row.same and row.megarays > 0 and 0 < row.usage <= 1 for row in rows)
    assert all(row.ratios[row.way] == 1.0 for row in rows)
    last = {row.way: row for row in rows if row.bounce == 1}
    assert last["runs"].usage < last["types"].usage <= last["blind"].usage
    with pytest.raises(ValueError, match="size is 600"):
        trace_paths(mesh, 600)


def test_verdicts_follow_the_figures():
    """Equal ways fulfil only the claims that something is not faster, or still near 1 at the end; others tip by their own."""
    held = {row.claim.split(":")[0].split(" (")[0] for row in judge(figures()) if row.holds}
    assert {"sorting before tracing does not pay", "repacking is not faster at first"} <= held
    assert not {"types is faster than runs", "two planes against intervals"} & held
    changed = {"runs": 0.8, "two-plane": 1.25, "repacked": 1.2, "sorted by cells": 1.5}
    held = {row.claim.split(" (")[0] for row in judge(figures(changed)) if row.holds}
    assert {"types is faster than runs", "two planes against intervals", "and faster from bounce 5 to 10"} <= held
    assert not {"sorting before tracing does not pay", "repacking is not faster at first"} & held
    with pytest.raises(ValueError, match="camera rays only"):
        judge([row for row in figures() if row.bounce == 0])


def test_other_hits_are_an_error():
    import click

    from wrt.bench.commands.command_options import table_console

    rows = figures()
    rows[3] = replace(rows[3], same=False)
    with pytest.raises(click.ClickException, match="differ"):
        print_bounces(rows, table_console(160))


def test_command(tmp_path, monkeypatch):
    monkeypatch.setattr(bounce_commands, "compare_bounces", lambda *arguments, **options: figures())
    target = tmp_path / "bounces.json"
    arguments = ["bounces", "teapot", "--size", "16", "--bounces", "1", "--rounds", "1", "--json", str(target)]
    done = CliRunner().invoke(studies, arguments)
    assert done.exit_code == 0, done.output
    assert "omnidirectional" in done.output
    written = json.loads(target.read_text())
    assert {row["way"] for row in written["bounces"]} == {*WAYS}
    assert all({"claim", "paper", "found", "holds"} == set(row) for row in written["verdicts"])
