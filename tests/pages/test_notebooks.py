"""Every notebook runs from top to bottom, and is committed with its outputs."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import json
import os
import re
import types
from pathlib import Path

import pytest
import warp as wp

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"

SETTINGS = f"""
import gc, sys, warp
warp.config.cpu_compiler_flags = {wp.config.cpu_compiler_flags!r}
sys.path.insert(0, {str(FOLDER)!r})
"""
"""Kernels as the other tests compile them, which may have done so already; studies are found, as in a notebook's folder."""

FREEZE = "gc.freeze()\n"
"""Studies collect garbage before each round. What earlier cells made need not be scanned for it."""

ROUNDS = re.compile(r"(rounds\W+)\d+")
"""How often a notebook measures; here once, as nobody looks at the figures."""

SIZES = re.compile(r"(\bsizes = )\([\d, ]*\b64\b[\d, ]*\)")
"""Sizes of packets that a notebook compares, each with kernels of its own; here the one that other tests have compiled."""

REFERENCES = re.compile(r"(\breference_samples = )\d+")
"""Samples a pixel of pictures that others are compared with; here few."""

SMALLER = {"detail": 5, "cells": 14, "level": 8, "trees": 3, "samples": 8, "size": 64}
"""Largest sizes of built-in scenes, samples of a pixel and pixels along a side; only whole ones."""

EFFORT = re.compile(r'("tests": |pairs=)1 << \d+')
"""Pairs of a ray and a triangle that a notebook measures with; here few."""

FEWER = (
    ("in TRAVERSALS.items():", 'in [(way, TRAVERSALS[way]) for way in ("single", "packet", "interleaved")]:'),
    ("for name in CULLINGS", 'for name in ("none", "vertex", "frustum")'),
    ('scenes.build("atrium")\ncamera', 'scenes.build("atrium", detail=2)\ncamera'),
)
"""What notebooks go through from end to end, and here in part: each row takes kernels of its own, which other tests hold
against brute force, and the code of a notebook is the same for all."""

COARSER = (
    ("court = wrt.scenes.atrium()", "court = wrt.scenes.atrium(detail=2)"),
    ('compare_traces(wrt.scenes.build("atrium"),', 'compare_traces(wrt.scenes.build("atrium", detail=2),'),
    ('mesh = wrt.scenes.build("atrium")\nchecked', 'mesh = wrt.scenes.build("atrium", detail=2)\nchecked'),
    ("for size in (256, 512)", "for size in (64, 128)"),
    ("(1, 9, 36, 100)", "(1, 9)"),
    ("samples = (1, 4, 16, 64, 256)", "samples = (1, 4, 16)"),
)
"""Scenes, rays and samples of the notebooks that take longest, and here smaller ones: nobody looks at the figures. Views keep
their pixels: "auto" chooses other kernels for fewer rays, and these would be compiled in addition."""

WHOLE_SIZES = re.compile(rf"\b({'|'.join(SMALLER)})=(\d+)\b(?!\.)")

RATIO = re.compile(r"\b\d+\.\d+x\b|\b\d+(?:\.\d+)? times\b|\d %")
"""A ratio in prose: 1.3x, 1.3 times or 30 %."""

QUOTED = re.compile(r"paper|thesis|report|et al|\((?:19|20)\d\d\b")
"""A paragraph that names the source of its figures."""

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def reduced(source: str) -> str:
    """The source of a cell, with few rounds, samples and triangles."""
    source = SIZES.sub(r"\g<1>(64,)", REFERENCES.sub(r"\g<1>100", ROUNDS.sub(r"\g<1>1", source)))
    source = EFFORT.sub(r"\g<1>1 << 14", source)
    for whole, part in FEWER + COARSER:
        source = source.replace(whole, part)
    return WHOLE_SIZES.sub(lambda given: f"{given[1]}={min(int(given[2]), SMALLER[given[1]])}", source)


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("whole", [whole for whole, _ in FEWER + COARSER])
def test_what_is_shortened_is_in_a_notebook(whole):
    assert any(whole in "".join(cell["source"]) for path in NOTEBOOKS for cell in json.loads(path.read_text())["cells"])


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_text_states_no_measured_ratio(path):
    """Verdicts written by hand contradicted the tables beside them after these were measured again; code computes them now."""
    cells = json.loads(path.read_text())["cells"]
    texts = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    paragraphs = [part for text in texts for part in re.split(r"\n\s*\n|\n\* ", text)]
    assert [part for part in paragraphs if RATIO.search(part) and not QUOTED.search(part)] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_names_that_a_notebook_takes_from_modules_exist(path, monkeypatch):
    """Found in a second what the run below finds in minutes."""
    for name in ("matplotlib", "IPython"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install 'wrt[test-all]'")
    monkeypatch.syspath_prepend(str(FOLDER))
    cells = json.loads(path.read_text())["cells"]
    tree = ast.parse("\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"))
    modules, missing = {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {
                one.asname or one.name.partition(".")[0]: one.name if one.asname else one.name.partition(".")[0]
                for one in node.names
            }
        if isinstance(node, ast.ImportFrom):
            home = importlib.import_module(node.module)
            for one in node.names:
                if not hasattr(home, one.name) and not importlib.util.find_spec(f"{node.module}.{one.name}"):
                    missing.append(f"{node.module}.{one.name}")
                elif isinstance(value := getattr(home, one.name, None), types.ModuleType) or value is None:
                    modules[one.asname or one.name] = f"{node.module}.{one.name}"
    for node in ast.walk(tree):
        home = modules.get(node.value.id) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) else None
        if home and not hasattr(importlib.import_module(home), node.attr):
            missing.append(f"{home}.{node.attr}")
    assert missing == []


@pytest.mark.notebooks
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
        cell.source = FREEZE + reduced(cell.source)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(SETTINGS))
    os.environ.setdefault("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    client.NotebookClient(notebook, timeout=300, iopub_timeout=60, resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = sum(
        "image/png" in output.get("data", {}) for cell in notebook.cells if "outputs" in cell for output in cell.outputs
    )
    assert pictures == sum("image/png" in data for data in committed)
