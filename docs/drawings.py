"""Pictures of the pages: rooms on their floors and the path of a query, from the code as it stands; frames of sensors."""

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "tests"))

from support import import_graph  # noqa: E402

COLOURS = {"kernels": "#cfe3d4", "builders": "#f3e3c3", "wrt": "#d5e1f2"}

EDGE = {"ec": "#5b6470", "lw": 0.8}

QUERY = (
    ("wrt.scene.scene", "Scene", "holds the state, which an update replaces"),
    ("wrt.query.api", "Queries.intersect", "signature and docstring; rays become a wrt.Rays"),
    ("wrt.query.answers", "closest_hits", "ordinary, precise, or skipping a triangle"),
    ("wrt.engine.executor", "answer", "rays to the device, plan, prepared query or batch"),
    ("wrt.engine.launch.prepared", "PreparedQuery.run", "addresses of rays and hits into packed arguments"),
    ("wrt.kernels.runtime.launch", "PreparedLaunch.run", "items into chunks"),
    ("wrt.kernels.runtime.pool", "Pool.run", "threads claim chunks in native code"),
    ("wrt.kernels.traversal", "kernel", "one kernel for the whole plan"),
)
"""Modules from `Scene.intersect` to the kernel, what is called there, and what it does."""

ASIDE = {
    "wrt.engine.executor": ("wrt.engine.rays", "wrt.engine.plan.choices"),
    "wrt.engine.launch.prepared": ("wrt.engine.device_hits",),
}
"""What a module on the way calls beside the next one."""


def drawn_room(module: str) -> str:
    """The room of a module, as it is drawn: all of builders/ is one."""
    return "wrt.builders" if module.startswith("wrt.builders") else import_graph.room_of(module)


def drawn_rooms() -> tuple[dict[str, set[str]], dict[str, int]]:
    """What each drawn room imports of the others, and its lines of code."""
    graph: dict[str, set[str]] = {}
    lines: dict[str, int] = {}
    for module, used in import_graph.imports().items():
        if module not in ("wrt", "wrt.__main__", "wrt.kernels"):
            room = drawn_room(module)
            graph.setdefault(room, set()).update(drawn_room(other) for other in used if other != "wrt")
            lines[room] = lines.get(room, 0) + len(import_graph.modules()[module].read_text().splitlines())
    return {room: used - {room} for room, used in graph.items()}, lines


def draw_rooms(path: Path) -> None:
    """Rooms by floor: each stands above all that it imports. Sizes of boxes say nothing; the number is lines of code."""
    graph, lines = drawn_rooms()
    floor = import_graph.floors(graph)
    direct = {room: used - {far for near in used for far in reachable(graph, near)} for room, used in graph.items()}
    rows = [[room for room in graph if floor[room] == number] for number in range(1, max(floor.values()) + 1)]
    widest, centre = max(map(len, rows)), {}
    figure = Figure(figsize=(1.75 * widest, 0.95 * len(rows) + 0.2))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for number, row in reversed(list(enumerate(rows))):
        above = {room: [centre[user][0] for user in centre if room in direct[user]] for room in row}
        row = sorted(row, key=lambda room: (sum(above[room]) / max(len(above[room]), 1), room))
        for place, room in enumerate(row):
            centre[room] = ((place + 0.5) * widest / len(row), number)
    for room, (x, y) in centre.items():
        for other in direct[room]:
            ends = (x, y - 0.26), (centre[other][0], centre[other][1] + 0.26)
            axes.add_patch(FancyArrowPatch(*ends, arrowstyle="-|>", mutation_scale=9, color="#8a8f98", lw=0.7, zorder=1))
    for room, (x, y) in centre.items():
        parts = room.split(".")
        colour = COLOURS.get(parts[1], COLOURS["wrt"])
        axes.add_patch(FancyBboxPatch((x - 0.43, y - 0.24), 0.86, 0.48, "round,pad=0.02", fc=colour, **EDGE, zorder=2))
        axes.text(x, y + 0.06, parts[-1], ha="center", va="center", fontsize=9, weight="bold", zorder=3)
        what = f"{lines[room]:,} lines" if len(parts) == 2 and parts[1] in COLOURS else f"{parts[-2]}/   {lines[room]:,} lines"
        axes.text(x, y - 0.12, what, ha="center", va="center", fontsize=7, color="#444", zorder=3)
    axes.set_xlim(0, widest)
    axes.set_ylim(-0.4, len(rows) - 0.6)
    axes.axis("off")
    figure.savefig(path)


