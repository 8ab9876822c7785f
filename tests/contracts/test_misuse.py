"""What callers do that they should not: each is answered by an error that helps, or works, and nothing crashes."""

from __future__ import annotations

import errno
import io
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.query.verification import FALSE_HIT, Fault
from wrt.scene.archives import CHECKSUM, checksum

TEAPOT = wrt.scenes.build("teapot", level=2)


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(TEAPOT, device="cpu")


def rays(count: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """From around the teapot to its middle."""
    origins = TEAPOT.center + TEAPOT.extent * np.random.default_rng(0).normal(size=(count, 3))
    return origins.astype(np.float32), (TEAPOT.center - origins).astype(np.float32)


# -- arrays that change ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 5000])
def test_writing_into_faces_and_vertices_afterwards(count):
    """Kernels follow `faces` unchecked: a caller that wrote 2^30 into its own array made the process crash."""
    vertices, faces = TEAPOT.vertices.astype(np.float32), TEAPOT.faces.copy()
    mesh = wrt.TriangleMesh(vertices, faces)
    scene = wrt.Scene(mesh, device="cpu")
    expected = scene.intersect(*rays(count)).normal
    faces[:] = 1 << 30
    vertices[:] = np.nan
    hits = scene.intersect(*rays(count))
    np.testing.assert_array_equal(hits.normal, expected)
    np.testing.assert_array_equal(mesh.faces, TEAPOT.faces)
    assert scene.verify(samples=40).ok


def test_arrays_of_a_mesh_stay_read_only():
    """Setting the flag back is refused by NumPy, also after a pickle."""
    for mesh in (TEAPOT, pickle.loads(pickle.dumps(TEAPOT)), TEAPOT.transformed(np.eye(4))):
        for array in (mesh.vertices, mesh.faces, mesh.bounds):
            with pytest.raises(ValueError, match="cannot set WRITEABLE flag"):
                array.flags.writeable = True


def test_one_copy_is_shared():
    """By meshes that are made of one another and, on the CPU, by what kernels read."""
    mesh = wrt.TriangleMesh(TEAPOT.vertices, TEAPOT.faces)
    assert np.shares_memory(mesh.faces, TEAPOT.faces)
    scene = wrt.Scene(mesh, device="cpu")
    assert np.shares_memory(scene.state.device_mesh.faces.numpy(), TEAPOT.faces)
    scene.update(0, vertices=mesh.vertices + 1)
    assert np.shares_memory(scene.meshes[0].faces, TEAPOT.faces)


# -- hits of other scenes, and in pickles ------------------------------------------------------------------------------


def test_hits_of_another_scene_are_refused(scene):
    """It was enough that the numbers of triangles were the same."""
    wider = wrt.Scene(TEAPOT.transformed(np.diag([2, 2, 2, 1.0])), device="cpu")
    foreign = wider.intersect(*rays())
    with pytest.raises(ValueError, match="hits of another scene"):
        scene.occluded(*rays(), skip=foreign)
    with pytest.raises(ValueError, match="hits belong to another scene"):
        wrt.device.differentiable_hits(scene, foreign, *rays())
    twin = wrt.Scene(TEAPOT, "kdtree", device="cpu")
    scene.occluded(*rays(), skip=twin.intersect(*rays()))  # the same triangles in the same places
    own = twin.intersect(*rays())
    twin.update(0, vertices=TEAPOT.vertices * 1.1)
    twin.occluded(*rays(), skip=own)  # from before an update
    with pytest.raises(ValueError, match="hits of another scene"):
        twin.occluded(*rays(), skip=scene.intersect(*rays()))


@pytest.mark.parametrize("count", [3, 5000])
@pytest.mark.parametrize("kind", [np.ndarray, wp.array])
@pytest.mark.parametrize("options", [{}, {"counters": True}, {"precise": True}], ids=str)
def test_hits_are_pickled(scene, count, kind, options):
    given = rays(count)
    if kind is wp.array:
        given = [wp.array(values, dtype=wp.vec3, device="cpu") for values in given]
    hits = scene.intersect(*given, **options)
    revived = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(hits))))
    for name in ("t", "primitive_id", "geometry_id", "instance_id", "uv", "is_hit", "position", "normal"):
        assert_equal(getattr(revived, name), getattr(hits, name))
    assert (revived.plan, revived.shape) == (hits.plan, hits.shape)
    np.testing.assert_array_equal(scene.occluded(*rays(count), skip=revived), scene.occluded(*rays(count), skip=hits))
    there = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(there.occluded(*rays(count), skip=revived), scene.occluded(*rays(count), skip=hits))
    if options == {"counters": True}:
        np.testing.assert_array_equal(revived.counters["nodes"], hits.counters["nodes"])
    else:
        with pytest.raises(ValueError, match="no counters were recorded"):
            _ = revived.counters
    with pytest.raises(ValueError, match="call spawn before pickling"):
        revived.spawn([0, 0, 1])


