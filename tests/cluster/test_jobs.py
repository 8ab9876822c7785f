"""Jobs in folders: killed anywhere they go on, nothing is computed twice or lost, and nothing else is taken for theirs."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
import warp as wp
from click.testing import CliRunner
from support.hits import mixed_rays

import wrt
from wrt.cli import main
from wrt.cluster.job_folder import JobFolder
from wrt.cluster.stored_answers import pack_answer, unpack_answer
from wrt.query.batches.exact_sums import exact_sum
from wrt.query.blocks import BYTES_PER_RAY

COUNT = 3000
ROWS = 250
MEMORY = ROWS * BYTES_PER_RAY


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.meshes[0], COUNT, seed=4)


class Noted:
    """Rays that note in a file which rows were asked for, and take their time."""

    def __init__(self, path: str, rays: tuple[np.ndarray, np.ndarray], seconds: float = 0.0):
        self.path, self.rays, self.seconds = path, rays, seconds

    def __call__(self, first: int, count: int):
        if count == ROWS:  # a block, not a sample for the hash
            with open(self.path, "a") as file:
                file.write(f"{first}\n")
            sleep(self.seconds)
        return self.rays[0][first : first + count], self.rays[1][first : first + count]

    @property
    def asked(self) -> list[int]:
        return [int(line) for line in Path(self.path).read_text().split()]


@pytest.fixture
def noted(rays, tmp_path) -> Noted:
    return Noted(str(tmp_path / "asked"), rays)


def test_a_job_is_computed_once(scene, rays, noted, tmp_path):
    """In any number of runs, and with another bound on memory, which blocks keep to that they began with."""
    generated = wrt.batches.GeneratedRays(noted, COUNT)
    job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(generated, memory=MEMORY))
    with pytest.raises(RuntimeError, match=r"12 blocks .* call run"):
        job.result()
    assert not job.status.is_complete
    expected = scene.occluded(*rays)
    np.testing.assert_array_equal(job.run().result(), expected)
    again = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(generated, memory="1 GB")).run()
    np.testing.assert_array_equal(again.result(), expected)
    out = np.zeros(COUNT, dtype=bool)
    assert again.write(out) == COUNT
    np.testing.assert_array_equal(out, expected)
    assert sorted(noted.asked) == list(range(0, COUNT, ROWS))
    status = again.status
    assert status.is_complete
    assert (status.done, status.blocks, status.rays, status.rays_done) == (12, 12, COUNT, COUNT)
    assert status.bytes > COUNT
    assert not status.is_running


def test_reductions_and_attributes(scene, rays, tmp_path):
    """States of merged reductions are kept by block; of hits, the attributes that were asked for."""
    reduce = {"t": "sum", "uv": "max", "is_hit": "mean", "primitive_id": wrt.batches.Histogram([-1, 0, 10_000])}
    blocks = scene.intersect_blocks(*rays, t_max=9.0, memory=MEMORY, reduce=reduce)
    expected = scene.intersect_blocks(*rays, t_max=9.0, reduce=reduce).result()
    for _ in range(2):
        result = wrt.cluster.Job(tmp_path / "sums", blocks).run().result()
        assert result.keys() == expected.keys()
        for name in reduce:
            np.testing.assert_array_equal(result[name], expected[name])
    hits = scene.intersect(*rays)
    job = wrt.cluster.Job(tmp_path / "hits", scene.intersect_blocks(*rays, memory=MEMORY), attributes=["t", "normal"]).run()
    assert job.result().keys() == {"t", "normal"}
    np.testing.assert_array_equal(job.result()["normal"], hits.normal)
    t = np.zeros(COUNT)
    job.write({"t": t})
    np.testing.assert_array_equal(t, hits.t)
    default = wrt.cluster.Job(tmp_path / "default", scene.intersect_blocks(*rays)).run().result()
    assert default.keys() == {"t", "primitive_id", "geometry_id"}


def test_states_are_stored_without_pickles():
    values = np.float64([1e300, 1e-300, 3.0])
    states = {
        "sum": exact_sum(values, (0,)) + exact_sum(-values, (0,)),
        "rows": (exact_sum(values[:, None], (1,)), 3),
        "n": 2.5,
    }
    arrays = pack_answer(states)
    assert all(not array.dtype.hasobject for array in arrays.values())
    found = unpack_answer(arrays)
    assert found["sum"].rounded() == 0.0
    np.testing.assert_array_equal(found["rows"][0].rounded(), values)
    assert (found["rows"][1], found["n"]) == (3, 2.5)
    with pytest.raises(TypeError, match="set"):
        pack_answer({"a": {1}})


def test_a_damaged_chunk_is_computed_again(scene, noted, tmp_path):
    """Whatever happened to it: cut short, of another job, another block, or gone."""
    blocks = scene.occluded_blocks(wrt.batches.GeneratedRays(noted, COUNT), memory=MEMORY)
    job = wrt.cluster.Job(tmp_path / "job", blocks).run()
    expected = job.result()
    other = wrt.cluster.Job(tmp_path / "other", blocks).run()
    Path(noted.path).unlink()
    job.folder.chunk_path(3).write_bytes(job.folder.chunk_path(3).read_bytes()[:-40])
    shutil.copy(other.folder.chunk_path(4), job.folder.chunk_path(4))
    shutil.copy(job.folder.chunk_path(6), job.folder.chunk_path(5))
    flipped = bytearray(job.folder.chunk_path(7).read_bytes())
    flipped[len(flipped) // 2] ^= 4
    job.folder.chunk_path(7).write_bytes(flipped)
    np.testing.assert_array_equal(job.result(), expected)
    assert noted.asked == [750, 1000, 1250, 1750]
    job.folder.chunk_path(11).unlink()
    with pytest.raises(RuntimeError, match="1 blocks"):
        job.result()
    np.testing.assert_array_equal(job.run().result(), expected)


def test_a_changed_job_is_refused(scene, rays, tmp_path):
    origins, directions = rays
    wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, memory=MEMORY, reduce="sum"))
    moved = wrt.Scene(wrt.TriangleMesh(scene.meshes[0].vertices + np.float32(1e-3), scene.meshes[0].faces), device="cpu")
    turned = directions.copy()
    turned[COUNT - 1] += 1.0
    for name, blocks in (
        ("scene", moved.occluded_blocks(*rays, reduce="sum")),
        ("scene", wrt.Scene(scene.meshes[0], triangle_test="moeller_trumbore").occluded_blocks(*rays, reduce="sum")),
        ("rays", scene.occluded_blocks(origins, turned, reduce="sum")),
        ("rays", scene.occluded_blocks(*rays, t_max=3.0, reduce="sum")),
        ("rays", scene.occluded_blocks(*rays, skip=np.full(COUNT, 3), reduce="sum")),
        ("query", scene.count_blocks(*rays, reduce="sum")),
        ("options", scene.occluded_blocks(*rays, reduce="mean")),
        ("options", scene.occluded_blocks(*rays, reduce=lambda dark, axes: dark, axis=0)),
        ("options", scene.occluded_blocks(*rays)),
        ("rays", scene.occluded_blocks(origins[:-1], directions[:-1], reduce="sum")),
    ):
        with pytest.raises(ValueError, match=f"{name}"):
            wrt.cluster.Job(tmp_path / "job", blocks)
    other_tree = wrt.Scene(scene.meshes[0], "kdtree", device="cpu")
    wrt.cluster.Job(tmp_path / "job", other_tree.occluded_blocks(*rays, reduce="sum"))


def test_refused(scene, rays, tmp_path):
    with pytest.raises(ValueError, match="GeneratedRays"):
        wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(iter([rays])))
    with pytest.raises(ValueError, match="'depth'; choose from t"):
        wrt.cluster.Job(tmp_path / "job", scene.intersect_blocks(*rays), attributes=["depth"])
    with pytest.raises(ValueError, match="leave it out"):
        wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays), attributes=["t"])
    assert not (tmp_path / "job").exists()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    with pytest.raises(ValueError, match=r"holds thesis.txt and no job"):
        wrt.cluster.Job(tmp_path / "full", scene.occluded_blocks(*rays))
    with pytest.raises(FileNotFoundError, match="no job"):
        wrt.cluster.job_status(tmp_path / "full")
    (tmp_path / "full" / "manifest.json").write_text('{"format": 99}')
    with pytest.raises(ValueError, match="format 99"):
        wrt.cluster.job_status(tmp_path / "full")


def test_two_clients(scene, rays, tmp_path):
    """The second is refused while the first runs, also to mend a damaged block; then it may go on."""
    blocks = scene.occluded_blocks(*rays, memory=MEMORY)
    first, second = (wrt.cluster.Job(tmp_path / "job", blocks) for _ in range(2))
    with first.folder.locked():
        assert second.status.is_running
        with pytest.raises(RuntimeError, match=f"being run by process {os.getpid()} on "):
            second.run()
    assert not second.status.is_running
    second.run()
    first.folder.chunk_path(0).write_bytes(b"damaged")
    with second.folder.locked(), pytest.raises(RuntimeError, match="being run"):
        first.result()
    np.testing.assert_array_equal(first.run().result(), scene.occluded(*rays))


CLIENT = """
import sys
sys.path[:0] = {paths!r}
import warp as wp
wp.config.log_level, wp.config.cpu_compiler_flags = wp.LOG_ERROR, {flags!r}
import numpy as np
import wrt
from tests.cluster.test_jobs import Noted
if __name__ == "__main__":
    scene = wrt.Scene.load({scene!r}, device="cpu")
    rays = np.load({rays!r})
    generated = wrt.batches.GeneratedRays(Noted({asked!r}, (rays[0], rays[1]), 0.1), rays.shape[1])
    with wrt.cluster.ProcessPool(2, threads=1) as pool:
        wrt.cluster.Job({folder!r}, scene.occluded_blocks(generated, memory={memory}, executor=pool)).run()
