"""mypy over `wrt` and over code that uses it: `python -m tests.typed.mypy_run`.

In a checkout, kernels/ and builders/ are beside wrt/, and `wrt/__init__.py` finds them there; a type checker does not run it.
So mypy reads a folder of links in which they are inside wrt/, as in an installation.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def link_packages(folder: Path) -> Path:
    """Makes `folder`/wrt of links into the checkout, as an installation has it; returns `folder`."""
    package = folder / "wrt"
    package.mkdir(parents=True)
    for path in [*(ROOT / "wrt").iterdir(), ROOT / "kernels", ROOT / "builders"]:
        (package / path.name).symlink_to(path)
    return folder


def run_mypy(folder: Path, arguments: list[str]) -> str:
    """Runs mypy in this process with the settings of pyproject.toml; returns what it prints.

    Args:
        folder: empty, for the links and the cache.
        arguments: of mypy: files or packages.
    """
    from mypy import api

    before, os.environ["MYPYPATH"] = os.environ.get("MYPYPATH"), str(link_packages(folder / "linked"))
    try:
        options = [f"--config-file={ROOT / 'pyproject.toml'}", f"--cache-dir={folder / 'cache'}"]
        printed, failed, _ = api.run([*options, *arguments])
    finally:
        del os.environ["MYPYPATH"]
        if before is not None:
            os.environ["MYPYPATH"] = before
    return printed + failed


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        printed = run_mypy(Path(folder), ["-p", "wrt"])
    print(printed, end="")
    sys.exit(not printed.startswith("Success"))


if __name__ == "__main__":
    main()
