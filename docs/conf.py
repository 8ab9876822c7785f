"""How Sphinx builds the site: `sphinx-build -W --keep-going -b html docs OUT`, after `pip install -e ".[docs]"`."""

import shutil
import sys
import textwrap
from pathlib import Path

import wrt

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import drawings  # noqa: E402
import source_links  # noqa: E402

from wrt.references import REFERENCES  # noqa: E402

ROOT = HERE.parent

project = "wrt"
author = "The wrt authors"
release = version = wrt.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"wrt {release}"

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 4

nb_execution_mode = "off"  # notebooks are shown with the outputs that they were committed with

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
default_role = "code"  # docstrings put names between single backquotes
napoleon_use_ivar = True
napoleon_use_rtype = False


def gather_pages() -> None:
    """Copies notebooks and records into docs/, where Sphinx looks for pages, and writes the page of references; docs/.gitignore
    leaves these out."""
    for source, target, patterns in (
        (ROOT / "notebooks", HERE / "notebooks", ("*.ipynb",)),
        (ROOT / "notebooks" / "records", HERE / "records", ("*.md", "*.png")),
    ):
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        for path in (path for pattern in patterns for path in sorted(source.glob(pattern))):
            shutil.copyfile(path, target / path.name)
    rows = [f"`{key}`\n" + "\n  ".join(textwrap.wrap(f": {work}", 120)) + "\n" for key, work in REFERENCES.items()]
    text = "# References\n\nWhat docstrings cite, by key (`wrt.references`).\n\n" + "\n".join(rows)
    (HERE / "references.md").write_text(text, encoding="utf-8")


def as_restructured_text(app, what, name, obj, options, lines: list[str]) -> None:
    """Docstrings as Sphinx reads them: indented examples become code blocks, a bar around a number is no substitution."""
    above, inside, result = "", False, []
    for number, line in enumerate(lines):
        is_indented, after_blank = line.startswith("    "), number == 0 or not lines[number - 1].strip()
        if is_indented and after_blank and not inside and above and not above.startswith((" ", "*")):
            result += [".. code-block:: python", ""]
            inside = True
        if line.strip():
            inside = inside and is_indented
            above = line
        plain = line.split("`")
        plain[::2] = [text.replace("|", "\\|") for text in plain[::2]]
        result.append(line if inside else "`".join(plain))
    lines[:] = result


def setup(app) -> None:
    """Comes before napoleon, which reads sections by their indentation."""
    app.connect("autodoc-process-docstring", as_restructured_text, priority=400)
    source_links.connect(app, app.outdir)


def draw_pictures() -> None:
    """Draws what the architecture page shows."""
    folder = HERE / "drawn"
    folder.mkdir(exist_ok=True)
    drawings.draw_rooms(folder / "rooms.svg")
    drawings.draw_query(folder / "query.svg")
    guides = HERE / "guides" / "drawn"
    guides.mkdir(exist_ok=True)
    drawings.draw_frames(guides / "frames.svg")


gather_pages()
draw_pictures()
