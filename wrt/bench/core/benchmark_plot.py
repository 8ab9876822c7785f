"""The report as a picture: rays per second of every contender, workload by workload."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from wrt.atomic_files import replaced
from wrt.bench.core.benchmark_report import model_label, times
from wrt.bench.core.benchmark_results import Question, Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def matplotlib_missing() -> str | None:
    """Why no plot can be drawn, with the way to get it; None if it can."""
    from importlib.util import find_spec

    return None if find_spec("matplotlib") else "a plot needs matplotlib: pip install matplotlib"


def save_plot(report: Report, path: str | Path) -> None:
    """Writes one panel a model and workload, bars in Mrays/s on a logarithmic axis, labelled with time / wrt.

    Raises:
        ValueError: there is nothing to plot, or matplotlib does not know the file's format.
    """
    from matplotlib.figure import Figure

    panels = [(model, question) for model in report.models for question in model.questions if question.workload]
    if not panels:
        raise ValueError("there is nothing to plot: no workload was measured")
    columns = max(len([panel for panel in panels if panel[0] is model]) for model in report.models)
    figure = Figure(figsize=(4.0 * columns, 3.2 * len(report.models)), layout="constrained")
    axes = figure.subplots(len(report.models), columns, squeeze=False)
    for line, model in zip(axes, report.models, strict=True):
        questions = [question for question in model.questions if question.workload]
        for place in line[len(questions) :]:
            place.set_axis_off()
        for place, question in zip(line, questions, strict=False):
            draw_question(place, question)
        line[0].set_ylabel(model_label(model))
    save_figure(figure, path)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure in the format of the suffix, PNG if there is none; an old file is replaced when the new one is complete.

    Raises:
        ValueError: matplotlib does not know the format.
        OSError: the file cannot be written.
    """
    with replaced(path, streams=True) as file:
        figure.savefig(file, format=Path(path).suffix.lower().lstrip(".") or "png", dpi=150)


def draw_question(axes, question: Question) -> None:
    """Horizontal bars, wrt on top."""
    rows = [row for row in question.rows if row.rays_per_second is not None]
    colors = ["tab:green" if row.name.startswith("wrt") else "tab:gray" for row in rows]
    bars = axes.barh([row.name for row in rows], [row.rays_per_second / 1e6 for row in rows], color=colors)
    axes.bar_label(bars, [times(row.ratio) for row in rows], padding=2, fontsize="small")
    axes.set_xscale("log")
    axes.set_xlim(right=axes.get_xlim()[1] * 8.0)
    axes.invert_yaxis()
    axes.set_title(f"{question.workload} ({question.kind})", fontsize="medium")
    axes.set_xlabel("Mrays/s; labels: time / wrt", fontsize="small")
    axes.tick_params(labelsize="small")
