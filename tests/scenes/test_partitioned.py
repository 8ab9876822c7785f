"""Partitioned scenes against one scene in memory: the same answers bit for bit, under any budget; clear errors; no bad part."""

from __future__ import annotations

import os
import pickle
import threading
import weakref

import numpy as np
import pytest
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.disk import partitioned_scene, ray_job
from wrt.disk.cycling import PAIRS_PER_RAY, cycle
from wrt.disk.partition_files import LIST, MAPPED, RECORDS, RELATIVE, part_path
from wrt.engine import executor
from wrt.engine.launch import triangle_records
from wrt.revisions import TREE_REVISION
from wrt.scene.archives import array_places, checksum, read_archive, write_archive

MODES = tuple(partitioned_scene.MODES)
ATTRIBUTES = ("t", "primitive_id", "geometry_id", "instance_id", "uv", "is_hit", "position", "normal")


def meshes() -> list[wrt.TriangleMesh]:
    """Far from the origin, in both types, with coincident triangles in different meshes."""
    teapot = wrt.scenes.build("teapot", level=3)
    far = wrt.TriangleMesh(teapot.vertices + np.array([3000.0, -500.0, 20.0]), teapot.faces, name="far")
    soup = wrt.scenes.build("random_triangles", count=3000, size=0.5, seed=2)
    soup = wrt.TriangleMesh((soup.vertices + np.float32([3000.0, -500.0, 21.0])).astype(np.float32), soup.faces, name="soup")
    return [far, soup, far]


@pytest.fixture(scope="module")
def whole() -> wrt.Scene:
    return wrt.Scene(meshes(), "bvh", device="cpu")


@pytest.fixture(scope="module")
def rays(whole):
    return mixed_rays(wrt.TriangleMesh.concatenate(whole.meshes), 6000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("partitioned") / "scene"
    wrt.disk.PartitionedScene.build(meshes(), path, part_triangles=250, device="cpu")
    return path


@pytest.fixture
def scene(folder):
    """Under a quarter of its memory."""
    full = wrt.disk.PartitionedScene(folder, device="cpu").bytes
    return wrt.disk.PartitionedScene(folder, memory=full // 4, device="cpu")


@pytest.mark.parametrize("mode", MODES)
def test_answers_equal_those_of_the_whole_scene(scene, whole, rays, mode):
    assert scene.part_count > 20
    assert scene.triangle_count == whole.triangle_count
    np.testing.assert_array_equal(scene.bounds, whole.bounds)
    expected, hits = whole.intersect(*rays), scene.intersect(*rays, mode=mode)
    assert 0.1 < expected.is_hit.mean() < 0.9
    assert (expected.geometry_id == 0).any()
    assert not (expected.geometry_id == 2).any(), "of coincident triangles, the first mesh's are hit"
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name), err_msg=name)
    np.testing.assert_array_equal(hits.spawn(rays[1]), expected.spawn(rays[1]))
    np.testing.assert_array_equal(scene.occluded(*rays, mode=mode), whole.occluded(*rays))
    np.testing.assert_array_equal(scene.count(*rays, mode=mode), whole.count(*rays))
    assert 0 < scene.last_query.peak_bytes <= scene.memory
    assert scene.loaded_bytes <= scene.memory


@pytest.mark.parametrize("mode", MODES)
def test_ranges_and_culling(scene, whole, rays, mode):
    """Intervals that end exactly at hits, in single precision, whatever part the hits are in."""
    first = whole.intersect(*rays)
    t_max = np.where(first.is_hit, first.t, 1e9).astype(np.float32)
    t_min = np.where(np.arange(len(t_max)) % 2, 0, np.where(first.is_hit, first.t, 0)).astype(np.float32)
    for limits in ((t_min, t_max), (0.0, np.nextafter(t_max, np.float32(0)))):
        assert_same_hits(scene.intersect(*rays, *limits, mode=mode), whole.intersect(*rays, *limits))
        np.testing.assert_array_equal(scene.occluded(*rays, *limits, mode=mode), whole.occluded(*rays, *limits))
    culled = whole.intersect(*rays, cull_backfaces=True)
    assert_same_hits(scene.intersect(*rays, mode=mode, cull_backfaces=True), culled)


