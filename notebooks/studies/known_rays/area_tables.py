"""Tables of Falcone 2024 with the cases that the notebook `ray_distribution` takes, for the command line.

References: falcone-2024 (sections 6.2 to 6.5).
"""

from __future__ import annotations

from studies.known_rays import area_experiments as experiments
from studies.known_rays import ray_distribution as distribution
from studies.known_rays.ray_cases import TREES, cases

Row = distribution.Row


def costs(*, rays: int = 1024) -> list[Row]:
    """Sections 6.2.1 to 6.2.3: estimated and counted costs of the trees of both heuristics, in all scenes and directions."""
    return distribution.measure(cases(), rays=rays)


def precision(*, rays: int = 1024) -> list[Row]:
    """Sections 6.2.1 and 6.2.2: mean errors of both heuristics in per cent, by the areas and by how rays are cast."""
    measured = costs(rays=rays)
    errors, kinds = (distribution.average(measured, "error", *by) for by in (("tree",), ("tree", "kind")))
    raw = distribution.average(measured, "error_unclipped", "tree", "kind")
    caps = distribution.average(experiments.cap_errors(cases(kinds=("point",)), rays=rays), "error", "cap")
    found = {"SAH, plane and point": errors["SAH + LSPH",], "PAH, plane and point": errors["PAH + SPFH",]}
    for kind in ("plane", "point"):
        found |= {f"PAH, {kind}": kinds["PAH + SPFH", kind], f"PAH, {kind}, not clipped": raw["PAH + SPFH", kind]}
    found |= {f"PAH, point, {cap} cap": error for (cap,), error in caps.items()}
    return [{"error": name, "percent": 100.0 * value} for name, value in found.items()]


def gains(*, rays: int = 1024) -> list[Row]:
    """Sections 6.2.3, 6.2.6 and 6.2.7: gains over SAH and LSPH in per cent, means over the scenes."""
    measured, rows = costs(rays=rays), []
    for tree in TREES:
        if tree != distribution.REFERENCE:
            found = [
                {"kind": kind, "way": way, "gain": gain} for (_, kind, way), gain in distribution.faster(measured, tree).items()
            ]
            means = distribution.average(found, "gain", "kind", "way")
            rows += [{"tree": tree, "kind": kind, "way": way, "percent": 100.0 * mean} for (kind, way), mean in means.items()]
    return rows


def build_times(*, rounds: int = 3) -> list[Row]:
    """Section 6.2.4: times of builds."""
    return distribution.build_times(cases(("random 1000", "wood", "palace"), ways=("15 degrees",)), rounds=rounds)


def axes_tried() -> list[Row]:
    """Section 6.2.4: axes that are tried at a node."""
    return experiments.axes_tried(cases())


def break_evens(*, rays: int = 4096) -> list[Row]:
    """Section 6.2.5: the share of rays that have to end in an area's tree."""
    return distribution.balances(cases(("random 1000", "cottage", "crowd", "palace")), rays=rays)


def walk_orders(*, rays: int = 1024) -> list[Row]:
    """Section 5.1.2: costs of a stack, of a queue, and of the nearest child first."""
    return experiments.walk_orders(cases(ways=("parallel", "oblique")), rays=rays)


def octree_levels(*, areas: int = 20, rays: int = 4096, seed: int = 0) -> list[Row]:
    """Table 6.1: costs by the levels of the octree."""
    chosen = cases(("cottage", "random 1000", "wood", "head"), ("plane",), ("parallel",))
    return experiments.octree_levels(chosen, areas=areas, rays=rays, seed=seed)


def thresholds(*, rays: int = 1024) -> list[Row]:
    """Tables 6.2 and 6.3: costs by the thresholds of the choice of axes."""
    return distribution.sweep(cases(("random 100", "random 1000", "head", "cottage")), rays=rays)


def memory(*, depth: int = 4) -> list[Row]:
    """Section 6.5: bytes with one area and with twenty."""
    return distribution.memory(cases(("random 1000", "wood", "palace"), ("plane",), ("oblique",)), depth=depth)
