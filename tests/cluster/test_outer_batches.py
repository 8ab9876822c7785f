"""Batches that are reduced along their first axis: points and suns are exchanged, and nothing else changes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import wrt
from wrt.query.blocks import BYTES_PER_RAY

SUNS, POINTS = 24, 300


@pytest.fixture(scope="module")
def batch() -> SimpleNamespace:
    """Shadow rays of 24 suns from 300 points of a teapot, and what is true of each."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")
    rng = np.random.default_rng(5)
    at = scene.intersect(rng.uniform(-3.0, 3.0, (POINTS, 3)) * [1.0, 1.0, 0.0] + np.array([0.0, 0.0, 9.0]), [0.0, 0.0, -1.0])
    points = np.where(at.is_hit[:, None], at.position, rng.uniform(-1.0, 1.0, (POINTS, 3)))
    suns = np.abs(rng.normal(size=(SUNS, 3))).astype(np.float32)
    return SimpleNamespace(scene=scene, at=at, points=points, suns=suns[:, None], rng=rng)


@pytest.mark.parametrize("reduce", ["sum", "mean", "any", "all", "weights", "own"])
def test_reductions_along_the_first_axis(batch, reduce, tmp_path):
    """Those of NumPy on the whole answer, with arrays for each sun or each point, in any blocks and from a job's folder."""
    limits = {"t_min": batch.rng.uniform(0.0, 0.1, POINTS), "t_max": batch.rng.uniform(0.5, 9.0, (SUNS, 1)), "skip": batch.at}
    arguments = (batch.points, batch.suns)
    dark = batch.scene.occluded(*arguments, **{**limits, "skip": batch.at.primitive_id[None].repeat(SUNS, axis=0)})
    assert 0.1 < dark.mean() < 0.9
    weights = batch.rng.integers(0, 5, (3, SUNS)).astype(float)
    given = {"weights": wrt.batches.WeightedSum(weights), "own": Odd()}.get(reduce, reduce)
    own = {"weights": dark.T @ weights.T, "own": dark.sum(axis=0) % 2}
    expected = own[reduce] if reduce in own else getattr(dark, reduce)(axis=0)
    for rows in (1, 7, 10**6):
        blocks = batch.scene.occluded_blocks(*arguments, **limits, reduce=given, axis=0, memory=BYTES_PER_RAY * SUNS * rows)
        np.testing.assert_array_equal(blocks.result(), expected)
    small = batch.scene.occluded_blocks(*arguments, **limits, reduce=given, axis=-2, memory=BYTES_PER_RAY * SUNS * 50)
    job = wrt.cluster.Job(tmp_path / "job", small).run()
    np.testing.assert_array_equal(job.result(), expected)
    written = np.zeros_like(expected)
    small.write(written)
    np.testing.assert_array_equal(written, expected)


class Odd:
    """A reduction of a user's own: whether an odd number of values is true."""

    def part(self, values, axes):
        return values.sum(axis=axes) % 2

    def merge(self, one, other):
        return (one + other) % 2

    def finish(self, state):
        return state


def test_a_block_has_all_suns_of_some_points(batch, tmp_path):
    """What a job stores is then one state for each point, not one for each point and block."""
    memory = BYTES_PER_RAY * SUNS * 30
    blocks = batch.scene.occluded_blocks(batch.points, batch.suns, reduce="sum", axis=0, memory=memory)
    assert blocks.shape == (POINTS, SUNS)
    assert [(rows.start, len(answer)) for rows, answer in blocks] == [(30 * k, 30) for k in range(10)]  # can be iterated
    weighted = wrt.batches.WeightedSum(np.ones((12, SUNS)))
    stored = []
    for number, size in enumerate((30, 150)):
        blocks = batch.scene.occluded_blocks(
            batch.points, batch.suns, reduce=weighted, axis=0, memory=BYTES_PER_RAY * SUNS * size
        )
        job = wrt.cluster.Job(tmp_path / str(number), blocks).run()
        stored.append(job.status.bytes - job.status.blocks * 2000)  # but for the names in each file
    assert max(stored) < 1.2 * POINTS * 12 * 8


@pytest.mark.parametrize("apart", [0.01, 1e4])
def test_near_places_are_neighbours_of_a_block(batch, apart, monkeypatch):
    """Blocks of places that are nearer to each other than rays to two suns are traced sun by sun; answers are the same."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 20), np.linspace(-1.0, 1.0, 15))
    points = np.stack([x, y, np.full_like(x, 9.0)], axis=-1).reshape(-1, 3)
    at = batch.scene.intersect(points, [0.0, 0.0, -1.0])
    points = np.where(at.is_hit[:, None], at.position, points) * [apart, apart, 1.0]
    limits = {"t_min": batch.rng.uniform(0.0, 0.1, POINTS), "t_max": batch.rng.uniform(0.5, 9.0, (SUNS, 1)), "skip": at}
    dark = batch.scene.occluded(points, batch.suns, **{**limits, "skip": at.primitive_id[None].repeat(SUNS, axis=0)})
    shapes, occluded = [], wrt.Scene.occluded
    monkeypatch.setattr(
        wrt.Scene, "occluded", lambda self, rays, **own: shapes.append(rays.shape) or occluded(self, rays, **own)
    )
    for reduce in ("sum", wrt.batches.WeightedSum(np.ones(SUNS))):
        blocks = batch.scene.occluded_blocks(
            points, batch.suns, **limits, reduce=reduce, axis=0, memory=BYTES_PER_RAY * SUNS * 100
        )
        np.testing.assert_array_equal(blocks.result(), dark.sum(axis=0))
    assert set(shapes) == {(SUNS, 100) if apart < 1.0 else (100, SUNS)}


def test_batches_that_stay_as_they_are(batch, tmp_path):
    """Rays of their own for each sun and point, arrays in files, functions of rows and of numbers, all axes reduced."""
    scene, shape = batch.scene, (SUNS, POINTS, 3)
    whole = np.broadcast_to(batch.points, shape).copy()
    on_disk = np.lib.format.open_memmap(tmp_path / "suns.npy", "w+", np.float32, batch.suns.shape)
    on_disk[:] = batch.suns
    made = wrt.batches.GeneratedRays(lambda first, count: (batch.points, batch.suns[first : first + count]), (SUNS, POINTS))
    dark = scene.occluded(batch.points, batch.suns)
    for rays in ((whole, batch.suns), (batch.points, on_disk), (made,)):
        blocks = scene.occluded_blocks(*rays, reduce="sum", axis=0, memory=BYTES_PER_RAY * POINTS * 5)
        assert blocks.shape == (SUNS, POINTS)
        np.testing.assert_array_equal(blocks.result(), dark.sum(axis=0))
        with pytest.raises(ValueError, match="leaves no rows"):
            next(iter(blocks))
    assert scene.occluded_blocks(batch.points, batch.suns, reduce="sum", axis=None).result() == dark.sum()
    kept = scene.occluded_blocks(batch.points, batch.suns, reduce="sum", axis=1)
    assert kept.shape == (SUNS, POINTS)
    np.testing.assert_array_equal(kept.result(), dark.sum(axis=1))
    of_rows = scene.occluded_blocks(batch.points, batch.suns, reduce=lambda values, axes: values, axis=0, memory=BYTES_PER_RAY)
    with pytest.raises(ValueError, match="cannot merge"):
        of_rows.result()
