"""Scenes in files, in pickles and with trees from a folder: the same hits to the bit, and nothing stale or broken is taken."""

from __future__ import annotations

import copy
import gc
import json
import os
import pickle
import subprocess
import sys
import threading
import time
import zipfile

import numpy as np
import pytest
from support.environment import DEVICES
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.builders.bvh import BVH_BUILDERS, small_mesh_build
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.builders.tree_check import check_tree
from wrt.kernels.layout.bvh_nodes import leaf_child
from wrt.revisions import TREE_REVISION
from wrt.scene.archives import ALIGNED, array_places, read_archive, write_archive
from wrt.scene.storage import pack_tree, unpack_tree

DESCRIPTIONS = {
    "bvh": wrt.Bvh(bins=12),
    "bvh4": wrt.Bvh(width=4, max_leaf_triangles=3),
    "kdtree": wrt.KdTree(block_cost=0.7),
    "medians": wrt.KdTree(builder="spatial_median", axis="round_robin", max_depth=9),
}


def meshes() -> list[wrt.TriangleMesh]:
    """Two, one in float64 and far away."""
    teapot = wrt.scenes.build("teapot", level=3)
    far = wrt.TriangleMesh(teapot.vertices.astype(np.float64) * 0.7 + 1e5, teapot.faces[:-100], name="far", up=(0, 1, 0))
    return [wrt.TriangleMesh(teapot.vertices + 1e5, teapot.faces), far]


@pytest.fixture(params=DESCRIPTIONS)
def scene(request, device) -> wrt.Scene:
    test = "moeller_trumbore" if request.param == "bvh" else "auto"
    return wrt.Scene(meshes(), DESCRIPTIONS[request.param], triangle_test=test, device=device, num_threads=2)


@pytest.fixture
def built(monkeypatch) -> list[str]:
    """Notes each tree that is built."""
    names = []
    for cls in (Bvh, KdTree):

        def build(self, triangles, width, original=cls.build):
            names.append(self.kind)
            return original(self, triangles, width)

        monkeypatch.setattr(cls, "build", build)

    def build_small_mesh(*given, original=small_mesh_build.build_small_mesh):
        names.append("bvh")
        return original(*given)

    monkeypatch.setattr(small_mesh_build, "build_small_mesh", build_small_mesh)
    return names


def assert_same(scene: wrt.Scene, other: wrt.Scene) -> None:
    """The same description, the same meshes, the same tree and the same hits."""
    assert (scene.accelerator, scene.triangle_test) == (other.accelerator, other.triangle_test)
    for mesh, twin in zip(scene.meshes, other.meshes, strict=True):
        assert (mesh.name, mesh.up, mesh.vertices.dtype) == (twin.name, twin.up, twin.vertices.dtype)
        np.testing.assert_array_equal(mesh.vertices, twin.vertices)
        np.testing.assert_array_equal(mesh.faces, twin.faces)
        assert not twin.vertices.flags.writeable
    one, two = pack_tree(scene.tree), pack_tree(other.tree)
    assert one.keys() == two.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])
    rays = mixed_rays(wrt.TriangleMesh.concatenate(scene.meshes), 150)
    assert_same_hits(scene.intersect(*rays), other.intersect(*rays))
    assert scene.statistics().build_seconds == other.statistics().build_seconds


def test_files(scene, built, tmp_path):
    path = tmp_path / "model.scene"
    scene.save(path)
    scene.save(path)
    loaded = wrt.Scene.load(path, device=scene.device)
    assert_same(scene, loaded)
    assert built == []
    assert list(tmp_path.iterdir()) == [path]


def test_pickles(scene, built):
    revived = pickle.loads(pickle.dumps(scene))
    assert_same(scene, revived)
    assert (revived.device, revived.num_threads) == (scene.device, 2)
    assert built == []


def test_copies_share_the_tree(scene, built):
    twin = copy.copy(scene)
    assert twin.tree is scene.tree
    assert_same(scene, twin)
    assert built == []


def test_pickled_instances():
    """They still share their mesh, and are as read-only as before."""
    mesh = meshes()[0]
    pair = [wrt.Instance(mesh, 2.0 * np.eye(4) - np.diag([0, 0, 0, 1.0]), mask=5), wrt.Instance(mesh)]
    first, second = pickle.loads(pickle.dumps(pair))
    assert first.mesh is second.mesh
    assert (first.mask, second.mask) == (5, pair[1].mask)
    np.testing.assert_array_equal(first.transform, pair[0].transform)
    assert not first.transform.flags.writeable


