"""The report about triangle tests as tables, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from studies.triangles.triangle_test_comparison import REFERENCE, Ratio, TestResult, TestsReport
from wrt.bench.core.benchmark_plot import save_figure
from wrt.bench.core.benchmark_report import new_table, times

FOOTNOTES = {
    "speed": f"Time / {REFERENCE}: median of the rounds' ratios, least - greatest. soup, frusta: without a tree; the others\n"
    "with a BVH. single, packets, view: from one point (packets: the same culling for all; view: as the engine chooses);\n"
    "stream: random rays. prepare: what is computed beforehand, the copy of the vertices included.",
    "cost": "operations: additions, multiplications and divisions of a test that goes to its end; done: on the average, if\n"
    "each test leaves at the first exit that it can / if 16 rays leave together / with the exits that the engine compiles.\n"
    "bytes: held for a triangle, and those of them that a test reads.",
    "exits": "Share of the tests, and of the frusta of 4 x 4 rays (by their last ray), that end there, without a tree.",
    "precision": "99th percentile of the errors against float64, t relative. far: 1,000 edges away; slim: height 1e-3 of an\n"
    "edge. invented: clear misses that are reported as hits, of triangles of height 1e-5. Leaks: rays per million that pass\n"
    "between triangles of closed convex bodies, aimed at points of edges and at vertices.",
}

FAR, SLIM, SLIMMEST = 1e3, 1e-3, 1e-5


def print_tests_report(report: TestsReport, console: Console) -> None:
    """Prints every table."""
    console.print(f"{report.model}, {report.triangles:,} triangles; {report.machine['cpu']}", highlight=False)
    tables = {"speed": speed_table(report), "cost": cost_table(report.results), "exits": exit_table(report.results)}
    if any(result.precision for result in report.results):
        tables["precision"] = precision_table(report.results)
    for name, table in tables.items():
        console.print(f"\n[bold]{name.capitalize()}[/bold]")
        console.print(table)
        console.print(FOOTNOTES[name], style="dim", highlight=False)


def speed_table(report: TestsReport):
    """A column a situation."""
    situations = list(report.results[0].speed)
    table = new_table(("test",), situations)
    for result in report.results:
        table.add_row(result.name, *(ratio_cell(result.speed[name]) for name in situations))
    return table


def ratio_cell(ratio: Ratio | None) -> str:
    """Median and range."""
    return "-" if ratio is None else f"{times(ratio.median)} ({ratio.least:.2f} - {ratio.greatest:.2f})"


def cost_table(results: Sequence[TestResult]):
    """Operations, bytes and what a test promises."""
    table = new_table(("test",), ("operations", "done", "bytes", "read"), ("promises",))
    for result in results:
        done = " / ".join("-" if value is None else f"{value:.1f}" for value in result.operations_done.values())
        flags = {"watertight": result.watertight, "accurate": result.accurate, "two-sided": result.two_sided}
        flags["shared origin"] = result.needs_shared_origin
        operations = "-" if result.operations is None else str(result.operations)
        promises = ", ".join(name for name, value in flags.items() if value)
        table.add_row(result.name, operations, done, str(result.record_bytes), str(result.test_bytes), promises)
    return table


def exit_table(results: Sequence[TestResult]):
    """A row an exit."""
    table = new_table(("test", "ends"), ("tests", "frusta"))
    for result in results:
        for number, entry in enumerate(result.exits["exits"]):
            shares = (f"{100 * entry[key]:.2f} %" for key in ("tests", "vectors"))
            table.add_row(result.name if number == 0 else "", entry["exit"], *shares)
    return table


def precision_table(results: Sequence[TestResult]):
    """Errors and leaks."""
    table = new_table(("test",), ("t", "u, v", "far: u, v", "slim: t", "slim: u, v", "invented", "edges", "vertices"))
    for result in results:
        if result.precision is None or result.leaks is None:
            continue
        by_distance = {case["distance"]: case for case in result.precision["distance"]}
        by_slimness = {case["slimness"]: case for case in result.precision["slimness"]}
        plain, far, slim = by_slimness[1.0], by_distance[FAR], by_slimness[SLIM]
        table.add_row(
            result.name,
            error(plain, "t"),
            error(plain, "u", "v"),
            error(far, "u", "v"),
            error(slim, "t"),
            error(slim, "u", "v"),
            f"{100 * by_slimness[SLIMMEST]['invented']:.2f} %",
            *(f"{result.leaks[name]['per_million']:,.0f}" for name in ("edges", "vertices")),
        )
    return table


def error(case: dict, *names: str) -> str:
    """The greater of the 99th percentiles of some values; "-" without a hit."""
    values = [case[name]["p99"] for name in names if case[name] is not None]
    return f"{max(values):.1e}" if values else "-"


def save_tests_plot(report: TestsReport, path: str | Path) -> None:
    """Writes a panel a situation: bars of time / the reference's with the range over rounds.

    Raises:
        ValueError: matplotlib does not know the file's format.
    """
    from matplotlib.figure import Figure

    situations = list(report.results[0].speed)
    figure = Figure(figsize=(3.2 * len(situations), 1.2 + 0.3 * len(report.results)), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(situations), squeeze=False, sharey=True)[0], situations, strict=True):
        found = [(result.name, result.speed[name]) for result in report.results]
        ratios = [ratio or Ratio(0.0, 0.0, 0.0, 0.0) for _, ratio in found]
        ranges = [[r.median - r.least for r in ratios], [r.greatest - r.median for r in ratios]]
        bars = axes.barh([test for test, _ in found], [r.median for r in ratios], xerr=ranges, color="tab:blue", ecolor="gray")
        axes.bar_label(bars, [times(ratio.median) if ratio else "-" for _, ratio in found], padding=4, fontsize="small")
        axes.axvline(1.0, color="gray", linewidth=0.8)
        axes.set_xlim(right=1.3 * axes.get_xlim()[1])
        axes.set_title(name, fontsize="medium")
        axes.set_xlabel(f"time / {REFERENCE}", fontsize="small")
        axes.tick_params(labelsize="small")
    figure.axes[0].invert_yaxis()
    save_figure(figure, path)
