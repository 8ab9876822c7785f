"""`python -m tests.bits [--write]`: see the package."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # for support

import support.environment  # noqa: F401 (before wrt)

from wrt.kernels.compilation.target import lane_width

from . import digests
from .hit_bits import hit_hashes
from .picture_bits import picture_hashes
from .tree_bits import tree_hashes

GROUPS: dict[str, tuple[str, Callable[[], Iterator[tuple[str, str, str]]]]] = {
    "hits": ("hits", hit_hashes),
    "trees": (f"trees {lane_width()}", tree_hashes),
    "pictures": (f"pictures {lane_width()}", picture_hashes),
}
"""For each kind of results the group of its hashes, and (case, engine, hash) for every case and engine."""


def computed(kinds: tuple[str, ...]) -> tuple[digests.Hashes, list[str]]:
    """Hashes of all cases, and a line for each engine that does not give the hash of the first one."""
    found: digests.Hashes = {}
    unequal = []
    for kind in kinds:
        group, cases = GROUPS[kind]
        first = found.setdefault(group, {})
        for number, (case, engine, value) in enumerate(cases()):
            if first.setdefault(case, value) != value:
                unequal.append(f"{group}: {case}: {engine} gives {value}, the first engine {first[case]}")
            if sys.stderr.isatty() or number % 100 == 0:
                click.echo(f"\r\x1b[K{group}: {number + 1}: {case}", nl=not sys.stderr.isatty(), err=True)
    return found, unequal


@click.command()
@click.option("--write", is_flag=True, help="Keep the hashes; changed ones need a raised revision.")
@click.option("--what", multiple=True, type=click.Choice(list(GROUPS)), help="Only these; repeat.  [all]")
@click.option("--file", default=digests.KEPT, type=click.Path(path_type=Path), help="Where hashes are kept.")
def main(write: bool, what: tuple[str, ...], file: Path) -> None:
    """Compares hashes of hits, trees and pictures with those that are kept."""
    found, lines = computed(what or tuple(GROUPS))
    if write:
        lines += digests.write(found, file)
    else:
        lines += digests.differences(found, digests.read(file))
    for line in lines:
        click.echo(line)
    click.echo(f"{sum(map(len, found.values()))} hashes, {len(lines)} differences")
    raise SystemExit(1 if lines else 0)


main()
