"""A scene: meshes, a tree over their triangles, and the queries that it answers."""

from __future__ import annotations

import warnings
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import Accelerator, AcceleratorName
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.engine.facts.scene_state import SceneState
from wrt.instances.members import Members
from wrt.kernels.runtime.launch import check_num_threads, refuse_capture, use_threads
from wrt.meshes.instance import Instance, has_instances
from wrt.meshes.mesh import TriangleMesh
from wrt.query.api import Queries
from wrt.scene.instanced_state import build_instanced_state
from wrt.scene.mesh_state import state_of_meshes
from wrt.scene.updates import UpdatePolicy, When, as_policy

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from wrt.array_types import ArrayLike, Indices
    from wrt.builders import tree as common
    from wrt.meshes.instance import Geometry
    from wrt.scene.scene_statistics import SceneStatistics
    from wrt.scene.storage import TreeSource
    from wrt.scene.updates import UpdateReport


ANALYSES = (
    "ambient_occlusion bake clearance closest_pair distance_grid exposure overlapping_triangles sample_surface shape_diameter "
    "sign_rule signed_distance thickness viewshed visible_faces winding_number"
)
"""Functions of `wrt.analysis` that take a scene, where some look for methods."""

MOVED_TO_STATE = frozenset(
    {
        "area_trees",
        "complete",
        "depth",
        "device_mesh",
        "exact_vertices",
        "lazy_tree",
        "parts",
        "record_bytes",
        "width",
    }
)
"""Members that scenes had; old code finds them through `Scene.__getattr__`."""


