"""Instances whose transforms are Warp arrays on the scene's device: as if they had gone through the host, to the bit."""

from __future__ import annotations

import gc
import pickle

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.random_instances import BALL, BOX, FLAT

import wrt
from wrt.instances import device_moves
from wrt.instances.instance_boxes import Covers, InstanceBoxes, cover, outermost
from wrt.kernels.compilation import local_memory
from wrt.meshes.instance import matrices_of
from wrt.meshes.mesh import TriangleMesh

COUNT = 60


def poses(seed: int, spread: float = 8.0) -> np.ndarray:
    """(COUNT, 7) float32: positions and quaternions of any length."""
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-spread, spread, (COUNT, 3)), rng.normal(size=(COUNT, 4))], axis=1).astype(np.float32)


def scene_of(transforms: np.ndarray, worlds: int | None, device: str) -> wrt.Scene:
    """Boxes and balls with masks, some of them in all environments."""
    made = [
        wrt.Instance(
            BALL if number % 3 else BOX,
            matrix,
            mask=1 << number % 3,
            environment=-1 if worlds is None or number % 10 == 0 else number % worlds,
        )
        for number, matrix in enumerate(transforms)
    ]
    return wrt.Scene(made, "bvh", device=device)


def given(values: np.ndarray, kind: type, device: str) -> tuple[wp.array, np.ndarray]:
    """Poses as an array on the device, and as float64 matrices; in numbers of float64, the last row is left out."""
    if kind is wp.transformf:
        moved = wp.array(values, dtype=wp.transformf, device=device)
        return moved, matrices_of(moved)
    matrices = matrices_of(wp.array(values, dtype=wp.transformf, device="cpu")).astype(np.float32)
    rows = 3 if kind is wp.float64 else 4
    return wp.array(matrices[:, :rows], dtype=kind, device=device), matrices.astype(np.float64)


@pytest.fixture(params=[False, True], ids=["new", "kept"])
def keeps(request, monkeypatch):
    """Whether moves take memory and packed kernels of states that are gone, as they do on CUDA."""
    monkeypatch.setattr(device_moves, "keeps_moves", lambda device: request.param or device.is_cuda)
    return request.param


