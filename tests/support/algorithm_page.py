"""The tables of docs/algorithms.md: sections, rows, and the names of algorithms in them."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "algorithms.md").read_text(encoding="utf-8")


def sections(page: str) -> dict[str, str]:
    """Heading -> what follows it, up to the next heading."""
    parts = re.split(r"^#+ (.+)$", page, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def rows_of(text: str) -> list[tuple[str, str]]:
    """First and second cell of every row below the head "name | paper" of a section's table."""
    rows, inside = [], False
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| name |"):
            inside = True
        elif inside and not line.startswith("|"):
            inside = False
        elif inside and not line.startswith("| ---"):
            rows.append((cells[0], cells[1]))
    return rows


def keys_in(page: str, section: str) -> list[str]:
    """Names in the first cells of a section's table."""
    return [key for name, _ in rows_of(sections(page)[section]) for key in re.findall(r"`([^`]+)`", name)]
