# Written by `python -m tests.typed.stubs` from the table of names in wrt/cluster/__init__.py.
from wrt.cluster.dask_arrays import map_points as map_points
from wrt.cluster.dask_arrays import map_rays as map_rays
from wrt.cluster.job import Job as Job
from wrt.cluster.job import JobStatus as JobStatus
from wrt.cluster.job import job_status as job_status
from wrt.cluster.parquet_files import ParquetColumns as ParquetColumns
from wrt.cluster.parquet_files import write_parquet as write_parquet
from wrt.query.batches.workers import ProcessPool as ProcessPool
from wrt.query.batches.workers import Workers as Workers

__all__ = [
    "Job",
    "JobStatus",
    "ParquetColumns",
    "ProcessPool",
    "Workers",
    "job_status",
    "map_points",
    "map_rays",
    "write_parquet",
]
