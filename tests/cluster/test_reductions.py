"""Reductions of batches: those of NumPy on the whole answer, exact, and the same however the batch is cut and in any order."""

from __future__ import annotations

from fractions import Fraction
from functools import reduce as fold
from operator import add

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from wrt.cluster.stored_answers import pack_answer, unpack_answer
from wrt.query.batches.exact_sums import exact_sum
from wrt.query.batches.reductions import REDUCTIONS, OfRows, as_block_reduction
from wrt.query.batches.weighted_sums import sums_of_columns
from wrt.query.blocks import BYTES_PER_RAY


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = mixed_rays(scene.meshes[0], 3000, seed=4)
    return origins.reshape(60, 50, 3), directions.reshape(60, 50, 3)


def correctly_rounded(values: np.ndarray) -> float:
    """The sum in rational numbers, rounded once."""
    total = sum(map(Fraction, values.reshape(-1).tolist()), Fraction(0))
    try:
        return total.numerator / total.denominator
    except OverflowError:
        return float("inf") if total > 0 else float("-inf")


def wide_values(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Values of every size: near each other, over all exponents with opposite ones among them, and the smallest there are."""
    if kind == "distances":
        return rng.uniform(0.0, 300.0, count).astype(np.float32)
    if kind == "float32":
        values = rng.integers(0, 1 << 32, count, dtype=np.uint32).view(np.float32)
    elif kind == "float64":
        values = rng.integers(0, 1 << 63, count, dtype=np.uint64).view(np.float64) * rng.choice([-1.0, 1.0], count)
    else:
        values = rng.integers(0, 1 << 54, count, dtype=np.uint64).view(np.float64)
    values = np.where(np.isfinite(values), values, values.dtype.type(1.0))
    values[: count // 3] = -values[count // 3 : 2 * (count // 3)]
    return values


@pytest.mark.parametrize("kind", ["distances", "float32", "float64", "smallest"])
def test_sums_of_floats_are_exact(kind):
    """In any order and any division, of numbers whose float64 sum would lose all digits."""
    rng = np.random.default_rng(7)
    for count in (0, 1, 2, 50, 700):
        values = wide_values(kind, count, rng)
        expected = correctly_rounded(values)
        for _ in range(4):
            shuffled = rng.permutation(values)
            parts = np.split(shuffled, np.sort(rng.integers(0, count + 1, 5)))
            rng.shuffle(parts)
            with np.errstate(over="ignore"):
                total = fold(add, [exact_sum(part, (0,)) for part in parts]).rounded()
            assert np.float64(total).tobytes() == np.float64(expected + 0.0).tobytes()


@pytest.mark.parametrize("axis", [0, 1])
def test_weighted_sums(scene, rays, axis, tmp_path):
    """In groups, along either axis: those of rational numbers, the same bits for any blocks, also from a job's folder."""
    rng = np.random.default_rng(3)
    dark = scene.occluded(*rays)
    count = dark.shape[axis]
    weights = rng.uniform(-1.0, 1.0, (4, count)) * 10.0 ** rng.integers(-12, 12, (4, 1))
    weights[1] = np.arange(count) % 3 == 0
    reduction = wrt.batches.WeightedSum(weights)
    whole = scene.occluded_blocks(*rays, reduce=reduction, axis=axis).result()
    assert whole.shape == (dark.shape[1 - axis], 4)
    for rows, flags in zip(whole[:10], np.moveaxis(dark, axis, 1)[:10], strict=True):
        exact = [float(sum(map(Fraction, one[flags].tolist()), Fraction(0))) for one in weights]
        scale = np.abs(weights).sum(axis=1)
        np.testing.assert_allclose(rows, exact, rtol=0, atol=2.0**-51 * scale.max() * count)
        assert rows[1] == exact[1]  # whole numbers stay so
    for size in (1, 7, 33):
        memory = BYTES_PER_RAY * size * dark.shape[1]
        parts = scene.occluded_blocks(*rays, reduce=reduction, axis=axis, memory=memory)
        np.testing.assert_array_equal(parts.result(), whole)
    job = wrt.cluster.Job(tmp_path / "job", parts)
    np.testing.assert_array_equal(job.run(most=1).run().result(), whole)
    with pytest.raises(ValueError, match="other options"):
        wrt.cluster.Job(tmp_path / "job", scene.occluded_blocks(*rays, reduce=wrt.batches.WeightedSum(-weights), axis=axis))
    one = scene.occluded_blocks(*rays, reduce=wrt.batches.WeightedSum(weights[1]), axis=axis).result()
    np.testing.assert_array_equal(one, whole[:, 1])
    lit = scene.intersect_blocks(*rays, reduce={"is_hit": wrt.batches.WeightedSum(weights[1])}, axis=axis).result()
    assert lit["is_hit"].shape == one.shape


@pytest.mark.parametrize("shape", [(7, 3, 1), (130, 2, 257), (65, 600, 1), (0, 5, 2), (4, 0, 2)])
def test_sums_of_columns_in_any_layout(shape):
    """Tiles that are not full, more rows than are copied at a time, rows in no group and in all, and arrays without values."""
    rng = np.random.default_rng(8)
    values, weights = rng.random(shape) < 0.4, np.rint(rng.normal(0.0, 1e9, (3, shape[0])))
    weights[:, ::3], weights[1, 1::3] = 0.0, 0.0
    expected = np.tensordot(values.astype(float), weights, (0, 1)).reshape(-1, 3)
    for layout in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):  # all give the same array, laid out in memory in another order
        stored = np.ascontiguousarray(values.transpose(layout))
        np.testing.assert_array_equal(sums_of_columns(stored.transpose(np.argsort(layout)), weights), expected)


