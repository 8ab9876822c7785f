"""Engines that `wrt tune` found to be faster on this machine than what the rules choose: read once, from a file.

    {"revision": 1, "cpu": ..., "target": ..., "lanes": 16,
     "engines": {"8": {"closest coherent one point picture 2^16 rays 2^20 triangles": "interleaved"}}}

`engines` has the engine by number of threads and class of query, rays and scene. The file is `tuned.json` in the folder of
compiled kernels, or the one that WRT_TUNED names. One that is damaged, or of another machine or revision, is not used, and a
line on stderr says so once.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.atomic_files import replaced
from wrt.kernels.compilation.host_cpu import cpu_name
from wrt.kernels.compilation.target import lane_width, target_name
from wrt.revisions import TUNING_REVISION

if TYPE_CHECKING:
    from wrt.engine.facts.facts import RayFacts, SceneFacts

VARIABLE = "WRT_TUNED"

MAX_BYTES = 1 << 20
"""Bytes of a file that is read."""

Engines = dict[str, dict[str, str]]
"""Name of an engine by number of threads and class."""

_engines: Engines | None = None


def tuned_file() -> Path:
    """Where the file is, or would be."""
    return Path(os.environ.get(VARIABLE) or Path(wp.config.kernel_cache_dir or ".") / "tuned.json")


def this_machine() -> dict[str, Any]:
    """What a file must say to be used."""
    return {"revision": TUNING_REVISION, "cpu": cpu_name(), "target": target_name(), "lanes": lane_width()}


def class_name(scene: SceneFacts, rays: RayFacts, query: str) -> str:
    """The class of a query: its kind, what its rays are like, and powers of two of their number and the scene's."""
    parts = [query, "coherent" if rays.coherent else "incoherent"]
    parts += ["one point"] * rays.shared_origin + ["picture"] * (rays.columns > 0) + ["instances"] * (scene.instances > 0)
    sizes = f"2^{rays.count.bit_length() - 1} rays 2^{scene.triangles.bit_length() - 1} triangles"
    return " ".join([*parts, sizes])


def tuned_engine(scene: SceneFacts, rays: RayFacts, query: str, threads: int) -> str | None:
    """The engine for a query; None if the file has none."""
    known = engines().get(str(threads))
    return known.get(class_name(scene, rays, query)) if known else None


def engines() -> Engines:
    """What the file has; nothing if it is not used."""
    global _engines
    if _engines is None:
        _engines = read(tuned_file())
    return _engines


def forget() -> None:
    """Has the file read again."""
    global _engines
    _engines = None


def read(path: Path) -> Engines:
    """The engines of a file; none if it is not there or not to be used, which is said on stderr."""
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return {}
    except OSError as error:
        return _refuse(path, error)
    try:
        found = json.loads(content) if len(content) <= MAX_BYTES else None
        machine = {name: found[name] for name in this_machine()}  # type: ignore[index]
        known = {str(threads): dict(own) for threads, own in found["engines"].items()}  # type: ignore[index]
        texts = [text for own in known.values() for pair in own.items() for text in pair]
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("engines are names")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return _refuse(path, "it is damaged")
    if machine != this_machine():
        return _refuse(path, "it is of another machine, target or version")
    return known


def write(found: Mapping[str, Mapping[str, str]], path: Path) -> None:
    """Adds engines to a file, by number of threads and class, in place of those of the same number of threads; makes it if
    there is none that can be used.

    Raises:
        OSError: it cannot be written.
    """
    known = read(path) if path.exists() else {}
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {**this_machine(), "engines": {**known, **{threads: dict(own) for threads, own in found.items()}}}
    with replaced(path) as file:
        file.write((json.dumps(content, indent=1, sort_keys=True) + "\n").encode())
    forget()


def _refuse(path: Path, reason: object) -> Engines:
    print(f"wrt: '{path}' is not used ({reason}); 'wrt tune' makes it anew", file=sys.stderr)
    return {}
