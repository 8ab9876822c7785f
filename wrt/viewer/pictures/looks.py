"""What a picture shows, by name: light, or a layer: values or costs (`wrt.viewer.pictures.layers`).

The last sample of light completes the picture of `wrt.render` with the same arguments, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.integrators.rendering_call import new_picture
from wrt.kernels.runtime.launch import get_num_threads, use_threads
from wrt.scene.scene import Scene
from wrt.viewer.pictures.layers import Depth, Ids, Normals, PacketsTakenApart, PacketWork, RayWork, as_bytes
from wrt.viewer.pictures.view_request import ViewRequest

__all__ = ["BEAUTY", "LOOKS", "Light", "make_picture"]

COARSE_AMBIENT_RAYS, COARSE_RADIUS = 2, 2
"""Ambient rays of coarse pictures, and the rows and columns within which pixels share them: two rays alone are both blocked
at every other pixel of a dark cloister, which made it black and white."""

TILE = 1 << 14
"""Camera rays that are traced at a time: a picture that is no longer wanted ends after them."""

BEAUTY = "beauty"


class Light:
    """A picture by an integrator of `wrt.render` (`wrt.viewer.frame_loop.Picture`).

    Args:
        scene, request, camera: what to show, from where.
        is_coarse: whether one sample is enough.
        options: of the integrator, as in `wrt.render`.
    """

    scale = None

    def __init__(
        self, scene: Scene, request: ViewRequest, camera: PinholeCamera, is_coarse: bool, options: Mapping[str, Any]
    ) -> None:
        self._scene, self._camera, self.rays = scene, camera, 0
        self._threads = threads_for(is_coarse)
        given = {"traversal": request.traversal, "triangle_test": request.triangle_test, **options}
        given["samples"] = 1 if is_coarse else request.samples
        if request.integrator == "ambient" and is_coarse:
            given["ambient_samples"] = min(COARSE_AMBIENT_RAYS, given.get("ambient_samples", COARSE_AMBIENT_RAYS))
            given["ambient_radius"] = max(COARSE_RADIUS, given.get("ambient_radius", 0))
        given["tile_pixels" if request.integrator == "ambient" else "wave"] = TILE
        self._made = new_picture(scene, camera, request.integrator, **given)

    @property
    def is_complete(self) -> bool:
        """Whether all samples are there."""
        return self._made.done >= self._made.samples

    def advance(self, check: Callable[..., None]) -> None:
        """Adds a sample."""
        with use_threads(self._threads):
            self._made.advance(1, progress=check)
        self.rays = self._made.rays

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8, rounded as by `wrt.save_image`."""
        return as_bytes(self._made.developed(), self._camera, self._scene)


LOOKS: dict[str, Any] = {
    BEAUTY: Light,
    "depth": Depth,
    "normals": Normals,
    "triangle ids": partial(Ids, "primitive_id"),
    "geometry ids": partial(Ids, "geometry_id"),
    "instance ids": partial(Ids, "instance_id"),
    "cost: nodes": partial(RayWork, "nodes", "inner nodes a ray"),
    "cost: leaves": partial(RayWork, "leaves", "leaves a ray"),
    "cost: triangle tests": partial(RayWork, "triangles", "triangle tests a ray"),
    "cost: nodes of packets": PacketWork,
    "cost: packets taken apart": PacketsTakenApart,
}
"""Makers of pictures by name; layers take scene, request and camera."""


def make_picture(
    scene: Scene, request: ViewRequest, scale: float, is_coarse: bool, options: Mapping[str, Any] | None = None
) -> Any:
    """The picture of a request.

    Args:
        scene: the scene in the request's version.
        request: what to show.
        scale: side of the picture relative to that of the whole one.
        is_coarse: whether something moves: light then has one sample.
        options: of the integrator, as in `wrt.render`.

    Raises:
        TypeError, ValueError: as in `wrt.render` and `wrt.Scene.intersect`.
    """
    camera = request.camera_of(scale)
    if request.look == BEAUTY:
        return Light(scene, request, camera, is_coarse, options or {})
    return LOOKS[request.look](scene, request, camera)


def threads_for(is_coarse: bool) -> int:
    """Threads of a picture: all; for a coarse one all but one, which is left to the server and to a browser on this computer.

    A launch waits for its slowest thread. On two cores, of which a browser uses one, small pictures took twice as long with two
    threads as with one (notebooks/records/2026-11-22-live-view.md).
    """
    return max(1, get_num_threads() - 1) if is_coarse else get_num_threads()
