"""Instances: a mesh with a transform and a mask, and their construction from the graph of a trimesh scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import warp as wp

from wrt.kernels.validation import as_int, as_numbers, as_real_array
from wrt.meshes.graph_transforms import graph_transform
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.placement import MAX_COORDINATE, members_of

if TYPE_CHECKING:
    import trimesh
    from trimesh.parent import Geometry as OfTrimesh

    from wrt.array_types import ArrayLike

Member: TypeAlias = "TriangleMesh | Instance | OfTrimesh"

Geometry: TypeAlias = "Member | Sequence[Member] | Sequence[Sequence[Member]]"
"""What scenes are made of; objects of trimesh are meshes and scenes."""

MAX_CONDITION = 1e12
"""Condition number from which a map counts as singular: its inverse has no reliable digits."""

MAX_SCALE = 2.0**100
"""Largest factor by which a map may enlarge or shrink, so that ray directions in the mesh's space stay within float32."""

FEW = 16
"""Matrices up to which Python is faster than NumPy."""

LAST_ROW = [0.0, 0.0, 0.0, 1.0]

TINY = float(np.finfo(np.float64).tiny)

MAX_MASK = (1 << 32) - 1

EVERY = -1
"""Environment of instances that the rays of all environments see."""

MAX_ENVIRONMENT = (1 << 31) - 1

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
        environment: 0 to 2^31 - 1, one of many worlds in a scene: rays of an environment see the instances of theirs only, and
            those of environment -1, which all share.

    Attributes:
        mesh: the mesh as given.
        transform: (4, 4) float64, read-only.
        mask, environment: int.

    Raises:
        TypeError: the mesh, the mask or the environment has a wrong type.
        ValueError: a transform that is not finite, not affine or singular, or that enlarges or shrinks by more than 2^100;
            a mask or an environment out of range.
    """

    __slots__ = ("environment", "mask", "mesh", "transform")

    def __init__(
        self,
        mesh: TriangleMesh | trimesh.parent.Geometry,
        transform: ArrayLike | None = None,
        *,
        mask: int = MAX_MASK,
        environment: int = EVERY,
    ) -> None:
        if not (isinstance(mesh, TriangleMesh) or (hasattr(mesh, "faces") and hasattr(mesh, "vertices"))):
            raise TypeError(
                f"mesh must be a wrt.TriangleMesh or a trimesh.Trimesh, not {type(mesh).__name__}; pass a trimesh.Scene to "
                "wrt.Scene directly"
            )
        self.mesh: Any = mesh
        self.transform = check_transform(np.eye(4) if transform is None else transform)
        self.mask = check_mask(mask)
        self.environment = check_environment(environment)

    def moved(self, transform: np.ndarray, mask: int, environment: int) -> Instance:
        """The mesh elsewhere: transform, mask and environment as in the class, which must have been checked."""
        other = object.__new__(Instance)
        other.mesh, other.transform, other.mask, other.environment = self.mesh, transform, mask, environment
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        """Arrays in a pickle are writable; the constructor makes the transform read-only again."""
        return partial(Instance, mask=self.mask, environment=self.environment), (self.mesh, self.transform)

    def __repr__(self) -> str:
        environment = "" if self.environment == EVERY else f", environment={self.environment}"
        return f"Instance({self.mesh!r}, mask={self.mask:#x}{environment})"


def check_transform(transform: Any, name: str = "transform") -> np.ndarray:
    """(4, 4) float64, read-only.

    Raises:
        ValueError: wrong shape, not finite, not affine, singular, too large or too small.
    """
    matrix = as_numbers(name, transform, finite=False)
    if matrix.shape != (4, 4):
        raise ValueError(f"{name} must be a finite (4, 4) matrix, not of shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} must be a finite (4, 4) matrix, not {matrix.tolist()}")
    if not (np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)) <= 1e-12).all():
        raise ValueError(f"{name} must be affine, its last row (0, 0, 0, 1); got {matrix[3].tolist()}")
    if is_surely_regular(matrix.ravel().tolist()):
        matrix.flags.writeable = False
        return matrix
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


def is_surely_regular(matrix: list[float]) -> bool:
    """Whether the linear part of a finite map is far from singular, by bounds on its singular values that take no time.

    matrix: (4, 4), row by row.
    """
    a, b, c, _x, d, e, f, _y, g, h, i = matrix[:11]
    square = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
    largest = sqrt(square)  # at least the largest singular value
    determinant = abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))
    smallest = determinant / max(square, TINY)  # at most the smallest one
    return largest <= MAX_SCALE and smallest >= 1.0 / MAX_SCALE and largest < MAX_CONDITION * smallest


def check_transforms(transforms: Any, count: int) -> np.ndarray:
    """(count, 4, 4) float64, read-only, of one matrix for all instances or one for each.

    Args:
        transforms: (4, 4) or (count, 4, 4), without the last row, too; or a Warp array: of matrices, of numbers in one of these
            shapes, or (count,) of `wp.transform`.
        count: number of instances.

    Raises:
        ValueError: another number of matrices, or as `check_transform`.
    """
    matrices = matrices_of(transforms) if isinstance(transforms, wp.array) else as_real_array("transform", transforms)
    if matrices.ndim in (2, 3) and matrices.shape[-2:] == (3, 4):
        last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*matrices.shape[:-2], 1, 4))
        matrices = np.concatenate([matrices, last], axis=-2)
    if matrices.ndim == 3 and len(matrices) != count:
        raise ValueError(f"transform holds {len(matrices)} matrices for {count} instances; pass one each, or one for all")
    if matrices.ndim != 3:
        return np.broadcast_to(check_transform(matrices), (count, 4, 4))
    if matrices.shape[1:] != (4, 4):
        for matrix in matrices:
            check_transform(matrix)
    matrices = matrices.astype(np.float64)
    if count <= FEW:
        for number, row in enumerate(matrices.reshape(-1, 16).tolist()):
            if not (is_surely_regular(row) and row[12:] == LAST_ROW and all(map(isfinite, row[3:12:4]))):
                check_transform(matrices[number])
        matrices.flags.writeable = False
        return matrices
    entries = np.ascontiguousarray(matrices.reshape(-1, 16).T)
    a, b, c, x, d, e, f, y, g, h, i, z = entries[:12]
    with np.errstate(all="ignore"):  # a NaN is not below any bound
        square = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
        largest = np.sqrt(square)  # as in `is_surely_regular`
        smallest = np.abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)) / np.maximum(square, TINY)
        fine = (largest <= MAX_SCALE) & (smallest >= 1.0 / MAX_SCALE) & (largest < MAX_CONDITION * smallest)
        for values in (x, y, z):
            fine &= np.isfinite(values)
        for values, wanted in zip(entries[12:], LAST_ROW, strict=True):
            fine &= np.abs(values - wanted) <= 1e-12
    for number in np.flatnonzero(~fine).tolist():
        check_transform(matrices[number])
    matrices.flags.writeable = False
    return matrices


def matrices_of(transforms: wp.array) -> np.ndarray:
    """(..., 4, 4) of a Warp array of matrices, of numbers, or of `wp.transform`: a position and a quaternion x, y, z, w."""
    if transforms.dtype not in (wp.transformf, wp.transformd):
        return transforms.numpy()
    values = transforms.numpy().astype(np.float64)
    matrices = np.zeros((*values.shape[:-1], 4, 4))
    matrices[..., :3, 3], matrices[..., 3, 3] = values[..., :3], 1.0
    matrices[..., :3, :3] = rotation_matrices(values[..., 3:] / np.linalg.norm(values[..., 3:], axis=-1, keepdims=True))
    return matrices


def rotation_matrices(unit: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices of (..., 4) unit quaternions x, y, z, w."""
    x, y, z, w = np.moveaxis(unit, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def check_environment(environment: Any) -> int:
    """Checks that an environment is an int from -1 to 2^31 - 1.

    Raises:
        TypeError: not an int.
        ValueError: out of range.
    """
    environment = as_int("environment", environment)
    if not EVERY <= environment <= MAX_ENVIRONMENT:
        raise ValueError(f"environment is {environment}; it must be from 0 to 2**31 - 1, or -1 for all environments")
    return environment


def check_mask(mask: Any) -> int:
    """Checks that a mask is an int from 0 to 2^32 - 1.

    Raises:
        TypeError: not an int.
        ValueError: out of range.
    """
    mask = as_int("mask", mask)
    if not 0 <= mask <= MAX_MASK:
        raise ValueError(f"mask is {mask}; it must be from 0 to 2**32 - 1, bits combined as 1 << 0 | 1 << 3")
    return mask


def check_extent(
    transforms: np.ndarray, masks: np.ndarray, geometry_ids: Sequence[int], meshes: Sequence[TriangleMesh]
) -> None:
    """Refuses a scene beyond float32, or so large that float64 does not resolve positions within one of its instances.

    Args:
        transforms: (N, 4, 4) of the instances.
        masks: (N,); instances with mask 0, which no ray sees, are not checked for resolution.
        geometry_ids: the mesh of each instance.
        meshes: each mesh once.

    Raises:
        ValueError: there is such an instance.
    """
    boxes = np.array([mesh.bounds for mesh in meshes])[np.array(geometry_ids)]
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
    lost = (size < MIN_RELATIVE_SIZE * distance) & (size > 0.0) & (masks != 0)
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
    names, known = scene.graph.transforms.node_data, {}
    instances = [
        Instance(scene.geometry[names[node]["geometry"]], graph_transform(scene, node, known)) for node in graph_nodes(scene)
    ]
    if not instances:
        raise ValueError("no triangles in the trimesh.Scene: it needs a mesh (point clouds and paths do not count)")
    return instances


def graph_nodes(scene: Any) -> list[str]:
    """Names of the nodes of a trimesh.Scene that hold triangles, in the order of its graph."""
    filled = {name for name, mesh in scene.geometry.items() if len(getattr(mesh, "faces", ()))}
    names = scene.graph.transforms.node_data
    return [node for node in scene.graph.nodes_geometry if names[node]["geometry"] in filled]
