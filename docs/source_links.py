"""Links from pages to lines of code, which are found by name when the site is built.

A page writes `[text](../../kernels/native/box.h#slab "float enter = t_min")`: a file, a function, class, struct or constant in
it (`Walk.settle` for a member, `make_loading_kernel.interleaved_bvh` for a function inside one), and a fragment of its code.
`find` gives the line of the fragment and fails if there is none, so that a link cannot lead to other code unnoticed. On the
site such a link leads to that line of a page with the whole file.
"""

from __future__ import annotations

import ast
import html
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent

LINK = re.compile(r'\[([^\]]+)\]\((?:\.\./)+((?:kernels|builders|wrt|tests)/[\w/.]+)#([\w.]+)\s+"([^"]+)"\)')
"""A link to code: text, file, name, fragment."""


class Place(NamedTuple):
    """Lines of a file, counted from 1: of the definition, and of the fragment in it."""

    first: int
    last: int
    line: int


def python_lines(text: str, name: str) -> tuple[int, int]:
    """First and last line of a function, class or constant; dots lead inside."""
    body: list[ast.stmt] = ast.parse(text).body
    found: ast.stmt | None = None
    for part in name.split("."):
        inside = [inner for node in body for inner in (node, *ast.walk(node)) if isinstance(inner, ast.stmt)]
        found = next((node for node in inside if part in defined_by(node)), None)
        if found is None:
            raise LookupError(f"no {part}")
        body = getattr(found, "body", [])
    decorators = getattr(found, "decorator_list", [])
    return min([found.lineno, *(decorator.lineno for decorator in decorators)]), found.end_lineno


def defined_by(node: ast.stmt) -> list[str]:
    """Names that a statement defines; overloads define none."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        is_overload = any(isinstance(decorator, ast.Name) and decorator.id == "overload" for decorator in node.decorator_list)
        return [] if is_overload else [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [inner.id for target in targets for inner in ast.walk(target) if isinstance(inner, ast.Name)]


def native_lines(text: str, name: str) -> tuple[int, int]:
    """The same of a header: a definition ends at the brace that closes it, a constant at its semicolon."""
    begin, end = 0, len(text)
    for part in name.split("."):
        for match in re.finditer(rf"\b{part}\b", text[begin:end]):
            at = begin + match.start()
            line = text.rfind("\n", 0, at) + 1
            if text[line:at].lstrip().startswith("//"):
                continue
            stop = re.compile(r"[{;]").search(text, at)
            is_constant = re.match(rf"\s*{part}\s*=", text[at:]) and "constexpr" in text[line:at]
            heads = re.match(rf"{part}\s*\(|{part}\s*\{{|{part}\s*$", text[at:], re.MULTILINE)
            if stop is None or not (is_constant or (heads and stop.group() == "{")):
                continue
            begin, end = line, (text.index(";", at) if is_constant else closing(text, stop.start()) + 1)
            break
        else:
            raise LookupError(f"no {part}")
    return text.count("\n", 0, begin) + 1, text.count("\n", 0, end) + 1


def closing(text: str, at: int) -> int:
    """Where the brace at `at` is closed."""
    depth = 0
    for place in range(at, len(text)):
        depth += {"{": 1, "}": -1}.get(text[place], 0)
        if depth == 0:
            return place
    raise LookupError("a brace is not closed")


def find(path: str, name: str, fragment: str) -> Place:
    """Where a fragment of code is.

    Raises:
        LookupError: the file, the name in it, or the fragment does not exist.
    """
    if not (ROOT / path).is_file():
        raise LookupError(f"{path} does not exist")
    text = (ROOT / path).read_text(encoding="utf-8")
    try:
        first, last = (python_lines if path.endswith(".py") else native_lines)(text, name)
    except LookupError as error:
        raise LookupError(f"{path}#{name}: {error}") from None
    lines = text.splitlines()[first - 1 : last]
    for number, line in enumerate(lines, first):
        if fragment in line:
            return Place(first, last, number)
    raise LookupError(f"{path}#{name} has no line with {fragment!r}")


def with_lines(text: str, page: str, note: Callable[[str], None]) -> str:
    """A page whose links to code lead to the pages of files; `note` is told of each file."""
    depth = page.count("/")

    def replaced(match: re.Match[str]) -> str:
        words, path, name, fragment = match.groups()
        place = find(path, name, fragment)
        note(path)
        inside = re.sub(r"`([^`]+)`", r"<code>\1</code>", words)
        return f'<a href="{"../" * depth}source/{path}.html#line-{place.line}">{inside}</a>'

    return LINK.sub(replaced, text)


def write_source(path: str, folder: Path) -> None:
    """Writes the page of a file: its lines, numbered."""
    target = folder / "source" / f"{path}.html"
    target.parent.mkdir(parents=True, exist_ok=True)
    lines = (ROOT / path).read_text(encoding="utf-8").splitlines()
    rows = "\n".join(
        f'<span id="line-{number}"><i>{number:5}</i>  {html.escape(line)}</span>' for number, line in enumerate(lines, 1)
    )
    style = "span:target { background: #fff3b0 } i { color: #888 } body { margin: 1em }"
    title = html.escape(path)
    target.write_text(
        f"<!DOCTYPE html><meta charset=utf-8><title>{title}</title><style>{style}</style><h1>{title}</h1><pre>{rows}</pre>\n",
        encoding="utf-8",
    )


def connect(app: object, folder: str | os.PathLike[str]) -> None:
    """Lets Sphinx resolve the links of all pages."""
    files: set[str] = set()

    def read(_: object, name: str, source: list[str]) -> None:
        source[0] = with_lines(source[0], name, files.add)

    def finish(_: object, error: Exception | None) -> None:
        if error is None:
            for path in sorted(files):
                write_source(path, Path(folder))

    app.connect("source-read", read)
    app.connect("build-finished", finish)