def test_weights_that_do_not_fit(scene, rays):
    for wrong in ([], [[]], [np.nan], [1e308, 1e308], [[[1.0]]]):
        with pytest.raises(ValueError, match="weights"):
            wrt.batches.WeightedSum(wrong)
    with pytest.raises(TypeError, match="weights"):
        wrt.batches.WeightedSum(["a"])
    with pytest.raises(ValueError, match="one axis of this length"):
        scene.occluded_blocks(*rays, reduce=wrt.batches.WeightedSum(np.ones(50)), axis=0)
    with pytest.raises(ValueError, match="one axis of this length"):
        scene.occluded_blocks(*rays, reduce=wrt.batches.WeightedSum(np.ones(3000)))
    with pytest.raises(TypeError, match="booleans"):
        scene.count_blocks(*rays, reduce=wrt.batches.WeightedSum(np.ones(60)), axis=0).result()
    tiny = wrt.batches.WeightedSum([5e-324, 1e-310])
    assert tiny.finish(tiny.part(np.array([True, False]), (0,))) == 5e-324


def test_sums_of_what_is_not_finite():
    """As NumPy adds them: an infinity, NaN of both, NaN of one."""
    values = np.float32([[1, np.inf, 2], [np.inf, -np.inf, 0], [np.nan, 1, 1], [3, 4, 5]])
    with np.errstate(invalid="ignore"):
        expected = values.sum(axis=1, dtype=np.float64)
    np.testing.assert_array_equal(exact_sum(values, (1,)).rounded(), expected)
    np.testing.assert_array_equal(REDUCTIONS["mean"].finish(REDUCTIONS["mean"].part(values, (1,))), expected / 3)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_blocks_with_what_is_not_finite(dtype):
    """In some blocks only, whatever the order in which they are merged, and through the files of a job: an infinity or a NaN of
    one block is that of the sum, opposite infinities of two blocks are a NaN, and rows without them stay exact."""
    values = np.array(
        [
            [1.0, 2.0, 3.0, 4.0],
            [np.inf, 1e30, 1e-30, 2.0],
            [1e30, 1e-30, 2.0, -np.inf],
            [np.inf, 1e30, -1e30, -np.inf],
            [np.nan, np.inf, 1e-30, 1.0],
            [np.inf, np.inf, np.inf, np.inf],
            [np.nan, np.nan, -np.inf, -np.inf],
        ],
        dtype,
    )
    with np.errstate(invalid="ignore"):
        expected = values.sum(axis=1, dtype=np.float64)
    for order in ((0, 1, 2, 3), (3, 0, 2, 1), (2, 3, 1, 0)):
        for name, divisor in (("sum", 1), ("mean", 4)):
            reduction = REDUCTIONS[name]
            parts = [reduction.part(values[:, column : column + 1], (1,)) for column in order]
            parts = [unpack_answer(pack_answer(part)) for part in parts]
            with np.errstate(invalid="ignore"):
                state = unpack_answer(pack_answer(fold(reduction.merge, parts)))
            np.testing.assert_array_equal(reduction.finish(state), expected / divisor)


