"""Surfaces that repeat an earlier one exactly: triangles with the same corners and the same side in front, and instances.

Exporters write faces twice, and meshes are joined with themselves. Closest hits do not notice; a parity of crossings counts a
surface twice that is there once. A triangle that is turned over is no repetition: two boxes that touch have their common
wall twice, each facing outward from its own, and a ray from one to the other crosses both.

Nor is a patch of repeated triangles in vain if the surfaces around need it twice: of two houses on the same ground, one inside
the other, each is closed by its own floor. Each edge at the rim of such a patch has an even number of other triangles there;
around a face that was written once too often it has one.

**Search.** Triangles get a hash of 64 bits that does not depend on the order of their corners. If no two are equal, which one
sort tells, nothing repeats. Only those with equal hashes are compared, by their coordinates.

References: appleby-2011 (the mixing of bits).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.mesh_measures import first_of_equal_points


def repeated_triangles(meshes: Sequence[TriangleMesh]) -> list[np.ndarray]:
    """For each mesh, (F,) bool: triangles that repeat an earlier one of the same mesh or of a mesh before it.

    Corners are compared by their coordinates, exactly; -0.0 equals 0.0, and float32 equals the float64 of the same value.
    """
    hashes = np.concatenate([triangle_hashes(mesh) for mesh in meshes])
    repeated = np.zeros(len(hashes), dtype=bool)
    ranked = np.sort(hashes)
    twice = ranked[1:][ranked[1:] == ranked[:-1]]
    first = np.cumsum([0, *(mesh.triangle_count for mesh in meshes)])
    if len(twice):
        suspects = np.flatnonzero(np.isin(hashes, twice))
        owner = np.searchsorted(first, suspects, side="right") - 1
        own = [suspects[owner == number] - first[number] for number in range(len(meshes))]
        corners = [mesh.vertices[mesh.faces[rows]].astype(np.float64) for mesh, rows in zip(meshes, own, strict=True)]
        _, kept = np.unique(rotated(np.concatenate(corners)).reshape(-1, 9), axis=0, return_index=True)
        repeated[suspects] = True
        repeated[suspects[kept]] = False
    return np.split(repeated, first[1:-1])


def without_repeated(meshes: Sequence[TriangleMesh]) -> tuple[TriangleMesh, ...] | None:
    """The meshes without triangles that repeat an earlier one in vain, and without meshes that lose all of theirs; None if
    there are no such triangles. Meshes that lose some have neither names nor materials."""
    repeated = repeated_triangles(meshes)
    if any(marks.any() for marks in repeated):
        joined = TriangleMesh.concatenate([TriangleMesh(mesh.vertices.astype(np.float64), mesh.faces) for mesh in meshes])
        marks = np.concatenate(repeated)
        marks[needed_twice(first_of_equal_points(joined.vertices)[joined.faces], marks)] = False
        repeated = np.split(marks, np.cumsum([mesh.triangle_count for mesh in meshes])[:-1])
    if not any(marks.any() for marks in repeated):
        return None
    pairs = zip(meshes, repeated, strict=True)
    return tuple(
        TriangleMesh(mesh.vertices, mesh.faces[~marks]) if marks.any() else mesh for mesh, marks in pairs if not marks.all()
    )


def needed_twice(corners: np.ndarray, repeated: np.ndarray) -> np.ndarray:
    """Numbers of the repeated triangles whose neighbours need them and what they repeat.

    Args:
        corners: (F, 3) the points that triangles have as corners, by number.
        repeated: (F,) bool: triangles that repeat an earlier one.
    """
    ordered = np.sort(corners, axis=1)
    edges = np.concatenate([ordered[:, [0, 1]], ordered[:, [1, 2]], ordered[:, [0, 2]]])
    _, edge = np.unique(edges[:, 0] * (int(edges.max()) + 1) + edges[:, 1], return_inverse=True)
    edge = edge.reshape(3, -1).T
    rows = np.flatnonzero(repeated)
    count, extra = np.bincount(edge.ravel()), np.bincount(edge[rows].ravel(), minlength=edge.max() + 1)
    others = count - 2 * extra
    # where an odd number of repetitions ends, an odd number of others says that they are too many, an even one that not
    at_end = (extra % 2 == 1) & (others > 0)
    votes = np.where(at_end, np.where(others % 2 == 1, 1, -1), 0)
    patch = connected(edge[rows])
    for_leaving = np.bincount(patch, weights=votes[edge[rows]].sum(axis=1), minlength=len(rows))
    return rows[for_leaving[patch] < 0]


def connected(edge: np.ndarray) -> np.ndarray:
    """(N,) the same number for triangles that are connected by edges; edge: (N, 3) the edges of each, by number."""
    _, edge = np.unique(edge, return_inverse=True)
    edge = edge.reshape(-1, 3)
    label = np.arange(len(edge))
    while True:
        smallest = np.full(edge.max() + 1, len(edge))
        for side in range(3):
            np.minimum.at(smallest, edge[:, side], label)
        better = smallest[edge].min(axis=1)
        better = better[better]
        if (better == label).all():
            return label
        label = better


def distinct_instances(instances: Sequence[Instance], numbers: Sequence[int], meshes: Sequence[TriangleMesh]) -> list[Instance]:
    """The instances without those that repeat an earlier one: of an equal mesh, with equal transform and environment. Masks are
    not compared, but those that no ray sees repeat nothing that some do.

    Args:
        instances: the instances.
        numbers: the mesh of each of them.
        meshes: what to put in place of their meshes, by number. Two are equal if their vertices and faces are, in order.
    """
    kept, places = [], {}
    for number, one in zip(numbers, instances, strict=True):
        place = one.mask != 0, one.environment, (one.transform + 0.0).tobytes()  # -0.0 becomes 0.0
        mesh = meshes[number]
        others = places.setdefault((place, mesh.vertex_count, mesh.triangle_count, mesh.bounds.tobytes()), [])
        if any(number == other or are_equal(mesh, meshes[other]) for other in others):
            continue
        others.append(number)
        kept.append(Instance(mesh, one.transform, mask=one.mask, environment=one.environment))
    return kept


def are_equal(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Whether two meshes have the same vertices and faces in the same order."""
    return np.array_equal(one.vertices, other.vertices) and np.array_equal(one.faces, other.faces)