def test_blocks_and_threads_do_not_show(folder, whole, rays, monkeypatch):
    """Few rays in a block, few pairs in a list, and another number of threads."""
    expected = whole.intersect(*rays)
    monkeypatch.setattr(partitioned_scene, "BLOCK", 1000)
    monkeypatch.setattr("wrt.disk.cycling.MAX_PAIRS", 2000)
    for mode, threads in (("cycle", 1), ("cycle", 3), ("forward", 3)):
        some = wrt.disk.PartitionedScene(folder, num_threads=threads, device="cpu")
        assert_same_hits(some.intersect(*rays, mode=mode), expected)
        np.testing.assert_array_equal(some.count(*rays, mode=mode), whole.count(*rays))


def test_rays_through_many_parts(scene, whole):
    """More pairs of rays and parts than there is room for at first: they are listed again."""
    low, high = whole.bounds
    start = low + (high - low) * np.random.default_rng(5).uniform(0.0, 0.2, (5000, 3))
    expected = whole.count(start, high - start)
    np.testing.assert_array_equal(scene.count(start, high - start, mode="cycle"), expected)
    assert scene.last_query.rays_traced > PAIRS_PER_RAY * 5000


def test_shapes(scene, whole):
    directions = np.random.default_rng(1).normal(size=(4, 5, 3))
    origin = whole.bounds.mean(axis=0)
    hits, expected = scene.intersect(origin, directions), whole.intersect(origin, directions)
    assert hits.t.shape == (4, 5)
    assert hits.position.dtype == np.float64
    np.testing.assert_array_equal(hits.position, expected.position)
    assert scene.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert scene.intersect(np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)
    copy = pickle.loads(pickle.dumps(hits))
    np.testing.assert_array_equal(copy.normal, expected.normal)
    with pytest.raises(ValueError, match="do not hold the meshes"):
        hits.smooth_normal()


def test_each_part_is_loaded_once_in_a_cycle(folder, rays):
    scene = wrt.disk.PartitionedScene(folder, memory="1 GB", device="cpu")
    scene.intersect(*rays, mode="cycle")
    assert scene.last_query.loads <= scene.part_count
    for mode in MODES:
        scene.intersect(*rays, mode=mode)
        assert scene.last_query.loads == scene.last_query.bytes_read == 0, "all parts are in memory"
    scene.release()
    assert scene.loaded_bytes == 0
    scene.occluded(*rays)
    assert scene.last_query.loads > 0


