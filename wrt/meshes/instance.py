"""Instances: a mesh with a transform and a mask, and their construction from the graph of a trimesh scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import MAX_COORDINATE, members_of

MAX_CONDITION = 1e12
"""Condition number from which a map counts as singular: its inverse has no reliable digits."""

MAX_SCALE = 2.0**100
"""Largest factor by which a map may enlarge or shrink, so that ray directions in the mesh's space stay within float32."""

MAX_MASK = (1 << 32) - 1

MIN_RELATIVE_SIZE = 2.0**-40
"""Smallest size of an instance as a share of its distance from the scene's centre: float64 positions within it have 13 bits."""


class Instance:
    """A mesh with a transform. Instances of one mesh share its tree.

        tree = wrt.TriangleMesh.load("tree.ply")
        scene = wrt.Scene([wrt.Instance(tree, matrix) for matrix in matrices])

    Two instances share a tree if their meshes are the same object.

    Args:
        mesh: a `TriangleMesh` or a trimesh.Trimesh.
        transform: (4, 4) affine map from the mesh's space to the scene's, p -> (transform @ [p, 1])[:3], last row (0, 0, 0,
            1); None for the identity. It may scale, shear and mirror; normals keep pointing outward.
        mask: 0 to 2^32 - 1; a ray sees the instance if its own mask has a bit in common with this one.

    Attributes:
        mesh: the mesh as given.
        transform: (4, 4) float64, read-only.
        mask: int.

    Raises:
        TypeError: the mesh or the mask has a wrong type.
        ValueError: a transform that is not finite, not affine or singular, or that enlarges or shrinks by more than 2^100;
            a mask out of range.
    """

    def __init__(self, mesh: Any, transform: Any = None, *, mask: int = MAX_MASK) -> None:
        if not (isinstance(mesh, TriangleMesh) or (hasattr(mesh, "faces") and hasattr(mesh, "vertices"))):
            raise TypeError(
                f"mesh must be a wrt.TriangleMesh or a trimesh.Trimesh, not {type(mesh).__name__}; pass a trimesh.Scene to "
                "wrt.Scene directly"
            )
        self.mesh = mesh
        self.transform = check_transform(np.eye(4) if transform is None else transform)
        self.mask = check_mask(mask)

    def __reduce__(self) -> tuple[Any, ...]:
        """Arrays in a pickle are writable; the constructor makes the transform read-only again."""
        return partial(Instance, mask=self.mask), (self.mesh, self.transform)

    def __repr__(self) -> str:
        return f"Instance({self.mesh!r}, mask={self.mask:#x})"


def check_transform(transform: Any, name: str = "transform") -> np.ndarray:
    """(4, 4) float64, read-only.

    Raises:
        ValueError: wrong shape, not finite, not affine, singular, too large or too small.
    """
    try:
        matrix = np.array(transform, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be a (4, 4) matrix of real numbers: {error}") from None
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"{name} must be a finite (4, 4) matrix, not of shape {matrix.shape}: {matrix.tolist()}")
    if not (np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)) <= 1e-12).all():
        raise ValueError(f"{name} must be affine, its last row (0, 0, 0, 1); got {matrix[3].tolist()}")
    sizes = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    if sizes[2] > 0.0 and not (sizes[0] <= MAX_SCALE and sizes[2] >= 1.0 / MAX_SCALE):
        raise ValueError(
            f"{name} scales by {sizes[2]:.3g} to {sizes[0]:.3g}; float32 represents rays in the mesh's space for factors from "
            f"{1.0 / MAX_SCALE:.3g} to {MAX_SCALE:.3g}; choose another unit of length for the mesh, or for the scene"
        )
    if not sizes[0] < MAX_CONDITION * sizes[2]:
        raise ValueError(
            f"{name} is singular and has no inverse to transform rays with: {matrix[:3, :3].tolist()}; transform the mesh "
            "instead, and pass mesh.transformed(transform) to the scene"
        )
    matrix.flags.writeable = False
    return matrix


