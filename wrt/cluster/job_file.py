"""Job files: a job as a TOML text, for `wrt job run job.toml`. Paths in it are relative to the file.

    folder = "sun_hours"                # the job's folder
    query = "occluded"                  # or "intersect", "count"
    memory = "256 MB"                   # of a block

    [scene]
    file = "town.npz"                   # what Scene.save wrote, or a mesh file; accelerator = "auto" for these

    [rays]
    origins = "points.npy"              # .npy, .zarr, or {parquet = "rays.parquet", columns = ["x", "y", "z"]}
    directions = "suns.npy"
    outer = true                        # every direction from every origin: (points, suns) rays
    # function = "rays.py:rays"         # in place of the three: a function(first, count) of a Python file,
    # shape = [1_000_000_000]           # and the shape of the batch

    [reduce]
    by = "sum"                          # of closest hits: by = {t = "min"}
    axis = 1

    [executor]
    kind = "processes"                  # or "none", "threads", "dask"
    workers = 2                         # of processes and threads; threads = 1 of each
    # address = "tcp://node17:8786"     # of Dask's scheduler; or scheduler_file = "scheduler.json"

    [output]
    file = "shaded.npy"                 # of closest hits a folder, with a file for each attribute

A file with a function runs its code, as importing a module does.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from wrt.atomic_files import replaced
from wrt.cluster.job import Job
from wrt.cluster.parquet_files import ParquetColumns
from wrt.kernels.compilation.cores import available_cores
from wrt.meshes.mesh import TriangleMesh
from wrt.query.batches.block_rows import GeneratedRays
from wrt.query.batches.workers import ProcessPool, Workers
from wrt.scene.scene import Scene
from wrt.tables import lookup

KEYS = {
    "": {"folder", "query", "memory", "attributes", "options", "scene", "rays", "reduce", "executor", "output"},
    "scene": {"file", "accelerator", "device", "threads"},
    "rays": {"origins", "directions", "outer", "t_min", "t_max", "function", "shape"},
    "reduce": {"by", "axis"},
    "executor": {"kind", "workers", "threads", "devices", "device", "address", "scheduler_file", "folder", "window", "retries"},
    "output": {"file"},
}
"""Keys of each table of a job file; "" is the file itself."""

QUERIES = {"intersect": "intersect_blocks", "occluded": "occluded_blocks", "count": "count_blocks"}


def read_job_file(path: Path) -> dict[str, Any]:
    """The contents of a job file, with every table.

    Raises:
        ImportError: Python is older than 3.11, and tomli is not installed.
        OSError: the file cannot be read.
        ValueError: it is not TOML, or has an unknown key.
    """
    try:
        import tomllib
    except ImportError:
        try:
            import tomli as tomllib
        except ImportError as error:
            raise ImportError("job files need tomli with this version of Python: pip install 'wrt[cluster-dask]'") from error
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"'{path}' is not a TOML file: {error}") from error
    for table, keys in KEYS.items():
        found = given.setdefault(table, {}) if table else given
        if not isinstance(found, dict):
            raise ValueError(f"{table} in '{path}' must be a table: [{table}]")
        if unknown := sorted(found.keys() - keys):
            raise ValueError(f"'{path}' has the key {unknown[0]!r} in [{table}]; choose from {', '.join(sorted(keys))}")
    if not given["scene"].get("file") or "folder" not in given:
        raise ValueError(f"'{path}' needs folder and [scene] file")
    return given


def run_job_file(path: Path, progress: bool) -> Job:
    """Runs the job of a file until it is complete, and writes its output.

    Args:
        path: of the file.
        progress: whether to show a progress bar on stderr.

    Raises:
        ImportError, OSError, RuntimeError, TypeError, ValueError: as `read_job_file`, `Job` and `Job.run`.
    """
    given, base = read_job_file(path), path.absolute().parent
    scene, reduce = load_scene(given["scene"], base), given["reduce"]
    origins, directions = load_rays(given["rays"], base)
    method = getattr(scene, QUERIES[lookup({name: name for name in QUERIES}, given.get("query", "occluded"), "query")])
    bounds = {name: float(given["rays"][name]) for name in ("t_min", "t_max") if name in given["rays"]}
    options = {"reduce": reduce.get("by"), "axis": as_axis(reduce.get("axis")), **given.get("options", {})}
    if "memory" in given:
        options["memory"] = given["memory"]
    with executor_of(given["executor"], base) as executor:
        blocks = method(origins, directions, **bounds, **options, executor=executor, progress=progress)
        job = Job(base / given["folder"], blocks, attributes=given.get("attributes")).run()
        if "file" in given["output"]:
            write_output(job, base / given["output"]["file"])
    return job


def load_scene(given: Mapping[str, Any], base: Path) -> Scene:
    """The scene of a job file: saved by `Scene.save`, or a mesh."""
    file = base / given["file"]
    if file.suffix == ".npz":
        return Scene.load(file, device=given.get("device"), num_threads=given.get("threads"))
    options = {"device": given.get("device"), "num_threads": given.get("threads")}
    return Scene(TriangleMesh.load(file), given.get("accelerator", "auto"), **options)


def load_rays(given: Mapping[str, Any], base: Path) -> tuple[Any, Any]:
    """Origins and directions of a job file, or the function that makes them."""
    if "function" in given:
        if "origins" in given or "directions" in given:
            raise ValueError("[rays] has a function and arrays; leave one of them out")
        return GeneratedRays(FileFunction(*split_function(given["function"], base)), given.get("shape", 0)), None
    if "origins" not in given or "directions" not in given:
        raise ValueError("[rays] needs origins and directions, or a function and a shape")
    origins, directions = (load_array(given[name], name, base) for name in ("origins", "directions"))
    if given.get("outer"):
        origins = np.asarray(origins)[:, None]
    return origins, directions


def load_array(given: Any, name: str, base: Path) -> Any:
    """Vectors of a job file: from a file, or numbers that stand in it."""
    if isinstance(given, Mapping):
        return ParquetColumns(base / given["parquet"], given["columns"])
    if not isinstance(given, str):
        return np.asarray(given, dtype=np.float64)
    path = base / given
    if not path.exists():
        raise FileNotFoundError(f"[rays] {name}: there is no file '{path}'")
    if path.suffix == ".npy":
        return np.load(path, mmap_mode="r")
    if path.suffix == ".zarr":
        import zarr

        return zarr.open_array(path, mode="r")
    raise ValueError(f"[rays] {name}: '{path}' must be .npy or .zarr, or a table {{parquet = ..., columns = ...}}")


class FileFunction:
    """A function in a Python file, which each process imports when it first calls it.

    Args:
        path: of the file.
        name: of the function.
    """

    def __init__(self, path: str, name: str) -> None:
        self.path, self.name = path, name

    def __call__(self, first: int, count: int) -> Any:
        module = f"wrt_job_{abs(hash(self.path))}"
        if module not in sys.modules:
            spec = importlib.util.spec_from_file_location(module, self.path)
            loaded = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(loaded)
            sys.modules[module] = loaded
        return getattr(sys.modules[module], self.name)(first, count)


def split_function(text: str, base: Path) -> tuple[str, str]:
    """Path and name of "file.py:function"."""
    file, colon, name = text.rpartition(":")
    if not colon or not (base / file).is_file():
        raise ValueError(f"[rays] function is {text!r}; give a file and a function in it, such as 'rays.py:rays'")
    return str(base / file), name


def as_axis(axis: Any) -> Any:
    """An axis, several, or None for all."""
    return tuple(axis) if isinstance(axis, list) else axis


@contextmanager
def executor_of(given: Mapping[str, Any], base: Path) -> Iterator[Workers | None]:
    """The executor of a job file, which is ended with the `with` block."""
    kind = given.get("kind", "none")
    options = {name: given[name] for name in ("device", "window", "retries") if name in given}
    if "folder" in given:
        options["folder"] = base / given["folder"]
    if kind == "none":
        yield None
    elif kind == "threads":
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(given.get("workers", available_cores())) as executor:
            yield Workers(executor, threads=given.get("threads"), **options)
    elif kind == "processes":
        with ProcessPool(given.get("workers"), threads=given.get("threads"), devices=given.get("devices")) as executor:
            yield Workers(executor, **options)
    elif kind == "dask":
        try:
            from distributed import Client
        except ImportError as error:
            raise ImportError("[executor] kind = 'dask' needs Dask: pip install 'wrt[cluster-dask]'") from error
        if not ("address" in given) ^ ("scheduler_file" in given):
            raise ValueError("[executor] of Dask needs either address or scheduler_file")
        named = {"scheduler_file": str(base / given["scheduler_file"])} if "scheduler_file" in given else {}
        with Client(given.get("address"), **named) as client:
            yield Workers(client.get_executor(), threads=given.get("threads"), **options)
    else:
        raise ValueError(f"[executor] kind is {kind!r}; choose from none, threads, processes, dask")


def write_output(job: Job, path: Path) -> None:
    """Writes a job's answer to a .npy file; of closest hits, to a file of each attribute in a folder. Whole or not at all."""
    result = job.result()
    files = {path / f"{name}.npy": one for name, one in result.items()} if isinstance(result, dict) else {path: result}
    for file, array in files.items():
        os.makedirs(file.parent, exist_ok=True)
        with replaced(file) as target:
            np.save(target, array)
