"""Job folders of strangers, edited ones, and ones on a full disk: nothing outside is touched, nothing wrong is taken."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from wrt.cluster.job_folder import JobFolder
from wrt.cluster.job_manifest import FORMAT, signed
from wrt.query.blocks import BYTES_PER_RAY
from wrt.scene.archives import read_archive, write_archive

COUNT = 3000
ROWS = 250
MEMORY = ROWS * BYTES_PER_RAY
PRECIOUS = b"years of work"


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.meshes[0], COUNT, seed=4)


@pytest.fixture(scope="module")
def complete(scene, rays, tmp_path_factory) -> Path:
    """The folder of a complete job."""
    folder = tmp_path_factory.mktemp("jobs") / "job"
    wrt.cluster.Job(folder, scene.occluded_blocks(*rays, memory=MEMORY)).run()
    return folder


@pytest.fixture
def folder(complete, tmp_path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(complete, tmp_path / "job"))


def made(scene: wrt.Scene, rays: tuple[np.ndarray, np.ndarray], folder: Path) -> wrt.cluster.Job:
    return wrt.cluster.Job(folder, scene.occluded_blocks(*rays, memory=MEMORY))


@pytest.mark.parametrize("kind", ["link", "hard link", "link to nothing", "other contents"])
def test_the_lock_of_a_stranger_empties_no_file(scene, rays, folder, tmp_path, kind):
    """`lock` as a symbolic link: its target was emptied, and then held the client's name."""
    target, lock = tmp_path / "thesis", folder / "lock"
    lock.unlink()
    if kind != "link to nothing":
        target.write_bytes(PRECIOUS)
    if kind == "hard link":
        os.link(target, lock)
    elif kind == "other contents":
        shutil.copy(target, lock)
    else:
        lock.symlink_to(target)
    (folder / "chunks" / "0000" / "0000003.npz").unlink()
    job = made(scene, rays, folder)
    with pytest.raises(ValueError, match=r"lock' is (a symbolic link|not the lock of a job)"):
        job.run()
    if kind == "link to nothing":
        assert not target.exists()
    else:
        assert target.read_bytes() == PRECIOUS
    if "link" in kind and kind != "hard link":
        with pytest.raises(ValueError, match="is a symbolic link"):
            wrt.cluster.job_status(folder)
    if kind == "other contents":  # also where there is no job yet
        (tmp_path / "mine").mkdir()
        shutil.copy(target, tmp_path / "mine" / "lock")
        with pytest.raises(ValueError, match="not the lock of a job"):
            made(scene, rays, tmp_path / "mine")
        assert (tmp_path / "mine" / "lock").read_bytes() == PRECIOUS


@pytest.mark.parametrize("name", ["manifest.json", "chunks", "chunks/0000", "chunks/0000/0000003.npz"])
def test_no_link_in_a_folder_is_followed(scene, rays, folder, tmp_path, name):
    """Answers were written, and leftovers removed, wherever `chunks` pointed to."""
    elsewhere, path = tmp_path / "elsewhere", folder / name
    shutil.move(path, elsewhere)
    path.symlink_to(elsewhere)
    before = {one: one.stat().st_mtime_ns for one in (elsewhere, *elsewhere.rglob("*"))}
    with pytest.raises(ValueError, match=r"is a (symbolic )?link"):
        made(scene, rays, folder).run().result()
    with pytest.raises(ValueError, match=r"is a (symbolic )?link"):
        wrt.cluster.job_status(folder)
    assert {one: one.stat().st_mtime_ns for one in (elsewhere, *elsewhere.rglob("*"))} == before
    place = JobFolder(folder)
    if name != "manifest.json":
        with pytest.raises(ValueError, match="is a symbolic link"):
            place.write_chunk(3, "label", {"a": np.zeros(1)})
        with pytest.raises(ValueError, match="is a symbolic link"):
            place.read_chunk(3, "label")
        assert {one: one.stat().st_mtime_ns for one in (elsewhere, *elsewhere.rglob("*"))} == before


def test_a_manifest_that_points_nowhere_is_not_made(scene, rays, tmp_path):
    """It was written to where the link pointed."""
    (tmp_path / "job").mkdir()
    (tmp_path / "job" / "manifest.json").symlink_to(tmp_path / "planted")
    with pytest.raises(ValueError, match="is a symbolic link"):
        made(scene, rays, tmp_path / "job")
    assert not (tmp_path / "planted").exists()


@pytest.mark.parametrize("name", ["manifest.json", "lock", "chunks/0000/0000003.npz"])
def test_pipes_are_not_waited_for(scene, rays, folder, name):
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(ValueError, match=r"not a regular file|no regular file"):
        made(scene, rays, folder).run().result()
    with pytest.raises(ValueError, match=r"not a regular file|no regular file"):
        wrt.cluster.job_status(folder)


def test_a_file_in_place_of_a_folder(scene, rays, folder):
    shutil.rmtree(folder / "chunks")
    (folder / "chunks").write_text("no folder")
    with pytest.raises(ValueError, match="chunks' is not a folder"):
        made(scene, rays, folder).run()


