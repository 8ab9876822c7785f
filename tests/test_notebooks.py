"""Every notebook runs from top to bottom, and is committed with its outputs."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import warp as wp

SETTINGS = f"import warp; warp.config.cpu_compiler_flags = {wp.config.cpu_compiler_flags!r}"
"""Kernels as the other tests compile them, which may have done so already."""

ROUNDS = re.compile(r"(\brounds\W+)\d+")
"""How often a notebook measures; here once, as nobody looks at the figures."""

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path, tmp_path):
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "commit the notebook with its outputs: run all its cells"
    committed = [output.get("data", {}) for cell in code for output in cell.outputs]
    assert any("image/png" in data for data in committed), "a notebook shows pictures"
    assert path.stat().st_size < 1_500_000, "keep the pictures small"
    for cell in code:
        cell.source = ROUNDS.sub(r"\g<1>1", cell.source)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(SETTINGS))
    os.environ.setdefault("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    client.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = sum(
        "image/png" in output.get("data", {}) for cell in notebook.cells if "outputs" in cell for output in cell.outputs
    )
    assert pictures == sum("image/png" in data for data in committed)
