"""Prose as a native engineer writes it: phrases that docs/style.md rewrites do not come back."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STYLE = "docs/style.md"
ROWS = re.findall(r"^\| `([^|]+)` \| ([^|]+) \|$", (ROOT / STYLE).read_text(encoding="utf-8"), re.MULTILINE)


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Every text of the product by its path, each run of white space as one space."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "wrt", "kernels", "builders", "docs", "notebooks/studies", "README.md", "CONTRIBUTING.md"],
        cwd=ROOT,
        capture_output=True,
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    names = [name for name in listed.stdout.decode().split("\0") if name.endswith((".py", ".md", ".h")) and name != STYLE]
    return {name: " ".join((ROOT / name).read_text(encoding="utf-8").split()) for name in names if (ROOT / name).is_file()}


def test_the_table_is_read():
    assert len(ROWS) >= 50
    assert len({phrase for phrase, _ in ROWS}) == len(ROWS)


@pytest.mark.parametrize("phrase", [phrase for phrase, _ in ROWS])
def test_no_text_has(phrase, texts):
    pattern = re.compile(rf"(?<!\w){re.escape(phrase)}", re.IGNORECASE)
    assert [name for name, text in texts.items() if pattern.search(text)] == [], f"{STYLE} says what to write"


def test_a_phrase_is_found_across_lines(texts):
    assert "Exact ray and point queries against triangle meshes from Python, on all cores" in texts["README.md"]
