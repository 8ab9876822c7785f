"""Nodes of glTF: where meshes stand. Skins are posed as the nodes are; animations are not played.

The nodes are walked without recursion, so that chains of any length are, too; a node that is reached twice is refused, which
ends every circle and keeps a small file from growing without bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.meshes.files.gltf.document import Document

__all__ = ["PlacedMesh", "placed_meshes", "skinned"]

INSTANCING = "EXT_mesh_gpu_instancing"
MAX_INSTANCES = 1 << 20
"""Instances of a node, which are flattened."""


@dataclass
class PlacedMesh:
    """A mesh at a node.

    Attributes:
        mesh: its number.
        weights: of its morph targets; None for those of the mesh.
        matrices: (N, 4, 4) float64, to the scene, one for each instance.
        joints: (J, 4, 4) float64, of a skin: from the mesh in its rest pose to the scene; None for none.
        extras: of the node.
    """

    mesh: Any
    weights: Any
    matrices: np.ndarray
    joints: np.ndarray | None
    extras: Any


def placed_meshes(document: Document) -> list[PlacedMesh]:
    """The meshes of the default scene, in the order of its nodes: a node before its children.

    Without scenes, those of all nodes; without nodes, all meshes once.

    Raises:
        ValueError: broken structure, or nodes that have two parents or are in a circle.
    """
    count = len(document.list_of("nodes"))
    if count == 0:
        return [PlacedMesh(n, None, np.eye(4)[None], None, None) for n in range(len(document.list_of("meshes")))]
    children = [_children(document, number) for number in range(count)]
    below = {child for some in children for child in some}
    tops = [number for number in range(count) if number not in below]
    local = local_matrices([document.item("nodes", number) for number in range(count)])
    order, worlds = _walk(document, tops, children, local)
    scenes = document.list_of("scenes")
    if scenes:
        roots = document.item("scenes", document.json.get("scene", 0)).get("nodes", [])
        inside, _ = _walk(document, roots, children, local)
    else:
        inside = order
    placed = []
    for number in inside:
        node = document.item("nodes", number)
        if node.get("mesh") is not None:
            placed.append(_placed(document, node, number, worlds))
    return placed


def _children(document: Document, number: int) -> list[int]:
    given = document.item("nodes", number).get("children", [])
    for child in given:
        document.item("nodes", child)
    return list(given)


def _walk(
    document: Document, roots: list[Any], children: list[list[int]], local: np.ndarray
) -> tuple[list[int], dict[int, np.ndarray]]:
    """Nodes below some roots, each before its children, and their maps to the scene."""
    order: list[int] = []
    worlds: dict[int, np.ndarray] = {}
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    while waiting:
        number, above = waiting.pop()
        document.item("nodes", number)
        if number in worlds:
            raise ValueError(f"nodes[{number}] has two parents, or is below itself; those of glTF are trees")
        worlds[number] = above @ local[number]
        order.append(number)
        waiting += [(child, worlds[number]) for child in reversed(children[number])]
    return order, worlds


def local_matrices(nodes: list[dict[str, Any]]) -> np.ndarray:
    """(N, 4, 4) float64, from each node to its parent: its matrix, by columns, or translation x rotation x scale."""
    found = matrices_of(
        _table(nodes, "translation", (0.0, 0.0, 0.0)),
        _table(nodes, "rotation", (0.0, 0.0, 0.0, 1.0)),
        _table(nodes, "scale", (1.0, 1.0, 1.0)),
    )
    for number, node in enumerate(nodes):
        if node.get("matrix") is not None:
            matrix = _array(node["matrix"], 16, f"the matrix of nodes[{number}]").reshape(4, 4).T
            if (np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)) > 1e-6).any():
                raise ValueError(f"the matrix of nodes[{number}] is not affine: its last row is {matrix[3].tolist()}")
            found[number, :3] = matrix[:3]
    return found


def _table(nodes: list[dict[str, Any]], name: str, default: tuple[float, ...]) -> np.ndarray:
    """(N, k) float64: a value of all nodes."""
    values = [default if node.get(name) is None else node[name] for node in nodes]
    try:
        table = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        table = np.zeros(0)
    if table.shape != (len(nodes), len(default)) or not np.isfinite(table).all():
        table = np.array([_array(one, len(default), f"the {name} of nodes[{n}]") for n, one in enumerate(values)])
    return table


def matrices_of(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(N, 4, 4) float64 of (N, 3) translations, (N, 4) quaternions x, y, z, w of any length and (N, 3) scales."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    x, y, z, w = np.where(length > 0.0, rotation / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 0.0, 1.0)).T
    matrices = np.zeros((len(translation), 4, 4))
    matrices[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
    matrices[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
    matrices[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
    matrices[:, :3, :3] *= scale[:, None, :]
    matrices[:, :3, 3], matrices[:, 3, 3] = translation, 1.0
    return matrices


def _array(values: Any, count: int, what: str) -> np.ndarray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{what} is {str(values)[:80]}, and not {count} finite numbers")
    return array


def _placed(document: Document, node: dict[str, Any], number: int, worlds: dict[int, np.ndarray]) -> PlacedMesh:
    world, joints = worlds[number], None
    if node.get("skin") is not None:
        joints = _joints(document, node["skin"], worlds)
    matrices = world[None]
    extension = (node.get("extensions") or {}).get(INSTANCING)
    if extension is not None:
        matrices = world @ _instances(document, extension["attributes"], f"nodes[{number}]")
    return PlacedMesh(node["mesh"], node.get("weights"), matrices, joints, node.get("extras"))


def _instances(document: Document, attributes: dict[str, Any], what: str) -> np.ndarray:
    """(N, 4, 4) of `EXT_mesh_gpu_instancing`."""
    found = {}
    for name, kind in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")):
        if name in attributes:
            found[name] = document.accessor(attributes[name], (kind,), f"{name} of the instances of {what}").astype(np.float64)
    counts = {len(values) for values in found.values()}
    if len(counts) != 1 or max(counts) > MAX_INSTANCES or not all(np.isfinite(values).all() for values in found.values()):
        raise ValueError(
            f"the instances of {what} have {sorted(counts)} translations, rotations and scales; there must be as many of each, "
            f"finite, and at most {MAX_INSTANCES}"
        )
    count = counts.pop()
    return matrices_of(
        found.get("TRANSLATION", np.zeros((count, 3))),
        found.get("ROTATION", np.broadcast_to((0.0, 0.0, 0.0, 1.0), (count, 4))),
        found.get("SCALE", np.ones((count, 3))),
    )


def _joints(document: Document, index: Any, worlds: dict[int, np.ndarray]) -> np.ndarray:
    """(J, 4, 4) float64: a skin's joints in the pose of the nodes, after the inverse of their rest pose."""
    skin = document.item("skins", index)
    joints = skin["joints"]
    for joint in joints:
        document.item("nodes", joint)
        if joint not in worlds:
            raise ValueError(f"nodes[{joint}], a joint of skins[{index}], is in a circle")
    found = np.array([worlds[joint] for joint in joints]).reshape(-1, 4, 4)
    if skin.get("inverseBindMatrices") is not None:
        inverse = document.accessor(skin["inverseBindMatrices"], ("MAT4",), f"inverseBindMatrices of skins[{index}]")
        if len(inverse) < len(joints):
            raise ValueError(f"skins[{index}] has {len(joints)} joints and {len(inverse)} matrices")
        found = found @ inverse[: len(joints)].astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
    return found


