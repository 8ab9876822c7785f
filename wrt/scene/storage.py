"""Scenes in files and pickles: the meshes, the description of the tree, and the tree, so that it need not be rebuilt.

A tree is identified by its **key**: a hash of the vertices and faces that it was built over, of its description (`wrt.Bvh`,
`wrt.KdTree`) with the width chosen for the device, and of the revision of its builders. A stored tree is used only if its key
matches; after any change the tree is rebuilt. So a scene's answers never depend on where its tree comes from.

A file is an .npz archive of plain arrays, which runs no code when it is read (as a pickle would); its checksum detects
damage (`wrt.scene.archives`). It is not a signature: a file that was forged together with its checksum gives wrong answers.
Kernels follow the indices in a tree without checks, so those of a stored tree are checked first: every child, leaf and
triangle exists, children come after their parents, and no path is longer than the traversals' stacks.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import warp as wp

from wrt.accelerators import accelerator as descriptions
from wrt.accelerators.accelerator import ACCELERATORS, Accelerator
from wrt.accelerators.cuda_trees import for_device
from wrt.builders.tree import BuildStats, Bvh, KdTree
from wrt.builders.tree_check import check_tree
from wrt.materials.mesh_materials import pack_materials, unpack_materials
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.node_graph import NOWHERE, NodeGraph
from wrt.revisions import TREE_REVISION
from wrt.scene.archives import UNREADABLE, check_format, checked_reading, read_archive, write_archive

if TYPE_CHECKING:
    from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes
    from wrt.builders.kdtree.lazy.lazy_kdtree import LazyKdTree
    from wrt.builders.triangle_boxes import TriangleBoxes
    from wrt.engine.facts.scene_state import SceneState
    from wrt.meshes.placement import PlacedMeshes
    from wrt.scene.updates import TreeRecipe

FORMAT = 2
"""Version of the file format; incremented when the contents change."""

TREES = {"bvh": Bvh, "kdtree": KdTree}

NODE_FIELDS = ("parents", "local", "node_of")
"""What a file holds of a scene's graph besides the names of its nodes."""

OPTIONAL = ("layout", "pairs")
"""Fields of trees that not every file has."""

INSTANCE_FIELDS = ("transform", "mask", "environment")
"""What a file holds of each instance besides the number of its mesh."""


class TreeSource(Protocol):
    """A source of trees."""

    def tree(self, key: str, triangles: int, build: Callable[[], Bvh | KdTree]) -> Bvh | KdTree:
        """The tree with this key over `triangles` triangles, on the CPU; `build` makes it if the source does not have it."""
        ...


@dataclass(frozen=True)
class StoredTree:
    """A tree that was stored with a scene."""

    key: str
    known: Bvh | KdTree

    def tree(self, key: str, triangles: int, build: Callable[[], Bvh | KdTree]) -> Bvh | KdTree:
        """The tree, if its key matches."""
        return self.known if key == self.key else build()


@dataclass(frozen=True)
class StoredTrees:
    """The trees of the meshes of a scene of instances, by their keys."""

    known: Mapping[str, Bvh | KdTree]

    def tree(self, key: str, triangles: int, build: Callable[[], Bvh | KdTree]) -> Bvh | KdTree:
        """The tree with this key; built if there is none."""
        return self.known[key] if key in self.known else build()


@dataclass(frozen=True)
class TreeFolder:
    """A folder of tree files, each named by its key."""

    folder: Path

    def tree(self, key: str, triangles: int, build: Callable[[], Bvh | KdTree]) -> Bvh | KdTree:
        """The tree from its file; a missing or damaged file is written again."""
        path = self.folder / f"{key}.npz"
        with suppress(*UNREADABLE):
            return unpack_tree(read_archive(path), triangles)
        self.folder.mkdir(parents=True, exist_ok=True)  # before the work of building
        tree = build()
        try:
            write_archive(path, pack_tree(tree))
        except (OSError, ValueError) as error:
            warnings.warn(f"the tree is not cached: cannot write to the folder '{self.folder}' ({error})", stacklevel=2)
        return tree


