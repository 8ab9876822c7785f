"""What a job is: other scenes, rays, options and versions of functions are refused, whenever they come up; nothing is mixed."""

from __future__ import annotations

import functools
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from wrt.cluster import job_blocks
from wrt.cluster.file_functions import FileFunction
from wrt.cluster.identity import array_hashes, ray_hashes
from wrt.cluster.identity.described import code_of, options_text
from wrt.cluster.identity.scene_hashes import mesh_hash, scene_hash
from wrt.query.batches.block_work import BlockWork
from wrt.query.batches.shared_files import share_scene
from wrt.query.blocks import BYTES_PER_RAY
from wrt.revisions import ANSWER_REVISION

COUNT = 3000
ROWS = 250
MEMORY = ROWS * BYTES_PER_RAY


@pytest.fixture
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


@pytest.fixture(scope="module")
def rays() -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(wrt.scenes.build("teapot", level=4), COUNT, seed=4)


def test_a_scene_that_was_updated_is_refused(scene, rays, tmp_path):
    """Blocks of the old scene and of the new one were mixed, and the job was complete: 2,965 of 4,000 rows were wrong."""
    before, expected = scene.meshes[0].vertices, scene.occluded(*rays)
    job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, memory=MEMORY)).run(most=5)
    scene.update(0, vertices=before * np.float32(1.5))
    with pytest.raises(ValueError, match="the scene has changed since the job"):
        job.run()
    assert job.status.done == 5
    with pytest.raises(ValueError, match="begun with another scene"):
        wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, memory=MEMORY))
    scene.update(0, vertices=before)
    scene.num_threads = 1
    np.testing.assert_array_equal(job.run().result(), expected)


@pytest.mark.parametrize("threads", [0, 2])
def test_a_scene_that_is_updated_meanwhile(scene, rays, tmp_path, threads):
    """By another thread, or by the function that makes the rays: blocks that were written are of the scene as it was."""
    before, expected = scene.meshes[0].vertices, scene.occluded(*rays)

    def updating(first: int, count: int):
        if count == ROWS and first == 4 * ROWS:
            scene.update(0, vertices=before * np.float32(1.5))
        return rays[0][first : first + count], rays[1][first : first + count]

    with ThreadPoolExecutor(max(threads, 1)) as pool:
        options = {"memory": MEMORY, "executor": pool if threads else None}
        job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(wrt.batches.GeneratedRays(updating, COUNT), **options))
        with pytest.raises(ValueError, match="the scene has changed since the job"):
            job.run()
    scene.update(0, vertices=before)
    assert 1 <= job.status.done < COUNT // ROWS
    for number in job.folder.done():
        arrays = job.folder.read_chunk(number, job_blocks.chunk_label(job.manifest, number))
        np.testing.assert_array_equal(arrays["array.0"], expected[number * ROWS : (number + 1) * ROWS])


def test_blocks_of_one_iteration_are_of_one_scene(scene, rays):
    """Also without a job: an update between two blocks changed those that followed."""
    expected, found = scene.occluded(*rays), []
    blocks = scene.occluded_blocks(*rays, memory=MEMORY)
    for _, dark in blocks:
        found.append(dark)
        if len(found) == 3:
            scene.update(0, vertices=scene.meshes[0].vertices * np.float32(1.5))
    np.testing.assert_array_equal(np.concatenate(found), expected)
    assert (blocks.result() != expected).any()


def test_workers_get_the_scene_as_it_is_now(scene, tmp_path):
    """An update keeps the scene's mark, by which its file was known: in a folder of the caller's, and while anything held the
    old state, workers went on with the file from before."""
    for folder in (None, tmp_path):
        held = scene.state
        first = share_scene(scene, folder)
        assert share_scene(scene, folder) is first
        scene.update(0, vertices=scene.meshes[0].vertices + np.float32(1.0))
        second = share_scene(scene, folder)
        np.testing.assert_array_equal(second.get("cpu").meshes[0].vertices, scene.meshes[0].vertices)
        np.testing.assert_array_equal(first.get("cpu").meshes[0].vertices, held.meshes[0].vertices)
    assert len(list(tmp_path.iterdir())) == 2


