"""Values of a surface, computed once and kept at its vertices or in the texels of an image.

**Texels.** A texel has a value if its centre is in a triangle, laid out by its texture coordinates. Which one that is, and
where in it, rays tell: the triangles in the plane are a scene, and a ray goes down at each centre. So texels on the edge of
two triangles belong to one of them.

**Padding.** Interpolation between texels reaches beyond the border of a chart. Texels near it get the mean of their neighbours
that have a value, ring by ring.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import wrt
from wrt.analysis.analysis_arguments import host, state_of
from wrt.analysis.sky_exposure import ambient_occlusion, exposure, sky_directions
from wrt.analysis.wall_thickness import thickness
from wrt.kernels.validation import as_int, as_numbers
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.meshes.mesh import TriangleMesh
    from wrt.query.hits import Hits
    from wrt.scene.scene import Scene

BLOCK = 1 << 16
"""Points that a function gets at a time."""

MAX_TEXELS = 1 << 14
"""Largest resolution."""

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
"""Weights of the second and third vertex at the corners of a triangle."""


class BakedTexture(NamedTuple):
    """An image of values on a surface.

    Attributes:
        values: (R, R, ...) float32; row 0 is at the top, where v is 1. NaN where `covered` is false, beyond the padding.
        covered: (R, R) bool, whether the centre of a texel is on a triangle.
    """

    values: np.ndarray
    covered: np.ndarray


def bake(
    scene: Scene,
    what: str | Callable[[Hits], Any],
    to: str = "vertices",
    *,
    resolution: int = 1024,
    padding: int = 4,
    rays: int = 64,
    uv: ArrayLike | None = None,
    instance_id: int | None = None,
) -> np.ndarray | BakedTexture:
    """Values of a surface at its vertices, or in an image that its texture coordinates lay out.

        light = wrt.analysis.bake(scene, "ambient_occlusion", to="texture")         # light.values: (1024, 1024)
        image = wrt.Texture(np.nan_to_num(light.values))
        wall = wrt.analysis.bake(scene, "thickness")                                # (V,)
        near = wrt.analysis.bake(scene, lambda points: scene.intersect(points.spawn(up), up).t, to="texture")

    Args:
        scene: a `wrt.Scene`; all of it is seen by the rays.
        what: "ambient_occlusion" (`wrt.analysis.ambient_occlusion`), "sky_view" (the cosine-weighted share of the sky above
            z = 0), "thickness", or a function. It gets up to 65,536 points (N,), as `scene.points_on` makes them, and returns
            (N, ...) numbers.
        to: "vertices": the mean of the corners of the triangles there, weighted by their angles. "texture": an image.
        resolution: texels along an edge of the image, up to 16384.
        padding: rings of texels beyond the charts that get values of their neighbours, for interpolation.
        rays: of each point, for "ambient_occlusion" and "sky_view".
        uv: (V, 2) or (F, 3, 2) texture coordinates of vertices or corners, in [0, 1]; None for those of the mesh
            (`TriangleMesh.with_materials`). Where triangles overlap, the one with the smallest number counts.
        instance_id: the instance, or the mesh in a scene without instances; may be left out if there is only one.

    Returns:
        (V, ...) float32, NaN for vertices of no triangle; or a `BakedTexture`.

    Raises:
        TypeError: an argument has a wrong type.
        ValueError: an unknown name, a number out of range, no or wrong texture coordinates, no such instance, or a function
            that does not return a row a point.
    """
    state, function = state_of(scene), as_function(scene, what, rays)
    lookup(dict.fromkeys(("vertices", "texture")), to, "to")
    count = len(state.instances) or len(state.meshes)
    if instance_id is None and count > 1:
        raise ValueError(f"the scene has {count} surfaces; say with instance_id which of them is meant")
    number = as_int("instance_id", 0 if instance_id is None else instance_id, 0, count - 1)
    mesh = state.meshes[state.geometry_ids[number] if state.instances else number]
    if to == "vertices":
        triangles = np.repeat(np.arange(mesh.triangle_count), 3)
        corners = evaluated(scene, function, triangles, np.tile(CORNERS, (mesh.triangle_count, 1)), number)
        return at_vertices(mesh, corners)
    size, padding = as_int("resolution", resolution, 1, MAX_TEXELS), as_int("padding", padding, 0)
    found = wrt.Scene(laid_out(mesh, uv), device="cpu", num_threads=state.num_threads).intersect(*texel_rays(size))
    covered = found.is_hit
    weights = np.clip(found.uv[covered].astype(np.float64), 0.0, 1.0)
    weights /= np.maximum(weights.sum(axis=-1, keepdims=True), 1.0)
    values = evaluated(scene, function, found.primitive_id[covered], weights, number)
    image = np.full((size, size, *values.shape[1:]), np.nan, dtype=np.float32)
    image[covered] = values
    return BakedTexture(padded(image, covered, padding), covered)


def as_function(scene: Scene, what: Any, rays: Any) -> Callable[[Hits], Any]:
    """The function of points that is meant.

    Raises:
        TypeError, ValueError: there is none, or a wrong number of rays.
    """
    if callable(what):
        return what
    if not isinstance(what, str):
        raise TypeError(f"what must be a name or a function of points, not {type(what).__name__}")
    rays = as_int("rays", rays, 1)
    known: dict[str, Callable[[Hits], Any]] = {
        "ambient_occlusion": partial(ambient_occlusion, scene, rays=rays),
        "sky_view": lambda points: exposure(
            scene, points, sky_directions(rays), weights=np.full(rays, 2.0 / rays), cosine=True
        ),
        "thickness": partial(thickness, scene),
    }
    return lookup(known, what, "what")


def evaluated(scene: Scene, function: Callable[[Hits], Any], triangles: np.ndarray, uv: np.ndarray, number: int) -> np.ndarray:
    """(N, ...) float32: values of a function at points of triangles, block by block."""
    found = []
    for begin in range(0, max(len(triangles), 1), BLOCK):
        part = slice(begin, begin + BLOCK)
        points = scene.points_on(triangles[part], uv[part], instance_id=number)
        values, count = host(function(points)), len(triangles[part])
        if values.shape[:1] != (count,) or values.dtype.kind not in "fiub":
            raise ValueError(
                f"what must return {count} rows of numbers, one a point, not {values.dtype} of shape {values.shape}"
            )
        found.append(values.astype(np.float32))
    return np.concatenate(found)


def at_vertices(mesh: TriangleMesh, corners: np.ndarray) -> np.ndarray:
    """(V, ...) means of the values (3 F, ...) of corners, weighted by their angles; NaN for vertices of no triangle."""
    ends = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    ways = [np.roll(ends, -step, axis=1) - ends for step in (1, 2)]
    with np.errstate(invalid="ignore", divide="ignore"):
        ways = [way / np.linalg.norm(way, axis=-1, keepdims=True) for way in ways]
        angles = np.nan_to_num(np.arccos(np.clip((ways[0] * ways[1]).sum(axis=-1), -1.0, 1.0))).ravel()
    known = np.isfinite(corners).reshape(len(corners), -1).all(axis=1)
    weights = np.where(known, np.maximum(angles, 1e-12), 0.0)  # those of triangles without area count where nothing else does
    rows, at = np.where(known[:, None], corners.reshape(len(corners), -1), 0.0), mesh.faces.ravel()
    count = len(mesh.vertices)
    total = np.bincount(at, weights, count)
    sums = np.stack([np.bincount(at, weights * column, count) for column in rows.T], axis=1)
    with np.errstate(invalid="ignore"):
        return (sums / total[:, None]).astype(np.float32).reshape(count, *corners.shape[1:])


def laid_out(mesh: TriangleMesh, uv: Any) -> TriangleMesh:
    """The triangles of a mesh in the plane of their texture coordinates.

    Raises:
        TypeError, ValueError: there are no such coordinates.
    """
    if uv is None:
        if mesh.materials is None or mesh.materials.corner_uv is None:
            raise ValueError("the mesh has no texture coordinates; pass uv, or make it by with_materials(..., uv=...)")
        corners = np.asarray(mesh.materials.corner_uv, dtype=np.float64)
    else:
        corners = as_numbers("uv", uv)
        if corners.shape == (len(mesh.vertices), 2):
            corners = corners[mesh.faces]
        if corners.shape != (mesh.triangle_count, 3, 2):
            raise ValueError(
                f"uv must have shape ({len(mesh.vertices)}, 2) for vertices or ({mesh.triangle_count}, 3, 2) for corners, not "
                f"{np.shape(uv)}"
            )
    if corners.min() < 0.0 or corners.max() > 1.0:
        raise ValueError(
            f"texture coordinates go from {corners.min():.4g} to {corners.max():.4g}, and an image has those in [0, 1]; lay "
            "the surface out anew, or scale them"
        )
    flat = np.concatenate([corners.reshape(-1, 2), np.zeros((corners.size // 2, 1))], axis=1)
    return wrt.TriangleMesh(flat, np.arange(len(flat)).reshape(-1, 3))


def texel_rays(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays down at the centres of texels: origins (size, size, 3), and their direction."""
    middle = (np.arange(size) + 0.5) / size
    origins = np.ones((size, size, 3))
    origins[..., 0], origins[..., 1] = middle, (1.0 - middle)[:, None]
    return origins, np.array([0.0, 0.0, -1.0], dtype=np.float32)


def padded(image: np.ndarray, covered: np.ndarray, rings: int) -> np.ndarray:
    """An image whose texels next to those with values have the mean of them, ring by ring."""
    rows, columns = covered.shape
    known = covered.copy()
    for _ in range(min(rings, rows + columns)):
        ring_rows, ring_columns = np.nonzero(~known & grown(known))
        if not len(ring_rows):
            break
        total, number = np.zeros((len(ring_rows), *image.shape[2:])), np.zeros(len(ring_rows))
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                row, column = ring_rows + down, ring_columns + right
                inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
                row, column = np.where(inside, row, ring_rows), np.where(inside, column, ring_columns)
                there = known[row, column]
                total[there] += image[row[there], column[there]]
                number += there
        image[ring_rows, ring_columns] = total / number.reshape(-1, *(1,) * (image.ndim - 2))
        known[ring_rows, ring_columns] = True
    return image


def grown(known: np.ndarray) -> np.ndarray:
    """What is known, and its eight neighbours."""
    wide = known.copy()
    wide[1:] |= known[:-1]
    wide[:-1] |= known[1:]
    found = wide.copy()
    found[:, 1:] |= wide[:, :-1]
    found[:, :-1] |= wide[:, 1:]
    return found