def skinned(document: Document, vertices: np.ndarray, attributes: dict[str, Any], joints: np.ndarray) -> np.ndarray:
    """(V, 3) float64: vertices of a skin in the scene, each moved by its joints.

    Raises:
        ValueError: joints or weights are missing, or name joints that are not there.
    """
    moved, total = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    points = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    for group in range(4):
        if f"JOINTS_{group}" not in attributes:
            break
        numbers = document.accessor(attributes[f"JOINTS_{group}"], ("VEC4",), f"JOINTS_{group}")
        weights = document.accessor(attributes[f"WEIGHTS_{group}"], ("VEC4",), f"WEIGHTS_{group}").astype(np.float64)
        if numbers.dtype.kind != "u" or len(numbers) != len(vertices) or len(weights) != len(vertices):
            raise ValueError(f"JOINTS_{group} and WEIGHTS_{group} do not fit the vertices")
        if len(numbers) and numbers.max() >= len(joints):
            raise ValueError(f"JOINTS_{group} go up to {int(numbers.max())}, and the skin has {len(joints)} joints")
        for column in range(4):
            weight = weights[:, column]
            used = np.flatnonzero(weight)
            moved[used] += weight[used, None] * np.einsum("nij,nj->ni", joints[numbers[used, column], :3], points[used])
            total += weight
    if not (total > 0.0).all():
        raise ValueError("vertices of a skin have no joints that move them")
    return moved / total[:, None]
