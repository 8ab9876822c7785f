"""Small pictures of every integrator."""

from __future__ import annotations

from collections.abc import Iterator

import wrt
from wrt.imaging.integrators import INTEGRATORS

from .digests import digest

SIZE = (48, 36)


def picture_hashes() -> Iterator[tuple[str, str, str]]:
    """(case, engine, hash) for every integrator, in a scene with materials and lights and in one without."""
    for name in ("cornell_box", "teapot"):
        mesh = wrt.scenes.build(name)
        scene = wrt.Scene(mesh, device="cpu")
        camera = wrt.PinholeCamera.framing(mesh, *SIZE)
        for integrator in INTEGRATORS:
            yield f"{name} {integrator}", "auto", digest(wrt.render(scene, camera, integrator=integrator, samples=4))
