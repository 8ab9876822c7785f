"""The upward direction of meshes: by the format of their file, and for pictures of several meshes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from wrt.kernels.validation import as_numbers

Direction = tuple[float, float, float]

Y_UP: Direction = (0.0, 1.0, 0.0)
Z_UP: Direction = (0.0, 0.0, 1.0)

Y_UP_FORMATS = frozenset({"glb", "gltf", "obj", "off", "ply"})
"""Formats of computer graphics, whose y axis usually points up; in glTF, by standard. In the others, of engineering, z does."""


def up_of_format(suffix: str) -> Direction | None:
    """Upward direction of meshes in files with this extension, without its dot; None for z, the default."""
    return Y_UP if suffix.lower() in Y_UP_FORMATS else None


def up_remark(up: Direction) -> str:
    """What `wrt.TriangleMesh.save` writes into a file as a comment, and `stated_up` reads.

    Formats have no other place for it.
    """
    return "up " + " ".join(f"{x!r}" for x in up)


def stated_up(remarks: Iterable[str]) -> Direction | None:
    """The upward direction in comments of a file; None if none states it."""
    for remark in remarks:
        words = remark.split()
        if len(words) == 4 and words[0] == "up":
            try:
                return checked_up([float(word) for word in words[1:]])
            except (TypeError, ValueError):
                continue
    return None


def checked_up(up: Any) -> Direction | None:
    """Returns a unit vector, or None for None.

    Raises:
        TypeError: `up` does not hold numbers.
        ValueError: it is not three finite numbers, or is zero.
    """
    if up is None:
        return None
    vector = as_numbers("up", up, finite=False)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ValueError(f"up must be three finite numbers x, y, z that are not all zero, or None, not {up!r}")
    vector /= np.abs(vector).max()  # so that squares neither overflow nor vanish
    return tuple((vector / np.linalg.norm(vector)).tolist())


def mapped_up(up: Direction | None, linear: np.ndarray) -> Direction | None:
    """Upward direction after a linear map, (3, 3); None if it is None or the map takes it to zero."""
    if up is None:
        return None
    image = linear @ up
    return checked_up(image) if image.any() and np.isfinite(image).all() else None


def common_up(meshes: Iterable[Any]) -> Direction | None:
    """The upward direction of all meshes that have one; None if none has, or if they differ by more than rounding."""
    known = [up for up in (getattr(mesh, "up", None) for mesh in meshes) if up is not None]
    return known[0] if known and np.allclose(known, known[0], rtol=0.0, atol=1e-9) else None


def default_up(geometry: Any) -> Direction:
    """Upward direction of pictures of a mesh or scene: that of its meshes (`common_up`), else z."""
    return common_up(getattr(geometry, "meshes", (geometry,))) or Z_UP