"""


def wait_until(condition, seconds: float = 120.0) -> None:
    end = monotonic() + seconds
    while not condition():
        assert monotonic() < end, "it took too long"
        sleep(0.01)


def test_a_client_that_is_killed(scene, rays, tmp_path):
    """By SIGKILL, with blocks under way: its lock is free, its processes end, and what was done is not computed again."""
    scene.save(tmp_path / "scene.npz")
    np.save(tmp_path / "rays.npy", np.stack(rays))
    given = {"scene": "scene.npz", "rays": "rays.npy", "asked": "asked", "folder": "job"}
    paths = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]
    code = CLIENT.format(
        paths=paths,
        flags=wp.config.cpu_compiler_flags,
        memory=MEMORY,
        **{key: str(tmp_path / one) for key, one in given.items()},
    )
    (tmp_path / "client.py").write_text(code)
    folder = JobFolder(tmp_path / "job")
    client = subprocess.Popen([sys.executable, str(tmp_path / "client.py")], start_new_session=True)
    try:
        wait_until(lambda: len(folder.done()) >= 3 or client.poll() is not None)
        assert folder.is_running()
        client.send_signal(signal.SIGKILL)
        client.wait()
        wait_until(lambda: not is_alive(client.pid), 10.0)
    finally:
        if is_alive(client.pid):
            os.killpg(client.pid, signal.SIGKILL)
    assert not folder.is_running()
    done = folder.done()
    assert 3 <= len(done) < COUNT // ROWS
    (folder.path / "chunks" / "0000" / ".0000011.npz.half").write_bytes(b"half")
    noted = Noted(str(tmp_path / "asked"), rays)
    before = len(noted.asked)
    job = wrt.cluster.Job(folder.path, scene.occluded_blocks(wrt.batches.GeneratedRays(noted, COUNT), memory=MEMORY))
    assert job.status.done == len(done)
    np.testing.assert_array_equal(job.run().result(), scene.occluded(*rays))
    assert sorted(noted.asked[before:]) == [ROWS * number for number in range(COUNT // ROWS) if number not in done]
    assert not list(folder.path.glob("chunks/*/.*"))


def is_alive(group: int) -> bool:
    """Whether a process of the group is left: the client's or one of its workers'."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


