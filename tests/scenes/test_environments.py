"""Many worlds in one scene: rays see the instances of their environment and those that all share, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.random_instances import BALL, BOX, asked_alone, move, random_instances

import wrt
from wrt.builders.bvh.instance_forest import MAX_PACKED
from wrt.instances.instance_boxes import build_upper
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE
from wrt.kernels.layout.instance_maps import LIST_BITS, MAX_LISTED_INSTANCES
from wrt.scene.archives import read_archive, write_archive

LAST = (1 << 31) - 1
NUMBERS = [-1, 0, 1, 7, LAST]


def in_environments(numbers: list[int], count: int = 24) -> list[wrt.Instance]:
    instances = random_instances(count)
    return [
        wrt.Instance(one.mesh, one.transform, mask=one.mask, environment=numbers[k % len(numbers)])
        for k, one in enumerate(instances)
    ]


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(in_environments(NUMBERS), "bvh", device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.flattened(), 6000)


@pytest.mark.parametrize("grouped", [True, False])
def test_as_the_instances_of_an_environment_asked_alone(scene, rays, grouped):
    """To the bit, for every traversal; environment 3 has no instances, and -1 of a ray sees all."""
    rng = np.random.default_rng(1)
    environment = rng.choice([*NUMBERS, 3], len(rays[0]))
    if grouped:
        environment.sort()
    t, triangle, uv, counts = (np.stack(values) for values in zip(*asked_alone(scene, *rays), strict=True))
    own = np.array([instance.environment for instance in scene.instances])
    seen = (own[:, None] == -1) | (environment == -1) | (own[:, None] == environment)
    t, counts = np.where(seen, t, np.inf), np.where(seen, counts, 0)
    first, ray = t.argmin(axis=0), np.arange(len(rays[0]))
    is_hit = np.isfinite(t.min(axis=0))
    assert 0.1 < is_hit.mean() < 0.9
    for traversal in ("single", "packet", "stream", "auto"):
        hits = scene.intersect(*rays, traversal=traversal, environment=environment)
        np.testing.assert_array_equal(hits.t, t.min(axis=0))
        np.testing.assert_array_equal(hits.instance_id, np.where(is_hit, first, -1))
        np.testing.assert_array_equal(hits.primitive_id, np.where(is_hit, triangle[first, ray], -1))
        np.testing.assert_array_equal(hits.uv[is_hit], uv[first, ray][is_hit])
        np.testing.assert_array_equal(scene.occluded(*rays, traversal=traversal, environment=environment), is_hit)
    np.testing.assert_array_equal(scene.count(*rays, environment=environment), counts.sum(axis=0))
    np.testing.assert_array_equal(scene.intersect_all(*rays, environment=environment).count, counts.sum(axis=0))


def test_environments_go_with_masks_blocks_and_broadcasting(scene, rays):
    origins, directions = (values[:2000].reshape(4, 500, 3) for values in rays)
    numbers = np.array([0, 1, 7, 3])
    hits = scene.intersect(origins, directions, environment=numbers[:, None], mask=5)
    assert hits.is_hit.any()
    for row, number in enumerate(numbers):
        alone = scene.intersect(origins[row], directions[row], environment=int(number), mask=5)
        np.testing.assert_array_equal(alone.t, hits.t[row])
        np.testing.assert_array_equal(alone.instance_id, hits.instance_id[row])
    t = np.empty((4, 500), dtype=np.float32)
    blocks = scene.intersect_blocks(origins, directions, environment=numbers[:, None], mask=5, memory=1 << 18)
    assert len(blocks) > 1
    blocks.write({"t": t})
    np.testing.assert_array_equal(t, hits.t)
    on_device = wp.array(np.repeat(numbers, 500).reshape(4, 500), dtype=int, device="cpu")
    np.testing.assert_array_equal(scene.intersect(origins, directions, environment=on_device, mask=5).t, hits.t)
    assert scene.explain(origins, directions, environment=0).traversal == scene.explain(origins, directions).traversal


def boxes(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-9, 9, (count, 3)).astype(np.float32)
    return low, low + rng.uniform(0, 2, (count, 3)).astype(np.float32)


@pytest.mark.parametrize("width", [2, 4, 16])
@pytest.mark.parametrize("shared", [0, 1, 20, 12])
def test_every_root_reaches_its_instances(width, shared):
    """Once each, below boxes that hold them; sizes about one node, two levels, and beyond packed trees."""
    sizes = [1, width - 1, width, width + 1, 3, width * width + 1, MAX_PACKED + 40]
    environment = np.concatenate([np.full(size, 5 * k) for k, size in enumerate(sizes)] + [np.full(shared, -1)]).astype(
        np.int32
    )
    environment = np.random.default_rng(0).permutation(environment)
    low, high = boxes(len(environment), 1)
    tree = build_upper((low, high), environment, width, 0, wp.get_device("cpu"))
    forest, bounds = tree.forest, tree.host

    def reached(node: int) -> list[int]:
        found = []
        for lane, word in enumerate(forest.child[node]):
            if word == int(EMPTY_LANE):
                assert bounds[node, 0, lane] == np.inf
                continue
            own = reached(word) if word >= 0 else [~word >> 6]
            assert word < 0 or word > node
            np.testing.assert_array_equal(bounds[node, :3, lane], low[own].min(axis=0))
            np.testing.assert_array_equal(bounds[node, 3:, lane], high[own].max(axis=0))
            found += own
        return found

    assert sorted(reached(forest.root)) == [*range(len(environment))]
    for number, root in zip(forest.environments, forest.roots, strict=True):
        assert sorted(reached(root)) == np.flatnonzero((environment == number) | (environment == -1)).tolist()
    if shared > MAX_LISTED_INSTANCES:
        assert len(forest.lists) == 0
    else:
        for number, word in zip([*forest.environments, -1], forest.lists, strict=True):
            nodes, own = forest.child[word >> LIST_BITS :][: word & (1 << LIST_BITS) - 1], np.flatnonzero(environment == number)
            listed = np.sort(~nodes[nodes != int(EMPTY_LANE)] >> 6)
            np.testing.assert_array_equal(listed, own if len(own) <= MAX_LISTED_INSTANCES else [])
    assert (forest.shared_root >= 0) == (shared > 0)
    if shared:
        assert sorted(reached(forest.shared_root)) == np.flatnonzero(environment == -1).tolist()
    rows = np.array([0, 7, len(low) - 1])
    low[rows] -= 30.0
    np.testing.assert_array_equal(forest.moved(bounds, low, high, rows), forest.bounds(low, high))


def test_a_scene_of_one_environment_has_no_shared_tree(rays):
    scene = wrt.Scene(in_environments([4]), "bvh", device="cpu")
    assert not scene.occluded(*rays, environment=3).any()
    np.testing.assert_array_equal(scene.occluded(*rays, environment=4), scene.occluded(*rays))


def test_members_come_and_go(scene, rays):
    """As scenes made anew, with the trees of meshes that were there; a later move, too."""
    changing = wrt.Scene(scene.instances, "bvh", device="cpu")
    trees = [state.tree for state in changing.state.mesh_states]
    other = wrt.TriangleMesh(BOX.vertices * 0.5, BOX.faces)
    new = [wrt.Instance(other, move(1.0), environment=7), wrt.Instance(BALL, move(-2.0), environment=0)]
    np.testing.assert_array_equal(changing.add(new), [25, 26])
    assert [state.tree for state in changing.state.mesh_states[:2]] == trees
    changing.remove([3, 0])
    changing.remove(5)
    members = [one for number, one in enumerate([*scene.instances, *new]) if number not in (0, 3, 7)]
    assert [one.transform.tolist() for one in changing.instances] == [one.transform.tolist() for one in members]
    changing.update(4, environment=1, transform=move(0.0, 1.0))
    changing.update([1, 2], mask=2)
    members[4] = wrt.Instance(members[4].mesh, move(0.0, 1.0), mask=members[4].mask, environment=1)
    for number in (1, 2):
        members[number] = wrt.Instance(
            members[number].mesh, members[number].transform, mask=2, environment=members[number].environment
        )
    expected = wrt.Scene(members, "bvh", device="cpu")
    environment = np.random.default_rng(3).choice([0, 1, 7, -1], len(rays[0]))
    assert_same_hits(
        changing.intersect(*rays, environment=environment, mask=3), expected.intersect(*rays, environment=environment, mask=3)
    )
    changing.remove(len(members) - 2)  # the only instance of the new mesh
    assert len(changing.meshes) == 2


def test_many_small_moves_are_one_large_move(rays):
    """The nodes above single instances get new boxes; the scene's centre stays until the boxes have gone far."""
    scene = wrt.Scene(in_environments([-1], 80), "bvh", device="cpu")
    rng = np.random.default_rng(5)
    matrices = np.array([instance.transform for instance in scene.instances])
    for scale in (0.01, 0.5, 40.0):
        for number in rng.permutation(81)[:30].tolist():
            matrices[number, :3, 3] += rng.normal(size=3) * scale
            scene.update(number, transform=matrices[number])
    made = [wrt.Instance(one.mesh, matrix, mask=one.mask) for one, matrix in zip(scene.instances, matrices, strict=True)]
    expected = wrt.Scene(made, "bvh", device="cpu")
    np.testing.assert_array_equal(scene.center, expected.center)
    np.testing.assert_array_equal(scene.bounds, expected.bounds)
    assert_same_hits(scene.intersect(*rays), expected.intersect(*rays))


