"""What pictures of all integrators share: tiles of samples that are added to a film, and kept or undone as a whole."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.imaging.cameras import OrthographicCamera, PinholeCamera
from wrt.imaging.image_files import save_image
from wrt.imaging.view_frames import is_cloud
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads
from wrt.kernels.validation import as_int
from wrt.meshes.vertex_values import joined, smooth_corner_normals
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from wrt.clouds.point_cloud import PointCloud

__all__ = ["Camera", "SampledPicture", "corner_normals", "default_light"]

Camera = PinholeCamera | OrthographicCamera

_corner_normals: WeakKeyDictionary[Scene, tuple[SceneMesh, dict[float, wp.array]]] = WeakKeyDictionary()


class SampledPicture(ABC):
    """A picture to which samples are added, tile by tile.

    Args:
        scene: the scene.
        camera: a `wrt.PinholeCamera` or `wrt.OrthographicCamera`.

    Attributes:
        camera: the camera.
        pixels: their number.
        samples: number of samples of a pixel when the picture is complete.
        done: number of samples so far.

    Raises:
        TypeError: `scene` or `camera` has a wrong type.
    """

    samples: int
    _sums: tuple[wp.array, ...]
    """What the samples so far have added, one value a pixel in each."""
    _tile: int
    """Pixels whose samples are traced together."""
    _takes_points: ClassVar[bool] = False
    """Whether `scene` may be a point cloud."""

    _pass: int = 1
    """Most samples of a pixel that are traced together."""

    def __init__(self, scene: Scene | PointCloud, camera: Camera) -> None:
        _check_types(scene, camera, self._takes_points)
        refuse_capture("rendering", scene.device)
        self._scene: Any = scene
        self.camera, self.done = camera, 0
        self.pixels = camera.width * camera.height

    def advance(self, samples: int | None = None, progress: Callable[[int, int], Any] | None = None) -> Any:
        """Adds samples to all pixels, and returns the picture.

        After an exception, a Ctrl-C included, the picture holds those samples that all pixels have; it may be continued.

        Args:
            samples: how many; None for all that are missing.
            progress: called as progress(done, total) in samples of pixels, after each tile; an exception that it raises ends
                the rendering.

        Raises:
            TypeError, ValueError: `samples` is not a whole number of at least 1.
        """
        refuse_capture("rendering", self._scene.device)
        goal = self.samples if samples is None else min(self.samples, self.done + as_int("samples", samples, 1))
        with use_threads(self._scene.num_threads):
            while self.done < goal:
                count = min(self._pass, goal - self.done)
                self._begin_pass()
                kept = tuple(wp.clone(one) for one in self._sums) if self.done else None
                try:
                    for first in range(0, self.pixels, self._tile):
                        pixels = min(self._tile, self.pixels - first)
                        self._expose(first, pixels, count)
                        if progress is not None:
                            progress(self.done * self.pixels + (first + pixels) * count, self.samples * self.pixels)
                except BaseException:
                    self._sums = self._zeros() if kept is None else kept
                    raise
                self.done += count
        return self

    def _begin_pass(self) -> None:  # noqa: B027 - most pictures have nothing to do
        """Called before the next samples of all pixels."""

    @abstractmethod
    def _expose(self, first: int, pixels: int, samples: int) -> None:
        """Adds this many samples to some pixels."""

    @abstractmethod
    def _zeros(self) -> tuple[wp.array, ...]:
        """The sums of no samples."""

    def _black(self, dtype: type) -> wp.array:
        """(pixels,) zeros."""
        made = empty(self.pixels, dtype, self._scene.device)
        made.zero_()
        return made

    def _of_pixels(self, kernel: wp.Kernel, dtype: type, *inputs: Any) -> wp.array:
        """(height, width): the result of a kernel over the pixels.

        Raises:
            ValueError: there are no samples.
        """
        if self.done == 0:
            raise ValueError("the picture has no samples yet; call advance() first")
        out = empty(self.pixels, dtype, self._scene.device)
        with use_threads(self._scene.num_threads):
            launch(kernel, self.pixels, [*inputs, out], device=self._scene.device, chunk=4096)
        return self._shaped(out)

    def _shaped(self, values: wp.array) -> wp.array:
        """(pixels,) values as (height, width), in the same memory."""
        return values.reshape((self.camera.height, self.camera.width))

    @property
    @abstractmethod
    def rays(self) -> int:
        """Number of rays traced so far."""

    @abstractmethod
    def developed(self) -> wp.array:
        """(height, width) vec3 on the scene's device, in [0, 1], encoded for display: the mean of the samples so far.

        Raises:
            ValueError: there are none.
        """

    def image(self) -> np.ndarray:
        """(height, width, 3) float32 in [0, 1], as `wrt.save_image` takes it; errors as in `developed`."""
        return self.developed().numpy()

    def save(self, path: str | Path) -> None:
        """Writes the picture for display.

        Args:
            path: of the file; its extension decides, as in `wrt.save_image`.

        Raises:
            ValueError: no samples yet, or an unknown extension.
            FileNotFoundError: the folder does not exist.
        """
        save_image(path, self.image())


def _check_types(scene: Any, camera: Any, takes_points: bool) -> None:
    if not isinstance(scene, Scene) and not (is_cloud(scene) and takes_points):
        remedy = "integrator='ambient' renders points" if is_cloud(scene) else "make one with wrt.Scene(mesh)"
        raise TypeError(f"scene must be a wrt.Scene, not {type(scene).__name__}; {remedy}")
    if not isinstance(camera, Camera):
        raise TypeError(f"camera must be a wrt.PinholeCamera or wrt.OrthographicCamera, not {type(camera).__name__}")


def default_light(camera: Camera) -> np.ndarray:
    """(3,) a position above and to the left of the camera, at about the distance between the camera and its target."""
    distance = float(np.linalg.norm(camera.look_at - camera.position))
    return camera.position + 0.75 * distance * (camera.up - camera.right)


def corner_normals(scene: Scene, crease_angle: float) -> wp.array:
    """(3 F,) vec3 on the scene's device: smooth unit normals of all triangle corners; shared meshes once, in their own
    space.

    Cached for each crease angle, in degrees, until the scene changes.
    """
    mesh, made = _corner_normals.get(scene, (None, {}))
    if mesh is not scene.state.device_mesh:
        made = {}
        _corner_normals[scene] = scene.state.device_mesh, made
    if crease_angle not in made:
        parts = [(part.device_mesh.vertices, part.device_mesh.faces, part.meshes) for part in scene.state.parts]
        made[crease_angle] = joined([smooth_corner_normals(*part, crease_angle) for part in parts])
    return made[crease_angle]