def test_lists_of_hits_are_pickled(scene):
    for some in (scene, wrt.Scene([wrt.Instance(TEAPOT), wrt.Instance(TEAPOT, np.diag([2, 2, 2, 1.0]))], device="cpu")):
        lists = some.intersect_all(*rays(30))
        revived = pickle.loads(pickle.dumps(lists))
        for name in (
            "offsets",
            "count",
            "ray_id",
            "t",
            "primitive_id",
            "geometry_id",
            "instance_id",
            "uv",
            "position",
            "normal",
        ):
            assert_equal(getattr(revived, name), getattr(lists, name))


def assert_equal(values, expected) -> None:
    assert type(values) is type(expected)
    assert (values.dtype, values.shape) == (expected.dtype, expected.shape)
    if isinstance(values, wp.array):
        values, expected = values.numpy(), expected.numpy()
    np.testing.assert_array_equal(values, expected)


# -- files -------------------------------------------------------------------------------------------------------------


def test_a_forged_scene_is_refused(scene, tmp_path):
    """Boxes that were halved under a valid archive gave wrong answers; every array counts."""
    scene.save(tmp_path / "scene.npz")
    arrays = dict(np.load(tmp_path / "scene.npz"))
    for name in arrays.keys() - {CHECKSUM, "wrt"}:
        forged = arrays[name].copy().reshape(-1)
        if forged.dtype.kind in "fi":
            forged[0] += 1
            np.savez(tmp_path / "forged.npz", **arrays | {name: forged.reshape(arrays[name].shape)})
            with pytest.raises(ValueError, match="its checksum does not match its arrays"):
                wrt.Scene.load(tmp_path / "forged.npz")
    np.savez(tmp_path / "without.npz", **{name: array for name, array in arrays.items() if name != CHECKSUM})
    with pytest.raises(ValueError, match="its checksum does not match its arrays"):
        wrt.Scene.load(tmp_path / "without.npz")


def test_what_an_archive_declares_is_checked_first(scene, tmp_path):
    """A header of 128 bytes that names terabytes was a MemoryError, one that names more than 2^63 elements an OverflowError."""
    scene.save(tmp_path / "scene.npz")
    for number, shape in enumerate([(10**12, 3), (10**25, 3), (5 * 10**8, 3), (-1, -3), (0, 3)]):
        path = tmp_path / f"{number}.npz"
        with zipfile.ZipFile(tmp_path / "scene.npz") as archive, zipfile.ZipFile(path, "w") as forged:
            for name in archive.namelist():
                content = archive.read(name)
                if name == "vertices.0.npy":
                    header = io.BytesIO()
                    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
                    content = header.getvalue() + content[128:]
                forged.writestr(name, content)
        with pytest.raises(ValueError, match="which does not match its size"):
            wrt.Scene.load(path)
    arrays = dict(np.load(tmp_path / "scene.npz"))
    np.savez_compressed(tmp_path / "bomb.npz", **arrays | {"tree.bounds": np.zeros(10**7)})
    with pytest.raises(ValueError, match="compressed, or larger than the file"):
        wrt.Scene.load(tmp_path / "bomb.npz")