MANIFESTS = {
    "no JSON": lambda one: "{",
    "not an object": lambda one: "[]",
    "nested": lambda one: "[" * 100_000,
    "other bytes": lambda one: b"\xff\xfe\x00",
    "empty": lambda one: "",
    "no rows": lambda one: {key: value for key, value in one.items() if key != "rows"},
    "other rows": lambda one: {**one, "rows": 500},
    "other rows, signed": lambda one: signed({**fields(one), "rows": 500}),
    "no rows at all": lambda one: signed({**fields(one), "rows": 0}),
    "half a row": lambda one: signed({**fields(one), "rows": 2.5}),
    "true rows": lambda one: signed({**fields(one), "rows": True}),
    "text": lambda one: signed({**fields(one), "rows": "250"}),
    "infinite": lambda one: signed({**fields(one), "rows": float("inf")}),
    "huge": lambda one: signed({**fields(one), "rows": 10**30}),
    "negative shape": lambda one: signed({**fields(one), "shape": [-1]}),
    "no shape": lambda one: signed({**fields(one), "shape": []}),
    "huge shape": lambda one: signed({**fields(one), "shape": [1 << 40, 1 << 40]}),
    "another query": lambda one: signed({**fields(one), "query": "visible"}),
    "an id of another kind": lambda one: signed({**fields(one), "id": "../../x"}),
    "scene of another kind": lambda one: signed({**fields(one), "scene": 3}),
    "options of another kind": lambda one: signed({**fields(one), "options": None}),
    "answers of another kind": lambda one: signed({**fields(one), "answers": "1"}),
    "earlier format": lambda one: {**one, "format": 2},
    "later format": lambda one: {**one, "format": [99]},
}


def fields(manifest: dict) -> dict:
    return {name: value for name, value in manifest.items() if name not in ("format", "checksum")}


@pytest.mark.parametrize("kind", MANIFESTS)
def test_manifests_that_were_edited_are_refused(scene, rays, folder, kind):
    """With other `rows`, the answers of blocks were taken for those of other rows."""
    path = folder / "manifest.json"
    changed = MANIFESTS[kind](json.loads(path.read_text()))
    if isinstance(changed, bytes):
        path.write_bytes(changed)
    else:
        path.write_text(changed if isinstance(changed, str) else json.dumps(changed))
    with pytest.raises(ValueError, match=r"manifest of the job .* cannot be read|begun with other rays"):
        made(scene, rays, folder).run().result()
    if kind != "other rows, signed":
        with pytest.raises(ValueError, match=r"manifest of the job .* cannot be read"):
            wrt.cluster.job_status(folder)


def test_formats():
    assert FORMAT == 3


@pytest.mark.parametrize(
    "name",
    [
        "0000/0000001 (copy).npz",
        "0000/0000012.npz",
        "0000/1.npz",
        "0001/0000001.npz",
        "0000/-000001.npz",
        "0000/\u0660000001.npz",
    ],
)
def test_archives_that_are_no_blocks_are_refused(scene, rays, folder, name):
    """A copy of a file ended in a message about `int()`; one beyond the job stood in for a block that was missing."""
    (folder / "chunks" / name).parent.mkdir(exist_ok=True)
    shutil.copy(folder / "chunks" / "0000" / "0000001.npz", folder / "chunks" / name)
    (folder / "chunks" / "0000" / "0000003.npz").unlink()
    job = made(scene, rays, folder)
    for call in (job.run, job.result, lambda: job.status):
        with pytest.raises(ValueError, match="is not the answer of a block of this job, which has blocks 0 to 11"):
            call()
    (folder / "chunks" / name).unlink()
    (folder / "chunks" / "0000" / ".DS_Store").touch()
    (folder / "chunks" / "0000" / "notes.txt").touch()
    np.testing.assert_array_equal(job.run().result(), scene.occluded(*rays))


def test_answers_of_another_form_are_computed_again(scene, rays, folder):
    """Of other rows, of no form that a job writes, or compressed: whatever their checksum says."""
    job, expected = made(scene, rays, folder), scene.occluded(*rays)
    path = job.folder.chunk_path
    arrays = read_archive(path(2))
    write_archive(path(2), arrays | {"array.0": arrays["array.0"][:-1]})
    write_archive(path(3), arrays)  # of block 2
    write_archive(path(4), read_archive(path(4)) | {"structure": np.array("{}")})
    write_archive(path(5), read_archive(path(5)) | {"structure": np.array("[" * 100_000)})
    write_archive(path(6), read_archive(path(6)) | {"rays_hash": np.array("0" * 64)})
    write_archive(path(7), read_archive(path(7)) | {"structure": np.array('{"array": "array.9"}')})
    with path(8).open("wb") as file:
        np.savez_compressed(file, **arrays)
    before = {number: path(number).stat().st_mtime_ns for number in range(12)}
    np.testing.assert_array_equal(job.result(), expected)
    assert [number for number in range(12) if path(number).stat().st_mtime_ns != before[number]] == [2, 3, 4, 5, 6, 7, 8]


def test_a_full_disk(scene, rays, tmp_path):
    """The error says so, what was there before stays, nothing half-written is left, and the job goes on afterwards."""
    small_files = pytest.importorskip("support.small_files", reason="only POSIX limits the size of files").small_files
    job = made(scene, rays, tmp_path / "job").run(most=3)
    before = {one: one.read_bytes() for one in (tmp_path / "job" / "chunks").rglob("*.npz")}
    with small_files(500), pytest.raises(OSError, match=r"0000003\.npz") as caught:  # a chunk has more
        job.run()
    with small_files(100), pytest.raises(OSError, match=r"manifest\.json"):
        made(scene, rays, tmp_path / "other")
    assert caught.value.errno == errno.EFBIG
    assert {one: one.read_bytes() for one in (tmp_path / "job" / "chunks").rglob("*") if one.is_file()} == before
    assert [one.name for one in (tmp_path / "other").iterdir()] == ["lock"]
    np.testing.assert_array_equal(job.run().result(), scene.occluded(*rays))
    np.testing.assert_array_equal(made(scene, rays, tmp_path / "other").run().result(), scene.occluded(*rays))
