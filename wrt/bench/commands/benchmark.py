"""`wrt bench`: wrt beside the ray tracing libraries that are installed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from wrt.bench.commands.command_options import (
    json_option,
    load_model,
    plot_option,
    progress,
    table_console,
    usage_errors,
    write_json,
)
from wrt.bench.core.benchmark_results import ModelResult, Question, Report, machine
from wrt.bench.core.workloads import ORDERS, WORKLOADS, WorkloadMaker
from wrt.bench.peers.peer_table import DEFAULT_PEERS, PEERS, make_peers
from wrt.cli.arguments import start_warp, target_options
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import MAX_THREADS, get_num_threads
from wrt.meshes.mesh import TriangleMesh

DEFAULT_MODELS = ("teapot", "atrium", "wood")
"""Built-in scenes that are measured when no model is named."""

COMPARISONS = {
    "auto": ("auto_command", "auto_command"),
    "jobs": ("jobs_command", "jobs_command"),
    "points": ("points_command", "points_command"),
    "scaling": ("scaling_command", "scaling_command"),
}
"""What can be compared within wrt, by what stands in place of the model: module of this package, and the command in it."""


class BenchCommand(click.Command):
    """A command that hands over to one of `COMPARISONS` if its name is the first argument (a file of that name: ./NAME)."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """The context of the command that is meant, which click goes on with; Warp's log stays out of its figures."""
        if not args or args[0] not in COMPARISONS:
            context = super().make_context(info_name, args, parent, **extra)
        else:
            module, attribute = COMPARISONS[args[0]]
            command = getattr(import_module(f"wrt.bench.commands.{module}"), attribute)
            context = command.make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        start_warp(context.params.get("device"), compiles_later=False)
        return context

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command that the context was made for."""
        return super().invoke(ctx) if ctx.command is self else ctx.command.invoke(ctx)


@click.command(cls=BenchCommand)
@click.argument("model", required=False)
@target_options
@click.option(
    "--workload", "workloads", multiple=True, type=click.Choice([*WORKLOADS]), help="Rays to trace; may be repeated. [all]"
)
@click.option(
    "--peer",
    "peers",
    multiple=True,
    type=click.Choice([*PEERS]),
    help="Other libraries to compare with; repeatable. [all but flat]",
)
@click.option("--size", default=1024, show_default=True, type=Whole(1), help="Views have SIZE x SIZE pixels.")
@click.option("--order", default="tiles", show_default=True, type=click.Choice(ORDERS), help="Order of a view's pixels.")
@click.option("--rounds", default=5, show_default=True, type=Whole(1), help="Rounds per contender.")
@click.option("--threads", type=Whole(1, MAX_THREADS), help="CPU threads of each contender. [all cores]")
@click.option("--device", default="cpu", show_default=True, help="Where wrt and wp.Mesh run, such as cuda:0.")
@click.option("--builders/--no-builders", default=True, show_default=True, help="Compare builds.")
@click.option("--startup/--no-startup", default=True, show_default=True, help="Compare start-up in fresh processes.")
@json_option
@plot_option
def bench(
    model: str | None,
    workloads: tuple[str, ...],
    peers: tuple[str, ...],
    size: int,
    order: str,
    rounds: int,
    threads: int | None,
    device: str,
    builders: bool,
    startup: bool,
    json_file: Path | None,
    plot_file: Path | None,
) -> None:
    """Compares wrt with the peers that are installed, on MODEL: a mesh file or the name of a built-in scene.

    Contenders take turns on the same rays; every figure is a ratio to wrt in the same round, with the share of rays on which
    they agree beside it. "plain" is wrt with Moeller and Trumbore's triangle test, which shows what watertightness costs;
    "engines" are wrt's own traversals, one by one. With --target x86-64-v3, Embree's C library is limited to AVX2, too; embreex
    and Open3D choose for themselves.

    "embree", "embree3" and "embree4" trace packets that are filled before the clock starts, and leave the answers in them:
    Embree's best case, which "fastest Embree" is about. "embree3-flat" and "embree4-flat" are Embree as programs with (N, 3)
    arrays get it: the time includes filling each packet from flat arrays and copying its answers to flat arrays. wrt reads and
    writes flat arrays in all of them.

    `wrt bench auto [MODEL]` compares what "auto" chooses with every other choice, `wrt bench scaling [MODEL]` numbers of
    threads, `wrt bench points [MODEL]` closest points with those of other libraries, `wrt bench jobs [NAMES]` whole jobs with
    their rays; each has options of its own. Studies that repeat the tables of papers are in a checkout's notebooks/studies.
    """
    from wrt.bench.core.benchmark_plot import matplotlib_missing, save_plot
    from wrt.bench.core.benchmark_report import ReportPrinter

    if plot_file is not None and (reason := matplotlib_missing()) is not None:
        raise click.UsageError(reason)
    meshes = [load_model(name) for name in ((model,) if model else DEFAULT_MODELS)]
    printer = ReportPrinter(table_console())
    with progress() as on_turn, usage_errors():

        def show(report: Report, question: Question) -> None:
            with on_turn.paused():
                printer.add(report, question)

        options = BenchOptions(
            workloads=workloads or tuple(WORKLOADS),
            peers=peers or DEFAULT_PEERS,
            size=size,
            order=order,
            rounds=rounds,
            threads=threads or get_num_threads(),
            device=device,
            builders=builders,
            startup=startup,
        )
        report = run_benchmark(meshes, options, on_turn=on_turn, on_question=show)
    printer.end(report)
    write_json(json_file, report.to_dict())
    if plot_file is not None:
        with usage_errors():
            save_plot(report, plot_file)


@dataclass(frozen=True)
class BenchOptions:
    """What is asked, as on the command line."""

    workloads: tuple[str, ...] = tuple(WORKLOADS)
    peers: tuple[str, ...] = DEFAULT_PEERS
    size: int = 1024
    order: str = "tiles"
    rounds: int = 5
    threads: int = 1
    device: str = "cpu"
    builders: bool = True
    startup: bool = True


def run_benchmark(
    meshes: list[TriangleMesh],
    options: BenchOptions = BenchOptions(),
    *,
    on_turn: Callable[[str], None] = lambda name: None,
    on_question: Callable[[Report, Question], None] = lambda report, question: None,
) -> Report:
    """Asks all questions.

    Args:
        on_turn: called with the name of each step when it begins.
        on_question: called with the report so far and its latest question when that is answered.

    Raises:
        ValueError: unknown names, or a size that does not divide into tiles.
    """
    from wrt.bench.comparisons.build_comparison import ask_builds
    from wrt.bench.comparisons.query_comparison import ask
    from wrt.bench.comparisons.startup_times import ask_startup

    rounds, threads, device = options.rounds, options.threads, options.device
    found, missing = make_peers(options.peers, threads, device)
    written = asdict(options) | {"workloads": list(options.workloads), "peers": list(options.peers)}
    del written["builders"], written["startup"]
    report = Report(machine(device), written, missing=missing)
    for mesh in meshes:
        result = ModelResult(mesh.name or "mesh", mesh.triangle_count, mesh.vertex_count)
        report.models.append(result)
        made = WorkloadMaker(mesh, size=options.size, order=options.order).make(options.workloads)
        for question in ask(found, mesh, made, rounds, on_turn):
            result.questions.append(question)
            on_question(report, question)
        if options.builders:
            result.questions.append(ask_builds(found, mesh, rounds, threads, device, on_turn))
            on_question(report, result.questions[-1])
    if options.startup:
        report.startup = ask_startup(found, threads, device, rounds, on_turn)
        on_question(report, report.startup)
    return report
