"""What a job file may hold: the keys of each table, and the values of each, which are checked before anything is done."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from wrt.kernels.runtime.launch import check_num_threads
from wrt.query.batches.block_limits import parse_memory
from wrt.query.batches.block_outputs import ATTRIBUTES
from wrt.query.batches.block_work import HIT_QUERIES
from wrt.query.batches.reductions import REDUCTIONS

QUERIES = {name: f"{name}_blocks" for name in ("intersect", "occluded", "count", "closest_point")}
"""Queries, and the methods of a scene that answer them."""

KINDS = ("none", "threads", "processes", "dask")
"""Kinds of executors."""

LARGEST_FILE = 1 << 24
"""Bytes of a job file at most."""

Check = Callable[[Any], str]
"""What a value must be, in words, if it is not; empty if it is."""


def text(value: Any) -> str:
    """A text that is not empty."""
    return "" if isinstance(value, str) and value and "\0" not in value else "must be a text"


def flag(value: Any) -> str:
    """True or false."""
    return "" if isinstance(value, bool) else "must be true or false"


def table(value: Any) -> str:
    """A table, whose keys are checked by themselves."""
    return "" if isinstance(value, dict) else "must be a table"


def texts(value: Any) -> str:
    """A list of texts."""
    is_list = isinstance(value, list) and value and not any(map(text, value))
    return "" if is_list else "must be a list of texts"


def one_of(names: Any) -> Check:
    """One of some texts."""
    return lambda value: (
        "" if isinstance(value, str) and value in names else f"is {value!r:.60}; choose from {', '.join(names)}"
    )


def some_of(names: Any) -> Check:
    """A list of some texts."""
    return lambda value: texts(value) or next((message for one in value if (message := one_of(names)(one))), "")


def whole(minimum: int, maximum: int = (1 << 62)) -> Check:
    """A whole number in a range."""
    words = f"must be a whole number from {minimum} to {maximum}"
    return lambda value: "" if is_whole(value) and minimum <= value <= maximum else words


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Whether a value is a number that float64 holds, and not NaN."""
    return (is_whole(value) and abs(value) < 1 << 1023) or (isinstance(value, float) and not math.isnan(value))


def nearest(value: Any) -> str:
    """A finite number from 0 up."""
    return "" if is_number(value) and 0 <= value < math.inf else "must be a finite number of at least 0"


def farthest(value: Any) -> str:
    """A number from 0 up, which may be infinite."""
    return "" if is_number(value) and value >= 0 else "must be a number of at least 0"


def memory(value: Any) -> str:
    """An amount of memory."""
    try:
        parse_memory(value)
    except (TypeError, ValueError, OverflowError) as error:
        return f"is wrong: {error}"
    return ""


def threads(value: Any) -> str:
    """A number of threads or processes."""
    try:
        check_num_threads(value, "it")
    except (TypeError, ValueError) as error:
        return f"is wrong: {error}"
    return ""


def shape(value: Any) -> str:
    """A number of rows, or a list that begins with it."""
    lengths = value if isinstance(value, list) else [value]
    fine = lengths and all(is_whole(one) and one >= 1 for one in lengths) and math.prod(lengths) < 1 << 62
    return "" if fine else "must be the number of rows, or a list that begins with it, such as [1_000_000, 60]"


def axis(value: Any) -> str:
    """An axis, or several."""
    axes = value if isinstance(value, list) else [value]
    return "" if axes and all(is_whole(one) and abs(one) < 64 for one in axes) else "must be a whole number, or a list of them"


def vectors(value: Any) -> str:
    """A path, a table of columns, or vectors as numbers."""
    if isinstance(value, dict):
        fine = value.keys() == {"parquet", "columns"} and not text(value["parquet"]) and not texts(value["columns"])
        return "" if fine else "must be a table such as {parquet = 'rays.parquet', columns = ['x', 'y', 'z']}"
    is_vector = isinstance(value, list) and len(value) == 3 and all(map(is_number, value))
    is_list = isinstance(value, list) and value and all(isinstance(one, list) and not vectors(one) for one in value)
    return "" if is_vector or is_list or not text(value) else "must be a path, or vectors of three numbers"


def reduction(value: Any) -> str:
    """The name of a reduction, or one for each of some attributes of hits."""
    name = one_of(REDUCTIONS)
    if not isinstance(value, dict):
        return name(value)
    if not value or value.keys() - set(ATTRIBUTES):
        return f"must have keys among {', '.join(ATTRIBUTES)}"
    return next((message for one in value.values() if (message := name(one))), "")


TABLES = ("options", "scene", "rays", "points", "reduce", "executor", "output")
"""Names of the tables."""