def test_pickles_go_to_other_processes(tmp_path):
    scene = wrt.Scene(meshes(), device="cpu")
    rays = mixed_rays(wrt.TriangleMesh.concatenate(scene.meshes), 100)
    (tmp_path / "job").write_bytes(pickle.dumps((scene, rays)))
    code = (
        "import pickle, sys, warp as wp; wp.config.log_level = wp.LOG_WARNING\n"
        "scene, rays = pickle.load(open('job', 'rb'))\n"
        "pickle.dump(scene.intersect(*rays).t, open('done', 'wb'))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
    answer = pickle.loads((tmp_path / "done").read_bytes())
    np.testing.assert_array_equal(answer, scene.intersect(*rays).t)


def test_folder_of_trees(built, tmp_path):
    """A tree is taken if, and only if, all that it depends on is the same; damage is repaired."""
    folder = tmp_path / "trees" / "of mine"
    first, second = meshes()
    scene = wrt.Scene(first, cache=folder, device="cpu")
    again = wrt.Scene(wrt.TriangleMesh(first.vertices, first.faces, name="other"), cache=str(folder), device="cpu")
    assert built == ["bvh"]
    assert_same_tree(scene, again)
    moved = first.vertices.copy()
    moved[5, 1] += 0.01
    others = [
        (wrt.TriangleMesh(moved, first.faces), "auto"),
        (wrt.TriangleMesh(first.vertices, first.faces[:, [1, 2, 0]]), "auto"),
        ([first, second], "auto"),
        (first, "kdtree"),
        (first, wrt.Bvh(bins=8)),
        (first, wrt.Bvh(width=2)),
    ]
    for number, (geometry, accelerator) in enumerate(others, 2):
        wrt.Scene(geometry, accelerator, cache=folder, device="cpu")
        assert len(built) == len(list(folder.iterdir())) == number
        wrt.Scene(geometry, accelerator, cache=folder, device="cpu")
        assert len(built) == number
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[:-200])
    assert_same_tree(scene, wrt.Scene(first, cache=folder, device="cpu"))
    assert len(built) == len(others) + 2
    wrt.Scene(first, cache=folder, device="cpu")
    assert len(built) == len(others) + 2
    with pytest.raises(TypeError, match="cache must be the path"):
        wrt.Scene(first, cache=3)


def test_a_pipe_in_a_folder_of_trees_is_not_waited_for(tmp_path):
    """The query for a stored tree opened whatever had its name."""
    first = wrt.Scene(meshes()[0], cache=tmp_path, device="cpu")
    (path,) = tmp_path.iterdir()
    path.unlink()
    os.mkfifo(path)
    with pytest.warns(UserWarning, match="the tree is not cached"):
        assert_same_tree(first, wrt.Scene(meshes()[0], cache=tmp_path, device="cpu"))


def assert_same_tree(scene: wrt.Scene, other: wrt.Scene) -> None:
    one, two = pack_tree(scene.tree), pack_tree(other.tree)
    for name in one.keys() - {"stats"}:
        np.testing.assert_array_equal(one[name], two[name])


def test_other_builders_build_again(built, tmp_path, monkeypatch):
    """What builders of another revision or a device of another width would build is not taken from a file."""
    scene = wrt.Scene(meshes(), device="cpu")
    scene.save(tmp_path / "scene")
    pickled = pickle.dumps(scene)
    monkeypatch.setattr(wrt, "__version__", "0.0.7")
    monkeypatch.setitem(TREE_REVISION, "kdtree", 99)  # another family
    assert_same_tree(scene, wrt.Scene.load(tmp_path / "scene", device="cpu"))
    assert built == ["bvh"]
    monkeypatch.setitem(TREE_REVISION, "bvh", 99)
    assert_same_tree(scene, wrt.Scene.load(tmp_path / "scene", device="cpu"))
    assert_same_tree(scene, pickle.loads(pickled))
    assert built == ["bvh"] * 3
    monkeypatch.undo()
    monkeypatch.setattr("wrt.scene.mesh_state.native_width", lambda device: 2)
    assert wrt.Scene.load(tmp_path / "scene", device="cpu").tree.width == 2


