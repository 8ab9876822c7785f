"""The C++ headers: they compile on their own, without a warning, for every number of lanes and every target, and are formatted.

Both tools are wheels (the extra `native`), so that no compiler has to be installed. `zig clang -cc1` is Clang without a C
library: the headers include nothing of it.
"""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from support.native_guards import has_assembly, x86_without_guard

from wrt.kernels.runtime import native

INSTANCES = sorted((Path(__file__).parents[1] / "support").glob("native_*.cpp"))
HEADERS = sorted(native.FOLDER.glob("*.h"))
TARGETS = {"x86-64": "x86_64-linux-gnu", "x86-64-v3": "x86_64-linux-gnu", "x86-64-v4": "x86_64-linux-gnu"}
TARGETS |= {"neoverse-n1": "aarch64-linux-gnu"}


def tool(module: str) -> None:
    """Skips the test where a tool is not installed."""
    if importlib.util.find_spec(module) is None:
        pytest.skip(f'{module} is not installed; it comes with the extra "native"')


@pytest.mark.parametrize("width", [4, 8, 16])
@pytest.mark.parametrize("target", TARGETS)
def test_headers_compile_on_their_own(target, width):
    tool("ziglang")
    flags = f"-fsyntax-only -x c++ -std=c++17 -triple {TARGETS[target]} -target-cpu {target} -DWIDTH={width} -DCUDA_CALLABLE="
    warnings = "-Wall -Wextra -Wshadow -Wno-unused-function -Werror"
    command = [sys.executable, "-m", "ziglang", "clang", "-cc1", *flags.split(), *warnings.split()]
    command += ["-Dsize_t=unsigned long", "-I", str(native.FOLDER), *map(str, INSTANCES)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_every_header_is_instantiated():
    included = {name for path in INSTANCES for name in native.INCLUDE.findall(path.read_text())}
    assert {header.name for header in HEADERS} == set(native.with_included(tuple(included)))


def test_headers_are_formatted():
    tool("clang_format")
    files = [*map(str, HEADERS), *map(str, INSTANCES)]
    style = f"--style=file:{native.FOLDER / '.clang-format'}"
    command = [sys.executable, "-c", "from clang_format import clang_format; clang_format()", "--dry-run", "-Werror", style]
    done = subprocess.run([*command, *files], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_lines_of_headers_fit():
    """Comments too, which the tool leaves as they are."""
    style = (native.FOLDER / ".clang-format").read_text()
    width = int(re.search(r"ColumnLimit: (\d+)", style)[1])
    lines = [(path.name, len(line)) for path in [*HEADERS, *INSTANCES] for line in path.read_text().splitlines()]
    assert [(name, length) for name, length in lines if length > width] == []


def test_headers_are_for_every_cpu():
    for header in HEADERS:
        assert not has_assembly(header.read_text())
        assert not x86_without_guard(header.read_text()), header.name


def test_headers_come_once_and_after_what_they_include():
    text = native.text_of(tuple(header.name for header in reversed(HEADERS)))
    assert [text.count(f'"wrt/kernels/native/{header.name}"') for header in HEADERS] == [1] * len(HEADERS)
    assert text.index("loops.h") < text.index("lanes.h") < text.index("box.h") < text.index("stream.h")
    assert "#include" not in text
    assert "#pragma once" not in text


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or what a module has."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        with suppress(ModuleNotFoundError):
            found = importlib.import_module(".".join(parts[:end]))
            for part in parts[end:]:
                found = getattr(found, part, None)
            return found is not None
    return False


def test_what_headers_refer_to_exists():
    """Comments name the Python modules whose structs and rules they use; both move."""
    names = {name for header in HEADERS for name in re.findall(r"\bwrt(?:\.[A-Za-z_]\w*)+", header.read_text())}
    assert len(names) > 40
    assert {name for name in names if not exists(name)} == set()
    assert not exists("wrt.kernels.nothing")