@pytest.mark.parametrize("worlds", [None, 4])
@pytest.mark.parametrize("kind", [wp.transformf, wp.float32, wp.float64])
def test_moves_on_the_device_equal_those_of_the_host(kind, worlds, keeps, device):
    """Boxes, the centre, maps, nodes and hits; little motions keep the upper tree, others build it again."""
    first, rng = matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), np.random.default_rng(1)
    here, host = scene_of(first, worlds, device), scene_of(first, worlds, device)
    rays = mixed_rays(host.flattened(), 3000)
    seen = {} if worlds is None else {"environment": rng.integers(-1, worlds, len(rays[0]))}
    near = poses(0) + np.float32(0.01) * poses(2)
    for rows, values in ((range(COUNT), near), (rng.permutation(COUNT)[:40], poses(3)[:40]), (range(COUNT), poses(4, 20.0))):
        moved, matrices = given(values, kind, device)
        here.update(rows, transform=moved)
        host.update(rows, transform=matrices[:, :3] if kind is wp.float64 else matrices)
        kept, known = here.state.on_host(), host.state
        assert kept.boxes.frame == known.boxes.frame
        assert kept.boxes.extremes == known.boxes.extremes
        for name in ("to_scene", "to_object", "origin", "mask", "first"):
            np.testing.assert_array_equal(kept.table[name], known.table[name])
        if here.state.device_moves is not None:
            np.testing.assert_array_equal(here.state.tree.bounds.numpy(), known.tree.host.ravel())
        assert (here.state.tree.low, here.state.tree.high) == (known.tree.low, known.tree.high)
        assert_same_hits(here.intersect(*rays, mask=3, **seen), host.intersect(*rays, mask=3, **seen))
    for one, other in zip(here.instances, host.instances, strict=True):
        np.testing.assert_array_equal(one.transform, other.transform)
        assert (one.mask, one.environment) == (other.mask, other.environment)
    for scene in (here, host):  # what goes through the host finds what moved on the device
        scene.update(5, transform=np.eye(4), mask=2)
    assert_same_hits(here.intersect(*rays, **seen), host.intersect(*rays, **seen))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_many_matrices_of_numpy_are_moved_by_the_kernels(dtype, monkeypatch):
    """On the CPU: as by NumPy, to the bit; also some of them, with one of them twice, and a few after many."""
    first, rng = matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), np.random.default_rng(1)
    here, host = scene_of(first, 4, "cpu"), scene_of(first, 4, "cpu")
    rays, seen = mixed_rays(host.flattened(), 1000), {"environment": rng.integers(-1, 4, 1000)}
    some, twice = rng.permutation(COUNT)[:40], np.r_[0:50, 3]
    steps = (np.arange(COUNT), poses(1)), (some, poses(2)[:40]), (twice, poses(3)[: len(twice)]), ([7], poses(4)[:1])
    for rows, values in (*steps, (np.arange(COUNT), poses(5, 20.0))):
        matrices = matrices_of(wp.array(values, dtype=wp.transformf, device="cpu")).astype(dtype)
        for scene, least in ((here, 33), (host, COUNT + 1)):
            monkeypatch.setattr(device_moves, "MIN_BY_KERNELS", least)
            scene.update(rows, transform=matrices)
        assert host.state.device_moves is None
        assert (here.state.device_moves is None) == (len(np.unique(rows)) != len(rows) or len(rows) < 33)
        kept, known = here.state.on_host(), host.state
        assert (kept.boxes.frame, kept.boxes.extremes) == (known.boxes.frame, known.boxes.extremes)
        for name in ("to_scene", "to_object", "origin", "mask", "first"):
            np.testing.assert_array_equal(kept.table[name], known.table[name])
        np.testing.assert_array_equal(kept.tree.host, known.tree.host)
        for one, other in zip(kept.tree.corners, known.tree.corners, strict=True):
            np.testing.assert_array_equal(one, other)
        assert_same_hits(here.intersect(*rays, **seen), host.intersect(*rays, **seen))
    monkeypatch.setattr(device_moves, "MIN_BY_KERNELS", 33)
    matrices[5, 0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        here.update(range(COUNT), transform=matrices)
    assert_same_hits(here.intersect(*rays, **seen), host.intersect(*rays, **seen))


def test_pickles_after_moves_on_the_device(device):
    """They hold what moved as on the host."""
    scene = scene_of(matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), None, device)
    scene.update(range(COUNT), transform=given(poses(0) + np.float32(0.01) * poses(2), wp.transformf, device)[0])
    assert scene.state.device_moves is not None
    again = pickle.loads(pickle.dumps(scene))
    for one, other in zip(again.instances, scene.instances, strict=True):
        np.testing.assert_array_equal(one.transform, other.transform)
    rays = mixed_rays(scene.flattened(), 500)
    assert_same_hits(again.intersect(*rays), scene.intersect(*rays))


def test_kept_memory_is_not_that_of_results(keeps, device):
    """Memory of a state is used again only once nothing needs it: hits, moves and instances read what they were made for."""
    start = matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu"))
    scene, rays = scene_of(start, None, device), mixed_rays(scene_of(start, None, device).flattened(), 500)
    kept, known, tables = [], [], set()
    for number in range(9):
        rows, seed = (range(COUNT), number) if number != 3 else (np.arange(20), 9)
        values = (poses(0) + np.float32(0.002) * poses(seed))[: len(rows)]
        scene.update(rows, transform=wp.array(values, dtype=wp.transformf, device=device))
        tables.add(scene.state.device_mesh.placements.ptr)
        hits, state = scene.intersect(*rays), scene.state
        if number < 3:
            kept.append((hits, state))
            twin = scene_of(np.array([one.transform for one in state.on_host().instances]), None, device)
            known.append(twin.intersect(*rays))
    assert keeps is False or len(tables) < 9
    for (hits, state), expected in zip(kept, known, strict=True):
        np.testing.assert_array_equal(hits.t, expected.t)
        np.testing.assert_array_equal(hits.normal, expected.normal)
        np.testing.assert_array_equal(state.boxes.origin, state.device_moves.bounded.origin.numpy())


def test_memory_of_states_in_cycles_is_not_freed(monkeypatch, device):
    """As that of answers: a state in a cycle, such as of an exception, is finalised with its arrays."""
    monkeypatch.setattr(device_moves, "keeps_moves", lambda device: True)
    scene = scene_of(matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), None, device)
    values, freed = wp.array(poses(0), dtype=wp.transformf, device=device), []
    for _ in range(2):
        scene.update(range(COUNT), transform=values)
    cycle, kept = [scene.state], scene.state.device_moves.kept
    cycle.append(cycle)
    (move,) = kept.lent.values()
    free, move.table.deleter = move.table.deleter, lambda ptr, size: freed.append(ptr)
    del move
    scene.update(range(COUNT), transform=values)
    del cycle
    gc.collect()
    assert freed == []
    assert len(kept.items()) == len(kept.lent) == 1
    kept.items()[0].table.deleter = free


