"""Trees of every builder, node for node."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

from support.meshes import STORED

import wrt
from wrt.builders import tree as trees
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities

from .digests import digest
from .hit_bits import SCENE_NAMES


def builds(mesh: wrt.TriangleMesh) -> Iterator[tuple[str, wrt.KdTree | wrt.Bvh | wrt.known_rays.ProjectedBvh]]:
    """A name and a description for every builder, with and without what it can do beside."""
    for name, builder in KDTREE_BUILDERS.items():
        yield f"kdtree {name}", wrt.KdTree(builder=name)
        if BuilderCapabilities.CLIPS in builder.capabilities:
            yield f"kdtree {name} clipped", wrt.KdTree(builder=name, split_clipping=True)
    for name in BVH_BUILDERS:
        yield f"bvh {name}", wrt.Bvh(builder=name)
    yield "kdtree binned median levels", wrt.KdTree(builder="binned", median_levels=2)
    yield "kdtree sweep empty space", wrt.KdTree(builder="sweep", empty_space="early")
    yield "bvh binned reinsertion", wrt.Bvh(reinsertion=2)
    yield "bvh binned subset", wrt.Bvh(subset=0.25)
    low, high = mesh.bounds
    area = wrt.known_rays.PointInfluenceArea(
        position=2.0 * high - low, direction=low - high, fov=(40.0, 30.0), near=0.1, far=math.inf
    )
    for name, options in {"pah": {}, "facing": {"axes": "facing"}, "spatial": {"spatial_splits": 0.5}}.items():
        yield f"bvh projected {name}", wrt.known_rays.ProjectedBvh(areas=(area,), **options)


def tree_hash(tree: trees.KdTree | trees.Bvh) -> str:
    """Hash of the nodes and the lists of triangles."""
    arrays = (tree.nodes,) if isinstance(tree, trees.KdTree) else (tree.bounds, tree.child)
    return digest(*arrays, tree.primitive)


def tree_hashes(
    scenes: Collection[str] = SCENE_NAMES, threads: Collection[int] = (1, 2, 5), names: Collection[str] | None = None
) -> Iterator[tuple[str, str, str]]:
    """(case, number of threads, hash) for every build, or for those of some names."""
    for scene_name in scenes:
        mesh = STORED[scene_name]()
        for name, description in builds(mesh):
            if names is not None and name not in names:
                continue
            for count in threads:
                scene = wrt.Scene(mesh, description, device="cpu", num_threads=count)
                scene.state.complete()
                yield f"{scene_name} {name}", f"{count} threads", tree_hash(scene.tree)
