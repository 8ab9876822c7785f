"""What a run found, as text and as a record."""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from .copies import ROOT
from .runner import ERROR, KILLED, SURVIVED, Outcome


def summary(outcomes: Sequence[Outcome]) -> str:
    """Counts, then each survivor and error with its promise."""
    states = Counter(outcome.state for outcome in outcomes)
    lines = [f"{len(outcomes)} mutations: {states[KILLED]} killed, {states[SURVIVED]} survived, {states[ERROR]} errors"]
    for outcome in outcomes:
        if outcome.state != KILLED:
            lines.append(f"{outcome.state.upper()} {outcome.name} {outcome.mutation.path}: {outcome.mutation.promise}")
            lines += [outcome.reason] if outcome.reason else []
    return "\n".join(lines)


def record_lines(outcomes: Sequence[Outcome], command: str, seconds: float) -> list[str]:
    """The record of a run, in Markdown: counts by table, then every survivor and error, then all mutations."""
    lines = [f"Commit {commit()}, `{command}`, {seconds / 60:.1f} minutes.", ""]
    lines += ["| table | mutations | killed | survived | errors |", "|---|---|---|---|---|"]
    by_area: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        for area in (outcome.name.partition(":")[0], "all"):
            by_area.setdefault(area, Counter())[outcome.state] += 1
    everything = by_area.pop("all", Counter())
    for area, states in (*by_area.items(), ("**all**", everything)):
        lines.append(f"| {area} | {states.total()} | {states[KILLED]} | {states[SURVIVED]} | {states[ERROR]} |")
    left = [f"* {o.state} `{o.name}`, `{o.mutation.path}`: {cell(o.mutation.promise)}" for o in outcomes if o.state != KILLED]
    lines += ["", "Survivors and errors:" if left else "No mutation survived.", "", *left, *([""] if left else [])]
    lines += ["| mutation | file | promise | outcome | s | noticed by |", "|---|---|---|---|---|---|"]
    for outcome in outcomes:
        noticed = outcome.reason.partition(" - ")[0] if outcome.state == KILLED else ""
        row = (
            outcome.name,
            f"`{outcome.mutation.path}`",
            outcome.mutation.promise,
            outcome.state,
            f"{outcome.seconds:.1f}",
            noticed,
        )
        lines.append("| " + " | ".join(map(cell, row)) + " |")
    return lines


def cell(text: str) -> str:
    """Text for a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


def commit(root: Path = ROOT) -> str:
    """The commit of the checkout, and whether files differ from it."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True).stdout.strip()

    changed = git("status", "--porcelain")
    return git("rev-parse", "--short", "HEAD") + (" with changes" if changed else "")
