"""A lidar that jumps from place to place of a scene: the time of "auto" over that of the best engine at each place.

"auto" starts without knowledge, so what it loses while it learns, and after jumps, counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from wrt.bench.comparisons.auto_cases import TURN, Case, case_of, places, scan
from wrt.bench.comparisons.auto_choices import Choice, ask, engines
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.plan.call_clock import call_clock
from wrt.engine.plan.choices import RULES, set_auto
from wrt.kernels.runtime.launch import use_threads
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

STAYS = (1, 8, 64)
"""Scans at a place before the next jump."""

REPEATS = 3
"""Journeys by each engine; the least time of a scan counts."""


def compare_journeys(
    name: str, scene: Scene, mesh: TriangleMesh, on_turn: Callable[[str], None] = lambda name: None
) -> Iterator[Choice]:
    """Journeys with stays of different lengths.

    Args:
        name: of the scene.
        scene: on the CPU.
        mesh: its triangles as one mesh.
        on_turn: told the name of each turn.
    """
    cases = [case for number, place in enumerate(places(mesh)) for case in case_of(f"{number}", scan(mesh, TURN, place))]
    plans = [engines(scene, case) for case in cases]
    with use_threads(scene.num_threads):
        clock = call_clock()

    def timed(case: Case, way: object) -> float:
        start = clock()
        ask(scene, case, way)  # type: ignore[arg-type]
        return clock() - start

    on_turn(f"{name}: scans at {len(cases)} places")
    names = [one for one in plans[0] if one != AUTO]
    fastest = {
        one: np.array(
            [min(timed(case, plan[one]) for _ in range(1 + REPEATS)) for case, plan in zip(cases, plans, strict=True)]
        )
        for one in names
    }
    best = np.min([*fastest.values()], axis=0)
    for stay in STAYS:
        on_turn(f"{name}: {stay} scans at a place")
        took = {}
        for how in (AUTO, RULES):
            found = []
            for _ in range(REPEATS):
                scene.state.cache.clear()
                scene.state.cache.learned.clear()
                set_auto(None if how == AUTO else RULES)
                found.append([timed(case, AUTO) for case in cases for _ in range(stay)])
            took[how] = np.min(found, axis=0).sum()
        set_auto(None)
        one = min(fastest, key=lambda engine: fastest[engine].sum())
        yield Choice(
            scene=name,
            kind=f"journey, {stay}",
            triangles=scene.triangle_count,
            rays=cases[0].rays_count,
            rays_class="",
            auto=AUTO,
            rules=RULES,
            reason="",
            best=one,
            ratio=float(took[AUTO] / (stay * best.sum())),
            rules_ratio=float(took[RULES] / (stay * best.sum())),
            auto_milliseconds=float(1e3 * took[AUTO] / (stay * len(cases))),
            milliseconds={engine: float(1e3 * values.mean()) for engine, values in fastest.items()},
        )