def check_mask(mask: Any, name: str = "mask") -> int:
    """Checks that a mask is an int from 0 to 2^32 - 1.

    Raises:
        TypeError: not an int.
        ValueError: out of range.
    """
    if isinstance(mask, (bool, np.bool_)) or not isinstance(mask, (int, np.integer)):
        raise TypeError(f"{name} must be an int, not {type(mask).__name__}; combine bits as 1 << 0 | 1 << 3")
    if not 0 <= mask <= MAX_MASK:
        raise ValueError(f"{name} is {mask}; it must be from 0 to 2**32 - 1")
    return int(mask)


def check_extent(instances: Sequence[Instance], geometry_ids: Sequence[int], meshes: Sequence[TriangleMesh]) -> None:
    """Refuses a scene beyond float32, or so large that float64 does not resolve positions within one of its instances.

    Args:
        instances: those with mask 0, which no ray sees, are not checked for resolution.
        geometry_ids: the mesh of each instance.
        meshes: each mesh once.

    Raises:
        ValueError: there is such an instance.
    """
    boxes = np.array([mesh.bounds for mesh in meshes])[np.array(geometry_ids)]
    transforms = np.array([instance.transform for instance in instances])
    linear, shift = transforms[:, :3, :3], transforms[:, :3, 3]
    half = (np.abs(linear) @ ((boxes[:, 1] - boxes[:, 0]) / 2)[:, :, None])[:, :, 0]
    middle = (linear @ boxes.mean(axis=1)[:, :, None])[:, :, 0] + shift
    far = (np.abs(middle) + half).max(axis=1)
    if not far.max() <= MAX_COORDINATE:
        worst = int(far.argmax())
        raise ValueError(
            f"instance {worst} has coordinates up to {far[worst]:.3g}, and those of a scene go up to {MAX_COORDINATE:.3g}; "
            "correct its transform, or choose another unit of length"
        )
    center = ((middle - half).min(axis=0) + (middle + half).max(axis=0)) / 2
    size, distance = 2.0 * half.max(axis=1), np.abs(middle - center).max(axis=1)
    lost = (size < MIN_RELATIVE_SIZE * distance) & (size > 0.0) & np.array([instance.mask != 0 for instance in instances])
    if lost.any():
        worst = int(np.flatnonzero(lost)[0])
        raise ValueError(
            f"instance {worst} is {size[worst]:.3g} large and {distance[worst]:.3g} from the scene's centre, where float64 "
            "does not resolve it; put distant instances into another scene, or hide this one with mask=0"
        )


def has_instances(geometry: Any) -> bool:
    """Whether the geometry needs two levels: it is or contains an `Instance` or a trimesh.Scene."""
    return any(isinstance(member, Instance) or is_graph(member) for member in members_of(geometry))


def as_instances(geometry: Any) -> tuple[Instance, ...]:
    """The instances of a two-level scene: a trimesh.Scene becomes an instance for each node that holds triangles.

    Raises:
        TypeError: an object that is neither an instance nor a mesh.
        ValueError: a trimesh.Scene without triangles.
    """
    instances: list[Instance] = []
    for member in members_of(geometry):
        if is_graph(member):
            instances.extend(graph_instances(member))
        else:
            instances.append(member if isinstance(member, Instance) else Instance(member))
    return tuple(instances)


def is_graph(geometry: Any) -> bool:
    """Whether this is a trimesh.Scene, without importing trimesh."""
    return hasattr(geometry, "graph") and hasattr(geometry, "geometry")


def graph_instances(scene: Any) -> list[Instance]:
    """The nodes of a trimesh.Scene that hold triangles, in the order of its graph."""
    meshes = {name: mesh for name, mesh in scene.geometry.items() if len(getattr(mesh, "faces", ()))}
    placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
    instances = [Instance(meshes[name], matrix) for matrix, name in placed if name in meshes]
    if not instances:
        raise ValueError("no triangles in the trimesh.Scene: it needs a mesh (point clouds and paths do not count)")
    return instances
