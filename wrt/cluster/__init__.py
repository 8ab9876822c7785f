"""Beyond one machine: executors, resumable jobs, and rays in files of other formats.

    with wrt.cluster.ProcessPool(8, threads=1) as pool:                        # or client.get_executor() of Dask
        blocks = scene.occluded_blocks(points[:, None], suns, executor=pool, reduce="sum", axis=1)
        shaded = wrt.cluster.Job("sun_hours", blocks).run().result()           # run again to resume

Queries take an executor by themselves (`wrt.Scene.intersect_blocks`, `wrt.batches`). This package adds options of executors
(`Workers`, `ProcessPool`), jobs in folders (`Job`, `job_status`), parquet files (`ParquetColumns`, `write_parquet`), and
queries on arrays of Dask and xarray (`map_rays`, `map_points`). What it needs of Dask, pyarrow and zarr comes with
`pip install "wrt[cluster-dask]"`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "Job": "wrt.cluster.job",
    "JobStatus": "wrt.cluster.job",
    "ParquetColumns": "wrt.cluster.parquet_files",
    "ProcessPool": "wrt.query.batches.workers",
    "Workers": "wrt.query.batches.workers",
    "job_status": "wrt.cluster.job",
    "map_points": "wrt.cluster.dask_arrays",
    "map_rays": "wrt.cluster.dask_arrays",
    "write_parquet": "wrt.cluster.parquet_files",
}

_MOVED = {
    "Histogram": "wrt.batches",
    "Reduction": "wrt.batches",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME, _MOVED)