NUMPY = {"sum": np.sum, "mean": np.mean, "min": np.min, "max": np.max, "any": np.any, "all": np.all}


@pytest.mark.parametrize("axis", [None, 0, 1, -1, (0, 1)])
@pytest.mark.parametrize("name", REDUCTIONS)
def test_as_numpy_does(scene, rays, name, axis):
    dark, count = scene.occluded(*rays), scene.count(*rays)
    for memory in (7 * 50 * BYTES_PER_RAY, "256 MB"):
        for whole, query in ((dark, scene.occluded_blocks), (count, scene.count_blocks)):
            result = query(*rays, memory=memory, reduce=name, axis=axis).result()
            expected = NUMPY[name](whole, axis=axis)
            np.testing.assert_array_equal(result, expected)
            assert result.dtype == (np.int64 if name == "sum" else expected.dtype)


def test_closest_hits(scene, rays):
    """Several attributes, each reduced in its own way; vectors keep their components."""
    hits = scene.intersect(*rays)
    edges = np.linspace(0.0, 4.0, 9)
    wanted = {"t": "min", "is_hit": "mean", "uv": "sum", "primitive_id": wrt.batches.Histogram([-1, 0, 100, 10_000])}
    results = [
        scene.intersect_blocks(*rays, memory=memory, reduce=wanted, axis=axis).result()
        for axis in (1, 0)
        for memory in (BYTES_PER_RAY, 11 * 50 * BYTES_PER_RAY, "256 MB")
    ]
    for axis, some in ((1, results[:3]), (0, results[3:])):
        for one in some:
            assert one.keys() == wanted.keys()
            for name in wanted:
                np.testing.assert_array_equal(one[name], some[0][name])
        np.testing.assert_array_equal(some[0]["t"], hits.t.min(axis=axis))
        np.testing.assert_array_equal(some[0]["is_hit"], hits.is_hit.mean(axis=axis))
        np.testing.assert_allclose(some[0]["uv"], hits.uv.sum(axis=axis, dtype=np.float64), rtol=1e-14)
        expected = [np.histogram(row, [-1, 0, 100, 10_000])[0] for row in np.moveaxis(hits.primitive_id, axis, -1)]
        np.testing.assert_array_equal(some[0]["primitive_id"], expected)
    counted = scene.intersect_blocks(*rays, reduce={"t": wrt.batches.Histogram(edges)}).result()["t"]
    np.testing.assert_array_equal(counted, np.histogram(hits.t[np.isfinite(hits.t)], edges)[0])


def test_reduced_rows(scene, rays):
    """Without the first axis, blocks have reduced rows, and arrays hold them."""
    expected = scene.occluded(*rays).sum(axis=1)
    blocks = scene.occluded_blocks(*rays, memory=7 * 50 * BYTES_PER_RAY, reduce="sum", axis=1)
    np.testing.assert_array_equal(np.concatenate([answer for _, answer in blocks]), expected)
    out = np.zeros(60, dtype=np.int64)
    assert blocks.write(out) == blocks.done == 60
    np.testing.assert_array_equal(out, expected)
    longest = scene.occluded_blocks(*rays, reduce=lambda dark, axes: dark.argmax(axis=axes[0]), axis=1).result()
    np.testing.assert_array_equal(longest, scene.occluded(*rays).argmax(axis=1))


