"""Motion blur: what moves while the shutter is open.

The frame is cut into slices of time. Sample s of S is taken at the time (s + 1/2) / S, for all pixels, in the scene as it is
then: `wrt.Scene.update` moves vertices and instances. So each sample sees one consistent scene, exactly, in shadows and
reflections too, with every traversal and every tree. The price is an update for each sample; and the blur of a fast body is
made of S sharp pictures, where times that differ by pixel would show grain.

References: cook-1984; haeberli-akeley-1990 (frames of slices).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.kernels.validation import as_numbers
from wrt.meshes.instance import check_transform
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike

__all__ = ["Motion"]


class Motion:
    """Two keys of what moves: when the shutter opens and when it closes. Between them, everything moves evenly.

        wrt.moving.Motion(vertices={0: (before, after)})             # the vertices of mesh 0
        wrt.moving.Motion(transforms={3: (matrix, other)})           # instance 3

    Args:
        vertices: for the index of a mesh (as `wrt.Scene.update` takes it), two arrays (V, 3); points move on straight lines.
        transforms: for the index of an instance, two matrices (4, 4), whose elements are interpolated. A body that turns is
            distorted if the angle is large: cut the motion into smaller ones, and average pictures.

    Raises:
        ValueError: not two keys, keys of different shapes, or a transform that `wrt.Instance` refuses.
    """

    def __init__(
        self,
        vertices: Mapping[int, tuple[ArrayLike, ArrayLike]] | None = None,
        transforms: Mapping[int, tuple[ArrayLike, ArrayLike]] | None = None,
    ) -> None:
        self.vertices = {index: _keys("vertices", index, pair) for index, pair in (vertices or {}).items()}
        self.transforms = {index: _keys("transforms", index, pair) for index, pair in (transforms or {}).items()}
        for pair in self.transforms.values():
            for matrix in pair:
                check_transform(matrix)

    def begin(self, scene: Scene) -> Scene:
        """A scene of its own, which `move` changes.

        Raises:
            TypeError, ValueError: as `wrt.Scene.update`.
        """
        own = copy(scene)
        self.move(own, 0.0)
        return own

    def move(self, scene: Scene, time: float) -> None:
        """Moves a scene to a time, from 0 to 1."""
        for index, (before, after) in self.vertices.items():
            scene.update(index, vertices=(1.0 - time) * before + time * after)
        for index, (before, after) in self.transforms.items():
            scene.update(index, transform=(1.0 - time) * before + time * after)


def _keys(name: str, index: int, pair: Any) -> tuple[np.ndarray, np.ndarray]:
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise ValueError(
            f"{name}[{index}] must be a pair, when the shutter opens and when it closes, not {type(pair).__name__}"
        )
    before, after = (as_numbers("motion", key, finite=False) for key in pair)
    if before.shape != after.shape:
        raise ValueError(f"{name}[{index}] has keys of the shapes {before.shape} and {after.shape}; they must be equal")
    return before, after
