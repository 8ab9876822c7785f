"""Streams that shade: filters take each ray once, and shading by streams, sorted or in order gives the same bits."""

from __future__ import annotations

import json

import click
import numpy as np
import pytest
import warp as wp
from click.testing import CliRunner

import wrt
from studies import bounces as bounce_commands
from studies.__main__ import studies
from studies.light.shading_streams_comparison import (
    WAYS,
    StreamFigures,
    compare_shading,
    scene_of_materials,
    utilisation,
)
from wrt.bench.commands.command_options import table_console
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.wavefront.path_step import MISSED
from wrt.kernels.shading.wavefront.shading_streams import FILTERS, Streams, filter_streams

CAMERA = wrt.PinholeCamera(41, 29, fov=55, position=(1, -3, 2.5), look_at=(1, 1, 0), up=(0, 0, 1))


@pytest.mark.parametrize(("count", "length"), [(1, 4096), (4096, 4096), (5003, 64), (5003, 4096), (700, 1)])
def test_filters_take_each_ray_once_and_in_order(count, length):
    """The judge is a stable sort by filter within each stream."""
    kinds = np.random.default_rng(count).choice(FILTERS, count).astype(np.int32)
    streams, rest = Streams(), wp.empty(count, dtype=int, device="cpu")
    streams.order = wp.empty(count, dtype=int, device="cpu")
    streams.ends = wp.empty((-(-count // length), len(FILTERS) + 1), dtype=int, device="cpu")
    stack = wp.array(np.array(FILTERS, dtype=np.int32), dtype=int, device="cpu")
    inputs = [length, wp.array(kinds, dtype=int, device="cpu"), stack, rest, streams]
    launch(filter_streams, len(streams.ends.numpy()), inputs, device=wp.get_device("cpu"), chunk=1)
    ranks = np.array([FILTERS.index(kind) for kind in kinds])
    np.testing.assert_array_equal(streams.order.numpy(), np.lexsort((ranks, np.arange(count) // length)))
    for stream, ends in enumerate(streams.ends.numpy()):
        own = ranks[stream * length : (stream + 1) * length]
        np.testing.assert_array_equal(ends - stream * length, [(own < k).sum() for k in range(len(FILTERS) + 1)])


def test_moved_rays_of_all_kinds_keep_their_bits():
    """In lanes, the three ways share the kernel that makes wrt's pictures."""
    ways = ("lanes", "sorted, lanes", "filtered, lanes")
    rows = compare_shading(scene_of_materials(3), CAMERA, depth=4, stream=256, rounds=1, ways=ways)
    assert [(row.generation, row.way) for row in rows] == [(generation, way) for generation in range(4) for way in ways]
    assert all(row.same and row.seconds > 0 for row in rows)
    assert min(rows[3].shares) > 0
    assert sum(rows[3].shares) == pytest.approx(1.0)


def test_own_code_for_each_stream_keeps_the_bits():
    """Mirrors in the open: two streams, so two kernels to compile."""
    meshes = [mesh.with_materials(wrt.Material("mirror", color=0.9)) for mesh in scene_of_materials(2).meshes]
    rows = compare_shading(wrt.Scene(meshes), CAMERA, depth=3, stream=100, rounds=1, ways=("lanes", "filtered"))
    assert len(rows) == 6
    assert all(row.same for row in rows)
    assert 0.1 < rows[0].shares[FILTERS.index(MISSED)] < 0.9


def test_utilisation_of_lanes():
    """By hand: 8 rays of two kinds in turns use half of 4 lanes as they come, and all of them once filtered."""
    mixed = np.array([0, 1] * 4)
    assert utilisation(mixed, 4) == 0.5
    assert utilisation(mixed, 4, stream=8) == 1.0
    assert utilisation(mixed, 4, stream=4) == 0.5
    assert utilisation(np.zeros(5, int), 4) == pytest.approx(5 / 8)


def test_what_streams_do_not_do():
    scene = scene_of_materials(1)
    with pytest.raises(ValueError, match="without instances"):
        compare_shading(wrt.Scene([wrt.Instance(scene.meshes[0], np.eye(4))]), CAMERA)
    with pytest.raises(ValueError, match="unknown way 'guessed'"):
        compare_shading(scene, CAMERA, ways=("guessed",))


def figures(same: bool = True) -> list[StreamFigures]:
    shares = (0.1, 0.2, 0.3, 0.15, 0.25)
    return [StreamFigures(generation, way, 100, shares, 0.002, 1.25, 0.0005, same) for generation in (0, 1) for way in WAYS]


def test_command(tmp_path, monkeypatch):
    """What is asked for reaches the study, and its figures the tables and the file."""
    asked = {}
    monkeypatch.setattr(bounce_commands, "compare_shading", lambda scene, camera, **given: asked.update(given) or figures())
    target = tmp_path / "shading.json"
    arguments = ["shading", "--size", "16", "--balls", "2", "--depth", "2", "--stream", "64", "--json", str(target)]
    done = CliRunner().invoke(studies, arguments)
    assert done.exit_code == 0, done.output
    assert (asked["depth"], asked["stream"], asked["rounds"]) == (2, 64, 3)
    assert "generation 1, 100 rays: 10% missed, 20% diffuse" in done.output
    assert "filtered, lanes" in done.output
    assert [row["way"] for row in json.loads(target.read_text())["shading"]] == [*WAYS, *WAYS]


def test_other_answers_are_an_error():
    with pytest.raises(click.ClickException, match="differ"):
        bounce_commands.print_shading(figures(same=False), table_console(120))
