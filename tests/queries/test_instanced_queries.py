"""Every query of a scene of instances: it answers as a scene of one level does, or says what to do instead."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from conftest import assert_same_hits, mixed_rays

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
    with pytest.raises(ValueError, match="one number if the rays come from an iterator"):
        scene.intersect_blocks(iter([(origins, directions)]), mask=both["masks"])
    with pytest.raises(ValueError, match="mask needs instances"):
        next(iter(both["flat"].intersect_blocks(origins, directions, mask=1)))


def test_masks_in_plans(both):
    """The plan of rays with masks is the one by which they are traced."""
    scene, rays, masks = both["scene"], both["rays"], both["masks"]
    assert scene.explain(*rays, mask=masks) == scene.intersect(*rays, mask=masks).plan
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


def test_what_makes_no_sense_says_so(both, tmp_path):
    """Each message names the call to make instead, and that call works."""
    scene, rays = both["scene"], both["rays"]
    hits = scene.intersect(*rays)
    for call in (
        lambda: scene.intersect(*rays, skip=hits),
        lambda: scene.count(*rays, skip=hits),
        lambda: scene.intersect(*rays, precise=True),
        lambda: wrt.differentiable_hits(scene, hits, *rays),
        lambda: scene.handle(),
    ):
        with pytest.raises(ValueError, match=r"wrt\.Scene\(scene\.flattened\(\)"):
            call()
    scene.save(tmp_path / "scene.npz")
    assert_same_hits(wrt.Scene.load(tmp_path / "scene.npz", device="cpu").intersect(*rays), hits)
    flat = both["flat"]
    there = flat.intersect(*rays)
    flat.intersect(*rays, skip=there)
    flat.intersect(*rays, precise=True)
    wrt.differentiable_hits(flat, there, *rays)
    flat.handle()
    origins = hits.spawn(-rays[1])
    assert np.isfinite(origins[hits.is_hit]).all()
