"""Job files: a job as a TOML text, for `wrt job run job.toml`. Paths in it are relative to the file.

    folder = "sun_hours"                # the job's folder
    query = "occluded"                  # or "intersect", "count", "closest_point"
    memory = "256 MB"                   # of a block

    [scene]
    file = "town.npz"                   # what Scene.save wrote, or a mesh file; accelerator = "auto" for these

    [rays]
    origins = "points.npy"              # .npy, .zarr, or {parquet = "rays.parquet", columns = ["x", "y", "z"]}
    directions = "suns.npy"
    outer = true                        # every direction from every origin: (points, suns) rays
    # function = "rays.py:rays"         # in place of the three: a function(first, count) of a Python file,
    # shape = [1_000_000_000]           # and the shape of the batch

    # [points]                          # of "closest_point", in place of rays
    # positions = "points.npy"          # as origins; max_distance = 2.0

    [reduce]
    by = "sum"                          # of closest hits and points: by = {t = "min"}
    axis = 1
    # weights = "months.npy"            # of "occluded", with by = "sum": (G, D) sums in groups, as `wrt.batches.WeightedSum`

    [executor]
    kind = "processes"                  # or "none", "threads", "dask"
    workers = 2                         # of processes and threads; threads = 1 of each
    # address = "tcp://node17:8786"     # of Dask's scheduler; or scheduler_file = "scheduler.json"

    [output]
    file = "shaded.npy"                 # of closest hits and points a folder, with a file for each attribute

A job file with a function runs its code, as importing a module does, and one with Dask's scheduler speaks to it by pickles. Any
other job file reads the files that it names, wherever they are, and writes below its own folder, unless `wrt job run` is told
otherwise: the job's folder, and output that replaces files of NumPy only.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from wrt.atomic_files import replaced
from wrt.cluster.file_functions import FileFunction
from wrt.cluster.job import Job
from wrt.cluster.job_file_keys import QUERIES, read_job_file
from wrt.cluster.job_folder import JobFolder
from wrt.cluster.parquet_files import ParquetColumns
from wrt.kernels.compilation.cores import available_cores
from wrt.meshes.mesh import TriangleMesh
from wrt.query.batches.block_outputs import ATTRIBUTES
from wrt.query.batches.block_rows import GeneratedRays
from wrt.query.batches.block_work import HIT_QUERIES
from wrt.query.batches.weighted_sums import WeightedSum
from wrt.query.batches.workers import ProcessPool, Workers
from wrt.scene.scene import Scene

NPY = b"\x93NUMPY"
"""The first bytes of files of NumPy."""


def run_job_file(path: Path, progress: bool, outside: bool = False) -> Job:
    """Runs the job of a file until it is complete, and writes its output.

    Args:
        path: of the file.
        progress: whether to show a progress bar on stderr.
        outside: whether the folder and the output may be outside of the folder of the file.

    Raises:
        ImportError, OSError, RuntimeError, TypeError, ValueError: as `read_job_file`, `Job` and `Job.run`; a path outside.
    """
    given, base = read_job_file(path), path.absolute().parent
    query = given.get("query", "occluded")
    places = {key: place_below(base, *key, given, outside) for key in (("", "folder"), ("executor", "folder"))}
    output = place_below(base, "output", "file", given, outside)
    if output is not None:
        check_output(output, is_folder=query in HIT_QUERIES)
    scene, reduce = load_scene(given["scene"], base), given["reduce"]
    arrays = load_points(given["points"], base) if query == "closest_point" else load_rays(given["rays"], base)
    limits = {**given["rays"], **given["points"]}
    bounds = {name: float(limits[name]) for name in ("t_min", "t_max", "max_distance") if name in limits}
    by = WeightedSum(load_array(reduce["weights"], "[reduce] weights", base)) if "weights" in reduce else reduce.get("by")
    options = {"reduce": by, "axis": as_axis(reduce.get("axis")), **given["options"]}
    if "memory" in given:
        options["memory"] = given["memory"]
    with executor_of(given["executor"], base, places["executor", "folder"]) as executor:
        method = getattr(scene, QUERIES[query])
        blocks = method(*arrays, **bounds, **options, executor=executor, progress=progress)
        job = Job(places["", "folder"], blocks, attributes=given.get("attributes")).run()
        if output is not None:
            write_output(job, output)
    return job


def place_below(base: Path, table: str, key: str, given: Mapping[str, Any], outside: bool) -> Path | None:
    """The path of a file or a folder that a job writes; None if the job file does not name it.

    Raises:
        ValueError: it is outside of `base`, also by a link, and `outside` is false.
    """
    found = (given[table] if table else given).get(key)
    if found is None:
        return None
    path = base / found
    if not outside and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(base)):
        name = f"[{table}] {key}" if table else key
        raise ValueError(
            f"{name} is '{found}', outside of '{base}', the folder of the job file; choose a path in it, or pass "
            "--allow-output-outside"
        )
    return path


def check_output(path: Path, is_folder: bool) -> None:
    """Checks what an output would replace.

    Raises:
        ValueError: a name that does not end in .npy, or something that is not a file of NumPy.
    """
    if is_folder:
        if path.exists() and not path.is_dir():
            raise ValueError(f"[output] file is '{path}', a file; this query needs a folder, with a file for each attribute")
        for name in ATTRIBUTES:
            check_output(path / f"{name}.npy", is_folder=False)
        return
    if path.suffix != ".npy":
        raise ValueError(f"[output] file is '{path}'; give it a name that ends in .npy")
    if not os.path.lexists(path):
        return
    if not path.is_file():
        raise ValueError(f"[output] file is '{path}', which is not a regular file; choose another one")
    with path.open("rb") as file:
        if file.read(len(NPY)) != NPY:
            raise ValueError(f"[output] file is '{path}', which is not a file of NumPy; choose another one, or remove it")


def job_file_of(folder: Path) -> Path:
    """The job file of a job's folder: the one beside it that names it.

    Raises:
        FileNotFoundError: there is no job in the folder.
        ValueError: no job file beside it names it, or several do.
    """
    JobFolder(folder).manifest()
    real, found = os.path.realpath(folder), []
    for path in sorted(Path(real).parent.glob("*.toml")):
        try:
            given = read_job_file(path)
        except (OSError, ValueError):
            continue
        if os.path.realpath(path.parent / given["folder"]) == real:
            found.append(path)
    if len(found) != 1:
        count = "no job file beside it names it" if not found else f"{len(found)} job files beside it name it"
        raise ValueError(
            f"'{folder}' is the folder of a job, and {count}; give the job file (wrt job run job.toml), or run the script "
            "again that began the job"
        )
    return found[0]


def load_scene(given: Mapping[str, Any], base: Path) -> Scene:
    """The scene of a job file: saved by `Scene.save`, or a mesh."""
    file = base / given["file"]
    if file.suffix == ".npz":
        if "accelerator" in given:
            raise ValueError(f"[scene] accelerator is for mesh files, and '{file}' holds a tree; leave it out")
        return Scene.load(file, device=given.get("device"), num_threads=given.get("threads"))
    options = {"device": given.get("device"), "num_threads": given.get("threads")}
    return Scene(TriangleMesh.load(file), given.get("accelerator", "auto"), **options)


def load_rays(given: Mapping[str, Any], base: Path) -> tuple[Any, Any]:
    """Origins and directions of a job file, or the function that makes them."""
    if "function" in given:
        function = FileFunction.of(given["function"], base)
        if "shape" not in given:
            raise ValueError("[rays] has a function and no shape; give the shape of the batch, such as shape = [1_000_000, 60]")
        return GeneratedRays(function, given["shape"]), None
    origins, directions = (load_array(given[name], f"[rays] {name}", base) for name in ("origins", "directions"))
    if given.get("outer"):
        origins = np.asarray(origins)[:, None]
    return origins, directions


def load_points(given: Mapping[str, Any], base: Path) -> tuple[Any]:
    """Points of a job file."""
    return (load_array(given["positions"], "[points] positions", base),)


def load_array(given: Any, name: str, base: Path) -> Any:
    """Vectors or weights of a job file: from a file, or numbers that stand in it.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no regular file, or holds something else than an array of numbers.
    """
    if isinstance(given, Mapping):
        return ParquetColumns(base / given["parquet"], given["columns"])
    if not isinstance(given, str):
        return as_vectors(given, name)
    path = base / given
    if not path.exists():
        raise FileNotFoundError(f"{name}: there is no file '{path}'")
    if path.suffix == ".zarr" and path.is_dir():
        return open_zarr(path, name)
    if path.suffix != ".npy" or not path.is_file():  # a pipe would be waited for
        raise ValueError(f"{name}: '{path}' must be a .npy file, a .zarr folder, or a table {{parquet = ..., columns = ...}}")
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise ValueError(f"{name}: '{path}' is not an array of NumPy, or is damaged ({error})") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: '{path}' does not hold an array of real numbers")
    return array


def as_vectors(given: Any, name: str) -> np.ndarray:
    """Vectors that stand in a job file.

    Raises:
        ValueError: lists of different lengths.
    """
    try:
        return np.asarray(given, dtype=np.float64)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{name}: lists of vectors must have the same length ({error})") from error


def open_zarr(path: Path, name: str) -> Any:
    """An array of zarr.

    Raises:
        ImportError: zarr is not installed.
        ValueError: it is none.
    """
    try:
        import zarr
    except ImportError as error:
        raise ImportError("arrays of zarr need zarr: pip install 'wrt[cluster-dask]'") from error
    try:
        return zarr.open_array(path, mode="r")
    except Exception as error:  # zarr raises many kinds
        raise ValueError(f"{name}: '{path}' is not an array of zarr ({type(error).__name__}: {error})") from error


def as_axis(axis: Any) -> Any:
    """An axis, several, or None for all."""
    return tuple(axis) if isinstance(axis, list) else axis


@contextmanager
def executor_of(given: Mapping[str, Any], base: Path, folder: Path | None) -> Iterator[Workers | None]:
    """The executor of a job file, which is ended with the `with` block.

    Args:
        given: the table of the job file.
        base: the folder of the job file.
        folder: for the scene's file, as in `Workers`.
    """
    kind = given.get("kind", "none")
    options = {name: given[name] for name in ("device", "window", "retries") if name in given}
    if folder is not None:
        options["folder"] = folder
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
        for path in named.values():
            if Path(path).exists() and not Path(path).is_file():
                raise ValueError(f"[executor] scheduler_file is '{path}', which is not a regular file")
        with Client(given.get("address"), **named) as client:
            yield Workers(client.get_executor(), threads=given.get("threads"), **options)


def write_output(job: Job, path: Path) -> None:
    """Writes a job's answer to a .npy file; of closest hits, to a file of each attribute in a folder. Whole or not at all."""
    result = job.result()
    files = {path / f"{name}.npy": one for name, one in result.items()} if isinstance(result, dict) else {path: result}
    for file, array in files.items():
        os.makedirs(file.parent, exist_ok=True)
        check_output(file, is_folder=False)
        with replaced(file) as target:
            np.save(target, array, allow_pickle=False)
