"""C++ is in kernels/native, in functions that can be read; what Python holds are the lines that call it.

A native function in Python is a line or a few that call a function of a header. `WRITTEN_TWICE` has the functions of headers
that are alike but for names; it can only shrink.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from wrt.kernels.runtime import native

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("kernels", "builders", "wrt")

MAX_STRING, MAX_FUNCTION = 10, 80
"""Most lines of C++ in a string, and of a function of a header, its braces included."""

SHORT_BODY = 40
"""Words and signs of a body below which functions may be alike."""

WRITTEN_TWICE = {
    ("exact_signs.h: cross", "nearest_on_triangle.h: cross", "shading_vectors.h: cross"),
    ("projected_areas.h: lower", "projected_areas.h: upper"),
}
"""Functions with equal bodies: the same of numbers, of types of vectors, or of the other end."""

RUN = 60
"""Words and signs from the beginning of a statement on that two headers must not share."""

SHARED_RUNS = {
    ("binary_nodes.h", "warp_packets.h"),  # the calls for both boxes of a node
    ("bins.h", "events.h"),  # the lane with the least cost
    ("box.h", "projected_areas.h"),  # members of a struct of vectors, copied to arrays
    ("clip.h", "scan.h"),  # the beginning of two functions with the same targets
    ("exact_points.h", "point_groups.h"),
    ("light_raster.h", "ray.h"),  # a cross product
    ("packet_culling.h", "packet_frusta.h"),  # the beginning of culling by the rays at a box, and the ends of three vertices
    ("packet_culling.h", "stream_root.h"),  # the box of a child
}
"""Headers with such runs."""

KEYWORDS = {
    "if",
    "else",
    "for",
    "while",
    "return",
    "const",
    "int",
    "float",
    "double",
    "unsigned",
    "bool",
    "auto",
    "true",
    "false",
}


def documentation(tree: ast.Module) -> set[int]:
    """Which nodes are strings that stand alone."""
    return {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}


def text_of(node: ast.expr) -> str | None:
    """The text of a literal, with a name for each value that is put in."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "value" for part in node.values)
    return None


def literals(node: ast.AST) -> Iterator[ast.expr]:
    """All literals of strings; a text with values is one."""
    if isinstance(node, (ast.Constant, ast.JoinedStr)):
        yield node
        return
    for child in ast.iter_child_nodes(node):
        yield from literals(child)


def is_native(text: str) -> bool:
    """Whether a text has statements or macros of C++."""
    return text.count(";") > 1 or (";" in text and "{" in text) or "#define" in text


def native_lines(source: str) -> list[int]:
    """Lines of each string of C++ in a module."""
    tree = ast.parse(source)
    skipped = documentation(tree)
    texts = [text_of(node) for node in literals(tree) if id(node) not in skipped]
    return [sum(bool(line.strip()) for line in text.splitlines()) for text in texts if text and is_native(text)]


def functions(header: str) -> Iterator[tuple[str, str, int]]:
    """The head of each function, or of each member function, its body, and its lines from brace to brace.

    Braces stand alone on their lines, or around a body of one line.
    """
    lines = header.splitlines()
    for start, line in enumerate(lines):
        if re.fullmatch(r" *\{", line):
            end = lines.index(line.replace("{", "}"), start)
            yield lines[start - 1].strip(), "\n".join(lines[start + 1 : end]), end - start + 1
        elif one := re.fullmatch(r" *(.*\)(?: const)?) \{ (.*) \}", line):
            yield one[1], one[2], 1


def words(body: str) -> list[str]:
    """The words and signs of a text, without comments and directives."""
    return re.findall(r"[A-Za-z_]\w*|\d[\w.]*|[^\s\w]", re.sub(r"//.*|^ *#.*", "", body, flags=re.MULTILINE))


def shape(parts: list[str]) -> tuple[str, ...]:
    """The words and signs, with the same names for all that are alike but for names."""
    names: dict[str, str] = {}
    return tuple(
        names.setdefault(part, f"name{len(names)}") if re.match("[A-Za-z_]", part) and part not in KEYWORDS else part
        for part in parts
    )


def alike(headers: dict[str, str]) -> set[tuple[str, ...]]:
    """Functions of headers, by file and name, whose bodies are alike and not short."""
    found = defaultdict(set)
    for file, text in headers.items():
        for head, body, _lines in functions(text):
            named = re.findall(r"(\w+)\(", head)
            found[shape(words(body))].add(f"{file}: {named[0] if named else head}")
    return {tuple(sorted(those)) for body, those in found.items() if len(body) >= SHORT_BODY and len(those) > 1}


