"""The report as tables: one for each question and model, with the ratio to wrt first, printed when the question is answered."""

from __future__ import annotations

from collections.abc import Iterable
from math import floor

from rich.console import Console
from rich.table import Table

from wrt.bench.core.benchmark_results import ModelResult, Question, Report, Row

TITLES = {
    "closest": "Closest hit",
    "occlusion": "Occlusion",
    "all": "All hits",
    "inside": "Inside or outside",
    "build": "Build",
    "startup": "Start-up, fresh processes",
}
AGREEMENT = {
    "closest": ("hits", "same triangle", "same t"),
    "occlusion": ("occluded", "same"),
    "all": ("hits", "same number", "same triangles"),
    "inside": ("inside", "same"),
}
"""Columns that compare a contender's answers with wrt's."""

WIDTHS = {"rays": 20, "contender": 24, "time / wrt": 10, "Mrays/s": 7, "ms (min - max)": 22, "hits": 11}
"""Least characters of columns, so that those of one table stand below those of the table before."""

FOOTNOTES = {
    "closest": "time / wrt: per ray, median of the rounds' ratios; above 1 is slower than wrt. Rays are in each library's own "
    "form before the clock starts.\nsame triangle, same t: share of the rays that agree with wrt, t within 1e-5 of the box's "
    "diagonal.",
    "occlusion": "same: share of rays with the same answer as wrt.",
    "all": "time / wrt: per ray. same number, same triangles: share of rays with as many hits as wrt finds, and the same ones.",
    "inside": "time / wrt: per point. same: share of points with the same answer as wrt.",
    "build": "Timed from arrays in memory until the first ray is answered, kernels compiled. Bytes are per triangle.",
    "startup": "Whole processes, the interpreter's own start included; phases as the process saw them.",
}