def test_a_reduction_of_ones_own(scene, rays):
    class Product:
        """Of the values plus one, modulo a prime: exact, and the same in any order."""

        def part(self, values, axes):
            return int(np.prod([int(one) + 1 for one in values.reshape(-1)], dtype=object) % 65537)

        def merge(self, one, other):
            return one * other % 65537

        def finish(self, state):
            return np.int64(state)

    results = {int(scene.count_blocks(*rays, memory=size, reduce=Product()).result()) for size in (1, 400_000, "1 GB")}
    assert len(results) == 1


def test_iterators(scene, rays):
    items = [(rays[0][:10], rays[1][:10]), (rays[0][10:], rays[1][10:])]
    assert scene.occluded_blocks(iter(items), memory=5000, reduce="sum").result() == scene.occluded(*rays).sum()
    rows = scene.occluded_blocks(iter(items), memory=5000, reduce="sum", axis=1).result()
    np.testing.assert_array_equal(rows, scene.occluded(*rays).sum(axis=1))
    with pytest.raises(ValueError, match="no rays"):
        scene.occluded_blocks(iter([]), reduce="sum").result()


def test_no_rays(scene, rays):
    none = rays[0][:0], rays[1][:0]
    assert scene.occluded_blocks(*none, reduce="sum").result() == 0
    assert scene.occluded_blocks(*none, reduce="sum", axis=1).result().shape == (0,)
    assert np.isnan(scene.count_blocks(*none, reduce="mean").result())
    assert scene.occluded_blocks(*none).result().shape == (0, 50)


def test_refused(scene, rays):
    with pytest.raises(ValueError, match="'median' is unknown; choose from sum, mean"):
        scene.occluded_blocks(*rays, reduce="median")
    with pytest.raises(ValueError, match="Histogram"):
        scene.occluded_blocks(*rays, reduce="histogram")
    with pytest.raises(TypeError, match="reduce must be a name"):
        scene.occluded_blocks(*rays, reduce=3)
    with pytest.raises(ValueError, match="dict"):
        scene.intersect_blocks(*rays, reduce="min")
    with pytest.raises(ValueError, match="'depth'; choose from t"):
        scene.intersect_blocks(*rays, reduce={"depth": "min"})
    for axis in (2, -3, (0, 0), (1, -1)):
        with pytest.raises(ValueError, match="axis"):
            scene.occluded_blocks(*rays, reduce="sum", axis=axis)
    with pytest.raises(TypeError, match="axis"):
        scene.occluded_blocks(*rays, reduce="sum", axis="rows")
    with pytest.raises(ValueError, match="axis needs reduce"):
        scene.occluded_blocks(*rays, axis=1)
    with pytest.raises(ValueError, match="increasing"):
        wrt.batches.Histogram([1.0, 1.0])
    with pytest.raises(ValueError, match="result"):
        iter(scene.occluded_blocks(*rays, reduce="sum"))
    with pytest.raises(ValueError, match="result"):
        scene.occluded_blocks(*rays, reduce="sum").write(np.zeros(60))
    with pytest.raises(ValueError, match="leave axis 0 out"):
        scene.occluded_blocks(*rays, memory=1, reduce=lambda dark, axes: dark[:, 0]).result()
    with pytest.raises(ValueError, match="keep the first axis"):
        scene.occluded_blocks(*rays, reduce=lambda dark, axes: dark.sum(), axis=1).result()
    with pytest.raises(ValueError, match="write"):
        scene.intersect_blocks(*rays).result()
    assert isinstance(as_block_reduction(np.ptp, 1, False).reductions[""], OfRows)