def test_a_cycle_keeps_parts_for_the_next_one(folder, rays):
    """The newest part of a cycle leaves first. Were it the oldest, a query like the one before would load all parts again."""
    full = wrt.disk.PartitionedScene(folder, device="cpu")
    full.count(*rays)
    needed = full.last_query.loads
    scene = wrt.disk.PartitionedScene(folder, memory=full.bytes // 2, device="cpu")
    scene.count(*rays)
    assert scene.last_query.loads == needed, "nothing is loaded twice in a cycle"
    stay = scene._cache.is_loaded.copy()
    scene.count(*rays)
    assert scene.last_query.loads <= needed - stay.sum()
    assert scene._cache.bytes == sum(part.bytes for part in scene._cache._loaded.values()) <= scene.memory
    near = scene.part_bounds[int(np.flatnonzero(~scene._cache.is_loaded)[0])].mean(axis=0)
    scene.count(near, rays[1][:50], t_max=1e-3)
    assert scene.last_query.loads > 0
    scene.count(near, rays[1][:50], t_max=1e-3)
    assert scene.last_query.loads == 0, "parts of earlier queries leave before those of this one"


def test_a_cycle_refuses_what_is_too_much_for_a_block(folder, monkeypatch):
    """It must do nothing then: the block is cut, and its halves are traced."""
    job = type("Job", (), {})()
    monkeypatch.setattr("wrt.disk.cycling.list_pairs", lambda job: None)
    assert cycle(job) is False


def test_parts_are_scenes(folder):
    """A part can be read on its own, with the tools for scene files."""
    part = wrt.Scene.load(part_path(folder, 0), device="cpu")
    assert 0 < part.triangle_count <= 250


def test_from_files_and_generators(tmp_path, whole, rays):
    import trimesh

    paths = []
    for number, mesh in enumerate(meshes()):
        paths.append(tmp_path / f"{number}.ply")
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(paths[-1])
    expected = wrt.Scene([wrt.TriangleMesh.load(path) for path in paths], "bvh", device="cpu").intersect(*rays)
    scene = wrt.disk.PartitionedScene.build(
        (str(path) for path in paths), tmp_path / "scene", part_triangles=1000, device="cpu"
    )
    assert_same_hits(scene.intersect(*rays), expected)
    np.testing.assert_array_equal(scene.intersect(*rays).geometry_id, expected.geometry_id)
    assert scene.names == ("0", "1", "2")


@pytest.mark.parametrize("count", [1, 2])
def test_one_triangle(tmp_path, count):
    """One part, whose upper tree is one leaf; and coincident triangles in a single cell, divided by their order."""
    mesh = wrt.TriangleMesh(np.eye(3), np.repeat([[0, 1, 2]], count, axis=0))
    scene = wrt.disk.PartitionedScene.build(mesh, tmp_path / "one", part_triangles=1, device="cpu")
    assert scene.part_count == count
    for mode in MODES:
        hits = scene.intersect([0, 0, 0], [[1, 1, 1], [-1, 0, 0]], mode=mode)
        assert hits.primitive_id.tolist() == [0, -1]
        assert scene.count([0, 0, 0], [1, 1, 1], mode=mode) == count


def test_damaged_parts_are_refused(tmp_path, rays):
    path = tmp_path / "scene"
    scene = wrt.disk.PartitionedScene.build(meshes(), path, part_triangles=2000, device="cpu")
    expected = scene.occluded(*rays)
    files = [part_path(path, number) for number in range(scene.part_count)]
    whole = files[0].read_bytes()
    for place in (len(whole) // 2, len(whole) // 3):
        end = place + 128  # a single byte may be in the padding of the archive, which nobody reads
        files[0].write_bytes(whole[:place] + bytes(byte ^ 1 for byte in whole[place:end]) + whole[end:])
        scene.release()
        with pytest.raises(ValueError, match="part 0 of this scene, or it is damaged"):
            scene.occluded(*rays)
    files[0].write_bytes(whole[:-100])
    with pytest.raises(ValueError, match="damaged"):
        scene.occluded(*rays)
    files[0].write_bytes(files[1].read_bytes())
    with pytest.raises(ValueError, match="its label is"):
        scene.occluded(*rays)
    files[0].unlink()
    with pytest.raises(FileNotFoundError, match="part 0 of the scene is gone"):
        scene.occluded(*rays)
    files[0].write_bytes(whole)
    np.testing.assert_array_equal(scene.occluded(*rays), expected)
    text = (path / LIST).read_bytes()
    (path / LIST).write_bytes(text[:200] + b"x" + text[201:])
    with pytest.raises(ValueError, match="not the list of a partitioned scene"):
        wrt.disk.PartitionedScene(path)
    with pytest.raises(FileNotFoundError, match=r"wrt\.disk\.PartitionedScene\.build"):
        wrt.disk.PartitionedScene(tmp_path / "nothing")


def test_a_file_that_was_written_again_is_checked_again(tmp_path, rays):
    """Parts that were checked once are read without checks as long as their file stays the same."""
    path = tmp_path / "scene"
    scene = wrt.disk.PartitionedScene.build(meshes(), path, part_triangles=2000, device="cpu")
    scene.occluded(*rays)
    file = part_path(path, 0)
    content, status = bytearray(file.read_bytes()), os.stat(file)
    for place in range(len(content) // 2, len(content) // 2 + 128):  # beyond the padding of the archive, which nobody reads
        content[place] ^= 1
    file.write_bytes(content)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
    scene.release()
    with pytest.raises(ValueError, match="damaged"):
        scene.occluded(*rays)


def test_trees_of_other_builders_are_built_again(tmp_path, rays, monkeypatch):
    path = tmp_path / "scene"
    expected = wrt.disk.PartitionedScene.build(meshes(), path, part_triangles=2000, device="cpu").intersect(*rays)
    monkeypatch.setitem(TREE_REVISION, "bvh", 99)
    assert_same_hits(wrt.disk.PartitionedScene(path, device="cpu").intersect(*rays), expected)


def test_records_come_from_the_files(tmp_path, folder, whole, rays, monkeypatch):
    """They were made again for every part that was loaded. Files without them, as earlier versions wrote, still work."""
    expected = whole.intersect(*rays)
    plain = tmp_path / "plain"
    wrt.disk.PartitionedScene.build(meshes(), plain, part_triangles=250, store_records=False, device="cpu")
    for number in range(len(list(plain.glob("part-*")))):  # as before vertices relative to the centre were stored
        arrays = read_archive(part_path(plain, number))
        assert not [name for name in arrays if name.startswith(RECORDS)]
        with part_path(plain, number).open("wb") as file:
            arrays = {name: array for name, array in arrays.items() if name != RELATIVE}
            np.savez(file, **arrays, checksum=np.array(checksum(arrays)))
    earlier = wrt.disk.PartitionedScene(plain, device="cpu")
    assert_same_hits(earlier.intersect(*rays), expected)
    earlier.release()
    assert_same_hits(earlier.intersect(*rays), expected)  # without checks

    made, pack = [], triangle_records.pack_blocks
    monkeypatch.setattr(triangle_records, "pack_blocks", lambda *args: made.append(1) or pack(*args))
    scene = wrt.disk.PartitionedScene(folder, device="cpu")
    assert_same_hits(scene.intersect(*rays), expected)
    assert not made
    full = scene.loaded_bytes
    earlier.release()
    assert_same_hits(earlier.intersect(*rays), expected)
    assert made
    assert earlier.loaded_bytes == full, "records count as memory wherever they come from"


def test_what_is_mapped_lies_together_in_files_written_in_one_piece(tmp_path, folder):
    """Files that were written array by array were cached in small pages, which took ten times as long to map."""
    path = part_path(folder, 0)
    places = array_places(path)
    mapped = [place.offset for name, place in places.items() if name.startswith(MAPPED)]
    others = [place.offset for name, place in places.items() if not name.startswith(MAPPED)]
    assert len(mapped) >= len(MAPPED)
    assert not [offset for offset in others if min(mapped) < offset < max(mapped)]
    arrays = read_archive(path)
    write_archive(tmp_path / "pieces", arrays)
    write_archive(tmp_path / "piece", arrays, in_one_piece=True)
    assert (tmp_path / "piece").read_bytes() == (tmp_path / "pieces").read_bytes()


def test_wrong_records_are_refused(tmp_path, rays):
    path = tmp_path / "scene"
    scene = wrt.disk.PartitionedScene.build(meshes(), path, part_triangles=2000, device="cpu")
    arrays = read_archive(part_path(path, 0))
    name = next(name for name in arrays if name.startswith(RECORDS))
    for changed in ({name: arrays[name][:-16]}, {RELATIVE: arrays[RELATIVE] + np.float32(1)}):
        write_archive(part_path(path, 0), arrays | changed)
        with pytest.raises(ValueError, match="part 0 of this scene, or it is damaged"):
            scene.occluded(*rays)


def test_nothing_is_left_of_a_failed_build(tmp_path):
    def some():
        yield meshes()[0]
        raise RuntimeError("the source broke")

    with pytest.raises(RuntimeError, match="the source broke"):
        wrt.disk.PartitionedScene.build(some(), tmp_path / "scene")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("mine")
    with pytest.raises(FileExistsError, match="not an empty folder"):
        wrt.disk.PartitionedScene.build(meshes(), tmp_path / "full")
    assert (tmp_path / "full" / "file").read_text() == "mine"
    far = wrt.TriangleMesh(np.eye(3) * 1e12, [[0, 1, 2]])
    for geometry, error, message in (
        ([], ValueError, "gives no mesh"),
        (5, TypeError, "geometry must be meshes"),
        ([5], TypeError, "must be a wrt.TriangleMesh"),
        ([tmp_path / "no.ply"], FileNotFoundError, "no mesh file"),
        ([far], ValueError, "mesh 0 extends"),
    ):
        with pytest.raises(error, match=message):
            wrt.disk.PartitionedScene.build(geometry, tmp_path / "scene")
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"part_triangles": 0}, ValueError, "at least 1"),
        ({"part_triangles": 1.5}, TypeError, "must be an int"),
        ({"accelerator": "kdtree"}, ValueError, "choose 'bvh'"),
        ({"memory": "much"}, ValueError, "memory is 'much'"),
        ({"triangle_test": "komatsu"}, ValueError, "records depend on the origin"),
        ({"triangle_test": "nothing"}, ValueError, "triangle_test"),
    ],
)
def test_bad_options_of_a_build(tmp_path, options, error, message):
    with pytest.raises(error, match=message):
        wrt.disk.PartitionedScene.build(meshes(), tmp_path / "scene", **options)
    assert list(tmp_path.iterdir()) == []


