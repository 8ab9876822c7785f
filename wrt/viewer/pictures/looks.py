"""What a picture shows, by name: light, or a layer (`wrt.viewer.pictures.layers`), or cost (`wrt.viewer.pictures.cost_layers`).

The last sample of light completes the picture of `wrt.render` with the same arguments, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.rendering import AmbientRendering
from wrt.kernels.runtime.launch import get_num_threads, use_threads
from wrt.scene.scene import Scene
from wrt.viewer.pictures.cost_layers import PacketsTakenApart, PacketWork, RayWork
from wrt.viewer.pictures.layers import Depth, Ids, Normals, as_bytes
from wrt.viewer.pictures.wish import Wish

__all__ = ["BEAUTY", "LOOKS", "Light", "make_picture"]

COARSE_AMBIENT_RAYS, COARSE_RADIUS = 2, 2
"""Ambient rays of coarse pictures, and the rows and columns within which pixels share them: two rays alone are both blocked
at every other pixel of a dark cloister, which made it black and white."""

TILE, WAVE = 1 << 14, 1 << 14
"""Rays of "ambient" and of the others that are traced at a time: a picture that is no longer wanted ends after them."""

BEAUTY = "beauty"


class Light:
    """A picture by an integrator of `wrt.render` (`wrt.viewer.frame_loop.Picture`).

    Args:
        scene, wish, camera: what to show, from where.
        is_coarse: whether one sample is enough.
        options: of the integrator, as in `wrt.render`.
    """

    scale = None

    def __init__(self, scene: Scene, wish: Wish, camera: PinholeCamera, is_coarse: bool, options: Mapping[str, Any]) -> None:
        self._scene, self._camera, self.rays = scene, camera, 0
        self._threads = threads_for(is_coarse)
        given = {"traversal": wish.traversal, "triangle_test": wish.triangle_test, **options}
        given["samples"] = 1 if is_coarse else wish.samples
        if wish.integrator == "ambient":
            if is_coarse:
                given["ambient_samples"] = min(COARSE_AMBIENT_RAYS, given.get("ambient_samples", COARSE_AMBIENT_RAYS))
                given["ambient_radius"] = max(COARSE_RADIUS, given.get("ambient_radius", 0))
            self._made: Any = AmbientRendering(scene, camera, tile_pixels=TILE, **given)
            self._rays_a_sample = (2 + given.get("ambient_samples", 16)) * camera.width * camera.height
        else:
            from wrt.imaging.integrators.rendering_job import Rendering  # not needed for the first picture

            self._made = Rendering(scene, camera, integrator=wish.integrator, wave=WAVE, **given)

    @property
    def is_complete(self) -> bool:
        """Whether all samples are there."""
        return self._made.done >= self._made.samples

    def advance(self, check: Callable[..., None]) -> None:
        """Adds a sample."""
        with use_threads(self._threads):
            self._made.advance(1, progress=check)
        is_ambient = isinstance(self._made, AmbientRendering)
        self.rays = self._made.done * self._rays_a_sample if is_ambient else self._made.rays

    def pixels(self) -> np.ndarray:
        """(H, W, 3) uint8, rounded as by `wrt.save_image`."""
        if isinstance(self._made, AmbientRendering):
            image = self._made.developed()
        else:
            image = wp.array(self._made.image().reshape(-1, 3), dtype=wp.vec3, device=self._scene.device)
        return as_bytes(image, self._camera, self._scene)


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
"""Makers of pictures by name; layers take scene, wish and camera."""


def make_picture(scene: Scene, wish: Wish, scale: float, is_coarse: bool, options: Mapping[str, Any] | None = None) -> Any:
    """The picture of a wish.

    Args:
        scene: the scene in the wish's version.
        wish: what to show.
        scale: side of the picture relative to that of the whole one.
        is_coarse: whether something moves: light then has one sample.
        options: of the integrator, as in `wrt.render`.

    Raises:
        TypeError, ValueError: as in `wrt.render` and `wrt.Scene.intersect`.
    """
    camera = wish.camera_of(scale)
    if wish.look == BEAUTY:
        return Light(scene, wish, camera, is_coarse, options or {})
    return LOOKS[wish.look](scene, wish, camera)


def threads_for(is_coarse: bool) -> int:
    """Threads of a picture: all; for a coarse one all but one, which is left to the server and to a browser on this computer.

    A launch waits for its slowest thread. On two cores, of which a browser uses one, small pictures took twice as long with two
    threads as with one (notebooks/records/2026-11-22-live-view.md).
    """
    return max(1, get_num_threads() - 1) if is_coarse else get_num_threads()
