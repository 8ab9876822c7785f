"""What was measured, as plain data: what the tables show and what `--json` writes.

A `Report` holds one `ModelResult` for each model with its `Question`s; a question holds one `Row` a contender. `to_dict`
gives dictionaries, lists, numbers and strings only; what was not measured is None.
"""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import warp as wp

from wrt.bench.core.agreement import Agreement
from wrt.bench.core.paired_timing import Timing
from wrt.kernels.compilation.cores import available_cores
from wrt.kernels.compilation.host_cpu import cpu_name
from wrt.kernels.compilation.target import lane_width, simd_bits, target_name

EMBREE, FLAT = "Embree ", " flat"
"""How names of the contenders that are versions of Embree's C library begin; and end, if they are asked with flat arrays."""

FORMAT = 1
"""Version of the layout of `Report.to_dict`."""

PACKAGES = ("wrt", "warp-lang", "numpy", "open3d", "embreex", "trimesh", "rtree")


@dataclass
class Row:
    """One contender's answer to one question.

    Attributes:
        name, note, threads, device: as the peer's.
        rays: rays a call; None for builds and start-up.
        seconds: of each round; None where it sat out.
        median, least, greatest: seconds a call; None if it did not take part.
        rays_per_second: at the median.
        ratio: time (per ray) / wrt's, median of the rounds' ratios; above one: slower than wrt.
        agreement: with wrt; None where there is nothing to compare.
        details: figures that only this question has.
        error: why it did not take part.
    """

    name: str
    threads: int
    device: str
    note: str = ""
    rays: int | None = None
    seconds: list[float | None] = field(default_factory=list)
    median: float | None = None
    least: float | None = None
    greatest: float | None = None
    rays_per_second: float | None = None
    ratio: float | None = None
    agreement: Agreement | None = None
    details: dict[str, Any] = field(default_factory=dict)
    error: str | None = None

    def timed(self, timing: Timing, reference: Timing) -> Row:
        """Fills in what was measured."""
        self.error = timing.error
        if timing.times:
            self.seconds, self.median = timing.seconds, timing.median
            self.least, self.greatest = timing.spread
            self.ratio = timing.ratio_to(reference)
            if self.rays is not None:
                self.rays_per_second = self.rays / max(self.median, 1e-12)
        return self


@dataclass
class Question:
    """What all contenders were measured on.

    Attributes:
        kind: "closest", "occlusion", "all", "inside", "build" or "startup".
        workload: name of the rays; None for builds and start-up.
        rays: number of them.
        reference: name of the row that ratios refer to.
        rows: one a contender.
        embree_ratios: of the versions of Embree that took part, in packets that were filled before the clock started; wrt is
            held to the least.
    """

    kind: str
    workload: str | None
    rays: int | None
    reference: str
    rows: list[Row] = field(default_factory=list)
    embree_ratios: list[float] = field(init=False)

    def __post_init__(self) -> None:
        versions = [row for row in self.rows if row.name.startswith(EMBREE) and not row.name.endswith(FLAT)]
        self.embree_ratios = [row.ratio for row in versions if row.ratio is not None]


@dataclass
class ModelResult:
    """All questions about one mesh."""

    name: str
    triangles: int
    vertices: int
    questions: list[Question] = field(default_factory=list)


@dataclass
class Report:
    """A run of the benchmark.

    Attributes:
        machine: see `machine`.
        options: what was asked for.
        models: one entry a mesh.
        startup: the comparison of start-up times, if it was made.
        missing: reason why a peer could not run, by its name.
    """

    machine: dict[str, Any]
    options: dict[str, Any]
    models: list[ModelResult] = field(default_factory=list)
    startup: Question | None = None
    missing: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {"format": FORMAT, **asdict(self)}


def machine(device: str) -> dict[str, Any]:
    """The machine in general terms: processor, cores, SIMD width in bits, what kernels are compiled for, GPU, versions."""
    found = wp.get_device(device)
    return {
        "cpu": cpu_name(),
        "threads": available_cores(),
        "simd_bits": simd_bits(),
        "target": target_name(),
        "lanes": lane_width(),
        "gpu": found.name if found.is_cuda else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version for name in PACKAGES if (version := package_version(name)) is not None},
    }


def package_version(name: str) -> str | None:
    """Version of an installed package; None if it is not there."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None
