"""Scenes of instances whose members move, turn and bend: as scenes made anew; an update that fails changes nothing."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from support.hits import assert_same_hits, mixed_rays
from support.random_instances import BALL, BOX, FLAT, move, random_instances

import wrt
from wrt.instances.few_moves import MAX_AT_ONCE
from wrt.instances.instance_list import MAX_OBJECTS


@pytest.mark.parametrize("accelerator", ["bvh", "kdtree"])
def test_moving_vertices(accelerator):
    """A scene of meshes, and one of instances, after an update: as one made of what is there now."""
    rng = np.random.default_rng(2)
    moved = BALL.vertices * rng.uniform(0.5, 1.5, (BALL.vertex_count, 1)) + [7.0, 0.0, 0.0]
    after = wrt.TriangleMesh(moved, BALL.faces)
    origins, directions = mixed_rays(wrt.TriangleMesh.concatenate([BOX, after]), 2000)
    scene = wrt.Scene([BOX, BALL], accelerator, device="cpu")
    before = scene.intersect(origins, directions)
    scene.update(1, vertices=moved)
    old = before.position
    assert np.nanmax(old[before.is_hit][:, 0]) < 2.0
    assert_same_hits(scene.intersect(origins, directions), wrt.Scene([BOX, after], accelerator).intersect(origins, directions))
    made = [wrt.Instance(BOX), wrt.Instance(BALL), wrt.Instance(BALL, move(0, 5))]
    scene = wrt.Scene(made, accelerator, device="cpu")
    before = scene.intersect(origins, directions)
    scene.update(1, vertices=moved)
    assert np.nanmax(before.position[before.is_hit][:, 0]) < 2.0
    fresh = [wrt.Instance(BOX), wrt.Instance(after), wrt.Instance(after, move(0, 5))]
    expected = wrt.Scene([fresh[0], fresh[1], wrt.Instance(fresh[1].mesh, move(0, 5))], accelerator, device="cpu")
    assert_same_hits(scene.intersect(origins, directions), expected.intersect(origins, directions))
    assert scene.instances[2].mesh is scene.meshes[1]


@pytest.mark.parametrize("accelerator", ["bvh", "kdtree"])
def test_moving_instances(accelerator):
    """As a scene made of what is there now."""
    scene = wrt.Scene(random_instances(), accelerator, device="cpu")
    rays = mixed_rays(scene.flattened(), 6000)
    matrices = [instance.transform @ move(0.3) for instance in scene.instances]
    moving = wrt.Scene(scene.instances, scene.accelerator, device="cpu")
    moving.update(range(len(matrices)), transform=matrices)
    moving.update(2, transform=np.eye(4), mask=8)
    made = [wrt.Instance(old.mesh, m, mask=old.mask) for old, m in zip(scene.instances, matrices, strict=True)]
    made[2] = wrt.Instance(made[2].mesh, mask=8)
    expected = wrt.Scene(made, scene.accelerator, device="cpu")
    assert_same_hits(moving.intersect(*rays, mask=9), expected.intersect(*rays, mask=9))
    np.testing.assert_array_equal(moving.bounds, expected.bounds)


@pytest.mark.parametrize("at_once", [20, 80])
def test_the_upper_level_is_built_again_only_when_it_is_worn(at_once):
    """It was once built again whenever half of the instances had moved, in every frame of ten figures."""
    count, rng = 80, np.random.default_rng(4)
    places = np.array([move(3.0 * (number % 9), 3.0 * (number // 9)) for number in range(count)])
    scene = wrt.Scene([wrt.Instance(BOX, matrix) for matrix in places], "bvh", device="cpu")
    built = scene.state.tree.forest

    def update(matrices: np.ndarray) -> None:
        for first in range(0, count, at_once):
            rows = range(first, first + at_once)
            scene.update(rows, transform=matrices[rows])

    for step in range(4):
        update(places @ move(0.1 * step, 0.1))
    tree = scene.state.tree
    assert tree.forest is built
    assert (tree.cost is not None) == (at_once <= MAX_AT_ONCE)
    np.testing.assert_allclose(tree.cost or built.cost(tree.host), built.cost(tree.host), rtol=1e-12)
    shuffled = places[rng.permutation(count)]
    update(shuffled)
    update(shuffled)  # some were on their old places when it was built again
    assert scene.state.tree.forest is not built
    assert not scene.state.tree.is_degraded
    rays = mixed_rays(scene.flattened(), 3000)
    fresh = wrt.Scene([wrt.Instance(BOX, matrix) for matrix in shuffled], "bvh", device="cpu")
    assert_same_hits(scene.intersect(*rays), fresh.intersect(*rays))


UPDATES = {
    "nothing": (lambda s: s.update(0), TypeError, "nothing to update"),
    "no such instance": (lambda s: s.update(99, transform=np.eye(4)), ValueError, "instance indices go from 0 to 24"),
    "empty": (lambda s: s.update([], mask=1), ValueError, "index is empty"),
    "index": (lambda s: s.update(1.5, transform=np.eye(4)), TypeError, "index must be an int"),
    "singular": (lambda s: s.update(0, transform=FLAT), ValueError, r"singular.*mesh\.transformed"),
    "wrong number": (lambda s: s.update([0, 1], transform=np.tile(np.eye(4), (3, 1, 1))), ValueError, "3 matrices for 2"),
    "vertices": (lambda s: s.update(0, vertices=np.zeros((5, 3))), ValueError, "5 points, but the mesh has 162"),
    "late": (lambda s: s.update(0, vertices=np.full((162, 3), np.nan), transform=move(1)), ValueError, "must be finite"),
    "two meshes": (lambda s: s.update([0, 3], vertices=BALL.vertices), ValueError, "several meshes"),
    "mask": (lambda s: s.update(0, mask=1 << 32), ValueError, "mask is 4294967296"),
}


@pytest.mark.parametrize("case", UPDATES)
def test_a_failed_update_changes_nothing(case):
    call, kind, message = UPDATES[case]
    scene = wrt.Scene(random_instances(), device="cpu")
    before = dict(vars(scene))
    with pytest.raises(kind, match=message):
        call(scene)
    assert vars(scene).keys() == before.keys()
    assert all(vars(scene)[name] is value for name, value in before.items())


def test_instances_are_objects_when_they_are_read():
    """Many that move are arrays until then; what has not changed stays the same object."""
    count = MAX_OBJECTS + 8
    given = [wrt.Instance(BOX, move(3.0 * number), mask=number + 1) for number in range(count)]
    scene = wrt.Scene(given, device="cpu")
    assert scene.instances[3] is given[3]
    matrices = np.array([move(3.0 * number, 1.0) for number in range(count)])
    rows = np.arange(4, count)
    scene.update(rows, transform=matrices[rows])
    scene.update([5, *rows, 5], transform=matrices[[0, *rows, 1]])
    assert "objects" not in vars(scene.state.instances)
    scene.update(6, mask=2)
    assert "objects" not in vars(scene.state.instances)
    listed = scene.instances
    assert listed is scene.instances
    assert all(listed[row] is given[row] for row in range(4))
    expected = matrices.copy()
    expected[:4], expected[5] = [given[row].transform for row in range(4)], matrices[1]
    for row, one in enumerate(listed):
        np.testing.assert_array_equal(one.transform, expected[row])
        assert (one.mesh, one.mask, one.environment) == (BOX, 2 if row == 6 else row + 1, -1)
        assert type(one.mask) is int
        assert not one.transform.flags.writeable
    scene.update(7, transform=np.eye(4))
    assert scene.instances[8] is listed[8]
    scene.update(np.arange(count), transform=np.eye(4), mask=1)
    assert all(one.mask == 1 and (one.transform == np.eye(4)).all() for one in scene.instances)
    again = pickle.loads(pickle.dumps(scene))
    assert [(one.mask, one.transform.tolist()) for one in again.instances] == [(1, np.eye(4).tolist())] * count
    np.testing.assert_array_equal(listed[7].transform, matrices[7])
