"""What is found in the numbers of rays, against NumPy; and calls with what earlier ones left ready answer for their own."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.engine.facts.query_cache import MAX_PLANS
from wrt.engine.rays.coherence import detect_coherence

PAIRS = 64


def expected_look(origins: np.ndarray, directions: np.ndarray) -> tuple[bool, bool]:
    """Coherent and scattered, by the definition."""
    first = np.linspace(0, len(directions) - 2, PAIRS).astype(int)
    one, other = directions[first].astype(np.float64), directions[first + 1].astype(np.float64)
    with np.errstate(all="ignore"):
        lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
        alike = (one * other).sum(axis=1) / lengths > 0.966
        near = np.ones(PAIRS, dtype=bool)
        if len(origins) > 1:
            here = origins[first].astype(np.float64)
            step = np.abs(origins[first + 1] - here).sum(axis=1)
            near = step <= 0.1 * np.median(np.abs(here[::-1] - here).sum(axis=1))
    return bool((alike & near).mean() > 0.5), bool(near.mean() <= 0.5)


def expected_columns(directions: np.ndarray) -> int:
    """Columns of a picture, by the definition."""
    with np.errstate(all="ignore"):
        limit = 4.0 * np.abs(directions[1] - directions[0]).max()
        jumps = np.flatnonzero(np.abs(np.diff(directions[: (1 << 13) + 1], axis=0)).max(axis=1) > limit)
        columns = int(jumps[0]) + 1 if len(jumps) else 0
        if columns < 8 or len(directions) % columns or len(directions) < 8 * columns:
            return 0
        return columns if (np.abs(np.diff(directions[::columns], axis=0)) < limit).all() else 0


def arrays_of(*vectors: np.ndarray) -> list[wp.array]:
    return [wp.array(values, dtype=wp.vec3, device="cpu") for values in vectors]


def pixels(columns: int, rows: int) -> np.ndarray:
    y, x = np.mgrid[:rows, :columns] / 80.0
    return np.stack([x - 0.5, y - 0.5, np.ones_like(x)], axis=-1).reshape(-1, 3)


def test_looks_are_as_numpy_finds():
    """Views, noise, walks, spoiled numbers; every answer comes up often."""
    rng, seen = np.random.default_rng(0), []
    for _ in range(300):
        count = int(rng.choice([128, 129, 4096, 6401]))
        columns = int(rng.choice([4, 8, 64, 100, 700]))
        kinds = pixels(columns, -(-count // columns)), rng.normal(size=(count, 3)), rng.normal(size=3) + np.zeros((count, 3))
        directions = kinds[rng.integers(3)] + rng.normal(size=3) * rng.choice([0.0, 1e-3, 1.0])
        directions = (directions + rng.normal(size=directions.shape) * rng.choice([0.0, 0.0, 1e-4, 0.1])).astype(np.float32)
        origins = rng.normal(size=directions.shape) * rng.choice([1e-3, 1.0, 1e3])
        if rng.random() < 0.5:
            origins = np.cumsum(origins, axis=0)
        origins = origins.astype(np.float32)[: 1 if rng.random() < 0.5 else None]
        for values in (origins, directions):
            if rng.random() < 0.1:
                spoiled = rng.integers(len(values), size=int(len(values) * rng.random()))
                values[spoiled] = rng.choice(np.float32([0.0, np.nan, np.inf, 1e30]))
        found = detect_coherence(*arrays_of(origins, directions), wp.get_device("cpu"), len(origins) == 1)
        is_list = len(origins) == 1 and len(directions) >= 4096
        assert found == (*expected_look(origins, directions), expected_columns(directions) if is_list else 0)
        seen.append((*found[:2], found[2] > 0))
    assert all(0.02 < share < 0.98 for share in np.mean(seen, axis=0))


def test_few_rays_are_not_looked_at():
    rays = arrays_of(np.zeros((1, 3)), np.random.default_rng(0).normal(size=(2 * PAIRS - 1, 3)))
    assert detect_coherence(*rays, wp.get_device("cpu"), True) == (True, False, 0)


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=3), device="cpu")


def rays_of(scene: wrt.Scene, seed: int, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.flattened(), count, seed=seed)


def test_answers_by_what_is_ready_are_the_calls_own(scene):
    """Calls side by side, of other rays, numbers of rays, queries and layouts, leave each other's answers as they are."""
    batches = [rays_of(scene, seed, 2000 + 500 * seed) for seed in range(4)]
    batches.append((batches[0][0][:1], batches[0][1]))
    expected = [scene.intersect(*rays, traversal="single", counters=True) for rays in batches]

    def ask(number: int) -> tuple[wrt.Hits, np.ndarray]:
        rays = batches[number % len(batches)]
        return scene.intersect(*rays, traversal="single"), scene.occluded(*rays, traversal="single")

    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(ask, range(40)))
    for number, (hits, dark) in enumerate(answers):
        known = expected[number % len(batches)]
        assert_same_hits(hits, known)
        np.testing.assert_array_equal(dark, known.is_hit)
    kept = [prepared for chosen in scene.state.cache.plans for prepared in chosen.prepared.items()]
    assert 4 <= len(kept) < 40


def test_what_is_ready_goes_with_its_tree(scene):
    """After an update, the next call walks the new tree."""
    moving = wrt.Scene(scene.meshes, device="cpu")
    rays = rays_of(moving, 0)
    moving.intersect(*rays, traversal="single")
    moving.update(0, vertices=moving.meshes[0].vertices * 1.5)
    asked = moving.intersect(*rays, traversal="single")
    assert_same_hits(asked, moving.intersect(*rays, traversal="single", counters=True))


def test_so_many_kinds_of_queries_are_kept(scene):
    """The one after the last that there is room for begins anew, and the answers stay."""
    rays, own = rays_of(scene, 0), wrt.Scene(scene.meshes, device="cpu")
    expected = own.intersect(*rays, traversal="single")
    cache = own.state.cache
    for number in range(MAX_PLANS - len(cache.plans)):
        cache.keep_plan(number, None)
    assert_same_hits(own.intersect(*rays, traversal="single"), expected)
    assert len(cache.plans) == MAX_PLANS
    np.testing.assert_array_equal(own.occluded(*rays, traversal="single"), expected.is_hit)
    assert len(cache.plans) == 1


def test_nothing_stale(scene):
    """What was kept ready for a tree and its records is not used for others, also if the scene is the same one."""
    one, moved = (wrt.Scene(scene.meshes[0].transformed(np.diag([s, s, s, 1.0])), device="cpu") for s in (1.0, 0.5))
    rays = rays_of(one, 0)
    one.intersect(*rays, traversal="single")
    one.state = moved.state
    assert_same_hits(one.intersect(*rays, traversal="single"), moved.intersect(*rays, traversal="single"))