def as_source(cache: str | Path | TreeSource | None) -> TreeSource | None:
    """The source of trees for a scene: a path is that of a folder.

    Raises:
        TypeError: neither a path nor a source.
        ValueError: the path is that of a file, or below one.
    """
    if cache is None or hasattr(cache, "tree"):
        return cache
    if not isinstance(cache, (str, Path)):
        raise TypeError(f"cache must be the path of a folder, not {type(cache).__name__}")
    folder = Path(cache)
    nearest = next((path for path in (folder, *folder.absolute().parents) if path.exists()), None)
    if nearest is not None and not nearest.is_dir():
        raise ValueError(f"cache must be the path of a folder, and '{nearest}' is a file; choose another path")
    return TreeFolder(folder)


def is_storable(accelerator: Accelerator) -> bool:
    """Whether trees of a description can be stored: not those of influence areas, nor lazy ones."""
    if isinstance(accelerator, descriptions.KdTree):
        return not accelerator.is_lazy
    return isinstance(accelerator, descriptions.Bvh)


def tree_key(vertices: np.ndarray, faces: np.ndarray, accelerator: Accelerator, width: int) -> str:
    """The key of a tree: 64 hexadecimal digits.

    Args:
        vertices: (V, 3) float32, relative to the scene's centre.
        faces: (F, 3) int32.
        accelerator: the description of the tree.
        width: the device's vector width; used if the description leaves it open.
    """
    revision = TREE_REVISION["kdtree" if isinstance(accelerator, descriptions.KdTree) else "bvh"]
    state = hashlib.sha256(f"{FORMAT} {revision} {accelerator!r} {accelerator.config(width)!r}".encode())
    for array in (vertices, faces):
        state.update(f"{array.shape} {array.dtype.str}".encode())
        state.update(np.ascontiguousarray(array))  # type: ignore[arg-type]
    return state.hexdigest()


def find_tree(
    recipe: TreeRecipe,
    boxes: TriangleBoxes,
    placed: PlacedMeshes,
    cache: str | Path | TreeSource | None,
    meshes: MeshBoxes | None = None,
    previous: LazyKdTree | None = None,
) -> tuple[Bvh | KdTree, LazyKdTree | None]:
    """The tree of some triangles, from a source or built; for a lazy tree, the part that exists so far, and the lazy tree.

    meshes, previous: as in `wrt.builders.kdtree.lazy.lazy_kdtree.start`."""
    accelerator, source = recipe.accelerator, as_source(cache)
    if isinstance(accelerator, descriptions.KdTree) and accelerator.is_lazy:
        growing = accelerator.start(boxes, recipe.width, recipe.device, meshes, previous)
        return growing.current.tree, growing

    def build() -> Bvh | KdTree:
        return accelerator.build(boxes, recipe.width)

    if source is None or not is_storable(accelerator):
        return build().to(recipe.device), None
    key = tree_key(placed.vertices.numpy(), placed.faces.numpy(), accelerator, recipe.width)
    return source.tree(key, boxes.count, build).to(recipe.device), None


def stored_fields(cls: type) -> list[str]:
    """Names of the stored fields of a tree: not the costs that updates keep, which can be computed again, nor whether leaves
    share triangles, as in trees for known rays, which are not stored, nor what a refit keeps."""
    return [field.name for field in fields(cls) if field.name not in ("built_costs", "shared", "upward")]


def pack_tree(tree: Bvh | KdTree) -> dict[str, np.ndarray]:
    """The tree's fields as arrays, and its kind."""
    values = {name: getattr(tree, name) for name in stored_fields(type(tree)) if getattr(tree, name) is not None}
    values["kind"] = next(kind for kind, cls in TREES.items() if isinstance(tree, cls))
    values["stats"] = json.dumps(asdict(tree.stats))
    return {name: value.numpy() if isinstance(value, wp.array) else np.array(value) for name, value in values.items()}


