"""Copies of the checkout in which faults are put, and what says whether a fault is one."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import cache_from_source
from pathlib import Path

from .mutation import Mutation

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"kernels": "wrt.kernels", "builders": "wrt.builders"}
"""Folders of the checkout that are installed by another name."""

BESIDE = "shared"
"""A folder beside the checkout that has models for tests; copies see it, too."""


def project_files(root: Path) -> list[str]:
    """All files of a checkout that Git does not ignore, committed or not.

    Raises:
        RuntimeError: it is no checkout, or there is no Git.
    """
    command = ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        found = subprocess.run(command, capture_output=True, check=True).stdout.decode()
    except (OSError, subprocess.CalledProcessError) as error:
        raise RuntimeError(f"mutations need a Git checkout: {root} has none that Git can list ({error})") from None
    return [name for name in found.split("\0") if name and (root / name).is_file()]


class Copy:
    """A copy of a checkout.

    Attributes:
        root: its folder.
    """

    def __init__(self, source: Path, folder: Path) -> None:
        """Copies the files of the checkout `source` to a new folder inside `folder`."""
        folder.mkdir(parents=True)
        self.root = folder / "copy"
        for name in project_files(source):
            target = self.root / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source / name, target)
        if (source.parent / BESIDE).is_dir():
            (folder / BESIDE).symlink_to(source.parent / BESIDE)

    @contextmanager
    def mutated(self, mutation: Mutation) -> Iterator[None]:
        """Inside the `with` block, the copy has the fault.

        Raises:
            ValueError: the fault cannot be put in, or is none (`Mutation.applied_to`, `check_code`).
        """
        path = self.root / mutation.path
        if not path.is_file():
            raise ValueError(f"there is no file {mutation.path}")
        before = path.read_text(encoding="utf-8")
        after = mutation.applied_to(before)
        if path.suffix == ".py":
            check_code(before, after)
        try:
            write(path, after)
            yield
        finally:
            write(path, before)

    def environment(self, kernel_cache: Path) -> dict[str, str]:
        """Variables for a process that imports the copy, and keeps kernels in that folder."""
        return {**os.environ, "PYTHONPATH": str(self.root), "WARP_CACHE_PATH": str(kernel_cache)}


def write(path: Path, text: str) -> None:
    """Writes a file of code, and removes its compiled form: Python would take that for current if size and second are equal."""
    path.write_text(text, encoding="utf-8")
    for compiled in Path(cache_from_source(path)).parent.glob(f"{path.stem}.*"):
        compiled.unlink()


def check_code(before: str, after: str) -> None:
    """Checks that text is still Python, and another program than before.

    Raises:
        ValueError: it is not.
    """
    try:
        changed = program(after) != program(before)
    except SyntaxError as error:
        raise ValueError(f"the mutated file is no Python: {error}") from None
    if not changed:
        raise ValueError("only comments, docstrings or spaces change")


def program(text: str) -> str:
    """What a file of code says without comments, docstrings and formatting."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        for body in ("body", "orelse", "finalbody"):
            statements = getattr(node, body, None)
            if isinstance(statements, list):
                setattr(node, body, [one for one in statements if not is_docstring(one)])
    return ast.dump(tree)


def is_docstring(node: ast.AST) -> bool:
    """Whether a statement is a text and nothing else."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def module_of(path: str) -> str:
    """The module that a file of the checkout is when it is imported."""
    parts = Path(path).with_suffix("").parts
    name = ".".join((PACKAGES.get(parts[0], parts[0]), *parts[1:]))
    return name.removesuffix(".__init__")


def link_kernels(source: Path, folder: Path) -> None:
    """Puts the kernels of a kernel cache into another folder, as hard links where the file system has them.

    Other processes may use the cache: what they rename meanwhile is left out.
    """
    for place, _, files in os.walk(source):  # skips folders that are gone
        target = folder / Path(place).relative_to(source)
        target.mkdir(parents=True, exist_ok=True)
        for name in files:
            with suppress(FileNotFoundError):
                link(os.path.join(place, name), target / name)


def link(source: str, target: Path) -> None:
    """Links a file, or copies it to another file system."""
    try:
        os.link(source, target)
    except FileNotFoundError:
        raise
    except OSError:
        shutil.copy2(source, target)