def draw_query(path: Path) -> None:
    """The modules that a call passes on its way to the kernel, from the top down."""
    known = import_graph.modules()
    figure = Figure(figsize=(9.0, 0.78 * len(QUERY) + 0.3))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for number, (module, name, text) in enumerate(QUERY):
        y = len(QUERY) - number
        if module not in known:
            raise ValueError(f"docs/drawings.py names the module {module}, which is not there")
        colour = COLOURS["kernels" if ".kernels." in module else "wrt"]
        axes.add_patch(FancyBboxPatch((0.1, y - 0.3), 4.1, 0.6, "round,pad=0.02", fc=colour, **EDGE))
        axes.text(0.2, y + 0.11, name, fontsize=9, weight="bold", va="center")
        axes.text(0.2, y - 0.13, module, fontsize=7.5, color="#444", va="center")
        axes.text(4.4, y, text, fontsize=8.5, va="center")
        beside = ", ".join(ASIDE.get(module, ()))
        if beside:
            axes.text(4.4, y - 0.25, f"calls {beside}", fontsize=7, color="#666", va="center")
        if number + 1 < len(QUERY):
            axes.add_patch(
                FancyArrowPatch((2.1, y - 0.33), (2.1, y - 0.67), arrowstyle="-|>", mutation_scale=10, color="#5b6470")
            )
    axes.set_xlim(0, 9)
    axes.set_ylim(0.5, len(QUERY) + 0.5)
    axes.axis("off")
    figure.savefig(path)


FRAMES = (
    ("world (ENU)", (("x, east", 1.0, 0.0), ("y, north", 0.62, 0.55), ("z, up", 0.0, 1.0))),
    ("lidar (REP 103)", (("x, forward", 0.62, 0.55), ("y, left", -1.0, 0.0), ("z, up", 0.0, 1.0))),
    ("camera, optical frame", (("x, right", 1.0, 0.0), ("y, down", 0.0, -1.0), ("z, forward", 0.62, 0.55))),
)
"""Frames and their axes: name and direction in the drawing. Forward goes into the picture, drawn as a slanted line."""

AXIS_COLOURS = ("#b23a3a", "#3f7d4e", "#3a5fa8")


def draw_frames(path: Path) -> None:
    """The frames of sensors beside one another, and the pixels of an image."""
    figure = Figure(figsize=(9.6, 2.7))
    for number, (title, axes) in enumerate(FRAMES):
        panel = figure.add_axes((0.01 + 0.245 * number, 0.02, 0.23, 0.86))
        for (name, x, y), colour in zip(axes, AXIS_COLOURS, strict=True):
            panel.add_patch(FancyArrowPatch((0, 0), (x, y), arrowstyle="-|>", mutation_scale=12, color=colour, lw=1.8))
            side = "left" if x > 0.1 else "center"
            panel.text(x * 1.06, y * 1.12 + (0.06 if y == 0.0 else 0.0), name, color=colour, fontsize=8.5, ha=side, va="bottom")
        panel.set(xlim=(-1.5, 1.7), ylim=(-1.3, 1.35), aspect="equal")
        panel.set_title(title, fontsize=9.5)
        panel.axis("off")
    panel = figure.add_axes((0.765, 0.06, 0.22, 0.78))
    for k in range(5):
        panel.plot([k - 0.5, k - 0.5], [-0.5, 2.5], color="#8a8f98", lw=0.7)
        if k < 4:
            panel.plot([-0.5, 3.5], [k - 0.5, k - 0.5], color="#8a8f98", lw=0.7)
    panel.plot([0, 1], [0, 0], "o", color="#222", ms=4)
    panel.text(-0.05, -0.72, "(0, 0)", fontsize=8.5, ha="center")
    panel.text(1.1, -0.72, "(1, 0)", fontsize=8.5, ha="center")
    for end, name, at, colour in (
        (((3.3, 1.6)), "u", (3.0, 1.4), AXIS_COLOURS[0]),
        ((2.0, 2.9), "v", (1.7, 2.8), AXIS_COLOURS[1]),
    ):
        panel.add_patch(FancyArrowPatch((2.0, 1.6), end, arrowstyle="-|>", mutation_scale=12, color=colour, lw=1.8))
        panel.text(*at, name, color=colour, fontsize=9)
    panel.set(xlim=(-0.9, 3.9), ylim=(3.2, -1.0), aspect="equal")
    panel.set_title("image (OpenCV)", fontsize=9.5)
    panel.axis("off")
    figure.savefig(path)


def reachable(graph: dict[str, set[str]], node: str) -> set[str]:
    """All that a node imports, directly or through others."""
    found, waiting = set(), [node]
    while waiting:
        new = graph[waiting.pop()] - found
        found |= new
        waiting.extend(new)
    return found
