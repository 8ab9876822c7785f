"""Dated records of long runs, in notebooks/records: where they go, and on what machine they were made."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path

import wrt
from wrt.bench.core.benchmark_results import machine

RECORDS = Path(__file__).resolve().parents[1] / "notebooks" / "records"


def machine_line() -> str:
    """The CPU, what kernels are compiled for, and versions."""
    host = machine("cpu")
    versions = ", ".join(f"{name} {version}" for name, version in host["versions"].items())
    return (
        f"{host['cpu']}, {wrt.get_num_threads()} threads, target {host['target']}, W = {host['lanes']}, {host['system']}, "
        f"Python {host['python']}; {versions}"
    )


def write_record(name: str, title: str, lines: Sequence[str], path: Path | None = None) -> Path:
    """Writes a record, or replaces that of the same name and day; returns where it is.

    Args:
        name: of the run, for the file's name.
        title: for its first line, to which the day is added.
        lines: what ran and what came out.
        path: another place for it.
    """
    path = path or RECORDS / f"{date.today().isoformat()}-{name}.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    text = [f"# {title}, {date.today().isoformat()}", "", f"{machine_line()}.", "", *lines, ""]
    path.write_text("\n".join(text), encoding="utf-8")
    return path
