"""What belonging to an influence area costs a ray, and what is left of the areas' trees if it costs nothing.

    compare_affinity   time to find the area of each ray, and to check a given one, beside that of tracing with the default tree
    compare_work       boxes and triangles that a ray is tested against, alone and in packets, by tree

`wrt.known_rays.ProjectedBvh` is one tree for the rays of the area: nothing is looked up, so no way to find areas can be faster
than it.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import warp as wp

from studies.known_rays.ray_aware_comparison import (
    COUNTED,
    REFERENCE,
    Figure,
    Turns,
    accelerators,
    ask,
    known_rays,
    thinned,
)
from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh
from wrt.engine.launch.area_trees import assign
from wrt.engine.launch.given_areas import GivenAreas
from wrt.engine.rays.device_rays import to_device
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene


def compare_affinity(mesh: TriangleMesh, turns: Turns, *, size: int = 1024) -> list[Figure]:
    """Time of the default tree with packets or streams, and of the assignment of rays to areas: "found" and "given"."""
    options = {"device": "cpu", "num_threads": turns.threads}
    default, figures = Scene(mesh, Bvh(), **options), []
    for known in known_rays(mesh, default, size):
        state = Scene(mesh, RayAwareBvh(areas=[known.area]), **options).state
        batch = to_device(known.rays, state.device, state.center).batch
        given = GivenAreas(wp.zeros(batch.count, dtype=int, device="cpu"), 1)
        runs = {REFERENCE: partial(ask, default, known, "auto"), "found": partial(assign, state, batch)}
        runs["given"] = partial(assign, state, batch, given)
        figures += turns.figures("affinity", known.name, runs, len(known.rays))
    return figures


def compare_work(mesh: TriangleMesh, *, size: int = 256) -> list[dict[str, Any]]:
    """What rays are tested against, without the search for an area.

    Returns:
        A row for each workload, traversal and tree: rays, traversal ("single", "packet"), tree (`REFERENCE`, "ProjectedBvh"),
        boxes and triangles (of a ray: nodes times their width, and triangles, on average).
    """
    default, rows = Scene(mesh, Bvh(), device="cpu"), []
    for known in known_rays(mesh, default, size):
        trees = {name: one for name, one in accelerators(known.area).items() if name != "RayAwareBvh"}
        for name, accelerator in trees.items():
            scene = Scene(mesh, accelerator, device="cpu")
            for traversal in ("single", "packet"):
                rays = known.rays if traversal == "packet" else thinned(known.rays, COUNTED)
                work = scene.intersect(rays, traversal=traversal, counters=True).counters
                nodes, triangles = (float(np.mean(work[field], dtype=np.float64)) for field in ("nodes", "triangles"))
                row = {"rays": known.name, "traversal": traversal, "tree": name}
                rows.append(row | {"boxes": nodes * scene.tree.width, "triangles": triangles})
    return rows