def test_rays_that_are_written_to_are_refused(scene, rays, tmp_path):
    """Between making and running a job; in a copy of them that is on the way; masks and triangles to skip, too."""
    expected = scene.occluded(*rays)
    origins, skip = rays[0].copy(), np.full(COUNT, -1)
    job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(origins, rays[1], skip=skip, memory=MEMORY)).run(most=3)
    rows = job.manifest["rows"]
    origins[4 * rows + 7, 1] += 1.0
    with pytest.raises(ValueError, match=f"the rays of rows {4 * rows} to {5 * rows - 1} have changed"):
        job.run()
    assert job.status.done == 4
    origins[:] = rays[0]
    skip[-1] = 3
    with pytest.raises(ValueError, match=f"the rays of rows {COUNT // rows * rows} to {COUNT - 1} have changed"):
        job.run()
    skip[-1] = -1
    np.testing.assert_array_equal(job.run().result(), expected)


def test_rays_that_are_written_to_while_a_block_is_computed(scene, rays, tmp_path):
    """They are compared again before the answer is written."""
    origins = rays[0].copy()

    def spoil(values: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
        origins[3] += 1.0
        return values

    blocks = scene.occluded_blocks(origins[:, None], rays[1][:, None], reduce=spoil, axis=1, memory=MEMORY)
    job = wrt.cluster.Job(tmp_path / "job", blocks)
    with pytest.raises(ValueError, match="the rays of rows 0 to 249 have changed"):
        job.run()
    assert job.status.done == 0


def test_rays_that_all_blocks_share_are_compared(scene, rays, tmp_path):
    directions = rays[1][:20].copy()
    job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(rays[0][:, None], directions, memory=20 * MEMORY))
    directions[19] *= -1.0
    with pytest.raises(ValueError, match="the rays of rows 0 to 249 have changed"):
        job.run()


def test_generated_rays_that_changed(scene, rays, tmp_path):
    """3,999 rows that changed between those that were sampled were accepted. Up to a million are all compared: when the job
    is made, before each run, and after it; what a run has computed meanwhile is removed."""
    table, expected = rays[0].copy(), scene.occluded(*rays)
    spoil_at: list[int] = []

    def lines(first: int, count: int):
        if count == ROWS and first in spoil_at:
            table[1::2] += 1.0
        return table[first : first + count], rays[1][first : first + count]

    blocks = scene.occluded_blocks(wrt.batches.GeneratedRays(lines, COUNT), memory=MEMORY)
    job = wrt.cluster.Job(tmp_path / "job", blocks).run(most=3)
    table[1777] += 1.0
    with pytest.raises(ValueError, match="the rays have changed since the job"):
        job.run()
    with pytest.raises(ValueError, match="begun with other rays"):
        wrt.cluster.Job(tmp_path / "job", blocks)
    table[1777] = rays[0][1777]
    spoil_at.append(5 * ROWS)
    with pytest.raises(ValueError, match="the answers of this run were removed"):
        job.run()
    assert job.folder.done() == {0, 1, 2}
    spoil_at.clear()
    table[:] = rays[0]
    np.testing.assert_array_equal(job.run().result(), expected)


def test_large_batches_are_compared_in_pieces(scene, rays, tmp_path, monkeypatch):
    """Of arrays beyond 256 MB and of functions beyond a million rays, 64 pieces: the first and the last row are always among
    them, and a change of all rows is noticed."""
    monkeypatch.setattr(ray_hashes, "WHOLE", 1000)
    monkeypatch.setattr(array_hashes, "PIECE", 240)
    monkeypatch.setattr(ray_hashes, "MADE", 640)
    for name in ("arrays", "function"):
        table = rays[0].copy()

        def lines(first: int, count: int, table=table):
            return table[first : first + count], rays[1][first : first + count]

        given = (table, rays[1]) if name == "arrays" else (wrt.batches.GeneratedRays(lines, COUNT),)
        job = wrt.cluster.Job(tmp_path / name, scene.occluded_blocks(*given, memory=MEMORY))
        for row in (0, COUNT - 1, slice(None)):
            table[row] += 1.0
            with pytest.raises(ValueError, match="the rays have changed"):
                job.run()
            table[:] = rays[0]
        np.testing.assert_array_equal(job.run().result(), scene.occluded(*rays))
    path = tmp_path / "origins.npy"
    np.save(path, rays[0])
    job = wrt.cluster.Job(tmp_path / "mapped", scene.occluded_blocks(np.load(path, mmap_mode="r"), rays[1]))
    np.save(path, rays[0])
    with pytest.raises(ValueError, match="the rays have changed"):
        job.run()


