"""What a ray meets: instance, geometry and triangle. Neighbours often meet the same instance, which is then not searched."""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of


@wp.struct
class SurfaceIds:
    """Of a triangle; -1 for a miss."""

    instance: int
    geometry: int
    primitive: int
    """Number of the triangle within its geometry."""
    first: int
    """Number of the first triangle of the instance that was met last."""
    end: int
    """Number after the last one; 0 if none was met."""
    last: int
    """That instance."""


@wp.func
def surface_ids(mesh: SceneMesh, before: SurfaceIds, primitive: int):
    """The ids of a triangle of the scene, given those of another one."""
    ids = before
    ids.instance = -1
    ids.geometry = -1
    ids.primitive = -1
    if primitive >= 0:
        if primitive < before.first or primitive >= before.end:
            ids.last = geometry_of(mesh, primitive)
            ids.first = mesh.geometry_first[ids.last]
            ids.end = mesh.geometry_first[ids.last + 1]
        ids.instance = ids.last
        ids.geometry = ids.last
        if mesh.placements.shape[0] > 0:
            ids.geometry = mesh.placements[ids.last].geometry
        ids.primitive = primitive - ids.first
    return ids


@wp.func
def label_of(labels: wp.array(dtype=int), ids: SurfaceIds):
    """The label of an instance; -1 for a miss, and without labels."""
    label = int(-1)
    if ids.instance >= 0 and labels.shape[0] > 0:
        label = labels[ids.instance]
    return label