def unpack_tree(arrays: Mapping[str, np.ndarray], triangles: int) -> Bvh | KdTree:
    """The tree in these arrays, on the CPU.

    Raises:
        ValueError, KeyError, TypeError, RuntimeError: the arrays are not a tree over this many triangles.
    """
    cls = TREES[str(arrays["kind"])]
    names = [name for name in stored_fields(cls) if name not in OPTIONAL or name in arrays]
    values: dict[str, Any] = {name: np.array(arrays[name]) for name in names}
    values["stats"] = BuildStats(**json.loads(str(values["stats"])))
    values["width"] = int(values["width"])
    for corner in ("low", "high"):
        values[corner] = wp.vec3(*values[corner].astype(np.float32).tolist())
    if "layout" in values:
        values["layout"] = str(values["layout"])
    if "level_first" in values:
        if values["level_first"].dtype.kind != "i" or values["level_first"].ndim != 1:
            raise ValueError(f"level_first holds {values['level_first'].dtype}, and must be a list of integers")
        values["level_first"] = tuple(values["level_first"].tolist())
    if "pairs" in values and values["pairs"].dtype == np.int32:
        from wrt.builders.classics.kdtree.node_layouts import aligned_copy

        values["pairs"] = aligned_copy(values["pairs"])
    for name, dtype in (
        ("nodes", wp.vec2i),
        ("pairs", wp.vec2i),
        ("bounds", wp.float32),
        ("child", wp.int32),
        ("primitive", wp.int32),
    ):
        if name in values:
            wanted = np.float32 if name == "bounds" else np.int32
            shape = (len(values[name]), 2) if dtype is wp.vec2i else (values[name].size,)
            if values[name].dtype != wanted or values[name].shape != shape:
                raise ValueError(
                    f"{name} holds {values[name].shape} of {values[name].dtype}, not {shape} of {np.dtype(wanted)}"
                )
            values[name] = wp.array(values[name], dtype=dtype, device="cpu", copy=False)
    tree = cls(**values)
    check_tree(tree, triangles)
    return tree


def save_scene(scene: SceneState, path: str | Path) -> None:
    """Writes a scene to a file; see `wrt.Scene.save`."""
    scene.require("save")
    scene.require_whole("a file")
    if not is_storable(scene.accelerator):
        kept = "a wrt.Bvh or a wrt.KdTree that is not lazy"
        raise ValueError(
            f"a scene with {scene.accelerator} cannot be saved; make one with {kept}, or pickle it without its tree"
        )
    write_archive(Path(path), scene_arrays(scene))


def scene_arrays(scene: SceneState) -> dict[str, np.ndarray]:
    """The arrays of a scene's file."""
    header: dict[str, Any] = {
        "format": FORMAT,
        "key": "" if scene.instances else key_of(scene),
        "accelerator": asdict(scene.accelerator),
        "triangle_test": scene.triangle_test,
        "names": [mesh.name for mesh in scene.meshes],
        "up": [mesh.up for mesh in scene.meshes],
        "materials": [None] * len(scene.meshes),
    }
    arrays = {}
    for number, mesh in enumerate(scene.meshes):
        arrays |= {f"vertices.{number}": mesh.vertices, f"faces.{number}": mesh.faces}
        if mesh.materials is not None:
            header["materials"][number], own = pack_materials(mesh.materials)
            arrays |= {f"materials.{number}.{name}": array for name, array in own.items()}
    if scene.instances:
        header["keys"] = [key_of(part) for part in scene.parts]
        if scene.graph is not None:
            header["nodes"] = list(scene.graph.names)
            arrays |= {f"nodes.{name}": getattr(scene.graph, name) for name in NODE_FIELDS}
        arrays["geometry"] = np.array(scene.geometry_ids)
        for name in INSTANCE_FIELDS:
            arrays[name] = getattr(scene.instances, f"{name}s")
        for number, part in enumerate(scene.parts):
            arrays |= {f"tree{number}.{name}": array for name, array in pack_tree(part.tree).items()}
    else:
        arrays |= {f"tree.{name}": array for name, array in pack_tree(scene.tree).items()}
    arrays["wrt"] = np.array(json.dumps(header))
    return arrays


Stored = tuple["list[TriangleMesh] | list[Instance]", "Accelerator", str, TreeSource, "NodeGraph | None"]
"""Geometry, accelerator, triangle test, trees and graph of a scene in a file."""


def load_scene(path: str | Path) -> Stored:
    """Reads a scene from a file; see `wrt.Scene.load`."""

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no scene file at '{path}': check the path (now in '{Path.cwd()}')")
    with checked_reading(path, "a scene that wrt saved", "save it again"):
        return parse_scene(read_archive(path))