def instances(mask: int = 3, environment: int = -1, x: float = 0.0) -> wrt.Scene:
    """Two instances of a small mesh."""
    mesh, matrix = wrt.scenes.build("teapot", level=2), np.eye(4)
    matrix[0, 3] = 1.0 + x
    return wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, matrix, mask=mask, environment=environment)], device="cpu")


def test_instances_are_part_of_a_job(rays, tmp_path):
    """Their transforms, masks and environments, their number and their order; a job is found again by an equal scene."""
    wrt.cluster.Job(tmp_path / "job", instances().occluded_blocks(*rays))
    wrt.cluster.Job(tmp_path / "job", instances().occluded_blocks(*rays))
    moved, hidden, turned = instances(), instances(), instances()
    moved.update(1, transform=np.diag([1.0, 1.0, 2.0, 1.0]))
    hidden.update(1, mask=0)
    turned.add(wrt.Instance(turned.meshes[0]))
    others = [instances(mask=1), instances(environment=0), instances(x=1e-12), moved, hidden, turned]
    others.append(wrt.Scene([instances().instances[1], instances().instances[0]], device="cpu"))
    for other in others:
        with pytest.raises(ValueError, match="begun with another scene"):
            wrt.cluster.Job(tmp_path / "job", other.occluded_blocks(*rays))


def test_frames_are_scenes_of_their_own(rays, tmp_path):
    """Scenes of groups and of frames change by other calls than `update`."""
    mesh = wrt.scenes.build("teapot", level=2)
    frames = np.stack([mesh.vertices, mesh.vertices * np.float32(1.5)])
    fuzzy = wrt.moving.FuzzyScene(frames, mesh.faces, clusters=1, device="cpu")
    groups = wrt.moving.GroupedScene([mesh, mesh], device="cpu")
    for name, scene, change, back in (
        ("fuzzy", fuzzy, lambda: fuzzy.show(1), lambda: fuzzy.show(0)),
        ("groups", groups, lambda: groups.update({1: frames[1]}), lambda: groups.update({1: frames[0]})),
    ):
        before = scene_hash(scene)
        job = wrt.cluster.Job(tmp_path / name, scene.occluded_blocks(*rays, memory=MEMORY))
        change()
        assert scene_hash(scene) != before
        with pytest.raises(ValueError, match="the scene has changed since the job"):
            job.run(most=1)
        back()
        assert scene_hash(scene) == before


def test_scenes_are_hashed_whole(monkeypatch):
    """Arrays of vertices beyond 256 MB were sampled, as rays are."""
    monkeypatch.setattr(array_hashes, "PIECE", 100)
    mesh = wrt.scenes.build("teapot", level=4)
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    vertices[577, 2] += 1e-3
    faces[[1300, 1301]] = faces[[1301, 1300]]
    hashes = {mesh_hash(one) for one in (mesh, wrt.TriangleMesh(vertices, mesh.faces))}
    hashes.add(mesh_hash(wrt.TriangleMesh(mesh.vertices, faces)))
    assert len(hashes) == 3
    assert mesh_hash(wrt.TriangleMesh(mesh.vertices, mesh.faces)) in hashes