class Scene(Queries, Members):
    """Triangle meshes in a tree, against which rays are traced.

    The tree is built at once, or where rays visit it (`wrt.KdTree(builder="lazy")`). Several threads may use a scene at the
    same time. `update` changes it in one step at its end, or not at all: a query that runs meanwhile sees the scene as it was
    before. Earlier results keep the geometry for which they were computed.

    Args:
        geometry: a `TriangleMesh`, a trimesh.Trimesh or trimesh.Scene, a `wrt.Instance`, or a sequence of such. Each mesh of a
            sequence is a geometry of its own (`Hits.geometry_id`), in one tree with the others. With an instance or a
            trimesh.Scene in it, the scene has two levels (`wrt.moving.InstancedScene`): each node of the graph that holds
            triangles is an instance, and `move` moves nodes by name.
        accelerator: "auto", "bvh", "kdtree", or a description such as `wrt.KdTree(builder="in_place")`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`: the test of queries that name no
            other. Only the default one counts crossings exactly; `count`, `intersect_all` and `contains` always use it.
        device: a Warp device or its name, such as "cpu" or "cuda:0"; None for Warp's default device.
        num_threads: threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`.
        cache: path of a folder that stores trees by a hash of all that they depend on. A tree that is not there is built and
            written there. A folder may hold the trees of any number of scenes. None: no file is read or written.

    Raises:
        TypeError: `geometry`, `accelerator`, `num_threads` or `cache` has a wrong type.
        ValueError: unknown names, no such device, an empty sequence, one that contains itself, a `cache` that is a file;
            triangles that spread over more than 6.9e10 (`wrt.meshes.placement.MAX_EXTENT`) or lie beyond 1.3e36, which float32
            cannot hold.
        MemoryError: there is too little memory for the tree.
        OSError: the folder of `cache` cannot be made. (A tree that cannot be written there is a warning.)
    """

    state: SceneState
    """What queries read: the tree and the triangles on the device. An update replaces it. For code inside wrt; names of its
    members may change between releases."""

    def __init__(
        self,
        geometry: Geometry,
        accelerator: AcceleratorName | Accelerator = AUTO,
        *,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
        cache: str | Path | TreeSource | None = None,
    ) -> None:
        settings = as_settings(accelerator, triangle_test, device, num_threads)
        with use_threads(settings.num_threads):
            if has_instances(geometry):
                self.state = build_instanced_state(geometry, settings, cache)
            else:
                self.state = state_of_meshes(geometry, settings, cache)

    def update(
        self,
        index: Indices | Mapping[int, ArrayLike],
        *,
        vertices: ArrayLike | None = None,
        transform: ArrayLike | None = None,
        mask: int | None = None,
        environment: int | None = None,
        rebuild: When | UpdatePolicy = "auto",
    ) -> None:
        """Moves the vertices of a mesh, whose triangles stay the same, or moves instances.

            scene.update(0, vertices=points)                    # mesh 0
            scene.update({1: points, 4: others})                # meshes 1 and 4, in one step
            forest.update(3, transform=matrix)                  # of a scene of instances: instance 3
            forest.update(range(100), transform=matrices)       # many at once, which takes a few microseconds each
            forest.update(3, vertices=points)                   # the mesh of instance 3, in all its instances

        The tree keeps its nodes, which is faster than a build: a BVH is refitted, the leaves of a kd-tree are filled again. The
        further triangles move, the slower queries become. So the tree is rebuilt, in parts or as a whole, once its cost is too
        high (`wrt.moving.UpdatePolicy`); `last_update` reports what was done. Trees that are lazy, that clip triangles or that
        are made for influence areas are always rebuilt; trees that CUDA builds are, unless `rebuild` is "never".

        Args:
            index: index of the mesh (`Hits.geometry_id`), or a mapping from such indices to their vertices; in a scene of
                instances, index of the instance, or several indices for `transform`, `mask` and `environment`.
            vertices: (V, 3), as many as the mesh has; for an instance, in the mesh's own space. float32 on the scene's CUDA
                device stays there if the scene has one mesh in a `wrt.Bvh` with the defaults for CUDA: with "never" the tree is
                refitted there, with "auto" built there by "hploc". With "always" it stays if "hploc" is the tree's builder.
            transform: transform of the instance, (4, 4), or (N, 4, 4) for N instances, as in `wrt.Instance`, also without the
                last row, (3, 4) or (N, 3, 4); or a Warp array of such matrices or numbers, or of (N,) `wp.transform`.
            mask, environment: of the instance, or of all instances in `index`.
            rebuild: for `vertices`: "auto", "always", "never", or a `wrt.moving.UpdatePolicy`.

        Raises:
            TypeError: a value has a wrong type, or no value was given; a mapping that is empty, or `vertices` beside one.
            ValueError: no such mesh or instance, a mapping in a scene of instances, a wrong number of vertices, vertices that
                are NaN or infinite, triangles that spread too far (as for the class), a transform or a mask in a scene
                without instances, one that `wrt.Instance` refuses, or an unknown name. The scene is then unchanged.
        """
        if transform is None or self.device.is_cpu:  # those on a CUDA device can be part of a graph
            refuse_capture("an update", self.device)
        self.state = self.state.updated(index, vertices, transform, mask, as_policy(rebuild), environment)

    def updating(self, *args: Any, threads: int = 1, **options: Any) -> AbstractContextManager[None]:
        """Updates the scene in the background while the `with` block queries its previous version.

            with scene.updating(0, vertices=next_frame):
                image = wrt.render(scene, camera)  # the present frame
            # the scene now holds the next frame

        Args:
            args, options: as in `update`.
            threads: number of CPU threads for the update. Queries of this scene use the others meanwhile, but at least one.

        Raises:
            TypeError, ValueError: as `update`, at the end of the block. The scene is then unchanged.
        """
        from wrt.scene.background_update import updating

        return updating(self, threads, args, options)

    def save(self, path: str | Path) -> None:
        """Writes the meshes, the instances, the trees and their description to a file that `load` reads.

        The file is an .npz archive of plain arrays, whatever its name. An existing file is replaced only once the new one
        is complete; if `path` is a symbolic link, the file that it points to is replaced.

        Materials are written with the meshes, those that emit light, too. Cameras and lights (`wrt.lights`) are arguments of
        pictures and not in a scene: `wrt.lights.save_lights` writes lights to a file of their own.

        Raises:
            OSError: the file cannot be written.
            ValueError: the tree is lazy or has influence areas, which cannot be saved; or `path` is a device, a pipe or a
                folder.
        """
        from wrt.scene.storage import save_scene

        save_scene(self.state, path)

    @classmethod
    def load(cls, path: str | Path, *, device: str | wp.Device | None = None, num_threads: int | None = None) -> Scene:
        """Reads a saved scene. Its answers are bit for bit those of the scene that was saved.

        The tree is rebuilt if this machine would build another one: if the file is of a version of wrt with other builders
        (`wrt.revisions`), or if the device has vectors of another width. Nothing in a file is executed, and no file makes a
        kernel access memory outside its arrays. A checksum over all arrays detects damage. It is not a signature: where
        answers matter, load only files that you trust.

        Args:
            path: path of the file.
            device, num_threads: as in the constructor.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is not a scene that wrt saved, or it is damaged; no such device.
        """
        from wrt.scene.storage import load_scene

        meshes, accelerator, triangle_test, known, graph = load_scene(path)
        scene = cls(meshes, accelerator, triangle_test=triangle_test, device=device, num_threads=num_threads, cache=known)
        if graph is not None:
            scene.state = replace(scene.state, graph=graph)  # type: ignore[call-arg]
        return scene

    @property
    def accelerator(self) -> Accelerator:
        """The description of the tree."""
        return self.state.accelerator

    @property
    def triangle_test(self) -> str:
        """The triangle test of queries that name no other; "auto" or a name."""
        return self.state.triangle_test

    @property
    def device(self) -> wp.Device:
        """The device that holds the scene."""
        return self.state.device

    @property
    def num_threads(self) -> int | None:
        """Threads for the build and for queries on the CPU; None for `wrt.get_num_threads()`."""
        return self.state.num_threads

    @num_threads.setter
    def num_threads(self, count: int | None) -> None:
        self.state = self.state.with_threads(None if count is None else check_num_threads(count, "num_threads"))

    @property
    def meshes(self) -> tuple[TriangleMesh, ...]:
        """The meshes in the order of their geometry ids; those of instances once each, in order of first use."""
        return self.state.meshes

    @property
    def instances(self) -> tuple[Instance, ...]:
        """The instances of a scene of two levels, in the order of instance ids; empty in a scene of meshes."""
        return self.state.instances[:]

    @property
    def geometry_ids(self) -> tuple[int, ...]:
        """Index of the mesh of each instance; empty in a scene of meshes."""
        return getattr(self.state, "geometry_ids", ())

    @property
    def center(self) -> np.ndarray:
        """(3,) float64; the device holds geometry in float32, relative to this point."""
        return self.state.center

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the bounding box of all triangles."""
        return self.state.bounds

    @property
    def tree(self) -> common.KdTree | common.Bvh:
        """The tree; if it is built lazily, the part that exists so far; in a scene of instances, the upper tree."""
        return self.state.tree

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all meshes, or of all instances together."""
        return self.state.triangle_count

    @property
    def is_closed(self) -> bool:
        """Whether every mesh is closed."""
        return self.state.is_closed

    @property
    def last_update(self) -> UpdateReport | None:
        """What the last update did to the tree; None without an update, or if trees of this kind are always rebuilt."""
        return self.state.last_update

    @property
    def bytes(self) -> int:
        """Memory of trees, triangles, maps of instances, and of the triangle records made so far."""
        return self.state.bytes

    if not TYPE_CHECKING:  # type checkers refuse names that are not there

        def __getattr__(self, name: str) -> Any:
            """Members that are now those of `state`; each use warns."""
            if name not in MOVED_TO_STATE:
                where = f"; it is wrt.analysis.{name}(scene, ...)" if name in ANALYSES.split() else ""
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}{where}", name=name, obj=self)
            warnings.warn(
                f"wrt.Scene.{name} is now scene.state.{name}; the old name goes with the next release",
                DeprecationWarning,
                stacklevel=2,
            )
            return getattr(self.state, name)

    def __repr__(self) -> str:
        return f"Scene({self.state.contents()}, {self.accelerator}, device={str(self.device)!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles include the tree."""
        from wrt.scene.storage import pack_scene

        self.state.require("pickle")
        if self.state.hit_filter is not None:
            from wrt.scene.filtered_scene import given_filter

            return unpickle_filtered, (self.filtered(), *given_filter(self.state))
        return unpickle_scene, pack_scene(self.state)

    def __copy__(self) -> Scene:
        """Another scene with the same state: updates of one do not change the other."""
        other = object.__new__(type(self))
        other.__dict__ |= self.__dict__
        return other

    def filtered(self, *, ignore: ArrayLike | Mapping[int, ArrayLike] | None = None, alpha: bool = False) -> Scene:
        """A scene of the same tree whose rays pass through chosen triangles, or through the holes of alpha masks.

            glassless = scene.filtered(ignore=is_glass)       # (T,) bool
            seen = scene.filtered(alpha=True).intersect(origins, directions)

        Answers are those of brute force over what is left, to the bit: nothing starts again behind a hit. Numbers of
        triangles and the scene's bounds stay. Triangles that are left out cost nothing a ray, whatever the traversal; with
        alpha masks, rays go one by one (`explain`). Updates of the new scene keep its filter; those of this one do not
        reach it. Nearest points are those of what is left, too; with alpha masks they are refused. Questions about the
        whole surface (`contains`, `verify`, `save`) are refused.

        Args:
            ignore: (T,) bool, NumPy, a list, or Warp on any device: the triangles of the mesh that rays do not see, in all its
                instances. For some of several meshes, a mapping from their index (`meshes`) to such arrays. None: none.
            alpha: whether a triangle is hit only where the alpha of its material is at least `Material.alpha_cutoff`.

        Returns:
            A new `Scene`; without arguments, one whose rays see everything. A filter that this scene has does not count.

        Raises:
            TypeError: `ignore` holds no bools, or `alpha` is no bool.
            ValueError: wrong lengths, no such mesh, or an array in a scene of several; a scene with influence areas, or a
                `wrt.moving.FuzzyScene`.
        """
        from wrt.scene.filtered_scene import filtered

        return scene_of_state(filtered(self.state, ignore, alpha))

    def flattened(self) -> TriangleMesh:
        """All meshes as one, with triangles in the order in which the scene numbers them.

        A scene of instances gives float64 vertices, instance after instance, and needs the memory of all of them.
        """
        return self.state.flattened()

    def statistics(self) -> SceneStatistics:
        """Counts, histograms, costs and times of the mesh, the tree and its build.

        Raises:
            ValueError: the scene has many trees.
        """
        from wrt.scene.scene_statistics import scene_statistics

        return scene_statistics(self.state)

    def handle(self, *, mask: int | None = None, environment: int | None = None) -> Any:
        """The scene for your own kernels, as the functions of `wrt.device` take it.

        A struct that refers to the scene's arrays and keeps them alive. Making it takes about 0.1 ms.

        Args:
            mask, environment: in a scene of instances, which of them rays see, as in `intersect`; `wrt.device.seeing` chooses
                ray by ray.

        Raises:
            TypeError, ValueError: a mask or an environment in a scene without instances, of a wrong type, or out of range; a
                scene of influence areas or of fuzzy boxes.
        """
        from wrt.device import handle_of

        return handle_of(self.state, mask, environment)


def scene_of_state(state: SceneState) -> Scene:
    """A scene with the state of another scene, or with a part of one (`SceneState.parts`)."""
    scene = object.__new__(Scene)
    scene.state = state
    return scene


def unpickle_scene(geometry: Any, options: dict[str, Any], mark: str, cache: Any, graph: Any = None) -> Scene:
    """The scene of a pickle; `cache` knows its tree, if that was kept; graph: of a scene of instances."""
    scene = Scene(geometry, **options, cache=cache)
    scene.state = replace(scene.state, mark=mark, **({} if graph is None else {"graph": graph}))
    return scene


def unpickle_filtered(scene: Scene, ignore: Any, alpha: bool) -> Scene:
    """The filtered scene of a pickle."""
    return scene.filtered(ignore=ignore, alpha=alpha)
