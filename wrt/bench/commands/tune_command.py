"""`wrt tune`: finds out which engines are the fastest on this machine, and stores it for later processes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from math import log
from pathlib import Path

import click

from wrt.bench.commands.command_options import load_model, progress, threads_option, usage_errors
from wrt.bench.comparisons.auto_cases import KINDS, scene_of
from wrt.bench.comparisons.auto_choices import Choice, compare_choices
from wrt.cli.arguments import start_warp, target_options
from wrt.cli.number_types import Whole
from wrt.engine.plan.tuned_choices import tuned_file, write
from wrt.kernels.runtime.launch import get_num_threads

SIZES = (64, 256, 1024)

WORTH = 1.05
"""Time of what the rules choose over that of the best engine from which the latter is stored."""


@click.command("tune")
@click.argument("models", nargs=-1)
@target_options
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="Kind of rays; may be repeated. [all]")
@click.option("--size", "sizes", multiple=True, type=Whole(8), help="Views have SIZE x SIZE pixels. [64 256 1024]")
@click.option("--rounds", default=5, show_default=True, type=Whole(1), help="Rounds per engine.")
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="File to write. [what WRT_TUNED names]")
@threads_option
def tune(
    models: tuple[str, ...],
    kinds: tuple[str, ...],
    sizes: tuple[int, ...],
    rounds: int,
    output: Path | None,
    threads: int | None,
) -> None:
    """Finds out which engines are the fastest on this machine for MODELS, and stores it: "auto" then begins with them.

    All engines give the same hits. What was stored for the same number of threads is replaced.
    """
    if any(size % 4 for size in sizes):
        raise click.BadParameter("must be a multiple of 4", param_hint="--size")
    start_warp("cpu", compiles_later=False)
    count, path = threads or get_num_threads(), output or tuned_file()
    seen: list[Choice] = []
    with progress() as on_turn, usage_errors():
        for model in models or ("teapot",):
            scene, mesh = scene_of("model", load_model(model), count)
            some = compare_choices(
                model, scene, mesh, kinds=kinds or KINDS, sizes=sizes or SIZES, rounds=rounds, on_turn=on_turn
            )
            seen += some
    found = fastest(seen)
    write({str(count): found}, path)
    found_in = f"{len(seen)} cases on {count} threads; other engines than the rules choose for {len(found)} classes"
    click.echo(f"{found_in}: '{path}'")


def fastest(seen: Iterable[Choice]) -> dict[str, str]:
    """The engine of each class that takes least in the mean of the ratios, if that of the rules takes `WORTH` times as long."""
    classes: dict[str, list[Choice]] = defaultdict(list)
    for choice in seen:
        classes[choice.rays_class].append(choice)
    found = {}
    for name, choices in classes.items():
        common = set.intersection(*({*choice.milliseconds} for choice in choices))
        means = {
            engine: sum(log(choice.milliseconds[engine] / choice.milliseconds[choice.rules]) for choice in choices)
            for engine in sorted(common)
        }
        best = min(means, key=means.__getitem__, default="")
        if best and means[best] <= -log(WORTH) * len(choices):
            found[name] = best
    return found
