"""Hashes of arrays, and the file in which they are kept."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from wrt import revisions

KEPT = Path(__file__).parent / "hashes.json"

REVISIONS = "revisions.json"
"""Name of the file beside the hashes: for each family its digest and the revision at which it was recorded."""

Hashes = dict[str, dict[str, str]]
"""Hash by case for each group: "hits", "trees W" and "pictures W" for a width W."""

Recorded = dict[str, dict[str, Any]]
"""{"revision": number, "digest": hash over the family's hashes} by family."""


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


def family_of(group: str, case: str) -> str:
    """The family of a case, whose results have one revision: "hits", "pictures W", or "trees W" with "bvh" or "kdtree"."""
    return f"{group} {case.split()[1]}" if group.startswith("trees ") else group


def current_revision(family: str) -> int:
    """The revision in the code of a family's results."""
    results, last = family.split()[0], family.split()[-1]
    if results == "trees":
        return revisions.TREE_REVISION[last]
    return revisions.ANSWER_REVISION if results == "hits" else revisions.SAMPLE_REVISION


def family_digests(hashes: Hashes) -> dict[str, str]:
    """For each family the hash over its cases and their hashes."""
    families: dict[str, dict[str, str]] = {}
    for group, cases in hashes.items():
        for case, value in cases.items():
            families.setdefault(family_of(group, case), {})[case] = value
    return {
        family: hashlib.blake2b(json.dumps(cases, sort_keys=True).encode(), digest_size=8).hexdigest()
        for family, cases in sorted(families.items())
    }


def recorded(path: Path = KEPT) -> Recorded:
    """What was noted beside a file of hashes."""
    path = path.with_name(REVISIONS)
    return json.loads(path.read_text()) if path.exists() else {}


def faults_of_revisions(hashes: Hashes, known: Recorded) -> list[str]:
    """A line for each family whose hashes or revision are not those recorded."""
    lines = []
    for family, digest_now in family_digests(hashes).items():
        entry = known.get(family, {})
        if entry.get("digest") != digest_now:
            lines.append(f"{family}: its hashes were changed, but not by `python -m tests.bits --write`")
        elif entry["revision"] != current_revision(family):
            lines.append(
                f"{family}: recorded at revision {entry['revision']}, and wrt/revisions.py has {current_revision(family)}; run "
                "`python -m tests.bits --write` at this width"
            )
    return lines


def write(hashes: Hashes, path: Path = KEPT) -> list[str]:
    """Adds hashes to a file, or replaces those of the same cases, with their revisions in a file beside it.

    Returns a line for each family with changed hashes whose revision in the code is not above the recorded one. If there is
    any, nothing is written.
    """
    kept, known, changed = read(path), recorded(path), {}
    for group, cases in hashes.items():
        for case, value in cases.items():
            if kept.get(group, {}).get(case, value) != value:
                changed.setdefault(family_of(group, case), []).append(case)
    refused = [
        f"{family}: {len(cases)} hashes changed, such as {cases[0]}: raise the revision in wrt/revisions.py above "
        f"{current_revision(family)}, and write again"
        for family, cases in changed.items()
        if current_revision(family) <= known.get(family, {}).get("revision", 0)
    ]
    if refused:
        return refused
    whole = {group: kept.get(group, {}) | hashes.get(group, {}) for group in sorted({*kept, *hashes})}
    renewed = {family_of(group, case) for group, cases in hashes.items() for case in cases}
    for family, digest_now in family_digests(whole).items():
        if family in renewed:
            known[family] = {"revision": current_revision(family), "digest": digest_now}
    save(path, {group: dict(sorted(cases.items())) for group, cases in whole.items()})
    save(path.with_name(REVISIONS), dict(sorted(known.items())))
    return []


def save(path: Path, values: dict[str, Any]) -> None:
    """Writes a JSON file."""
    path.write_text(json.dumps(values, indent=1) + "\n")


def differences(found: Hashes, kept: Hashes) -> list[str]:
    """A line for each case whose hash is not the one kept, or of which none is kept."""
    lines = []
    for group, cases in found.items():
        for case, value in cases.items():
            known = kept.get(group, {}).get(case)
            if known != value:
                lines.append(f"{group}: {case}: {value}, " + (f"kept is {known}" if known else "none is kept"))
    return lines
