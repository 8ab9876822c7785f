"""A full disk: whatever writes a file says so, leaves the old one, and leaves nothing else.

`RLIMIT_FSIZE` bounds the size of files of this process, as a full disk does: C libraries meet it, too. Exporters emptied the
old file first, and what they then raised seldom said why.
"""

from __future__ import annotations

import errno
import os
import sys

import numpy as np
import pytest

import wrt
from wrt.atomic_files import write_text

small_files = pytest.importorskip("support.small_files", reason="only POSIX limits the size of files").small_files

ROOM = 2048
"""Bytes that still fit."""

MISSING = "{} is not installed: pip install 'wrt[test-all]'"


def needs(name):
    pytest.importorskip(name, reason=MISSING.format(name))


def points(path):
    """Random numbers, which do not become smaller by compression."""
    rng = np.random.default_rng(0)
    table = np.zeros(4000, dtype=[(axis, "f8") for axis in "xyz"])
    for axis in "xyz":
        table[axis] = rng.uniform(0, 100, 4000)
    return lambda: wrt.sensors.write_points(path, table)


def image(path):
    pixels = np.random.default_rng(0).random((64, 64, 3))
    return lambda: wrt.save_image(path, pixels)


def mesh(path):
    return lambda: wrt.scenes.build("teapot", level=3).save(path)


def scene(path):
    made = wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu")
    return lambda: made.save(path)


def analysis(method):
    def write(path):
        rows = [{"box": number, "cost": number / 7.0} for number in range(1000)]

        class Analysis(wrt.known_rays.TreeAnalysis):
            def __init__(self):
                pass

            def rows(self):
                return rows

            def to_dict(self):
                return {"boxes": rows}

        return lambda: getattr(Analysis(), method)(path)

    return write


def octree(path):
    class Analysis(wrt.known_rays.OctreeAnalysis):
        def __init__(self):
            pass

        def to_dict(self):
            return {"cells": list(range(1000))}

    return lambda: Analysis().save_json(path)


def figure(path):
    needs("matplotlib")
    from matplotlib.figure import Figure

    from wrt.bench.core.benchmark_plot import save_figure

    return lambda: save_figure(Figure(), path)


def fans(path):
    from wrt.builders.triangle_fans import TriangleFans
    from wrt.classics.fan_files import save_fans

    count = 500
    numbers = np.arange(count, dtype=np.int32)
    made = object.__new__(TriangleFans)
    for name, values in (("centre", numbers), ("rim", np.tile(numbers, 3)), ("first", 3 * np.arange(count + 1))):
        object.__setattr__(made, name, values)
    return lambda: save_fans(path, made, np.random.default_rng(0).random((count, 3)))


def chunk(path):
    from wrt.scene.archives import write_archive

    return lambda: write_archive(path, {"t": np.random.default_rng(0).random(2000)})


def parquet(path):
    needs("pyarrow")
    from wrt.cluster.parquet_files import WriteTable

    write = WriteTable(str(path.parent), ("t",))
    return lambda: write(slice(7, 2007), {"t": np.random.default_rng(0).random(2000)})


WRITERS = {
    "points.ply": points,
    "points.bin": points,
    "points.pcd": lambda path: (needs("pypcd4"), points(path))[1],
    "points.las": lambda path: (needs("laspy"), points(path))[1],
    "points.laz": lambda path: (needs("lazrs"), points(path))[1],
    "image.png": image,
    "image.jpg": image,
    "image.tiff": image,
    "image.npy": image,
    "image.exr": lambda path: (needs("OpenEXR"), image(path))[1],
    "mesh.ply": mesh,
    "mesh.obj": mesh,
    "mesh.stl": mesh,
    "mesh.glb": mesh,
    "scene.npz": scene,
    "fans.npz": fans,
    "chunk.npz": chunk,
    "part-000000000000007.parquet": parquet,
    "tree.json": analysis("save_json"),
    "tree.csv": analysis("save_csv"),
    "octree.json": octree,
    "figure.png": figure,
    "bench.json": lambda path: lambda: write_text(path, "0" * 10_000),
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_old_file_stays(tmp_path, name):
    path = tmp_path / name
    write = WRITERS[name](path)
    for old in (None, b"old"):
        if old is not None:
            path.write_bytes(old)
        with small_files(ROOM), pytest.raises(OSError, match=r"File too large|disk full") as caught:
            write()
        assert name in str(caught.value)
        assert (path.read_bytes() if path.exists() else None) == old
        assert len(os.listdir(tmp_path)) == (old is not None)
    write()
    assert path.stat().st_size > ROOM


def test_a_bag_is_whole_or_not_there(tmp_path):
    needs("rosbags")
    from support.sensed_scenes import wall

    made = wrt.Scene(wall(10.0), device="cpu")
    scan = wrt.sensors.Lidar.preset("velodyne_vlp16").scan(made, np.eye(4))
    with small_files(ROOM), pytest.raises(OSError, match=r"disk full|File too large") as caught:
        wrt.sensors.write_bag(tmp_path / "bag", {"/points": [scan]})
    assert "bag" in str(caught.value)
    assert not os.listdir(tmp_path)
    (tmp_path / "bag").mkdir()
    with pytest.raises(FileExistsError, match="bag"):
        wrt.sensors.write_bag(tmp_path / "bag", {"/points": [scan]})


@pytest.mark.parametrize("room", [ROOM, 200_000], ids=["triangles of parts", "trees of parts"])
def test_a_scene_in_parts_is_whole_or_not_there(tmp_path, room):
    """The error told numbers of bytes, or a file in a hidden folder."""
    mesh = wrt.scenes.build("teapot", level=8)
    wrt.disk.PartitionedScene.build(mesh, tmp_path / "before")  # kernels are files, too: these compile them
    with small_files(room), pytest.raises(OSError, match=r"disk full|File too large") as caught:
        wrt.disk.PartitionedScene.build(mesh, tmp_path / "parts")
    assert f"'{tmp_path / 'parts'}'" in str(caught.value)
    assert os.listdir(tmp_path) == ["before"]


@pytest.mark.skipif(sys.platform != "linux", reason="Linux has a device that is always full")
def test_a_full_device_is_named():
    """A device is written through; the error is that of the system, with the path."""
    with pytest.raises(OSError, match="'/dev/full'") as caught:
        write_text("/dev/full", "contents")
    assert caught.value.errno == errno.ENOSPC
