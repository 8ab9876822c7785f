"""The manifest of a job: its fields, and a checksum over them.

A manifest that was edited would have the answers of blocks taken for those of other rows, or another scene's for this one's.
The checksum is not a signature: whoever forges a manifest can compute it, too.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

from wrt.query.blocks import MAX_RAYS

FORMAT = 3
"""Version of the folder's format."""

METHODS = ("intersect", "occluded", "count", "closest_point")

HASH = re.compile(r"[0-9a-f]{64}")

MAX_COUNT = 1 << 62
"""Number of rays at most."""


def signed(fields: dict[str, Any]) -> dict[str, Any]:
    """A manifest with these fields, its format and its checksum."""
    whole = {"format": FORMAT, **fields}
    return {**whole, "checksum": checksum(whole)}


def checksum(manifest: dict[str, Any]) -> str:
    """SHA-256 of all fields but the checksum itself."""
    fields = {name: value for name, value in manifest.items() if name != "checksum"}
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def parse_manifest(text: bytes) -> dict[str, Any]:
    """The manifest in a file.

    Raises:
        RecursionError, ValueError: it is none, was changed, or is of another format.
    """
    manifest = json.loads(text)
    if not isinstance(manifest, dict) or "format" not in manifest:
        raise ValueError("it is not that of a job")
    if manifest["format"] != FORMAT:
        raise ValueError(f"it has format {manifest['format']!r:.40}, and this version of wrt reads format {FORMAT}")
    if missing := [name for name in (*FIELDS, "checksum") if name not in manifest]:
        raise ValueError(f"it has no {missing[0]}")
    for name, is_valid in FIELDS.items():
        if not is_valid(manifest[name]):
            raise ValueError(f"{name} is {manifest[name]!r:.60}")
    if manifest["checksum"] != checksum(manifest):
        raise ValueError("it was changed after it was written: its checksum differs")
    return manifest


def is_count(value: Any, minimum: int, maximum: int) -> bool:
    """Whether a value is a whole number in a range."""
    return isinstance(value, int) and not isinstance(value, bool) and minimum <= value <= maximum


def is_shape(value: Any) -> bool:
    """Whether a value is the leading shape of a batch."""
    if not isinstance(value, list) or not value:
        return False
    product = 1
    for length in value:
        if not is_count(length, 0, MAX_COUNT):
            return False
        product *= max(length, 1)
    return product <= MAX_COUNT


FIELDS = {
    "id": lambda value: isinstance(value, str) and re.fullmatch("[0-9a-f]{16}", value) is not None,
    "answers": lambda value: is_count(value, 1, MAX_COUNT),
    "scene": lambda value: isinstance(value, str) and HASH.fullmatch(value) is not None,
    "rays": lambda value: isinstance(value, str) and HASH.fullmatch(value) is not None,
    "query": lambda value: value in METHODS,
    "options": lambda value: isinstance(value, str),
    "shape": is_shape,
    "rows": lambda value: is_count(value, 1, MAX_RAYS),
}
"""The fields of a manifest, and what each may be."""
