"""Texture coordinates and colours of files, checked: values that are no numbers are left out with a warning."""

from __future__ import annotations

import numpy as np

from wrt.meshes.files.mesh_source import MeshSource

__all__ = ["checked_colors", "checked_uv"]


def checked_uv(uv: np.ndarray | None, source: MeshSource) -> np.ndarray | None:
    """Texture coordinates as float32; None, with a warning, if they are not finite."""
    if uv is None:
        return None
    with np.errstate(over="ignore"):
        uv = np.ascontiguousarray(uv, dtype=np.float32)
    if not np.isfinite(uv).all():
        source.warn("texture coordinates are NaN or infinite; coordinates and images are left out")
        return None
    return uv


def checked_colors(colors: np.ndarray, what: str, source: MeshSource) -> np.ndarray:
    """(N, 3) colours in [0, 1]: rows that are not finite become white, with a warning."""
    bad = ~np.isfinite(colors).all(axis=1)
    if bad.any():
        source.warn(f"{int(bad.sum())} of {len(colors)} {what} are NaN or infinite; they are white")
        colors = np.where(bad[:, None], 1.0, colors)
    return np.clip(colors, 0.0, 1.0)
