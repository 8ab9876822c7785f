"""`python -m tests.arm64 [--sample N:TURN] [--folder FOLDER]`: see the package."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ |= {"WRT_WIDTH": "8", "WRT_SHOW_COMPILING": "0"}  # as on ARM
ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

import click  # noqa: E402
from bits import digests  # noqa: E402
from support.selection import as_sample  # noqa: E402

from arm64 import cases, sysroot  # noqa: E402

KEPT = ("hits", "trees 8")
"""Groups of `tests/bits` whose hashes are compared."""


def expected_hashes(names: list[str]) -> dict[str, str]:
    """The hashes by case: those that are kept, and of other groups those that this CPU gives."""
    kept = digests.read()
    found = {case: value for group in KEPT for case, value in kept[group].items()}
    for name in (name for name in names if not name.startswith(("hits", "tree", "triangle test"))):
        found |= {case: value for case, _, value in cases.groups()[name]()}
    return found


@click.command()
@click.option("--sample", metavar="N:TURN", default="1:0", help="One group of cases in N; N turns draw all.  [all]")
@click.option("--folder", type=click.Path(path_type=Path), help="Where packages for ARM are kept.  [a temporary one]")
def main(sample: str, folder: Path | None) -> None:
    """Compares hits, trees and pictures on an emulated ARM processor with those of this CPU."""
    names = list(cases.chosen(*as_sample(sample)))
    with tempfile.TemporaryDirectory() as made:
        where = (folder or Path(made)).absolute()
        try:
            python = sysroot.prepare(where)
        except sysroot.Unavailable as reason:
            click.echo(f"no emulated ARM here: {reason}")
            return
        hashes = Path(made) / "hashes.json"
        hashes.write_text(json.dumps(expected_hashes(names)))
        paths = os.pathsep.join([str(where / "site"), str(ROOT)])
        environment = os.environ | {"PYTHONPATH": paths, "WARP_CACHE_PATH": str(where / "kernels")}
        program = str(Path(__file__).with_name("emulated.py"))
        done = subprocess.run([*python, program, sys.executable, str(hashes), *names], env=environment)
    raise SystemExit(done.returncode)


main()