def test_damaged_and_foreign_files(tmp_path):
    scene = wrt.Scene(meshes(), device="cpu")
    path = tmp_path / "scene.npz"
    scene.save(path)
    whole = path.read_bytes()
    middle = bytearray(whole)
    middle[len(whole) // 2] ^= 4
    buffers = {"empty": b"", "half": whole[: len(whole) // 2], "short": whole[:-1], "bit": bytes(middle), "text": b"a\nply\n"}
    for name, content in buffers.items():
        (tmp_path / name).write_bytes(content)
    np.savez(tmp_path / "foreign.npz", vertices=np.zeros(3))
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "pickle.npz", wrt=np.array({"a": print}, dtype=object))
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as archive:
        archive.writestr("wrt.npy", "text")
    for name in (*buffers, "foreign.npz", "array.npy", "pickle.npz", "zip.npz"):
        with pytest.raises(ValueError, match=rf"{name}' is not a scene that wrt saved, or it is damaged"):
            wrt.Scene.load(tmp_path / name)
    with pytest.raises(FileNotFoundError, match="check the path"):
        wrt.Scene.load(tmp_path / "nowhere.npz")
    with pytest.raises(FileNotFoundError):
        scene.save(tmp_path / "nowhere" / "scene.npz")
    with pytest.raises(ValueError, match="device 'cuda:99' does not exist"):
        wrt.Scene.load(path, device="cuda:99")


def test_later_formats_are_refused(tmp_path):
    path = tmp_path / "scene.npz"
    wrt.Scene(meshes(), device="cpu").save(path)
    arrays = dict(np.load(path))
    header = json.loads(str(arrays["wrt"])) | {"format": 99}
    write_archive(path, arrays | {"wrt": np.array(json.dumps(header))})
    with pytest.raises(ValueError, match="format 99, and this version of wrt reads format 2"):
        wrt.Scene.load(path)


def test_nothing_half_written(tmp_path, monkeypatch):
    """Ctrl-C while a scene is saved leaves the file that was there before, and nothing else."""
    path = tmp_path / "scene.npz"
    scene = wrt.Scene(meshes(), device="cpu")
    scene.save(path)
    before = path.read_bytes()

    def interrupted(file, array, **options):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np.lib.format, "write_array", interrupted)
    with pytest.raises(KeyboardInterrupt):
        scene.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def change(name: str, index: int, value: int):
    """A change of one element of a tree's array."""

    def apply(arrays: dict[str, np.ndarray]) -> None:
        arrays[name].reshape(-1)[index] = value

    return apply


def forged(arrays, name, values):
    arrays[name] = np.array(values)


FORGERIES = {
    "bvh": {
        "triangle": change("primitive", 3, 10**6),
        "negative triangle": change("primitive", 0, -2),
        "circle": change("child", 0, 0),
        "child beyond": change("child", 1, 10**6),
        "leaf beyond": change("child", -1, leaf_child.func(1 << 20, 5)),
        "width": lambda arrays: forged(arrays, "width", 3),
        "boxes": lambda arrays: forged(arrays, "bounds", arrays["bounds"][:-6]),
        "levels": lambda arrays: forged(arrays, "level_first", [0, 1]),
        "type": lambda arrays: forged(arrays, "child", arrays["child"].astype(float)),
        "kind": lambda arrays: forged(arrays, "kind", "octree"),
        "missing": lambda arrays: arrays.pop("low"),
    },
    "kdtree": {
        "triangle": change("primitive", 3, 10**6),
        "circle": change("nodes", 1, 0 << 2),
        "child beyond": change("nodes", 1, 10**6 << 2),
        "last node": change("nodes", -1, (10**6 << 2) | 1),
        "leaf beyond": change("nodes", -1, (10**6 << 2) | 3),
        "no nodes": lambda arrays: forged(arrays, "nodes", arrays["nodes"][:0]),
        "shape": lambda arrays: forged(arrays, "nodes", arrays["nodes"].reshape(-1)[:-1]),
        "deep": lambda arrays: forged(arrays, "nodes", np.int32([[0, (i + 2) << 2] for i in range(99)] + [[0, 3]] * 101)),
    },
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in FORGERIES for name in FORGERIES[kind]])
def test_forged_trees_are_refused(kind, name):
    """No index of a tree from outside leads a kernel out of its arrays."""
    scene = wrt.Scene(meshes(), kind, device="cpu")
    arrays = pack_tree(scene.tree)
    unpack_tree(arrays, scene.triangle_count)
    arrays = {key: array.copy() for key, array in arrays.items()}
    FORGERIES[kind][name](arrays)
    with pytest.raises((ValueError, KeyError, RuntimeError)):
        unpack_tree(arrays, scene.triangle_count)


