"""Every query of a scene of instances: it answers as a scene of one level does, or says what to do instead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays

import wrt


@pytest.fixture(scope="module")
def both():
    """Ten copies of a teapot, as instances with masks, and the same triangles in one tree; rays of every kind."""
    pot = wrt.scenes.build("teapot", level=3, ground=False)
    maps = []
    for n in range(10):
        matrix = np.diag([1.0 + 0.1 * n, 1.0, 1.0 - 0.05 * n, 1.0])
        matrix[:3, 3] = [4.0 * (n % 4), 4.0 * (n // 4), 0.3 * n]
        maps.append(matrix)
    scene = wrt.Scene([wrt.Instance(pot, matrix, mask=1 << n) for n, matrix in enumerate(maps)], device="cpu")
    origins, directions = mixed_rays(scene.flattened(), 4000)
    masks = np.random.default_rng(8).integers(0, 1 << 10, 4000).astype(np.uint32)
    return {"scene": scene, "flat": wrt.Scene(scene.flattened(), device="cpu"), "rays": (origins, directions), "masks": masks}


@pytest.mark.parametrize("memory", ["33 kB", "200 kB", "1 GB"])
def test_masks_in_blocks(both, memory):
    """Blocks had no masks: rays of a large batch saw all instances."""
    scene, rays, masks = both["scene"], both["rays"], both["masks"]
    whole = scene.intersect(*rays, mask=masks)
    assert 0 < whole.is_hit.sum() < scene.intersect(*rays).is_hit.sum()
    for given in (masks, wp.array(masks, dtype=wp.uint32, device="cpu")):
        t = np.empty(4000, dtype=np.float32)
        assert scene.intersect_blocks(*rays, mask=given, memory=memory).write({"t": t}) == 4000
        np.testing.assert_array_equal(t, whole.t)
    dark, count = np.empty(4000, dtype=bool), np.empty(4000, dtype=np.int32)
    scene.occluded_blocks(*rays, mask=masks, memory=memory).write(dark)
    scene.count_blocks(*rays, mask=masks, memory=memory).write(count)
    np.testing.assert_array_equal(dark, scene.occluded(*rays, mask=masks))
    np.testing.assert_array_equal(count, scene.count(*rays, mask=masks))


def test_masks_in_blocks_broadcast(both):
    """One number, one for each column, and one for each row."""
    scene, (origins, directions) = both["scene"], both["rays"]
    rays = origins.reshape(100, 40, 3), directions.reshape(100, 40, 3)
    for mask in (5, both["masks"][:40], both["masks"][:100, None], np.uint32(3)):
        parts = [hits.t for _, hits in scene.intersect_blocks(*rays, mask=mask, memory="100 kB")]
        assert len(parts) > 1
        np.testing.assert_array_equal(np.concatenate(parts), scene.intersect(*rays, mask=mask).t)
    pairs = iter([(origins[:9], directions[:9]), (origins[9:], directions[9:])])
    parts = [hits.t for _, hits in scene.intersect_blocks(pairs, mask=6)]
    np.testing.assert_array_equal(np.concatenate(parts), scene.intersect(origins, directions, mask=6).t)
    with pytest.raises(ValueError, match=r"one number, not of shape \(4000,\), if the rays come from an iterator"):
        scene.intersect_blocks(iter([(origins, directions)]), mask=both["masks"])
    with pytest.raises(ValueError, match="mask needs instances"):
        next(iter(both["flat"].intersect_blocks(origins, directions, mask=1)))


def test_masks_in_plans(both):
    """The plan of rays with masks is the one by which they are traced, where a call is not a trial of another one."""
    scene, rays, masks = both["scene"], both["rays"], both["masks"]
    wrt.device.set_auto("rules")
    try:
        explained, traced = scene.explain(*rays, mask=masks), scene.intersect(*rays, mask=masks).plan
    finally:
        wrt.device.set_auto(None)
    assert replace(explained, reason=traced.reason) == traced  # which says, too, what was not compiled yet
    with pytest.raises(ValueError, match="does not broadcast"):
        scene.explain(*rays, mask=masks[:7])


@pytest.mark.parametrize("query", ["occluded", "count"])
def test_same_answers_as_one_level(both, query):
    """Of rays in general position; triangles are rounded in other spaces, so a ray at a silhouette may differ."""
    rng, (low, high) = np.random.default_rng(2), both["scene"].bounds
    rays = rng.uniform(low - 1, high + 1, (4000, 3)), rng.normal(size=(4000, 3))
    flat, own = (getattr(both[name], query)(*rays) for name in ("flat", "scene"))
    assert 0.1 < (own > 0).mean() < 0.9
    assert (flat != own).mean() < 0.002


@pytest.fixture(scope="module")
def turned():
    """Ten teapots that are turned, sheared, stretched and partly mirrored, in environments and with masks; random rays."""
    pot, rng = wrt.scenes.build("teapot", level=2, ground=False), np.random.default_rng(3)
    members = []
    for n in range(10):
        matrix = np.eye(4)
        matrix[:3, :3] = np.diag([1.0 + 0.1 * n, -1.0 if n % 3 == 0 else 1.0, 1.0 - 0.05 * n])
        matrix[:3, :3] = matrix[:3, :3] @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix[:3, 3] = [4.0 * (n % 4), 4.0 * (n // 4), 0.3 * n]
        members.append(wrt.Instance(pot, matrix, mask=1 << n, environment=n % 3 - 1))
    scene = wrt.Scene(members, device="cpu")
    low, high = scene.bounds
    rays = rng.uniform(low - 1, high + 1, (4000, 3)), rng.normal(size=(4000, 3))
    sight = {"mask": rng.integers(0, 1 << 10, 4000).astype(np.uint32), "environment": rng.integers(-1, 3, 4000)}
    return {"scene": scene, "flat": wrt.Scene(scene.flattened(), device="cpu"), "rays": rays, "sight": sight}


def in_scene(hits: wrt.Hits) -> np.ndarray:
    """Numbers of the triangles, counted through all instances."""
    return hits.batch.primitive.numpy().reshape(hits.shape)


def test_skip(turned):
    """It was refused. Judged by the triangles in one tree, and by masks that hide whatever is not asked for."""
    scene, flat, rays, sight = (turned[name] for name in ("scene", "flat", "rays", "sight"))
    hits, other = scene.intersect(*rays), flat.intersect(*rays)
    np.testing.assert_array_equal(in_scene(hits), other.primitive_id)
    behind, expected = scene.intersect(*rays, skip=hits), flat.intersect(*rays, skip=other)
    assert (in_scene(behind) != in_scene(hits)).sum() == hits.is_hit.sum() > 500
    np.testing.assert_array_equal(in_scene(behind), expected.primitive_id)
    np.testing.assert_array_equal(scene.count(*rays, skip=hits), flat.count(*rays, skip=other))
    np.testing.assert_array_equal(scene.occluded(*rays, skip=hits), behind.is_hit)
    seen = scene.intersect(*rays, **sight)
    np.testing.assert_array_equal(scene.count(*rays, skip=seen, **sight), scene.count(*rays, **sight) - seen.is_hit)
    blocks = [part for _, part in scene.count_blocks(*rays, skip=hits, memory="200 kB")]
    assert len(blocks) > 1
    np.testing.assert_array_equal(np.concatenate(blocks), scene.count(*rays, skip=hits))
    with pytest.raises(ValueError, match="one instance, and the scene has 10"):
        scene.intersect(*rays, skip=np.zeros(4000, dtype=int))
    alone = wrt.Scene([scene.instances[4]], device="cpu")
    found = alone.intersect(*rays)
    np.testing.assert_array_equal(alone.count(*rays, skip=found.primitive_id), alone.count(*rays) - (found.primitive_id >= 0))


def test_skip_refuses_hits_of_instances_that_are_gone(turned):
    """Instances after the removed one have other numbers, and another triangle would have been ignored."""
    scene, rays = wrt.Scene(turned["scene"].instances, device="cpu"), turned["rays"]
    hits = scene.intersect(*rays)
    scene.update(3, transform=scene.instances[3].transform)
    scene.intersect(*rays, skip=hits)
    scene.remove(0)
    with pytest.raises(ValueError, match="hits of another scene"):
        scene.intersect(*rays, skip=hits)


def woop_in_float64(vertices: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """The closest hit of a ray with (F, 3, 3) triangles by brute force; (inf, -1) for a miss."""
    z = int(np.abs(direction).argmax())
    x, y = (z + 1) % 3, (z + 2) % 3
    t = (vertices[..., z] - origin[z]) / direction[z]
    px, py = (vertices[..., k] - origin[k] - direction[k] * t for k in (x, y))
    area = np.stack([px[:, (k + 1) % 3] * py[:, (k + 2) % 3] - py[:, (k + 1) % 3] * px[:, (k + 2) % 3] for k in range(3)])
    total = area.sum(axis=0)
    met = ((area >= 0).all(axis=0) | (area <= 0).all(axis=0)) & (total != 0)
    at = np.where(met, (area * t.T).sum(axis=0) / np.where(total == 0, 1.0, total), np.inf)
    at[at < 0] = np.inf
    best = int(at.argmin())
    return (at[best], best) if np.isfinite(at[best]) else (np.inf, -1)


def test_precise(turned):
    """It was refused. Brute force in float64 over all instances, and the mapped triangles in one tree."""
    scene, flat, rays, sight = (turned[name] for name in ("scene", "flat", "rays", "sight"))
    hits, other = scene.intersect(*rays, precise=True), flat.intersect(*rays, precise=True)
    np.testing.assert_array_equal(in_scene(hits), other.primitive_id)
    assert hits.t.dtype == hits.position.dtype == hits.normal.dtype == np.float64
    np.testing.assert_allclose(hits.t, other.t, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(hits.position, other.position, atol=1e-12)
    np.testing.assert_allclose(hits.normal, other.normal, atol=1e-12)
    corners = flat.meshes[0].vertices[flat.meshes[0].faces]
    for ray in range(200):
        t, triangle = woop_in_float64(corners, rays[0][ray], rays[1][ray])
        assert in_scene(hits)[ray] == triangle
        np.testing.assert_allclose(hits.t[ray], t, rtol=1e-12)
    seen = scene.intersect(*rays, precise=True, **sight)
    np.testing.assert_array_equal(seen.instance_id, scene.intersect(*rays, **sight).instance_id)
    assert 0.05 < seen.is_hit.mean() < 0.9 * hits.is_hit.mean()


def test_precise_far_away_and_equally_far(turned):
    """Instances at 1e7 resolve what float32 cannot; of coincident instances the earlier one counts."""
    matrix = np.eye(4)
    matrix[:3, 3] = 1e7, -1e7, 1e7
    pot = turned["scene"].meshes[0]
    scene = wrt.Scene([wrt.Instance(pot, matrix), wrt.Instance(pot, matrix)], device="cpu")
    low, high = pot.bounds
    rng = np.random.default_rng(1)
    origins, directions = rng.uniform(low - 1, high + 1, (500, 3)), rng.normal(size=(500, 3))
    hits = scene.intersect(origins + matrix[:3, 3], directions, precise=True)
    near = wrt.Scene(pot, device="cpu").intersect((origins + matrix[:3, 3]) - matrix[:3, 3], directions, precise=True)
    np.testing.assert_array_equal(hits.primitive_id, near.primitive_id)
    np.testing.assert_array_equal(np.unique(hits.instance_id), [-1, 0])
    np.testing.assert_allclose(hits.t, near.t, atol=1e-8)


@wrt.device.kernel
def ask_instances(
    first: int,
    scene: wrt.device.SceneHandle,
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3),
    masks: wp.array(dtype=wp.uint32),
    environments: wp.array(dtype=int),
    closest: wp.array(dtype=wrt.device.Hit),
    positions: wp.array(dtype=wp.vec3d),
    counts: wp.array(dtype=int),
):
    """Item: a ray, which sees some instances; all its hits are counted one after the other."""
    i = first + wp.tid()
    mine = wrt.device.seeing(scene, masks[i], environments[i])
    hit = wrt.device.closest_hit(mine, origins[i], directions[i], 0.0, wp.inf)
    closest[i] = hit
    positions[i] = wrt.device.position(mine, hit)
    number = int(0)
    hit = wrt.device.first_hit(mine, origins[i], directions[i], 0.0, wp.inf)
    while hit.primitive_id >= 0:
        number += 1
        hit = wrt.device.next_hit(mine, origins[i], directions[i], hit, wp.inf)
    counts[i] = number


def test_own_kernels(turned):
    """They needed scenes without instances. The answers of batch queries, to the bit."""
    scene, rays, sight = turned["scene"], turned["rays"], turned["sight"]
    types = (wp.vec3d, wp.vec3, wp.uint32, int)
    given = [wp.array(v, dtype=t, device="cpu") for v, t in zip((*rays, *sight.values()), types, strict=True)]
    found = [wp.zeros(4000, dtype=dtype, device="cpu") for dtype in (wrt.device.Hit, wp.vec3d, int)]
    wrt.device.launch(ask_instances, 4000, [scene.handle(), *given, *found], device="cpu")
    closest, positions, counts = (values.numpy() for values in found)
    hits = scene.intersect(*rays, **sight)
    for name in ("t", "uv", "primitive_id", "geometry_id", "instance_id"):
        np.testing.assert_array_equal(closest[name], getattr(hits, name))
    np.testing.assert_array_equal(positions, hits.position)
    np.testing.assert_array_equal(counts, scene.count(*rays, **sight))
    assert counts.max() > 2
    handle = scene.handle(mask=6, environment=1)
    assert (int(handle.mask.value), handle.environment) == (6, 1)
    with pytest.raises(ValueError, match="mask and environment of a handle needs instances"):
        turned["flat"].handle(mask=1)


@wp.kernel(module="unique")
def weigh(
    t: wp.array(dtype=wp.float64),
    positions: wp.array(dtype=wp.vec3d),
    normals: wp.array(dtype=wp.vec3d),
    weights: wp.array(dtype=wp.float64),
    loss: wp.array(dtype=wp.float64),
):
    """Item: a ray. Some function of all that a hit has."""
    i = wp.tid()
    if t[i] < wp.float64(1e30):
        own = t[i] + wp.float64(0.3) * positions[i][1] + wp.float64(0.2) * normals[i][2]
        wp.atomic_add(loss, 0, weights[i] * own)


def loss_with_gradients(scene: wrt.Scene, hits: wrt.Hits, *arrays: wp.array) -> float:
    """The loss of recomputed hits; the arrays get gradients."""
    loss = wp.zeros(1, dtype=wp.float64, requires_grad=True, device="cpu")
    weights = wp.array(np.random.default_rng(1).normal(size=len(hits.t)), dtype=wp.float64, device="cpu")
    with wp.Tape() as tape:
        found = wrt.device.differentiable_hits(scene, hits, *arrays)
        wp.launch(weigh, dim=len(weights), inputs=[found.t, found.position, found.normal, weights, loss], device="cpu")
    tape.backward(loss)
    return float(loss.numpy()[0])


def test_gradients(turned):
    """They died. Of rays, as of the triangles in one tree; of vertices, by the chain rule; of transforms, by differences."""
    scene, flat = turned["scene"], turned["flat"]
    rays = [values[:300] for values in turned["rays"]]
    hits, other = scene.intersect(*rays), flat.intersect(*rays)
    maps = np.array([one.transform for one in scene.instances])

    def on_tape(values: np.ndarray, dtype: type = wp.vec3d) -> wp.array:
        return wp.array(values, dtype=dtype, requires_grad=True, device="cpu")

    ours = [*map(on_tape, rays), on_tape(scene.meshes[0].vertices.astype(np.float64)), on_tape(maps, wp.mat44d)]
    theirs = [*map(on_tape, rays), on_tape(flat.meshes[0].vertices)]
    loss = loss_with_gradients(scene, hits, *ours)
    assert loss == pytest.approx(loss_with_gradients(flat, other, *theirs), rel=1e-12)
    for one, two in zip(ours[:2], theirs[:2], strict=True):
        np.testing.assert_allclose(one.grad.numpy(), two.grad.numpy(), atol=1e-11)
        assert np.abs(one.grad.numpy()).max() > 0.1
    each = theirs[2].grad.numpy().reshape(10, -1, 3)
    np.testing.assert_allclose(ours[2].grad.numpy(), np.einsum("kva,kab->vb", each, maps[:, :3, :3]), atol=1e-10)
    step, slopes = 1e-6, ours[3].grad.numpy()
    for place in [(0, 0, 1), (3, 2, 3), (5, 1, 1), (9, 0, 3)]:
        sides = []
        for sign in (-1.0, 1.0):
            moved = maps.copy()
            moved[place] += sign * step
            sides.append(loss_with_gradients(scene, hits, *ours[:3], on_tape(moved, wp.mat44d)))
        assert slopes[place] == pytest.approx((sides[1] - sides[0]) / (2 * step), rel=1e-6, abs=1e-6)
    assert np.abs(slopes[:, :3]).max() > 1.0


def test_gradients_of_poses(turned):
    """Of positions and quaternions, as simulators hold them, beside the matrices that they make."""
    pot, turn = turned["scene"].meshes[0], np.array([0.2, -0.3, 0.5, 0.8])
    turn /= np.linalg.norm(turn)
    pose = wp.array([[1.0, 2.0, 3.0, *turn]], dtype=wp.transformd, requires_grad=True, device="cpu")
    scene = wrt.Scene([wrt.Instance(pot)], device="cpu")
    scene.update([0], transform=pose)
    rays = [np.random.default_rng(2).normal(size=(300, 3)) for _ in range(2)]
    hits = scene.intersect(rays[0] + [1.0, 2.0, 3.0], rays[1])
    matrix = wp.array(np.array([scene.instances[0].transform]), dtype=wp.mat44d, requires_grad=True, device="cpu")
    given = [wp.array(v, dtype=wp.vec3d, device="cpu") for v in (rays[0] + [1.0, 2.0, 3.0], rays[1])]
    losses = [loss_with_gradients(scene, hits, *given, None, one) for one in (pose, matrix)]
    assert losses[0] == pytest.approx(losses[1], rel=1e-12)
    np.testing.assert_allclose(pose.grad.numpy()[0, :3], matrix.grad.numpy()[0, :3, 3], rtol=1e-10)
    assert np.abs(pose.grad.numpy()[0, 3:]).max() > 0.1


def test_what_makes_no_sense_says_so(both, tmp_path):
    """Each message names what to do instead."""
    scene, flat, rays = both["scene"], both["flat"], both["rays"]
    hits = scene.intersect(*rays)
    with pytest.raises(ValueError, match=r"wrt\.Scene\(scene\.flattened\(\)\)"):
        wrt.known_rays.analyse(scene)
    with pytest.raises(ValueError, match="transforms needs instances"):
        wrt.device.differentiable_hits(flat, flat.intersect(*rays), *rays, transforms=np.eye(4)[None])
    with pytest.raises(ValueError, match=r"pass \(10, 4, 4\)"):
        wrt.device.differentiable_hits(scene, hits, *rays, transforms=np.eye(4)[None])
    with pytest.raises(TypeError, match="mat44"):
        wrt.device.differentiable_hits(scene, hits, *rays, transforms=wp.zeros(10, dtype=wp.vec3, device="cpu"))
    scene.save(tmp_path / "scene.npz")
    assert_same_hits(wrt.Scene.load(tmp_path / "scene.npz", device="cpu").intersect(*rays), hits)
    origins = hits.spawn(-rays[1])
    assert np.isfinite(origins[hits.is_hit]).all()
