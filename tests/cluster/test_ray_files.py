"""Rays from zarr and parquet files, and answers to them, by workers that read and write their own rows."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from wrt.query.batches.block_outputs import StoreRows, TakeAttributes, for_workers
from wrt.query.blocks import BYTES_PER_RAY

COUNT = 3000
MEMORY = 700 * BYTES_PER_RAY


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.meshes[0], COUNT, seed=4)


@pytest.fixture(scope="module")
def processes():
    with wrt.cluster.ProcessPool(2, threads=1) as pool:
        yield pool


def test_zarr(scene, rays, processes, tmp_path):
    """Blocks have a multiple of a chunk's rows, or two workers would write the same chunk and lose what the other one wrote."""
    zarr = pytest.importorskip("zarr", reason="zarr is not installed: pip install 'wrt[cluster-dask]'")
    origins, directions = (
        zarr.create_array(tmp_path / f"{name}.zarr", data=one, chunks=(400, 3)) for name, one in zip("od", rays, strict=True)
    )
    t = zarr.create_array(tmp_path / "t.zarr", shape=(COUNT,), dtype="f4", chunks=(128,))
    position = zarr.create_array(tmp_path / "p.zarr", shape=(COUNT, 3), dtype="f4", chunks=(96, 3))
    assert isinstance(for_workers({"t": t, "position": position}), StoreRows)
    blocks = scene.intersect_blocks(origins, directions, memory=MEMORY, executor=processes)
    assert blocks.ranges((COUNT,), 384).step == 384
    assert blocks.write({"t": t, "position": position}) == COUNT
    hits = scene.intersect(*rays)
    np.testing.assert_array_equal(t[:], hits.t)
    np.testing.assert_array_equal(position[:], hits.position)
    coarse = zarr.create_array(tmp_path / "c.zarr", shape=(COUNT,), dtype="f4", chunks=(1000,))
    with pytest.raises(ValueError, match=r"chunks of 1,000 rows are larger than a block of 700 rows.* 320,000 bytes"):
        blocks.write({"t": coarse})
    in_memory = zarr.zeros((COUNT,), dtype="f4", chunks=(100,))
    assert isinstance(for_workers({"t": in_memory}), TakeAttributes)
    blocks.write({"t": in_memory})
    np.testing.assert_array_equal(in_memory[:], hits.t)


def test_parquet(scene, rays, processes, tmp_path):
    """Rows from groups of another size than blocks; answers as a file for each block."""
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'wrt[cluster-dask]'")
    from pyarrow import parquet

    lines = np.concatenate([*rays], axis=1)
    table = pa.table({name: lines[:, column] for column, name in enumerate(("x", "y", "z", "dx", "dy", "dz"))})
    parquet.write_table(table, tmp_path / "rays.parquet", row_group_size=450)
    origins = wrt.cluster.ParquetColumns(tmp_path / "rays.parquet", ["x", "y", "z"])
    directions = wrt.cluster.ParquetColumns(tmp_path / "rays.parquet", ["dx", "dy", "dz"])
    assert (origins.shape, origins.dtype) == ((COUNT, 3), np.float32)
    for rows in (slice(0, 0), slice(0, 450), slice(449, 451), slice(5, 2999, 7), slice(2999, 4000), slice(None)):
        np.testing.assert_array_equal(origins[rows], rays[0][rows])
    blocks = scene.intersect_blocks(origins, directions, memory=MEMORY, executor=processes)
    assert wrt.cluster.write_parquet(blocks, tmp_path / "hits", ["t", "normal"]) == COUNT
    assert len(list((tmp_path / "hits").iterdir())) == 5
    hits = scene.intersect(*rays)
    np.testing.assert_array_equal(wrt.cluster.ParquetColumns(tmp_path / "hits", "t")[:], hits.t)
    normals = wrt.cluster.ParquetColumns(tmp_path / "hits", [f"normal.{axis}" for axis in range(3)])
    np.testing.assert_array_equal(normals[700:2000], hits.normal[700:2000])
    wrt.cluster.write_parquet(scene.occluded_blocks(*rays, memory=MEMORY), tmp_path / "dark")
    np.testing.assert_array_equal(wrt.cluster.ParquetColumns(tmp_path / "dark", "value")[:], hits.is_hit)


def test_parquet_that_is_wrong(scene, rays, tmp_path):
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'wrt[cluster-dask]'")
    from pyarrow import parquet

    parquet.write_table(pa.table({"x": [1.0, None, 3.0], "name": ["a", "b", "c"]}), tmp_path / "some.parquet")
    with pytest.raises(FileNotFoundError, match="no parquet file"):
        wrt.cluster.ParquetColumns(tmp_path / "none.parquet", "x")
    with pytest.raises(ValueError, match="no column 'y'; choose from x, name"):
        wrt.cluster.ParquetColumns(tmp_path / "some.parquet", ["x", "y"])
    with pytest.raises(ValueError, match="do not hold numbers"):
        wrt.cluster.ParquetColumns(tmp_path / "some.parquet", ["name"])
    with pytest.raises(ValueError, match="no value in some of the rows 0 to 2"):
        wrt.cluster.ParquetColumns(tmp_path / "some.parquet", "x")[:]
    with pytest.raises(ValueError, match="use reduce"):
        wrt.cluster.write_parquet(scene.occluded_blocks(rays[0][:, None], rays[1][:5]), tmp_path / "rows")
    with pytest.raises(ValueError, match="GeneratedRays"):
        wrt.cluster.write_parquet(scene.occluded_blocks(iter([rays])), tmp_path / "rows")
