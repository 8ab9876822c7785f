"""Prose as a native engineer writes it: phrases that docs/style.md rewrites do not come back."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STYLE = "docs/style.md"
ROWS = re.findall(r"^\| `([^|]+)` \| ([^|]+) \|$", (ROOT / STYLE).read_text(encoding="utf-8"), re.MULTILINE)


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Every text of the product by its path, each run of white space as one space, in small letters."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "wrt", "kernels", "builders", "docs", "notebooks/studies", "README.md", "CONTRIBUTING.md"],
        cwd=ROOT,
        capture_output=True,
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    names = [name for name in listed.stdout.decode().split("\0") if name.endswith((".py", ".md", ".h")) and name != STYLE]
    files = {name: ROOT / name for name in names if (ROOT / name).is_file()}
    return {name: " ".join(file.read_text(encoding="utf-8").lower().split()) for name, file in files.items()}


def test_the_table_is_read():
    assert len(ROWS) >= 50
    assert len({phrase for phrase, _ in ROWS}) == len(ROWS)


@pytest.mark.parametrize("phrase", [phrase for phrase, _ in ROWS])
def test_no_text_has(phrase, texts):
    phrase = phrase.lower()
    pattern = re.compile(rf"(?<!\w){re.escape(phrase)}")
    found = [name for name, text in texts.items() if phrase in text and pattern.search(text)]
    assert not found, f"{STYLE} says what to write"


def test_a_phrase_is_found_across_lines(texts):
    assert "exact ray and point queries against triangle meshes from python, on all cores" in texts["README.md"]


def test_files_of_the_page_on_adding_have_our_style():
    """As they stand: a contributor who copies one had ruff complain about its imports."""
    pytest.importorskip("ruff", reason="ruff is not installed: pip install 'wrt[test]'")
    page = (ROOT / "docs" / "adding.md").read_text(encoding="utf-8")
    files = re.findall(r"^<!-- file: (\S+) -->\n```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert len(files) == 3
    for name, code in files:
        for command in (["check", "--quiet"], ["format", "--check", "--quiet"]):
            ruff = [sys.executable, "-m", "ruff", *command, "--stdin-filename", f"kernels/{name}", "-"]
            done = subprocess.run(ruff, input=code, cwd=ROOT, capture_output=True, text=True)
            assert done.returncode == 0, done.stdout + done.stderr