@pytest.mark.parametrize("name", ["binned", "in_place", "one triangle", "same place"])
def test_every_tree_that_is_built_passes(name):
    if name in BVH_BUILDERS:
        scenes = [wrt.Scene(meshes(), wrt.Bvh(builder=name, width=w), device="cpu") for w in (2, 8)]
    elif name in KDTREE_BUILDERS:
        scenes = [wrt.Scene(meshes(), wrt.KdTree(builder=name, width=w), device="cpu") for w in (1, 8)]
    else:
        faces = np.tile([[0, 1, 2]], (1 if name == "one triangle" else 200, 1))
        mesh = wrt.TriangleMesh(np.eye(3, dtype=np.float32), faces)
        scenes = [wrt.Scene(mesh, kind, device="cpu") for kind in ("bvh", "kdtree")]
    for scene in scenes:
        check_tree(scene.tree, scene.triangle_count)


@pytest.mark.skipif(len(DEVICES) < 2, reason="needs CUDA")
def test_between_devices(tmp_path):
    scene = wrt.Scene(meshes(), device="cpu")
    scene.save(tmp_path / "scene")
    other = wrt.Scene.load(tmp_path / "scene", device=DEVICES[1])
    rays = mixed_rays(wrt.TriangleMesh.concatenate(scene.meshes), 1000)
    assert_same_hits(scene.intersect(*rays), other.intersect(*rays))


@pytest.mark.parametrize(
    "accelerator",
    [
        wrt.KdTree(builder="lazy"),
        wrt.known_rays.RayAwareBvh(
            areas=[wrt.known_rays.PointInfluenceArea(position=(0, -9, 4), direction=(0, 9, -3), fov=(40, 40), near=0.1, far=20)]
        ),
    ],
    ids=["lazy", "areas"],
)
def test_trees_that_are_not_kept(accelerator, tmp_path):
    """They are refused by files, and built again behind a pickle and beside a folder."""
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, accelerator, device="cpu", cache=tmp_path)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="cannot be saved"):
        scene.save(tmp_path / "scene.npz")
    rays = mixed_rays(mesh, 2000)
    revived = pickle.loads(pickle.dumps(scene))
    assert revived.accelerator == accelerator
    assert_same_hits(revived.intersect(*rays), scene.intersect(*rays))


def test_archives_are_read_by_many_threads(tmp_path):
    """Python's parser, which reads the headers of arrays, counts its depth for all threads together (CPython 3.11.7): where a
    collection of garbage let another thread in, a load failed with a SystemError, once in 9,000."""
    path = tmp_path / "arrays.npz"
    write_archive(path, {f"array {number}": np.full((2, 2), number) for number in range(6)})
    thresholds, errors = gc.get_threshold(), []

    def let_others_in(phase: str, info: dict) -> None:
        time.sleep(0)

    def read() -> None:
        try:
            for _ in range(100):
                assert len(read_archive(path)) == 6
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=read) for _ in range(4)]
    gc.callbacks.append(let_others_in)
    gc.set_threshold(1, 1, 1)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        gc.set_threshold(*thresholds)
        gc.callbacks.remove(let_others_in)
    assert not errors


def test_arrays_begin_at_cache_lines(tmp_path):
    """Parts of scenes are mapped into memory, and kernels read vectors there."""
    arrays = {"a" * length: np.arange(length + 3, dtype=np.float32) for length in range(1, 9)}
    write_archive(tmp_path / "file.npz", arrays)
    assert all(place.offset % ALIGNED == 0 for place in array_places(tmp_path / "file.npz").values())
    with np.load(tmp_path / "file.npz") as stored:
        assert all(np.array_equal(stored[name], array) for name, array in arrays.items())
