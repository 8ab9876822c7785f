"""The Cornell box: a room of white, red and green walls with two blocks, lit by a square lamp in its ceiling.

The measured box of the Program of Computer Graphics at Cornell University, ten times as large: 5.56 m wide. Its colours are the
usual conversion of the measured spectra to red, green and blue. z is up, the open side faces -y. The lamp hangs half a
millimetre below the ceiling of the original, so that no two surfaces coincide.

References: goral-1984.
"""

from __future__ import annotations

import numpy as np

from wrt.kernels.validation import as_bool
from wrt.materials.material import Material
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import check_count

__all__ = ["cornell_box"]

WHITE, RED, GREEN, LAMP = range(4)

MATERIALS = (
    Material(color=(0.725, 0.71, 0.68)),
    Material(color=(0.63, 0.065, 0.05)),
    Material(color=(0.14, 0.45, 0.091)),
    Material(color=(0.78, 0.78, 0.78), emission=(17.0, 12.0, 4.0), two_sided=False),
)

# (x, height, depth) of the original; each polygon is seen counter-clockwise from inside the room
_WALLS = (
    (WHITE, ((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2))),
    (WHITE, ((556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0))),
    (WHITE, ((549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2))),
    (GREEN, ((0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2))),
    (RED, ((552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0))),
    (LAMP, ((343, 548.3, 227), (343, 548.3, 332), (213, 548.3, 332), (213, 548.3, 227))),
)
_BLOCKS = (
    (165, ((130, 65), (82, 225), (240, 272), (290, 114))),
    (330, ((423, 247), (265, 296), (314, 456), (472, 406))),
)


def cornell_box(blocks: bool = True, cells: int = 6) -> TriangleMesh:
    """The Cornell box, with its materials.

    Args:
        blocks: whether the two blocks stand in it.
        cells: triangles along an edge: each of the 36 triangles of the box (with blocks) is divided into cells x cells. Methods
            that find light for each triangle need small ones; for others, 1 is enough.

    Raises:
        TypeError, ValueError: `cells` is not a whole number of at least 1.
    """
    cells, blocks = check_count("cells", cells), as_bool("blocks", blocks)
    polygons = [(material, np.array(points, dtype=float)) for material, points in _WALLS]
    if blocks:
        for height, outline in _BLOCKS:
            polygons += [(WHITE, side) for side in _prism(np.array(outline, dtype=float), height)]
    corners = np.stack([points[[[0, 1, 2], [0, 2, 3]]] for _, points in polygons]).reshape(-1, 3, 3)
    weights, faces = _lattice(cells)
    points = (weights @ corners).reshape(-1, 3)
    vertices = np.stack([2.78 - points[:, 0] / 100, points[:, 2] / 100, points[:, 1] / 100], axis=1)
    starts = len(weights) * np.arange(len(corners))[:, None, None]
    mesh = TriangleMesh(vertices, (faces + starts).reshape(-1, 3), name="cornell_box", up=(0, 0, 1))
    return mesh.with_materials(MATERIALS, np.repeat([material for material, _ in polygons], 2 * cells * cells))


def _lattice(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the corners for the points of a divided triangle, (P, 3), and its triangles, (cells^2, 3)."""
    number = {place: n for n, place in enumerate((i, j) for i in range(cells + 1) for j in range(cells + 1 - i))}
    weights = np.array([(cells - i - j, i, j) for i, j in number], dtype=float) / cells
    faces = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i in range(cells) for j in range(cells - i)]
    faces += [
        (number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i in range(cells - 1) for j in range(cells - 1 - i)
    ]
    return weights, np.array(faces)


def _prism(outline: np.ndarray, height: float) -> list[np.ndarray]:
    """The top, the sides and the bottom of a block, counter-clockwise seen from outside."""
    top = np.insert(outline, 1, height, axis=1)
    bottom = np.insert(outline, 1, 0.5, axis=1)  # a little above the floor
    sides = [np.array([top[i], bottom[i], bottom[(i + 1) % 4], top[(i + 1) % 4]]) for i in range(4)]
    return [top, *sides, bottom[::-1]]
