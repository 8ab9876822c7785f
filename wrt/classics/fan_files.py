"""Files of fans: M + 2 vertices for a fan of M triangles, in place of 3 M.

A file is an .npz archive of two arrays: the positions of all vertices, fan after fan, each the centre and then the rim; and the
number of rim vertices of each fan. Positions are repeated from fan to fan, as they are from triangle to triangle in a list of
separate triangles, which is what the claim of Galin and Akkouche (2005) compares.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wrt.atomic_files import replaced
from wrt.builders.triangle_fans import TriangleFans
from wrt.meshes.mesh import TriangleMesh


def save_fans(path: str | Path, fans: TriangleFans, positions: np.ndarray) -> None:
    """Writes fans.

    Args:
        path: of the file, which gets the suffix .npz if it has another. An old file is replaced when the new one is complete.
        fans: the fans.
        positions: (V, 3) of the vertices that the fans number.

    Raises:
        OSError: the file cannot be written.
    """
    positions = np.asarray(positions)
    starts = fans.first[:-1]
    vertices = np.insert(positions[fans.rim], starts, positions[fans.centre], axis=0)
    path = Path(path)
    with replaced(path if path.suffix == ".npz" else path.with_name(f"{path.name}.npz")) as file:
        np.savez(file, vertices=vertices, rims=np.diff(fans.first).astype(np.int32))


def load_fans(path: str | Path) -> TriangleMesh:
    """The mesh of a file of fans: fan after fan, each triangle the centre and two rim vertices. Vertices are not shared between
    fans.

    Raises:
        OSError: there is no such file.
        ValueError: it does not hold fans.
    """
    with np.load(path, allow_pickle=False) as file:
        if set(file.files) != {"vertices", "rims"}:
            raise ValueError(f"{path} does not hold fans; wrt.classics.fan_files.save_fans writes such files")
        vertices, rims = file["vertices"], file["rims"].astype(np.int64)
    if not (
        rims.ndim == 1
        and len(rims)
        and (rims >= 2).all()
        and (rims <= len(vertices)).all()
        and vertices.shape == (int((rims + 1).sum()), 3)
    ):
        raise ValueError(f"{path} is damaged: its vertices are not those of its fans")
    first = np.cumsum(rims + 1) - (rims + 1)
    centre = np.repeat(first, rims - 1)
    place = np.arange(len(centre)) - np.repeat(np.cumsum(rims - 1) - (rims - 1), rims - 1)
    return TriangleMesh(vertices, np.stack([centre, centre + 1 + place, centre + 2 + place], axis=1).astype(np.int32))
