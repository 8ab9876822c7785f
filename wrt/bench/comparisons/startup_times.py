"""The question about start-up: what a fresh process waits for until its first hit.

Each contender is a process of its own: `import warp` alone, `import wrt` with what a scene needs, wrt with a warm kernel
cache, wrt with an empty one (so that the kernels of the default path are compiled) and Open3D. Timed is the process from
start to end; the phases inside are what the process itself measured. All ask one ray of a mesh of two thousand triangles.
wrt also makes a picture of it, of the size that `wrt render` makes, with a warm cache and with an empty one, where single rays
stand in for kernels that are not compiled.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from statistics import median
from typing import Any

from wrt.bench.core.benchmark_results import Question, Row
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.peers.peer import Peer
from wrt.bench.peers.peer_table import Open3D
from wrt.kernels.compilation.compile_later import VARIABLE

BUDGET = 20.0
"""Seconds for each contender."""

REFERENCE = "import warp"
EMPTY_CACHE = "wrt, first hit, empty kernel cache"
PICTURE, PICTURE_EMPTY_CACHE = "wrt, picture", "wrt, picture, empty kernel cache"

HEAD = """
import json, sys, time
device, threads = sys.argv[1], int(sys.argv[2])
marks = [("start", time.perf_counter())]
def mark(name):
    marks.append((name, time.perf_counter()))
"""

TAIL = """
print(json.dumps({name: now - before for (_, before), (name, now) in zip(marks, marks[1:])}))
later = sys.modules.get("wrt.kernels.compilation.compile_later")
if later is not None:
    later.stop()  # what it compiles would outlive the folder
"""

GRID = """
import numpy as np
x, y = np.meshgrid(np.linspace(0, 1, 33), np.linspace(0, 1, 33), indexing="ij")
vertices = np.stack([x, y, 0.1 * np.sin(9 * x) * np.cos(7 * y)], axis=-1).reshape(-1, 3).astype(np.float32)
corner = (np.arange(32)[:, None] * 33 + np.arange(32)).ravel()
faces = np.concatenate([np.stack([corner, corner + 33, corner + 34], 1), np.stack([corner, corner + 34, corner + 1], 1)])
origin, direction = np.array([[0.4, 0.3, 2.0]], np.float32), np.array([[0.0, 0.0, -1.0]], np.float32)
mark("data")
"""

IMPORT_WARP = """
import warp
mark("import")
warp.config.log_level = warp.LOG_WARNING
warp.init()
mark("init")
"""

IMPORT_WRT = """
import wrt
wrt.Scene, wrt.TriangleMesh
mark("import")
import warp
warp.config.log_level = warp.LOG_WARNING
warp.init()
mark("init")
"""

USE_WRT = """
scene = wrt.Scene(wrt.TriangleMesh(vertices, faces), device=device, num_threads=threads)
mark("scene")
assert scene.intersect(origin, direction).primitive_id.size == 1
mark("first query")
"""

DRAW_WRT = """
scene = wrt.Scene(wrt.TriangleMesh(vertices, faces), device=device, num_threads=threads)
mark("scene")
camera = wrt.PinholeCamera.framing(scene, 800, 600, fov=35.0)
assert wrt.render(scene, camera, samples=4).shape == (600, 800, 3)
mark("picture")
"""

USE_OPEN3D = """
import open3d
mark("import")
scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
scene.add_triangles(open3d.core.Tensor(vertices), open3d.core.Tensor(faces.astype(np.uint32)))
mark("scene")
scene.cast_rays(open3d.core.Tensor(np.concatenate([origin, direction], 1)))["t_hit"].numpy()
mark("first query")
"""


def ask_startup(
    peers: list[Peer],
    threads: int,
    device: str,
    rounds: int,
    on_turn: Callable[[str], None] = lambda name: None,
) -> Question:
    """Times fresh processes; ratios refer to `import warp`. Processes with an empty cache get one round."""
    first_hit = IMPORT_WRT + GRID + USE_WRT
    picture = IMPORT_WRT + GRID + DRAW_WRT
    scripts = {REFERENCE: IMPORT_WARP, "import wrt": IMPORT_WRT, "wrt, first hit": first_hit, PICTURE: picture}
    cold = {EMPTY_CACHE: first_hit, PICTURE_EMPTY_CACHE: picture}
    if any(isinstance(peer, Open3D) for peer in peers):
        scripts["Open3D, first hit"] = GRID + USE_OPEN3D
    phases: dict[str, list[dict[str, float]]] = {name: [] for name in (*scripts, *cold)}

    def contender(name: str, script: str) -> Contender:
        def run() -> None:
            phases[name].append(run_process(script, device, threads, empty_cache=name in cold))

        return Contender(name, run, warm_up=lambda: name in cold or run_process(script, device, threads))

    timings = take_turns([contender(*item) for item in scripts.items()], rounds, budget=BUDGET, on_turn=on_turn)
    timings |= take_turns([contender(*item) for item in cold.items()], 1, on_turn=on_turn)
    rows = []
    for name in timings:
        row = Row(name, threads, device, details={"phases": median_phases(phases[name])})
        rows.append(row.timed(timings[name], timings[REFERENCE]))
    return Question("startup", None, None, REFERENCE, rows)


def run_process(script: str, device: str, threads: int, *, empty_cache: bool = False) -> dict[str, float]:
    """Runs a script in a fresh interpreter; returns the seconds of its phases."""
    with tempfile.TemporaryDirectory(prefix="wrt-bench-") as folder:
        environment = os.environ | ({"WARP_CACHE_PATH": folder, VARIABLE: "1"} if empty_cache else {})
        command = [sys.executable, "-c", HEAD + script + TAIL, device, str(threads)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"a fresh process failed: {done.stderr.strip().splitlines()[-1:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def median_phases(rounds: list[dict[str, Any]]) -> dict[str, float]:
    """Median seconds of each phase."""
    return {name: median(phases[name] for phases in rounds) for name in rounds[0]} if rounds else {}
