"""`wrt bench`: wrt beside the ray tracing libraries that are installed."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from wrt.bench.peers import PEERS, make_peers
from wrt.bench.results import ModelResult, Report, machine
from wrt.bench.workloads import ORDERS, WORKLOADS, WorkloadMaker
from wrt.kernels.launch import MAX_THREADS, get_num_threads
from wrt.mesh import TriangleMesh

DEFAULT_MODELS = ("teapot", "atrium", "wood")
"""Built-in scenes that are measured when no model is named."""

SCENE_OPTIONS = {"teapot": {"level": 32, "ground": False}}
"""Where a scene's defaults do not suit: the teapot's ground would fill every view."""


class BenchCommand(click.Command):
    """`bench`, of which `bench builders` is a command of its own."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **extra: Any) -> click.Context:
        """The context of the command that is meant."""
        if args[:1] == ["builders"]:
            from wrt.bench.kdtree_builders import builders_command

            return builders_command.make_context(f"{info_name} builders", args[1:], *rest, **extra)
        return super().make_context(info_name, args, *rest, **extra)


@click.command(cls=BenchCommand)
@click.argument("model", required=False)
@click.option("--workload", "workloads", multiple=True, type=click.Choice([*WORKLOADS]), help="Rays to ask; repeat. [all]")
@click.option("--peer", "peers", multiple=True, type=click.Choice([*PEERS]), help="Contenders beside wrt; repeat. [all]")
@click.option("--size", default=1024, show_default=True, type=click.IntRange(1), help="Views have SIZE x SIZE pixels.")
@click.option("--order", default="tiles", show_default=True, type=click.Choice(ORDERS), help="Of a view's pixels.")
@click.option("--rounds", default=5, show_default=True, type=click.IntRange(1), help="Turns of each contender.")
@click.option("--threads", type=click.IntRange(1, MAX_THREADS), help="CPU threads of everybody. [all cores]")
@click.option("--device", default="cpu", show_default=True, help="Where wrt and wp.Mesh run, such as cuda:0.")
@click.option("--builders/--no-builders", default=True, show_default=True, help="Compare builds.")
@click.option("--startup/--no-startup", default=True, show_default=True, help="Compare start-up in fresh processes.")
@click.option("--json", "json_file", type=click.Path(dir_okay=False, writable=True, path_type=Path), help="Write all figures.")
@click.option("--plot", "plot_file", type=click.Path(dir_okay=False, writable=True, path_type=Path), help="Write a picture.")
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

    Contenders take turns on the same rays; every figure is a ratio to wrt in the same round, with the share of rays on
    which they agree beside it. "engines" are wrt's own traversals and triangle tests, one by one. `wrt bench builders` compares
    kd-tree builders.
    """
    from rich.console import Console

    from wrt.bench.plot import matplotlib_missing, save_plot
    from wrt.bench.report import print_report

    if plot_file is not None and (reason := matplotlib_missing()) is not None:
        raise click.UsageError(reason)
    meshes = [load_model(name) for name in ((model,) if model else DEFAULT_MODELS)]
    check_device(device)
    with progress() as on_turn, usage_errors():
        report = run_benchmark(
            meshes,
            workloads=workloads or tuple(WORKLOADS),
            peers=peers or tuple(PEERS),
            size=size,
            order=order,
            rounds=rounds,
            threads=threads or get_num_threads(),
            device=device,
            builders=builders,
            startup=startup,
            on_turn=on_turn,
        )
    console = Console()
    print_report(report, console if console.is_terminal else Console(width=180))
    with usage_errors():
        if json_file is not None:
            json_file.write_text(json.dumps(report.to_dict(), indent=1) + "\n", encoding="utf-8")
        if plot_file is not None:
            save_plot(report, plot_file)


def run_benchmark(
    meshes: list[TriangleMesh],
    *,
    workloads: tuple[str, ...] = tuple(WORKLOADS),
    peers: tuple[str, ...] = tuple(PEERS),
    size: int = 1024,
    order: str = "tiles",
    rounds: int = 5,
    threads: int = 1,
    device: str = "cpu",
    builders: bool = True,
    startup: bool = True,
    on_turn: Callable[[str], None] = lambda name: None,
) -> Report:
    """Asks all questions; arguments as on the command line.

    Raises:
        ValueError: unknown names, or a size that does not divide into tiles.
    """
    from wrt.bench.builds import ask_builds
    from wrt.bench.questions import ask
    from wrt.bench.startup import ask_startup

    options: dict[str, Any] = {"workloads": list(workloads), "peers": list(peers), "size": size, "order": order}
    options |= {"rounds": rounds, "threads": threads, "device": device}
    found, missing = make_peers(peers, threads, device)
    report = Report(machine(device), options, missing=missing)
    for mesh in meshes:
        result = ModelResult(mesh.name or "mesh", mesh.triangle_count, mesh.vertex_count)
        report.models.append(result)
        made = WorkloadMaker(mesh, size=size, order=order).make(workloads)
        result.questions += ask(found, mesh, made, rounds, on_turn)
        if builders:
            result.questions.append(ask_builds(found, mesh, rounds, threads, device, on_turn))
    if startup:
        report.startup = ask_startup(found, threads, device, rounds, on_turn)
    return report


def load_model(name: str) -> TriangleMesh:
    """A mesh file, or a built-in scene by its name."""
    from wrt import scenes

    try:
        if name in scenes.BUILTIN_SCENES and not Path(name).is_file():
            mesh = scenes.build(name, **SCENE_OPTIONS.get(name, {}))
            return TriangleMesh(mesh.vertices, mesh.faces, name=name)
        return TriangleMesh.load(name)
    except (FileNotFoundError, ValueError) as error:
        raise click.BadParameter(
            f"{error}; built-in scenes are {', '.join(scenes.BUILTIN_SCENES)}", param_hint="MODEL"
        ) from None


def check_device(name: str) -> None:
    """Fails for a device that is not there."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    if name not in (names := [device.alias for device in wp.get_devices()]):
        raise click.BadParameter(f"{name!r} is not there; choose from {', '.join(names)}", param_hint="--device")


@contextmanager
def usage_errors() -> Iterator[None]:
    """Values that turn out to be wrong, and files that cannot be written, as errors of the command line."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise click.ClickException(str(error)) from error


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """What to call with the name of each step: shown on stderr if that is a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda name: None
        return
    with console.status("bench") as status:
        yield lambda name: status.update(f"bench: {name}")