def test_options_of_rays_are_part_of_a_job(rays, tmp_path):
    """Masks, environments, bounds and engines; numbers and arrays."""
    scene, wanted = instances(), {"mask": 3, "t_min": 0.5, "t_max": 9.0}
    wrt.cluster.Job(tmp_path / "job", scene.intersect_blocks(*rays, **wanted))
    wrt.cluster.Job(tmp_path / "job", scene.intersect_blocks(*rays, **wanted))
    for changed in (
        {"mask": 2},
        {"mask": np.where(np.arange(COUNT) == 1777, 2, 3)},
        {"environment": 0},
        {"t_min": 0.25},
        {"t_max": np.full(COUNT, 9.0)},
        {"precise": True},
        {"triangle_test": "moeller_trumbore"},
        {"skip": 5},
    ):
        with pytest.raises(ValueError, match=r"begun with other (rays|options)"):
            wrt.cluster.Job(tmp_path / "job", scene.intersect_blocks(*rays, **{**wanted, **changed}))
    with pytest.raises(ValueError, match="begun with other options"):
        wrt.cluster.Job(tmp_path / "job", scene.intersect_blocks(*rays, **wanted), attributes=["t"])
    with pytest.raises(ValueError, match="begun with another query"):
        wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, **wanted))
    with pytest.raises(ValueError, match="begun with rays of another shape"):
        wrt.cluster.Job(tmp_path / "job", scene.intersect_blocks(rays[0][1:], rays[1][1:], **wanted))


LIMIT = 3


def above(limit: float):
    """A function with a closure."""
    return lambda values, axes: (values > limit).sum(axis=axes)


class Least:
    """A reduction of one's own, and the same with other code."""

    def __init__(self, floor: float) -> None:
        self.floor = floor

    def part(self, values, axes):
        return np.maximum(values, self.floor).min(axis=axes)


class Greatest(Least):
    """The same names, other code."""

    __qualname__ = "Least"

    def part(self, values, axes):
        return np.maximum(values, self.floor).max(axis=axes)


def test_functions_are_part_of_a_job(monkeypatch):
    """By their code, with that of functions in them, and by the values that they read: closures, defaults, globals, attributes.
    Only the outermost code was compared."""

    def nested(values, axes):
        return np.array([(lambda one: one + 1)(one) for one in values])

    def other(values, axes):
        return np.array([(lambda one: one + 2)(one) for one in values])

    other.__qualname__ = nested.__qualname__

    plus, minus = (lambda values, axes: values + 1), (lambda values, axes: values - 1)
    assert code_of(plus) != code_of(minus), "the same names and constants, another instruction"
    assert options_text(plus) != options_text(minus)

    def reads(values, axes):
        return values[:LIMIT]

    def keywords(values, axes, *, floor=1.0):
        return values + floor

    before, keys = options_text(reads), options_text(keywords)
    assert options_text(nested) != options_text(other)
    assert options_text(above(1.0)) != options_text(above(2.0))
    assert options_text(above(1.0)) == options_text(above(1.0))
    assert options_text(Least(1.0)) != options_text(Least(2.0))
    assert options_text(Least(1.0)) == options_text(Least(1.0))
    assert options_text(functools.partial(above, 1.0)) != options_text(functools.partial(above, 2.0))
    assert options_text(Least(1.0)) != options_text(Greatest(1.0))
    assert json.loads(options_text(np.sum))[-2:] == ["numpy", "sum"]  # old NumPy has it in Python
    assert " at 0x" not in options_text([np.sum, nested, Least(1.0), object(), functools.partial(np.max, axis=1)])
    monkeypatch.setitem(reads.__globals__, "LIMIT", 4)
    assert options_text(reads) != before
    keywords.__kwdefaults__["floor"] = 2.0
    assert options_text(keywords) != keys
    nested.itself = [nested]
    assert options_text({"a": nested.itself}) == options_text({"a": [nested]})


def test_the_code_that_makes_rays_is_part_of_a_job(scene, rays, tmp_path):
    """Between the rays that are compared it may make others. Data that it reads may lie elsewhere on another machine."""

    def lines(first, count):
        return rays[0][first : first + count], rays[1][first : first + count]

    def others(first, count):
        if first > 1 << 40:
            return None
        return rays[0][first : first + count], rays[1][first : first + count]

    wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(wrt.batches.GeneratedRays(lines, COUNT)))
    with pytest.raises(ValueError, match="begun with other rays"):
        wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(wrt.batches.GeneratedRays(others, COUNT)))
    assert code_of(functools.partial(lines, 0)) == code_of(lines) != code_of(others)
    assert code_of(Least(1.0).part) == code_of(Least(2.0).part) != code_of(Greatest(1.0).part)
    assert code_of(Least(1.0)) == code_of(Least(2.0)) != code_of(Greatest(1.0))


