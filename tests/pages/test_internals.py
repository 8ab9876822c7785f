"""The pages of docs/internals: links lead to lines, lists of modules are those that are counted, bounds are searched."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from bounds.search import BOUNDS

ROOT = Path(__file__).parents[2]
PAGES = {path.name: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs" / "internals").glob("*.md"))}
sys.path.append(str(ROOT / "docs"))

import source_links  # noqa: E402

TO_LINES = [(page, *match[1:]) for page, text in PAGES.items() for match in map(list, re.findall(source_links.LINK, text))]
COUNTED = [page for page, text in PAGES.items() if "**Modules behind" in text]


@pytest.mark.parametrize(("page", "path", "name", "fragment"), TO_LINES)
def test_links_lead_to_lines(page, path, name, fragment):
    place = source_links.find(path, name, fragment)
    assert place.first <= place.line <= place.last
    assert fragment in (ROOT / path).read_text(encoding="utf-8").splitlines()[place.line - 1]


def test_pages_link_by_name():
    """Every link to code with a name has a fragment too, so that the test above sees it; the pages that explain have many."""
    for page, text in PAGES.items():
        named = re.findall(r"\]\((?:\.\./)+(?:kernels|builders|wrt)/[^)\s]*#", text)
        assert len(named) == sum(link[0] == page for link in TO_LINES), page
    assert len(COUNTED) == 2
    assert all(sum(link[0] == page for link in TO_LINES) > 25 for page in COUNTED)


@pytest.mark.parametrize(
    ("path", "name", "fragment"),
    [
        ("kernels/native/absent.h", "slab", "t"),
        ("kernels/native/box.h", "absent", "t"),
        ("kernels/native/box.h", "slab", "float enter = 0"),
        ("kernels/native/interleaved.h", "Walk.absent", "t"),
        ("kernels/native/interleaved.h", "Walk.pop", "partition"),
        ("kernels/simd/boxes.py", "absent", "t"),
        ("kernels/simd/boxes.py", "SLACK", "2.0**-21"),
        ("kernels/traversal/interleaved/interleaved_bvh.py", "block_tester.absent", "t"),
    ],
)
def test_links_to_nothing_are_found(path, name, fragment):
    with pytest.raises(LookupError, match=path):
        source_links.find(path, name, fragment)


def test_links_on_the_site(tmp_path):
    """They lead to a numbered line of a page with the file."""
    files = set()
    text = '[`box.h`: `slab`](../../kernels/native/box.h#slab "float enter = t_min")'
    line = source_links.find("kernels/native/box.h", "slab", "float enter = t_min").line
    found = source_links.with_lines(text, "internals/ray", files.add)
    assert found == (f'<a href="../source/kernels/native/box.h.html#line-{line}"><code>box.h</code>: <code>slab</code></a>')
    assert files == {"kernels/native/box.h"}
    source_links.write_source("kernels/native/box.h", tmp_path)
    written = (tmp_path / "source" / "kernels" / "native" / "box.h.html").read_text(encoding="utf-8")
    assert re.search(rf'<span id="line-{line}"><i> *{line}</i> .*float enter = t_min', written)


@pytest.mark.parametrize("page", COUNTED)
def test_modules_are_those_behind(page):
    """Counted in a process of its own, as what has been made before is not made again."""
    command = [sys.executable, ROOT / "tests" / "support" / "modules_behind.py", page]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    names = [line for line in done.stdout.splitlines() if re.fullmatch(r"wrt[\w.]+|\w+\.h", line)]
    modules = [name for name in names if name.startswith("wrt")]
    listed = re.search(r"\*\*Modules behind.*?\((\d+), .*?```text\n(.*?)```", PAGES[page], re.DOTALL)
    assert listed[2].split() == modules
    assert int(listed[1]) == len(modules)
    headers = re.search(r"\*\*Headers\*\*(.*?)\.\n", PAGES[page], re.DOTALL)[1]
    assert re.findall(r"`(\w+\.h)`", headers) == [name for name in names if name.endswith(".h")]


def test_bounds_are_listed():
    rows = re.findall(r"^\| `(\w+)` \|.*\]\(\.\./\.\./([^)]+)\) \|$", PAGES["bounds.md"], re.MULTILINE)
    assert rows == [(name, bound.proof) for name, bound in BOUNDS.items()]


@pytest.mark.parametrize("name", BOUNDS)
def test_proofs_name_their_search(name):
    assert re.search(rf"`{name}`.{{0,80}}of\s+(//\s+)?tests/bounds", (ROOT / BOUNDS[name].proof).read_text(encoding="utf-8"))