def test_bad_options_of_a_query(scene, folder):
    ray = [0, 0, 0], [0, 0, 1]
    with pytest.raises(ValueError, match="give more memory, or build the scene with a smaller part_triangles"):
        wrt.disk.PartitionedScene(folder, memory=1000)
    with pytest.raises(ValueError, match="mode"):
        scene.intersect(*ray, mode="fast")
    with pytest.raises(ValueError, match="records depend on the origin"):
        scene.occluded(*ray, triangle_test="benthin")
    with pytest.raises(ValueError, match="does not walk a bvh"):
        scene.count(*ray, traversal="lockstep")
    with pytest.raises(TypeError, match="a plan is for one tree"):
        scene.count(*ray, traversal=wrt.Scene(meshes()[0], "bvh", device="cpu").explain(*ray))
    with pytest.raises(TypeError, match="folder must be a path"):
        wrt.disk.PartitionedScene(5)


def test_parts_of_one_query_share_a_prepared_query(scene, rays, monkeypatch):
    """Each visit of a part prepared its query again. What is shared must not keep parts in memory that were dropped."""
    prepared, held = [], []
    new, trace = executor.prepare, ray_job.trace_chosen
    monkeypatch.setattr(executor, "prepare", lambda *args: prepared.append(new(*args)) or prepared[-1])

    def traced(state, *args):
        held.append(weakref.ref(state.device_mesh))
        assert sum(mesh() is not None for mesh in held) <= scene._cache.is_loaded.sum()
        return trace(state, *args)

    monkeypatch.setattr(ray_job, "trace_chosen", traced)
    scene.intersect(*rays)
    assert scene.last_query.visits == len(held) > scene._cache.is_loaded.sum()
    assert 0 < len(prepared) < len(held) / 2


def test_several_threads(scene, whole, rays):
    expected, found = whole.intersect(*rays).t, []
    threads = [threading.Thread(target=lambda: found.append(scene.intersect(*rays).t)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    assert all(np.array_equal(t, expected) for t in found)