def test_transforms_come_as_arrays_of_warp():
    """Those of Newton and of Warp's simulations are positions with quaternions x, y, z, w."""
    scene = wrt.Scene([wrt.Instance(BALL), wrt.Instance(BOX)], device="cpu")
    half = np.sqrt(0.5)
    states = wp.array([[1, 2, 3, 0, 0, half, half], [0, 0, 5, 0, 0, 0, 1]], dtype=wp.transform, device="cpu")
    scene.update([0, 1], transform=states)
    np.testing.assert_allclose(
        scene.instances[0].transform, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-7
    )
    scene.update([0, 1], transform=wp.array(np.array([move(1), move(2)]), dtype=wp.mat44d, device="cpu"))
    np.testing.assert_array_equal(scene.instances[1].transform, move(2))


@pytest.mark.parametrize("accelerator", ["bvh", "kdtree"])
def test_a_saved_scene_of_instances(accelerator, rays, tmp_path):
    """Answers to the bit, from the trees in the file; a file with a wrong instance is refused."""
    scene = wrt.Scene(in_environments(NUMBERS), accelerator, device="cpu")
    scene.save(tmp_path / "worlds.wrt")
    loaded = wrt.Scene.load(tmp_path / "worlds.wrt", device="cpu")
    environment = np.random.default_rng(3).choice([0, 1, 7, -1], 2000)
    few = [values[:2000] for values in rays]
    assert_same_hits(*(one.intersect(*few, environment=environment, mask=3, traversal="single") for one in (scene, loaded)))
    np.testing.assert_array_equal(*(one.intersect(*few).instance_id for one in (scene, loaded)))
    assert len(loaded.meshes) == 2
    for old, new in zip(scene.state.parts, loaded.state.parts, strict=True):
        np.testing.assert_array_equal(old.tree.primitive.numpy(), new.tree.primitive.numpy())
    arrays = read_archive(tmp_path / "worlds.wrt")
    for name, wrong in (("geometry", np.full(25, 2)), ("transform", np.zeros((25, 4, 4))), ("environment", np.full(25, -3))):
        write_archive(tmp_path / "wrong.wrt", arrays | {name: wrong})
        with pytest.raises(ValueError, match="damaged"):
            wrt.Scene.load(tmp_path / "wrong.wrt", device="cpu")