def parse_scene(arrays: dict[str, np.ndarray]) -> Stored:
    """The scene in the arrays of a file.

    Raises:
        ValueError, TypeError, KeyError, RuntimeError: the arrays are not those of a scene.
    """
    header = json.loads(str(arrays["wrt"]))
    check_format(header["format"], FORMAT)
    names = header["names"]
    ups = header.get("up", [None] * len(names))  # files written before meshes had one
    meshes = [
        TriangleMesh(arrays[f"vertices.{i}"], arrays[f"faces.{i}"], name=name, up=up)
        for i, (name, up) in enumerate(zip(names, ups, strict=True))
    ]
    materials = header.get("materials", [None] * len(names))  # files written before meshes had materials have none
    meshes = [with_stored(mesh, i, listed, arrays) for i, (mesh, listed) in enumerate(zip(meshes, materials, strict=True))]
    if "keys" in header:
        trees = [arrays_below(arrays, f"tree{number}.") for number in range(len(meshes))]
        counts = [mesh.triangle_count for mesh in meshes]
        known: TreeSource = StoredTrees(dict(zip(header["keys"], map(unpack_tree, trees, counts), strict=True)))
        kind, geometry = trees[0]["kind"], list[Any](instances_of(arrays, meshes))
    else:
        tree = arrays_below(arrays, "tree.")
        known = StoredTree(header["key"], unpack_tree(tree, sum(mesh.triangle_count for mesh in meshes)))
        kind, geometry = tree["kind"], meshes
    accelerator = ACCELERATORS[str(kind)](**header["accelerator"])
    graph = graph_of(header["nodes"], arrays, len(geometry)) if "nodes" in header else None
    return geometry, accelerator, header["triangle_test"], known, graph


def graph_of(names: list[str], arrays: Mapping[str, np.ndarray], instances: int) -> NodeGraph:
    """The graph in a file.

    Raises:
        ValueError, KeyError, TypeError: the arrays do not hold a graph of this many instances.
    """
    parents, local, node_of = (arrays[f"nodes.{name}"] for name in NODE_FIELDS)
    count = len(names)
    if parents.shape != (count,) or local.shape != (count, 4, 4) or node_of.shape != (instances,):
        raise ValueError("the graph's arrays do not fit its nodes and instances")
    ends = ((parents, np.arange(count)), (node_of, np.full(instances, count)))
    if any(values.dtype.kind != "i" or (values < NOWHERE).any() or (values >= end).any() for values, end in ends):
        raise ValueError("the graph's numbers of nodes are out of range")
    return NodeGraph(tuple(map(str, names)), parents, local.astype(np.float64), node_of)


def arrays_below(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """The arrays of a file whose names begin with a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def instances_of(arrays: Mapping[str, np.ndarray], meshes: Sequence[TriangleMesh]) -> list[Instance]:
    """The instances in a file, checked as a caller's are.

    Raises:
        ValueError, KeyError, TypeError: the arrays do not hold instances of these meshes.
    """
    numbers = arrays["geometry"]
    if numbers.ndim != 1 or numbers.dtype.kind != "i" or not len(numbers) or set(numbers.tolist()) != set(range(len(meshes))):
        raise ValueError("the instances are not those of its meshes")
    rows = zip(numbers.tolist(), *(arrays[name] for name in INSTANCE_FIELDS), strict=True)
    return [Instance(meshes[at], matrix, mask=mask, environment=number) for at, matrix, mask, number in rows]


def with_stored(mesh: TriangleMesh, number: int, listed: Any, arrays: Mapping[str, np.ndarray]) -> TriangleMesh:
    """A mesh of a file with its materials, if it has any."""
    if listed is None:
        return mesh
    own = arrays_below(arrays, f"materials.{number}.")
    return mesh.with_materials(**unpack_materials(listed, own))


def key_of(scene: SceneState) -> str:
    """The key of a scene's tree."""
    mesh, described = scene.device_mesh, for_device(scene.accelerator, scene.device)
    return tree_key(mesh.vertices.numpy(), mesh.faces.numpy(), described, scene.tree.width)


def pack_scene(scene: SceneState) -> tuple[Any, ...]:
    """What a pickle of a scene holds: geometry, options, mark, its tree, if that is one and is kept, and its graph, if any."""
    options = {
        "accelerator": scene.accelerator,
        "triangle_test": scene.triangle_test,
        "device": str(scene.device),
        "num_threads": scene.num_threads,
    }
    if scene.instances or not is_storable(scene.accelerator):
        return scene.geometry, options, scene.mark, None, getattr(scene, "graph", None)
    return scene.meshes, options, scene.mark, PackedTree(key_of(scene), pack_tree(scene.tree))


@dataclass(frozen=True)
class PackedTree:
    """A tree in a pickle, as arrays."""

    key: str
    arrays: dict[str, np.ndarray]

    def tree(self, key: str, triangles: int, build: Callable[[], Bvh | KdTree]) -> Bvh | KdTree:
        """The tree, if its key matches."""
        return unpack_tree(self.arrays, triangles) if key == self.key else build()