KEYS: Mapping[str, Mapping[str, Check]] = {
    "": {
        "folder": text,
        "query": one_of(QUERIES),
        "memory": memory,
        "attributes": some_of(ATTRIBUTES),
        **dict.fromkeys(TABLES, table),
    },
    "options": {
        "traversal": text,
        "triangle_test": text,
        "precise": flag,
        "mask": whole(0, (1 << 32) - 1),
        "environment": whole(-1, (1 << 31) - 1),
    },
    "scene": {"file": text, "accelerator": text, "device": text, "threads": threads},
    "rays": {
        "origins": vectors,
        "directions": vectors,
        "outer": flag,
        "t_min": nearest,
        "t_max": farthest,
        "function": text,
        "shape": shape,
    },
    "points": {"positions": vectors, "max_distance": farthest},
    "reduce": {"by": reduction, "axis": axis, "weights": text},
    "executor": {
        "kind": one_of(KINDS),
        "workers": threads,
        "threads": threads,
        "devices": texts,
        "device": text,
        "address": text,
        "scheduler_file": text,
        "folder": text,
        "window": whole(1),
        "retries": whole(0),
    },
    "output": {"file": text},
}
"""Keys of each table of a job file, and what their values must be; "" is the file itself."""


def read_job_file(path: Path) -> dict[str, Any]:
    """The contents of a job file, with every table.

    Raises:
        ImportError: Python is older than 3.11, and tomli is not installed.
        OSError: the file cannot be read.
        ValueError: it is no regular file or not TOML, has an unknown key, lacks one, or has a value of another kind.
    """
    try:
        import tomllib
    except ImportError:
        try:
            import tomli as tomllib  # type: ignore[no-redef]
        except ImportError as error:
            raise ImportError("job files need tomli with this version of Python: pip install 'wrt[cluster-dask]'") from error
    if path.exists() and not path.is_file():
        raise ValueError(f"'{path}' is not a regular file; give the path of a job file")
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise ValueError(f"it has more than {LARGEST_FILE:,} bytes")
        given = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"'{path}' is not a TOML file: {error}") from error
    check_keys(given, path)
    return given


def check_keys(given: dict[str, Any], path: Path) -> None:
    """Checks all keys and values of a job file, and adds the tables that it does not have.

    Raises:
        ValueError: one is unknown, missing or wrong; the message names it.
    """
    for name, keys in KEYS.items():
        found, where = (given.setdefault(name, {}), f"[{name}]") if name else (given, "the file itself")
        if unknown := sorted(found.keys() - keys.keys()):
            raise ValueError(f"'{path}' has the key {unknown[0]!r} in {where}; choose from {', '.join(sorted(keys))}")
        for key, value in found.items():
            if message := keys[key](value):
                shown = f"[{name}] {key}" if name else key
                wanted = f"{message}: [{key}]" if key in TABLES and not name else message
                text = repr(value)
                raise ValueError(f"{shown} in '{path}' {wanted}, not {text if len(text) <= 60 else type(value).__name__}")
    if "file" not in given["scene"] or "folder" not in given:
        raise ValueError(f"'{path}' needs folder and [scene] file")
    (check_points if given.get("query") == "closest_point" else check_rays)(given, path)
    if "axis" in given["reduce"] and "by" not in given["reduce"]:
        raise ValueError(f"[reduce] in '{path}' has an axis and no by; name what to do along it, such as by = 'sum'")
    if "weights" in given["reduce"] and (given["reduce"].get("by"), given.get("query", "occluded")) != ("sum", "occluded"):
        raise ValueError(f"[reduce] weights in '{path}' are for by = 'sum' of query = 'occluded'; leave them out")
    of_hits = given.get("query") in HIT_QUERIES
    if isinstance(given["reduce"].get("by", ""), dict) != of_hits and "by" in given["reduce"]:
        kind = "a table such as {t = 'min'}" if of_hits else "one name, such as 'sum'"
        raise ValueError(f"[reduce] by in '{path}' must be {kind} for this query, not {given['reduce']['by']!r}")
    if "precise" in given["options"] and not of_hits:
        raise ValueError(f"[options] precise in '{path}' is for query = 'intersect' or 'closest_point'; leave it out")


def check_points(given: dict[str, Any], path: Path) -> None:
    """Checks the points of a job file, and that it has no rays; errors as `check_keys`."""
    if "positions" not in given["points"]:
        raise ValueError(f"'{path}' needs [points] positions for query = 'closest_point'")
    wrong = [f"[rays] {key}" for key in given["rays"]]
    wrong += [f"[options] {key}" for key in ("traversal", "triangle_test") if key in given["options"]]
    if wrong:
        raise ValueError(f"{wrong[0]} in '{path}' is for rays, and query = 'closest_point' has points; leave it out")


def check_rays(given: dict[str, Any], path: Path) -> None:
    """Checks the rays of a job file, and that it has no points; errors as `check_keys`."""
    for key in given["points"]:
        raise ValueError(f"[points] {key} in '{path}' is for query = 'closest_point'; leave it out")
    rays = given["rays"]
    if "function" in rays and ("origins" in rays or "directions" in rays or "outer" in rays):
        raise ValueError(f"[rays] in '{path}' has a function and arrays; leave one of them out")
    if "function" not in rays and not ("origins" in rays and "directions" in rays):
        raise ValueError(f"[rays] in '{path}' needs origins and directions, or a function and a shape")
    if "function" not in rays and "shape" in rays:
        raise ValueError(f"[rays] in '{path}' has a shape and no function; arrays have their own shapes: leave it out")
    if rays.get("t_min", 0.0) > rays.get("t_max", math.inf):
        raise ValueError(f"[rays] t_min in '{path}' is above t_max; no ray can hit anything")