def triangle_hashes(mesh: TriangleMesh) -> np.ndarray:
    """(F,) uint64, equal for triangles with the same corners in whatever order."""
    bits = (mesh.vertices.astype(np.float64) + 0.0).view(np.uint64)  # -0.0 becomes 0.0
    of_vertex = mixed(mixed(mixed(bits[:, 0]) + bits[:, 1]) + bits[:, 2])
    return of_vertex[mesh.faces].sum(axis=1, dtype=np.uint64)


def mixed(words: np.ndarray) -> np.ndarray:
    """A one-to-one map of 64-bit words after which each bit depends on many (Appleby 2011)."""
    words = (words ^ (words >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    words = (words ^ (words >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return words ^ (words >> np.uint64(33))


def rotated(corners: np.ndarray) -> np.ndarray:
    """(N, 3, 3) triangles whose corners are rotated so that the least, by x, then y, then z, is the first; -0.0 becomes 0.0."""
    corners = corners + 0.0
    smallest = np.zeros(len(corners), dtype=np.int64)
    for other in (1, 2):
        here = corners[np.arange(len(corners)), smallest]
        differs = here != corners[:, other]
        axis, rows = differs.argmax(axis=1), np.arange(len(corners))
        is_less = differs.any(axis=1) & (corners[rows, other, axis] < here[rows, axis])
        smallest[is_less] = other
    order = (smallest[:, None] + np.arange(3)) % 3
    return np.take_along_axis(corners, order[:, :, None], axis=1)
