"""Examples in docstrings are Python, and the names of wrt in them exist."""

from __future__ import annotations

import ast
import re
import textwrap
from functools import reduce
from pathlib import Path

import pytest

import wrt

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"(?:^|\n\n)((?: {4,}\S.*(?:\n|$)|\n(?= {4}))+)")
"""Lines of a docstring that stand further right, after an empty one."""


def examples() -> dict[str, str]:
    """The examples of docstrings of wrt by where they stand."""
    found = {}
    for path in sorted((ROOT / "wrt").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                for block in BLOCK.findall(ast.get_docstring(node) or ""):
                    if re.search(r"\b(wrt|scene|hits)\.\w+\(", block):
                        found[f"{path.relative_to(ROOT)}:{getattr(node, 'name', '')}"] = textwrap.dedent(block)
    return found


EXAMPLES = examples()


def test_there_are_examples():
    assert len(EXAMPLES) > 50


@pytest.mark.parametrize("place", EXAMPLES)
def test_names_of_examples_exist(place):
    for node in ast.walk(ast.parse(EXAMPLES[place])):
        if isinstance(node, ast.Attribute) and re.fullmatch(r"wrt(\.\w+)+", ast.unparse(node)):
            reduce(getattr, ast.unparse(node).split(".")[1:], wrt)