def test_answers_of_another_revision_are_refused(scene, rays, tmp_path, monkeypatch):
    """A job that goes on would mix answers of two versions of the code."""
    blocks = scene.occluded_blocks(*rays, memory=MEMORY)
    wrt.cluster.Job(tmp_path / "job", blocks).run(most=1)
    monkeypatch.setattr("wrt.cluster.job.ANSWER_REVISION", 99)
    other = rf"begun with a version of wrt that may give other answers .*: {ANSWER_REVISION} before, 99 now"
    with pytest.raises(ValueError, match=other):
        wrt.cluster.Job(tmp_path / "job", blocks)


def test_a_worker_with_other_things_is_refused(scene, rays, tmp_path, monkeypatch):
    """A worker may have read another file of the scene, or imported another version of the function."""
    generated = wrt.batches.GeneratedRays(
        lambda first, count: (rays[0][first : first + count], rays[1][first : first + count]), COUNT
    )
    turned = wrt.batches.GeneratedRays(
        lambda first, count: (rays[0][first : first + count], -rays[1][first : first + count]), COUNT
    )
    job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(generated, memory=MEMORY))
    rays_hash = ray_hashes.generated_hash(generated)
    examine = job_blocks.ExamineBlock(str(tmp_path / "job"), job.manifest, None, rays_hash, "another process")

    def run(scene: wrt.Scene, source: wrt.batches.GeneratedRays) -> None:
        BlockWork(scene, job.blocks.work.query, source, {}, 1, examine=examine).run(slice(0, ROWS), {})

    moved = wrt.Scene(wrt.TriangleMesh(scene.meshes[0].vertices * np.float32(2), scene.meshes[0].faces), device="cpu")
    with pytest.raises(ValueError, match="a worker has another scene"):
        run(moved, generated)
    with monkeypatch.context() as other:
        other.setattr(job_blocks, "ANSWER_REVISION", 99)
        with pytest.raises(ValueError, match=r"a worker has another version of wrt, whose answers have revision 99"):
            run(scene, generated)
    monkeypatch.setattr(job_blocks, "kept", lambda key, make: make())
    with pytest.raises(ValueError, match="makes other rays on a worker"):
        run(scene, turned)
    assert job.status.done == 0
    run(scene, generated)
    assert job.status.done == 1


def test_a_file_with_a_function_that_changed(tmp_path):
    """It was imported once for each path: a process that had run an earlier version of it, such as a Dask worker, kept that."""
    path = tmp_path / "rays.py"
    path.write_text("def rays(first, count):\n    return 1\n")
    first = FileFunction.of("rays.py:rays", tmp_path)
    assert first(0, 1) == 1
    path.write_text("# the same\ndef rays(first, count):\n    return 1\n")
    assert FileFunction.of("rays.py:rays", tmp_path).code_hash == first.code_hash
    path.write_text("def rays(first, count):\n    return 2\n")
    second = FileFunction.of("rays.py:rays", tmp_path)
    assert second.code_hash != first.code_hash
    assert (first(0, 1), second(0, 1)) == (1, 2)
    path.write_text("def rays(first, count):\n    return 3\n")
    late = FileFunction(str(path), "rays")
    path.write_text("def rays(first, count):\n    return 4\n")
    with pytest.raises(ValueError, match="has changed since the job began"):
        late(0, 1)


def test_a_batch_that_is_removed_while_it_runs(scene, rays, tmp_path):
    """Another job in the folder in place of this one is not written to."""
    job = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, memory=MEMORY)).run(most=2)
    job.folder.manifest_path.unlink()
    for path in (tmp_path / "job" / "chunks").rglob("*.npz"):
        path.unlink()
    for path in sorted((tmp_path / "job" / "chunks").rglob("*"), reverse=True):
        path.rmdir()
    (tmp_path / "job" / "chunks").rmdir()
    other = wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, memory=MEMORY))
    with pytest.raises(ValueError, match="holds another job than before"):
        job.run()
    assert other.status.done == 0