def test_masks_beside_transforms(keeps, device):
    """Those of instances that move, which they keep in later moves, whatever memory waits for these."""
    scene, host = (scene_of(matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), None, device) for _ in range(2))
    rays = mixed_rays(host.flattened(), 1000)
    for number, (rows, mask) in enumerate(((range(COUNT), None), (np.arange(40), 8), (range(COUNT), None), (range(COUNT), 4))):
        values = wp.array((poses(0) + np.float32(0.01 * number))[: len(rows)], dtype=wp.transformf, device=device)
        scene.update(rows, transform=values, mask=mask)
        host.update(rows, transform=matrices_of(values), mask=mask)
        assert scene.state.table is None
        for seen in (8, 12, 0xFFFFFFFF):
            assert_same_hits(scene.intersect(*rays, mask=seen), host.intersect(*rays, mask=seen))
    assert [one.mask for one in scene.instances] == [4] * COUNT
    with pytest.raises(ValueError, match="mask"):
        scene.update(range(COUNT), transform=values, mask=-1)


def test_environments_beside_transforms(keeps, device):
    """One that the instances have already changes nothing; another one puts them into another tree, as on the host."""
    first = matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu"))
    scene, host = scene_of(first, 1, device), scene_of(first, 1, device)
    rays, rows = mixed_rays(host.flattened(), 1000), np.flatnonzero(np.arange(COUNT) % 10)  # but those of all worlds
    for environment, stays in ((0, True), (2, False), (2, True)):
        values = wp.array((poses(0) + np.float32(0.01 * environment))[rows], dtype=wp.transformf, device=device)
        scene.update(rows, transform=values, environment=environment)
        host.update(rows, transform=matrices_of(values), environment=environment)
        assert (scene.state.table is None) == stays
        for world in range(3):
            assert_same_hits(scene.intersect(*rays, environment=world), host.intersect(*rays, environment=world))
    assert {scene.instances[row].environment for row in rows} == {2}


def test_a_small_motion_stays_on_the_device(device):
    """Neither transforms nor boxes are copied to the host, and the nodes stay."""
    scene = scene_of(matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), None, device)
    forest = scene.state.tree.forest
    scene.update(range(COUNT), transform=wp.array(poses(0), dtype=wp.transformf, device=device))
    state = scene.state
    assert state.tree.forest is forest
    assert state.table is None
    assert "on_host" not in vars(state.instances)
    assert not {"origin", "box", "norms"} & vars(state.boxes).keys()


def test_a_refused_transform_changes_nothing(device):
    """Singular, not finite, or none for an instance: with the message of the host."""
    scene = scene_of(matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), None, device)
    before, matrices = scene.state, given(poses(1), wp.float32, "cpu")[1]
    for bad in (FLAT, np.full((4, 4), np.nan), np.eye(4) * 2.0):
        matrices[7] = bad
        with pytest.raises(ValueError, match="transform"):
            scene.update(range(COUNT), transform=wp.array(matrices, dtype=wp.float32, device=device))
        assert scene.state is before
    with pytest.raises(ValueError, match="matrices for 60 instances"):
        scene.update(range(COUNT), transform=wp.array(poses(1)[:50], dtype=wp.transformf, device=device))
    assert scene.state is before


def test_outermost_corners_bound_as_all_do():
    """Boxes of maps are the same to the bit without the corners that others exceed."""
    rng = np.random.default_rng(5)
    mesh = TriangleMesh(rng.normal(size=(3000, 3)), rng.integers(0, 3000, (2000, 3)))
    state = wrt.Scene([wrt.Instance(mesh)], device="cpu").state.mesh_states[0]
    points = state.device_mesh.vertices.numpy()[mesh.referenced].astype(np.float64)
    signs = np.array([1.0, -1.0, 1.0])
    kept = outermost(points, signs)
    assert 0 < len(kept) < len(points) / 4
    assert not ((points * signs)[:, None] > (kept * signs)).all(axis=2).any()
    transforms = np.tile(np.eye(4), (200, 1, 1))
    transforms[:, :3] = rng.normal(size=(200, 3, 4))
    few, all_corners = cover(state), np.concatenate([cover(state), corners_of_cells(points)])
    one, other = (InstanceBoxes.of(transforms, np.zeros(200, int), Covers.of([own], [state]))[0] for own in (few, all_corners))
    np.testing.assert_array_equal(one.box, other.box)