def test_a_deep_mesh_below_few_instances():
    """Stacks were sized by the upper tree alone: a mesh whose tree was deeper overwrote memory, and rays got wrong answers."""
    size = 1.7 ** -np.arange(140.0)
    flat = np.zeros(140)
    corners = [[size, flat, flat], [2 * size, size, flat], [2 * size, flat, size]]
    mesh = wrt.TriangleMesh(np.moveaxis(np.array(corners), 2, 0).reshape(-1, 3), np.arange(420).reshape(-1, 3))
    one = wrt.Scene(mesh, wrt.Bvh(width=2), device="cpu")
    scene = wrt.Scene([wrt.Instance(mesh)], wrt.Bvh(width=2), device="cpu")
    assert one.tree.depth > 8
    targets = np.repeat(mesh.vertices.reshape(-1, 3, 3).mean(axis=1), 30, axis=0)
    origins = 5.0 * np.random.default_rng(0).normal(size=targets.shape)
    traced = [it.intersect(origins, targets - origins, traversal="single") for it in (one, scene)]
    np.testing.assert_array_equal(traced[0].primitive_id, traced[1].primitive_id)


WRONG = {
    "instance": (lambda s: wrt.Instance(BALL, environment=-2), ValueError, r"environment is -2.*-1 for all"),
    "type": (lambda s: wrt.Instance(BALL, environment=1.0), TypeError, "environment must be an int"),
    "rays": (lambda s: s.intersect([0, 0, 0], [1, 0, 0], environment=1 << 31), ValueError, "ranges from 2147483648"),
    "floats": (lambda s: s.intersect([0, 0, 0], [1, 0, 0], environment=0.5), TypeError, "environment must hold integers"),
    "shape": (lambda s: s.occluded(np.zeros((4, 3)), [1, 0, 0], environment=[1, 2]), ValueError, "does not broadcast"),
    "update": (lambda s: s.update(0, environment=-7), ValueError, "environment is -7"),
    "all": (lambda s: s.remove(range(25)), ValueError, "all instances"),
    "none": (lambda s: s.remove(25), ValueError, "instance indices go from 0 to 24"),
    "mesh": (lambda s: wrt.Scene(BALL, device="cpu").add(wrt.Instance(BOX)), ValueError, "add needs instances"),
    "meshes": (
        lambda s: wrt.Scene(BALL, device="cpu").intersect([0, 0, 0], [1, 0, 0], environment=0),
        ValueError,
        "needs inst",
    ),
    "add": (lambda s: s.add(3), TypeError, "mesh must be"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_environments_are_refused(case, scene):
    call, kind, message = WRONG[case]
    before = scene.state
    with pytest.raises(kind, match=message):
        call(scene)
    assert scene.state is before


def test_a_few_moves_write_what_a_new_scene_has():
    """All that is on the host, to the bit: one call of a kernel writes it, beside the array operations that move many."""
    rng = np.random.default_rng(5)
    members = [wrt.Instance(BALL if k % 3 else BOX, move(rng.uniform(-40, 40)), environment=k % 7 - 1) for k in range(120)]
    scene = wrt.Scene(members, "bvh", device="cpu")
    for rows in ([7], [0, 33, 119], list(range(20, 52)), list(range(60))):
        matrices = np.array([scene.instances[row].transform for row in rows])
        matrices[:, :3, :3] = np.diag([1.0, -0.7, 1.3]) + rng.uniform(-0.1, 0.1, (len(rows), 3, 3))
        matrices[:, :3, 3] += rng.uniform(-0.3, 0.3, (len(rows), 3))
        scene.update(rows, transform=matrices, mask=5)
        ours, new = scene.state, wrt.Scene(scene.instances, "bvh", device="cpu").state
        np.testing.assert_array_equal(ours.center, new.center)
        assert ours.boxes.extremes == new.boxes.extremes
        for name in ("origin", "box", "norms"):
            np.testing.assert_array_equal(getattr(ours.boxes, name), getattr(new.boxes, name))
        np.testing.assert_array_equal(ours.table, new.table)
        np.testing.assert_array_equal(ours.tree.corners, new.tree.corners)
        np.testing.assert_array_equal(ours.tree.host, ours.tree.forest.bounds(*ours.tree.corners))
    assert scene.state.table["mask"][7] == 5