def test_saving_follows_links_and_replaces_files_only(scene, tmp_path):
    """`Scene.save` put a file in the place of a pipe, of a link, and would have of a device."""
    target, link = tmp_path / "target.npz", tmp_path / "link.npz"
    link.symlink_to(target)
    scene.save(link)
    assert link.is_symlink()
    assert wrt.Scene.load(target, device="cpu").triangle_count == scene.triangle_count
    target.chmod(0o640)
    scene.save(link)
    assert target.stat().st_mode & 0o777 == 0o640
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path(os.devnull), tmp_path):
        with pytest.raises(ValueError, match="not a regular file"):
            scene.save(path)
    assert (tmp_path / "pipe").is_fifo()
    assert Path(os.devnull).is_char_device()
    assert len(list(tmp_path.iterdir())) == 3


def test_a_cache_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("text")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ValueError, match=r"cache must be the path of a folder, and '.*file' is a file"):
            wrt.Scene(TEAPOT, cache=path, device="cpu")


def test_a_full_disk_does_not_lose_the_tree(tmp_path, monkeypatch):
    def full(path, arrays):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("wrt.scene.storage.write_archive", full)
    with pytest.warns(UserWarning, match="the tree is not cached"):
        assert wrt.Scene(TEAPOT, cache=tmp_path, device="cpu").intersect(*rays()).is_hit.any()


# -- messages ----------------------------------------------------------------------------------------------------------


def test_more_rays_than_kernels_can_number(scene):
    many = np.broadcast_to(np.float32([0, 0, 1]), (1 << 16, 1 << 16, 3))
    for query in (scene.intersect, scene.occluded, scene.count, scene.intersect_all):
        with pytest.raises(ValueError, match=r"these are 4,294,967,296 rays, .*intersect_blocks"):
            query(many, many)
    with pytest.raises(ValueError, match="4,294,967,296 rays"):
        scene.contains(many)
    with pytest.raises(ValueError, match="2,147,483,648 rays"):
        scene.occluded([0, 0, 1], [0, 0, 1], t_max=np.broadcast_to(np.float32(1), 1 << 31))
    with pytest.raises(ValueError, match="4,294,967,296 rays"):  # before memory is taken for them
        scene.intersect(np.zeros((1 << 16, 1, 3), np.float32), np.ones((1, 1 << 16, 3), np.float32))


def test_numbers_that_no_float_holds(scene):
    for name in ("t_min", "t_max"):
        for number in (10**400, -(10**400)):
            with pytest.raises(ValueError, match=f"{name} is an int beyond the range of float64"):
                scene.intersect(*rays(), **{name: number})


def test_blocks_of_rays_that_do_not_broadcast(scene):
    origins, directions = rays()
    with pytest.raises(ValueError, match=r"do not broadcast: origins \(50,\), directions \(3,\)"):
        scene.intersect_blocks(origins, directions[:3])


def test_lists_that_contain_themselves(scene):
    endless: list = []
    endless.append(endless)
    for kind in (wrt.Scene, wrt.moving.GroupedScene, wrt.moving.InstancedScene):
        with pytest.raises(ValueError, match="contains itself"):
            kind(endless)
    with pytest.raises(TypeError, match="origins is not an array"):
        scene.intersect(endless, endless)
    with pytest.raises(TypeError, match="skip is not an array"):
        scene.intersect(*rays(), skip=endless)
    with pytest.raises(TypeError, match="image is not an array"):
        wrt.save_image("never.png", endless)
    twice = [TEAPOT]
    assert len(wrt.Scene([twice, twice], device="cpu").meshes) == 2


def test_ids_are_no_picture(scene, tmp_path):
    hits = scene.intersect(*rays())
    with pytest.raises(TypeError, match="give each a colour"):
        wrt.save_image(tmp_path / "ids.png", hits.primitive_id.reshape(5, 10))
    with pytest.raises(TypeError, match=r"np\.uint8\(255\)"):
        wrt.save_image(tmp_path / "mask.png", hits.is_hit.reshape(5, 10))
    wrt.save_image(tmp_path / "ids.npy", hits.primitive_id.reshape(5, 10))
    np.testing.assert_array_equal(np.load(tmp_path / "ids.npy").reshape(-1), hits.primitive_id)


