"""Hashes of arrays, and the file in which they are kept."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

KEPT = Path(__file__).parent / "hashes.json"

Hashes = dict[str, dict[str, str]]
"""Hash by case for each group: "hits", "trees W" and "pictures W" for a width W."""


def digest(*arrays: Any) -> str:
    """Hash of the bytes, shapes and types of arrays, NumPy's or Warp's."""
    state = hashlib.blake2b(digest_size=8)
    for array in arrays:
        values = np.ascontiguousarray(array.numpy() if hasattr(array, "numpy") else array)
        state.update(f"{values.dtype.str}{values.shape}".encode())
        state.update(values.tobytes())
    return state.hexdigest()


def read(path: Path = KEPT) -> Hashes:
    """The hashes in a file; none if there is no file."""
    return json.loads(path.read_text()) if path.exists() else {}


def write(hashes: Hashes, path: Path = KEPT) -> None:
    """Adds hashes to a file, or replaces those of the same cases."""
    known = read(path)
    for group, cases in hashes.items():
        known[group] = known.get(group, {}) | cases
    ordered = {group: dict(sorted(known[group].items())) for group in sorted(known)}
    path.write_text(json.dumps(ordered, indent=1) + "\n")


def differences(found: Hashes, kept: Hashes) -> list[str]:
    """A line for each case whose hash is not the one kept, or of which none is kept."""
    lines = []
    for group, cases in found.items():
        for case, value in cases.items():
            known = kept.get(group, {}).get(case)
            if known != value:
                lines.append(f"{group}: {case}: {value}, " + (f"kept is {known}" if known else "none is kept"))
    return lines