class ReportPrinter:
    """Prints the tables of a report while it grows: a comparison takes minutes.

    Args:
        console: where to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._title: str | None = None
        self._kinds: list[str] = []

    def add(self, report: Report, question: Question) -> None:
        """Prints the table of a question that has been answered, the latest of the report; first the machine."""
        if self._title is None:
            self._console.print(machine_line(report), highlight=False)
        title = TITLES[question.kind] + ("" if question.kind == "startup" else f": {model_label(report.models[-1])}")
        if title != self._title:
            self._console.print(f"\n[bold]{title}[/bold]", highlight=False)
        self._title = title
        self._kinds += [question.kind] if question.kind not in self._kinds else []
        self._console.print(table_of(question))
        for row in question.rows:
            if row.error is not None:
                where = f" on {question.workload}" if question.workload else ""
                self._console.print(f"{row.name} did not take part{where}: {row.error}", highlight=False, markup=False)

    def end(self, report: Report) -> None:
        """Prints what the columns mean, and what is missing."""
        for kind in self._kinds:
            self._console.print(f"\n{TITLES[kind]}. {FOOTNOTES[kind]}", style="dim", highlight=False)
        for name, note in notes(report).items():
            self._console.print(f"{name}: {note}", style="dim", highlight=False, markup=False)
        for name, reason in report.missing.items():
            self._console.print(f"left out: {name} ({reason})", highlight=False, markup=False)


def table_of(question: Question) -> Table:
    """The table of a question."""
    if question.kind == "startup":
        return startup_table(question)
    return build_table(question) if question.kind == "build" else ray_table(question.kind, [question])


def notes(report: Report) -> dict[str, str]:
    """What a reader should know of a contender, by its name."""
    questions = [question for model in report.models for question in model.questions if question.workload]
    return {row.name: row.note for question in questions for row in question.rows if row.note}


def machine_line(report: Report) -> str:
    """Processor, threads, SIMD, what kernels are compiled for, GPU and versions in one line."""
    found = report.machine
    code = f"{found['simd_bits']}-bit SIMD, {found['lanes']} lanes, code for {found['target']}"
    gpu = f", {found['gpu']}" if found["gpu"] else ""
    versions = ", ".join(f"{name} {number}" for name, number in found["versions"].items())
    return f"{found['cpu']}, {found['threads']} threads, {code}{gpu}; {found['system']}, Python {found['python']}, {versions}"


def model_label(model: ModelResult) -> str:
    """Name and size of a model."""
    return f"{model.name}, {model.triangles:,} triangles"


def new_table(left: Iterable[str], right: Iterable[str], last: Iterable[str] = ()) -> Table:
    """An empty table: columns of text, of numbers, of text."""
    table = Table(header_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for names, justify in ((left, "left"), (right, "right"), (last, "left")):
        for name in names:
            table.add_column(name, justify=justify, no_wrap=True, min_width=WIDTHS.get(name))  # type: ignore[arg-type]
    return table


def ray_table(kind: str, questions: Iterable[Question]) -> Table:
    """Contenders of one kind of query, workload after workload."""
    table = new_table(("rays", "contender"), ("threads", "time / wrt", "Mrays/s", "ms (min - max)", *AGREEMENT[kind]))
    for question in questions:
        rows = [row for row in question.rows if row.error is None]
        for number, row in enumerate(rows):
            table.add_row(
                f"{question.workload} {question.rays:,}" if number == 0 else "",
                row.name,
                place(row),
                times(row.ratio),
                "-" if row.rays_per_second is None else f"{row.rays_per_second / 1e6:.3g}",
                spread(row, 1e3),
                *agreement_cells(row, question),
            )
        add_fastest_embree(table, question, "", "fastest Embree", "")
        table.add_section()
    return table


def add_fastest_embree(table: Table, question: Question, *before: str) -> None:
    """A line with the ratio of the fastest version of Embree after other cells, if several versions took part."""
    if len(question.embree_ratios) > 1:
        table.add_row(*before, times(min(question.embree_ratios)))


def agreement_cells(row: Row, question: Question) -> list[str]:
    """Hits and the shares that agree with wrt."""
    found = row.agreement
    hits = f"{found.hits:,}" if row.rays == question.rays else f"{found.hits:,} of {row.rays:,}"
    if row.name == question.reference:
        return [hits, *[""] * (len(AGREEMENT[question.kind]) - 1)]
    shares = {
        "closest": (found.same_primitive, found.same_t),
        "all": (found.same_hit, found.same_primitive),
    }
    return [hits, *map(percent, shares.get(question.kind, (found.same_hit,)))]


def build_table(question: Question) -> Table:
    """Builders, their phases and their memory."""
    numbers = ("time / wrt", "ms (min - max)", "speed-up", "tree B", "records B", "peak B")
    table = new_table(("builder",), numbers, ("phases, ms",))
    for row in question.rows:
        if row.error is None:
            memory = (row.details.get(f"{name}_bytes_per_triangle") for name in ("tree", "record", "peak"))
            table.add_row(
                row.name,
                times(row.ratio),
                spread(row, 1e3),
                times(row.details.get("speedup_over_one_thread")),
                *("-" if count is None else f"{count:.0f}" for count in memory),
                phases(row),
            )
    add_fastest_embree(table, question, "fastest Embree")
    return table


def startup_table(question: Question) -> Table:
    """Processes and their phases."""
    table = new_table(("process",), ("time / import warp", "ms (min - max)"), ("phases, ms",))
    for row in question.rows:
        if row.error is None:
            table.add_row(row.name, times(row.ratio), spread(row, 1e3), phases(row))
    return table


def place(row: Row) -> str:
    """Threads on the CPU, or the device."""
    return str(row.threads) if row.device == "cpu" else row.device


def times(ratio: float | None) -> str:
    """A ratio to three digits."""
    if ratio is None:
        return "-"
    return f"{ratio:.2f}x" if ratio < 100 else f"{ratio:,.0f}x"


def spread(row: Row, unit: float) -> str:
    """Median with least and greatest."""
    if row.median is None:
        return "-"
    median, least, greatest = (
        f"{seconds * unit:.3g}" if seconds * unit < 1e3 else f"{seconds * unit:,.0f}"
        for seconds in (row.median, row.least, row.greatest)
    )
    return f"{median} ({least} - {greatest})"


def percent(share: float | None) -> str:
    """A share in per cent, rounded down, so that 100 % means all."""
    if share is None:
        return "-"
    return "100 %" if share == 1.0 else f"{floor(share * 1e5) / 1e3:.3f} %"


def phases(row: Row) -> str:
    """Times of the phases in milliseconds."""
    return ", ".join(f"{name} {seconds * 1e3:.0f}" for name, seconds in row.details.get("phases", {}).items())