def test_a_fault_says_where_its_triangle_was_hit():
    """It read "false hit: triangle 65035 instead of 65035"."""
    fault = Fault(FALSE_HIT, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 65035, 65035, 1.5, 1.25)
    assert str(fault).startswith("false hit: triangle 65035 at t = 1.5 instead of triangle 65035 at t = 1.25, origin")
    assert "nothing instead of triangle 3" in str(Fault("miss", (0.0,), (1.0,), -1, 3, np.inf, 1.0))


def run(code: str, folder: Path, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "import warp as wp; wp.config.log_level = wp.LOG_WARNING\n" + code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=os.environ | environment, check=False)


def test_kernels_that_cannot_be_kept(tmp_path):
    """A kernel cache that is not writable: one line says so and names the variable, and the process goes on."""
    (tmp_path / "file").write_text("")
    code = (
        "from wrt.kernels.runtime.launch import as_device\n"  # every scene starts Warp by it
        "print(as_device('cpu'), as_device('cpu'), wp.config.kernel_cache_dir)\n"
    )
    done = run(code, tmp_path, WARP_CACHE_PATH=str(tmp_path / "file" / "cache"))
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("compiled kernels cannot be kept") == 1
    assert "Set WARP_CACHE_PATH" in done.stderr
    folder = Path(done.stdout.split()[-1])
    assert "wrt-kernels-" in str(folder)
    assert not folder.exists()


def test_a_kernel_cache_that_runs_full(monkeypatch, capfd):
    """Compiling fails with whatever the system says; then a folder of the process's own is taken, and it works."""
    from wrt.kernels.compilation import kernel_cache as cache

    class Module:
        modified = False

        def load(self, device, block_dim):
            if not self.modified:
                raise RuntimeError("clang says something about a file")

        def mark_modified(self):
            self.modified = True

    monkeypatch.setattr(wp.config, "kernel_cache_dir", wp.config.kernel_cache_dir)
    with pytest.raises(RuntimeError, match="clang"):
        cache.load_module(Module(), None, 1)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(cache, "find_fault", lambda folder, wait=True: full if wait else None)  # since it was looked at
    cache.load_module(Module(), None, 1)
    assert "wrt-kernels-" in wp.config.kernel_cache_dir
    assert "No space left" in capfd.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="memory is bound by a limit that Linux has")
def test_too_little_memory_for_a_tree(tmp_path):
    code = (
        "import support.environment, resource, numpy as np, wrt\n"
        "n = 1_000_000\n"
        "corners = np.random.default_rng(0).random((3 * n, 3), dtype=np.float32)\n"
        "faces = np.arange(3 * n, dtype=np.int32).reshape(-1, 3)\n"
        "mesh = wrt.TriangleMesh(corners, faces)\n"
        "wrt.Scene(wrt.TriangleMesh(corners, faces[::10]), device='cpu')  # a compiler that lacks memory ends the process\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 120_000_000,) * 2)\n"
        "try:\n"
        "    wrt.Scene(mesh, device='cpu')\n"
        "except MemoryError as error:\n"
        "    print(error)\n"
    )
    done = run(code, tmp_path, PYTHONPATH=str(Path(__file__).parents[1]))
    assert "too little memory for the tree of 1,000,000 triangles, which take 48.0 MB themselves" in done.stdout, done.stderr


def test_checksums_tell_names_types_and_shapes_apart():
    array = np.arange(6, dtype=np.int32)
    others = [{"b": array}, {"a": array.view(np.float32)}, {"a": array.reshape(2, 3)}, {"a": array[:5]}, {"a": array + 1}]
    assert checksum({"a": array}) not in {checksum(other) for other in others}
    assert checksum({"a": array}) == checksum({CHECKSUM: array, "a": np.repeat(array, 2)[::2]})