def shared_runs(headers: dict[str, str]) -> set[tuple[str, ...]]:
    """Headers that share a run of `RUN` words and signs, but for names, from the beginning of a statement on."""
    found = defaultdict(set)
    for file, text in headers.items():
        parts = words(text)
        for i in range(1, len(parts) - RUN + 1):
            if parts[i - 1] in (";", "{", "}"):
                found[shape(parts[i : i + RUN])].add(file)
    return {tuple(sorted(files)) for files in found.values() if len(files) > 1}


def test_strings_of_native_code_are_short():
    found = {}
    for path in sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        long = sum(lines for lines in native_lines(path.read_text()) if lines > MAX_STRING)
        if long:
            found[str(path.relative_to(ROOT))] = long
    assert not found, f"C++ that belongs in kernels/native, in lines: {found}"


def test_native_functions_are_short():
    lengths = [
        (f"{path.name}: {head}", lines)
        for path in native.FOLDER.glob("*.h")
        for head, _body, lines in functions(path.read_text())
    ]
    assert len(lengths) > 50
    assert not [(where, lines) for where, lines in lengths if lines > MAX_FUNCTION]


def test_no_function_is_written_twice():
    """The slab test, areas of triangles, compaction and the like are templates, one for each kind of lanes."""
    found = alike({path.name: path.read_text() for path in native.FOLDER.glob("*.h")})
    assert found - WRITTEN_TWICE == set(), "functions that are alike but for names: make one, or a template"
    assert WRITTEN_TWICE - found == set(), "these are no more: remove them from the list"


def test_no_formula_is_written_twice():
    """Not inside a longer function, either."""
    found = shared_runs({path.name: path.read_text() for path in native.FOLDER.glob("*.h")})
    assert found - SHARED_RUNS == set(), "headers with the same statements but for names: make a function of them"
    assert SHARED_RUNS - found == set(), "these are no more: remove them from the list"


@pytest.mark.parametrize(
    ("file", "head"),
    [
        ("box.h", "Interval slab("),
        ("triangle.h", "Areas<F> areas_of("),
        ("lanes.h", "int append("),
        ("lanes.h", "void exchange("),
    ],
)
def test_copies_of_formulas_are_found(file, head):
    """A copy of the slab test, of the areas, of compaction, or of a step of the transposition, with other names and amid other
    statements."""
    text = (native.FOLDER / file).read_text()
    body = max((body for found, body, _lines in functions(text) if head in found), key=len)
    renamed = re.sub(r"[A-Za-z_]\w*", lambda name: name[0] if name[0] in KEYWORDS else f"other_{name[0]}", body)
    copy = f"namespace wrt {{\nfloat f(float x)\n{{\n    x += 1.0f;\n{renamed}\n    return x;\n}}\n}}\n"
    assert shared_runs({file: text, "copy.h": copy}) == {tuple(sorted((file, "copy.h")))}
    assert not shared_runs({file: text, "none.h": copy.replace(",", ", 1 +")})


def test_intrinsics_of_lanes_are_in_one_header():
    """Compaction and permutation by instructions of a CPU: a function for each kind of lanes."""
    found = defaultdict(list)
    for path in native.FOLDER.glob("*.h"):
        for name in re.findall(r"__builtin_ia32_(?:compress|expand|perm)\w+", path.read_text()):
            found[name].append(path.name)
    assert len(found) == 3
    assert {tuple(files) for files in found.values()} == {("lanes.h",)}


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ('"""a;\nb;\nc;"""\nx = 1', []),
        ('x = """\n\na;\nb;\n"""', [2]),
        ('x = f"""if ({x}) {{\n    a = {y + 1};\n}}"""', [3]),
        ('def f():\n    """One; two; three."""\n    g("a = 1;\\n" f"b = {c};", "no code")', [2]),
        ('x = "for each;" + """a;\nb;"""', [2]),
        ('x = "#define A b"', [1]),
    ],
)
def test_strings_of_native_code_are_found(source, lines):
    assert native_lines(source) == lines


def test_functions_of_headers_are_found():
    one = "namespace wrt {\nint f(int x) { return x; }\n\n"
    two = "int g(int x)\n{\n    if (x) {\n        x = 1;\n    }\n    return x;\n}\n"
    member = "struct S {\n    int n;\n    int h() const\n    {\n        return n;\n    }\n};\n}\n"
    found = [(head, lines) for head, _body, lines in functions(one + two + member)]
    assert found == [("int f(int x)", 1), ("int g(int x)", 6), ("int h() const", 3)]


def test_functions_that_are_alike_are_found():
    sum_of = (
        "float {0}(float a, float b)\n{{\n    float {1} = a;\n" + "    {1} += a * b - {1} * a;\n" * 4 + "    return {1};\n}}\n"
    )
    other = sum_of.format("h", "c").replace("a * b", "b * a")
    headers = {"one.h": sum_of.format("f", "c") + other, "two.h": sum_of.format("g", "d")}
    assert alike(headers) == {("one.h: f", "two.h: g")}