JOB = """
folder = "job"
query = "{query}"
memory = {memory}
[scene]
file = "{scene}"
device = "cpu"
[rays]
{rays}
[reduce]
{reduce}
[executor]
kind = "{executor}"
workers = 2
[output]
file = "{output}"
"""

ARRAYS = 'origins = "origins.npy"\ndirections = "directions.npy"\nouter = true'
FUNCTION = 'function = "rays.py:rays"\nshape = [3000]\nt_max = 5.0'


@pytest.mark.parametrize(
    ("query", "scene_file", "given", "reduce", "executor", "output"),
    [
        ("occluded", "scene.npz", ARRAYS, 'by = "sum"\naxis = 1', "threads", "shaded.npy"),
        ("intersect", "mesh.ply", FUNCTION, 'by = {t = "min", is_hit = "sum"}', "none", "least"),
    ],
)
def test_job_files(scene, rays, tmp_path, query, scene_file, given, reduce, executor, output):
    """`wrt job run` makes what the same call in Python makes, and `wrt job status` says how far it is."""
    scene.save(tmp_path / "scene.npz")
    scene.meshes[0].save(tmp_path / "mesh.ply")
    np.save(tmp_path / "origins.npy", rays[0][:100])
    np.save(tmp_path / "directions.npy", rays[1][:30])
    np.save(tmp_path / "all.npy", np.stack(rays))
    load = f"import numpy as np\nlines = np.load({str(tmp_path / 'all.npy')!r})\n"
    (tmp_path / "rays.py").write_text(load + "def rays(first, count):\n    return tuple(lines[:, first : first + count])\n")
    table = {"query": query, "scene": scene_file, "rays": given, "reduce": reduce, "executor": executor, "output": output}
    text = JOB.format(**table, memory=MEMORY)
    (tmp_path / "job.toml").write_text(text)
    for _ in range(2):
        done = CliRunner().invoke(main, ["job", "run", str(tmp_path / "job.toml")])
        assert done.exit_code == 0, done.output
        assert "blocks, 3,000 of 3,000 rays (100.0%)" in done.output
    if query == "occluded":
        expected = scene.occluded(rays[0][:100, None], rays[1][:30]).sum(axis=1)
        np.testing.assert_array_equal(np.load(tmp_path / "shaded.npy"), expected)
    else:
        hits = wrt.Scene(wrt.TriangleMesh.load(tmp_path / "mesh.ply"), device="cpu").intersect(*rays, t_max=5.0)
        assert np.load(tmp_path / "least" / "t.npy") == hits.t.min()
        assert np.load(tmp_path / "least" / "is_hit.npy") == hits.is_hit.sum()
    JobFolder(tmp_path / "job").chunk_path(2).unlink()
    shown = CliRunner().invoke(main, ["job", "status", str(tmp_path / "job"), "--json"])
    status = json.loads(shown.output)
    assert 10 < status["done"] == status["blocks"] - 1
    shown = CliRunner().invoke(main, ["job", "status", str(tmp_path / "job")])
    assert f"{status['done']} of {status['blocks']} blocks, 2,7{'60' if query == 'occluded' else '50'} of 3,000" in shown.output
    assert "not running" in shown.output


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("folder = ", "not a TOML file"),
        ('folder = "job"\nscnee = 3', "key 'scnee'"),
        ('folder = "job"\n[scene]\nfile = "x.npz"\nfiel = 3', r"key 'fiel' in \[scene\]"),
        ('folder = "job"\nscene = 3', "must be a table"),
        ('[scene]\nfile = "scene.npz"', "needs folder"),
        ('folder = "job"\n[scene]\nfile = "scene.npz"', "origins and directions"),
        ('folder = "job"\n[scene]\nfile = "scene.npz"\n[rays]\nfunction = "no.py:rays"', "a file and a function"),
        ('folder = "job"\n[scene]\nfile = "scene.npz"\n[rays]\norigins = "no.npy"\ndirections = [0, 0, 1]', "no file"),
        (
            'folder = "job"\nquery = "visible"\n[scene]\nfile = "scene.npz"\n[rays]\norigins = [[0, 0, 1]]\n'
            "directions = [0, 0, 1]",
            "query",
        ),
        (
            'folder = "job"\n[scene]\nfile = "scene.npz"\n[rays]\norigins = [[0, 0, 1]]\ndirections = [0, 0, 1]\n'
            '[executor]\nkind = "magic"',
            "choose from none, threads",
        ),
    ],
)
def test_job_files_that_are_wrong(scene, tmp_path, text, message):
    scene.save(tmp_path / "scene.npz")
    (tmp_path / "job.toml").write_text(text)
    from wrt.cluster.job_file import run_job_file

    with pytest.raises((ValueError, FileNotFoundError), match=message):
        run_job_file(tmp_path / "job.toml", False)
    assert not (tmp_path / "job").exists()