def corners_of_cells(points: np.ndarray) -> np.ndarray:
    """All corners of the boxes of points in the cells of an 8 x 8 x 8 grid."""
    low, high = points.min(axis=0), points.max(axis=0)
    cell = ((points - low) / (high - low) * 8).astype(int).clip(0, 7) @ (64, 8, 1)
    boxes = [(points[cell == one].min(axis=0), points[cell == one].max(axis=0)) for one in np.unique(cell)]
    choices = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T
    return np.concatenate([[np.array(box)[choice, range(3)] for choice in choices] for box in boxes])


@pytest.mark.cuda
@pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
def test_a_step_in_one_graph():
    """Moved, traced and read in a graph, which is launched with other transforms: as calls one by one, wherever they go."""
    first = matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu"))
    scene, other = scene_of(first, 4, "cuda:0"), scene_of(first, 4, "cuda:0")
    rays = [wp.array(values, dtype=wp.vec3, device="cuda:0") for values in mixed_rays(other.flattened(), 3000)]
    worlds = wp.array(np.arange(rays[0].size) % 4, dtype=int, device="cuda:0")
    moving = wp.array(poses(0), dtype=wp.transformf, device="cuda:0")

    def step(of: wrt.Scene) -> list[wp.array]:
        of.update(range(COUNT), transform=moving)
        hits = of.intersect(*rays, environment=worlds)
        return [hits.t, hits.primitive_id, hits.instance_id, hits.uv, hits.normal]

    with wp.ScopedCapture("cuda:0"), pytest.raises(RuntimeError, match="before the capture"):
        scene.update(range(COUNT), transform=moving)
    step(scene)
    with wp.ScopedCapture("cuda:0") as capture:
        found = step(scene)
    for number, spread in enumerate((8.0, 9.0, 60.0, 2.0)):
        wp.copy(moving, wp.array(poses(number, spread), dtype=wp.transformf, device="cuda:0"))
        wp.capture_launch(capture.graph)
        for one, expected in zip(found, step(other), strict=True):
            np.testing.assert_array_equal(one.numpy(), expected.numpy())


def test_local_memory_that_a_card_has_not_is_refused(monkeypatch):
    """A launch that finds no memory for its stacks may give wrong answers in silence."""

    class Kernel:
        key = "packets"

    class Card:
        alias, ordinal, free_memory, is_capturing = "cuda:9", 9, 30_000_000_000, False

    def synchronize(device):
        assert device is Card
        waits.append(Card.free_memory)
        Card.free_memory = freed

    waits, freed = [], 40_000_000_000
    monkeypatch.setattr(wp, "synchronize_device", synchronize)
    monkeypatch.setattr(local_memory, "_reserved", {})
    monkeypatch.setattr(local_memory, "resident_threads", lambda ordinal: 270_336)
    sizes = iter([100_000, 110_000, 240_000, 250_000])
    monkeypatch.setattr(local_memory, "local_bytes", lambda *loaded: next(sizes))
    for _ in range(3):  # what is reserved already serves the next kernel
        local_memory.reserve_local_memory(Kernel, Card, 128)
    assert waits == [30_000_000_000]  # what was freed counts once the pool has given it back
    freed = 1_000_000_000
    monkeypatch.setattr(Card, "free_memory", freed)
    with pytest.raises(MemoryError, match=r"packets needs 67\.6 GB of local memory .*cuda:9.* 1\.0 GB free"):
        local_memory.reserve_local_memory(Kernel, Card, 128)


def test_points_after_a_motion_on_the_device(device):
    """Points ask whether maps are similar, of a table that is on the device then."""
    scene = scene_of(matrices_of(wp.array(poses(0), dtype=wp.transformf, device="cpu")), None, device)
    moved = wp.array(poses(0) + np.float32(0.01) * poses(2), dtype=wp.transformf, device=device)
    scene.update(range(COUNT), transform=moved)
    assert scene.state.table is None
    expected = scene_of(matrices_of(moved), None, device)
    points = np.random.default_rng(2).uniform(-9.0, 9.0, (200, 3))
    found, there = scene.closest_point(points), expected.closest_point(points)
    np.testing.assert_array_equal(found.instance_id, there.instance_id)
    np.testing.assert_array_equal(found.distance, there.distance)
    squeezed = matrices_of(moved)
    squeezed[3, :3, 0] *= 2.0
    scene.update(range(COUNT), transform=wp.array(squeezed, dtype=wp.float32, device=device))
    with pytest.raises(ValueError, match="instance 3"):
        scene.closest_point(points)
