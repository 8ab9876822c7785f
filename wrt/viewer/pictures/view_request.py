"""What a client wants to see: plain values, which are compared to find out whether anything changed."""

from __future__ import annotations

from dataclasses import dataclass

from wrt.imaging.cameras import PinholeCamera

__all__ = ["ViewRequest"]


@dataclass(frozen=True)
class ViewRequest:
    """What a client wants to see.

    Attributes:
        version: of the scene (`wrt.viewer.shared_scene.SharedScene`).
        camera: position, look_at, up (each a tuple), and vertical field of view in degrees.
        size: width and height of the whole picture.
        look: key of `wrt.viewer.pictures.looks.LOOKS`.
        integrator: of "beauty".
        samples: of "beauty", for each pixel.
        traversal, triangle_test: as in `wrt.Scene.intersect`.
        culling: key of `wrt.kernels.traversal.packet.CULLINGS`, or "auto"; of camera rays in packets, not of "beauty".
    """

    version: int
    camera: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], float]
    size: tuple[int, int]
    look: str = "beauty"
    integrator: str = "ambient"
    samples: int = 4
    traversal: str = "auto"
    triangle_test: str = "auto"
    culling: str = "auto"

    def camera_of(self, scale: float = 1.0) -> PinholeCamera:
        """The camera of a picture whose sides are `scale` times as long."""
        position, look_at, up, fov = self.camera
        width, height = (max(1, round(side * scale)) for side in self.size)
        return PinholeCamera(width, height, fov=fov, position=position, look_at=look_at, up=up)
