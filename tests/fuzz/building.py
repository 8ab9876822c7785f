"""Builders, refit and refill on boxes and triangles that passed no check.

The check of boxes is taken away (`open_doors`): what is tried is whether any float leads an index out of an array, which
guard pages tell, or makes a tree that traversals could not walk, which `check_tree` tells. Of triangles as scenes admit them,
every one must be in a leaf.
"""

from __future__ import annotations

import dataclasses
from functools import reduce

import numpy as np
import warp as wp

import wrt
from wrt.accelerators.accelerator import Accelerator
from wrt.builders.kdtree import KDTREE_BUILDERS, LAYOUTS, BuilderCapabilities
from wrt.builders.kdtree.kdtree_config import HIERARCHIES
from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes
from wrt.builders.tree import Bvh, KdTree
from wrt.builders.tree_check import check_tree
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes, triangle_boxes

from . import floats
from .cases import Case, WrongAnswer

MAX_REFERENCES = 4096
"""References that a refilled tree may have."""

KDTREES = tuple(
    {"builder": name, "split_clipping": clips}
    for name, builder in KDTREE_BUILDERS.items()
    for clips in ((False, True) if BuilderCapabilities.CLIPS in builder.capabilities else (False,))
)
BVHS = ({"builder": "binned"}, {"builder": "sweep"}, {"builder": "binned", "reinsertion": 2}, {"builder": "projected"})


def open_doors() -> None:
    """Takes the check of boxes away, in this process."""
    TriangleBoxes.__post_init__ = lambda self: None


def make_case(rng: np.random.Generator) -> Case:
    """A builder with some options, and raw triangles or boxes; what they move to."""
    if rng.random() < 0.45:
        options = dict(
            BVHS[rng.integers(len(BVHS))], width=int(rng.choice([2, 4, 8, 16])), bins=int(rng.choice([2, 7, 16, 32]))
        )
        options["max_leaf_triangles"] = int(rng.choice([1, 4, 63])) if rng.random() < 0.4 else None
    else:
        options = dict(KDTREES[rng.integers(len(KDTREES))], width=int(rng.choice([1, 4, 8, 16])))
        options["axis"] = str(rng.choice(["longest", "round_robin"]))
        options["mailbox"] = bool(rng.random() < 0.2)
        options["termination"] = str(rng.choice(["cost", "automatic", "fixed"], p=[0.6, 0.2, 0.2]))
        options["max_depth"] = int(rng.choice([1, 5, 9])) if rng.random() < 0.3 or options["termination"] == "fixed" else None
        options["least_size"] = float(rng.choice([0.0, 0.1]))
        options |= further_options(rng, options)
    options["widen"] = bool(rng.random() < 0.2)
    points = floats.finite_corners(rng) if rng.random() < 0.3 else floats.corners(rng)
    vertices, faces = floats.shared(rng, points)
    arrays = {"vertices": vertices, "faces": faces}
    if rng.random() < 0.3 and not needs_triangles(options):
        arrays["low"], arrays["high"] = (floats.NUMBERS[rng.integers(len(floats.NUMBERS))](rng, (len(faces), 3)) for _ in "12")
    if rng.random() < 0.15:
        arrays["moved"] = floats.NUMBERS[rng.integers(len(floats.NUMBERS))](rng, vertices.shape)
    if options["builder"] == "projected":
        eye, way = rng.normal(size=3) * 2.0 ** rng.integers(-40, 40), rng.normal(size=3)
        options |= {"eye": eye.tolist(), "way": way.tolist(), "fov": float(rng.choice([1e-3, 40.0, 170.0])), "others": 0.1}
        options["axes"] = str(rng.choice(["facing", "longest", "in_turn", "all"]))
    return Case("meshes", options, arrays)


def further_options(rng: np.random.Generator, options: dict) -> dict:
    """Some of the options that only some builders have, for a kd-tree with the others."""
    able, further = KDTREE_BUILDERS[options["builder"]], {}
    tests = ["none", "leaves"] if options["split_clipping"] is False else ["none"]
    tests += ["nodes"] if BuilderCapabilities.CLIPS in able.capabilities and not options["split_clipping"] else []
    spaces = ["priced", "late"] + (["early", "both"] if BuilderCapabilities.CUTS_EARLY in able.capabilities else [])
    if BuilderCapabilities.ANY_COST in able.capabilities and not options["mailbox"]:
        further["cost_model"] = ["surface_area", "blocking"]
    if BuilderCapabilities.CHOOSES_AXES in able.capabilities:
        further |= {"resamplings": [1, 2, 4], "searched_axes": ["all", "longest", "mixed"]}
    if BuilderCapabilities.CLUSTERS in able.capabilities:
        further["median_levels"] = [0, 1, 3, 12]
    if able.start is None:
        further |= {"cell_tests": tests, "empty_space": spaces, "layout": list(LAYOUTS)}
    else:
        further["hierarchy"] = list(HIERARCHIES)
    return {name: values[rng.integers(len(values))] for name, values in further.items() if rng.random() < 0.4}


def needs_triangles(options: dict) -> bool:
    """Whether a builder reads the triangles, or divides boxes that must not be inside out."""
    reads = options.get("split_clipping") or options.get("cell_tests", "none") != "none"
    return reads or options.get("cost_model") == "blocking" or options["builder"] == "lazy"


def accelerator_of(options: dict) -> Accelerator:
    """What the options describe."""
    options = {name: value for name, value in options.items() if name != "widen"}
    if options["builder"] == "projected":
        eye, way, fov = options.pop("eye"), options.pop("way"), options.pop("fov")
        del options["builder"]
        area = wrt.known_rays.PointInfluenceArea(position=eye, direction=way, fov=(fov, fov), near=0.01, far=100.0)
        return wrt.known_rays.ProjectedBvh(areas=(area,), **options)
    return wrt.Bvh(**options) if "bins" in options else wrt.KdTree(**options)


def run_case(case: Case) -> str:
    """Builds the tree, moves it if there is where to, and checks all that is made."""
    accelerator, arrays = accelerator_of(case.options), case.arrays
    vertices, faces = placed(arrays["vertices"]), wp.array(arrays["faces"], dtype=wp.vec3i, device="cpu")
    boxes = triangle_boxes(vertices, faces)
    if "low" in arrays:
        boxes = raw_boxes(arrays["low"], arrays["high"], vertices, faces)
    of_triangles = "low" not in arrays  # else a lower corner may be above the upper one, and only memory is looked after
    small = bool(np.abs(np.concatenate([boxes.low, boxes.high])).max() <= 2.0**36)
    admitted = of_triangles and small and bool(np.isfinite(arrays["vertices"]).all())
    tree = build(accelerator, boxes)
    if of_triangles or isinstance(tree, Bvh):
        check(tree, len(faces), admitted or isinstance(tree, Bvh))
    if "moved" in arrays:
        measure(tree, accelerator)
        move(tree, placed(arrays["moved"]), faces)
    elif case.options["widen"] and isinstance(tree, KdTree):
        widen(tree, boxes, admitted)
    return "built"


def build(accelerator: Accelerator, boxes: TriangleBoxes) -> Bvh | KdTree:
    """The tree; a lazy one from a hierarchy if it is to have one: ranges of triangles as meshes, one of them in a group of its
    own and the rest below it, and so on; or its own clusters."""
    hierarchy = getattr(accelerator, "hierarchy", "grid")
    if hierarchy == "grid":
        return accelerator.build(boxes, 8)
    meshes = previous = None
    if hierarchy in ("meshes", "groups"):
        first = np.unique(np.linspace(0, boxes.count, 4 if hierarchy == "meshes" else 8).astype(int))
        corners = (boxes.boxes.low.numpy(), np.minimum), (boxes.boxes.high.numpy(), np.maximum)
        nested = reduce(lambda below, number: (below, number), range(1, len(first) - 1), 0)
        low, high = (extreme.reduceat(corner, first[:-1], axis=1).T for corner, extreme in corners)
        meshes = MeshBoxes(first, low, high, nested)
    else:
        previous = accelerator.start(boxes, 8, wp.get_device("cpu"))
    return accelerator.start(boxes, 8, wp.get_device("cpu"), meshes, previous).finish()


def placed(points: np.ndarray) -> wp.array:
    """Points on the CPU, in memory of Warp's own."""
    return wp.array(points, dtype=wp.vec3, device="cpu")


def raw_boxes(low: np.ndarray, high: np.ndarray, vertices: wp.array, faces: wp.array) -> TriangleBoxes:
    """Boxes whose lower corner may be above the upper one."""
    boxes = Boxes()
    boxes.low, boxes.high = (wp.array(np.ascontiguousarray(corner.T), dtype=float, device="cpu") for corner in (low, high))
    return TriangleBoxes(boxes, len(low), low.min(axis=0), high.max(axis=0), vertices=vertices, faces=faces)


def check(tree: Bvh | KdTree, triangles: int, complete: bool) -> None:
    """A tree that can be walked, with every triangle in it."""
    try:
        check_tree(tree, triangles)
    except ValueError as error:
        raise WrongAnswer(f"no tree: {error}") from error
    listed = tree.primitive.numpy()
    if complete and len(np.unique(listed[listed >= 0])) != triangles:
        raise WrongAnswer(f"{triangles - len(np.unique(listed[listed >= 0]))} triangles are in no leaf")


def measure(tree: Bvh | KdTree, accelerator: Accelerator) -> None:
    """Walks the whole tree for its figures."""
    from wrt.builders.bvh.update.node_costs import node_costs
    from wrt.builders.kdtree.kdtree_statistics import unpack

    with np.errstate(all="ignore"):
        if isinstance(tree, Bvh):
            node_costs(tree, accelerator.config(8).cost)
        else:
            unpack(tree)


def move(tree: Bvh | KdTree, vertices: wp.array, faces: wp.array) -> None:
    """The same tree around triangles that are elsewhere."""
    from wrt.builders.bvh.update.bvh_update import refit
    from wrt.builders.kdtree.update.refill import refill

    if isinstance(tree, Bvh):
        check(refit(tree, vertices, faces), len(faces), complete=True)
        return
    boxes = triangle_boxes(vertices, faces)
    shift = np.array([0.0, 1.0, np.float64(boxes.low[0])])
    with np.errstate(all="ignore"):
        moved = refill(tree, boxes, shift, MAX_REFERENCES)
    if moved is not None:
        check(moved, len(faces), complete=False)


def widen(tree: KdTree, boxes: TriangleBoxes, complete: bool) -> None:
    """The tree in nodes of eight children."""
    from wrt.builders.convert.wide_kdtree import to_wide_bvh

    form = to_wide_bvh(tree, boxes, wrt.Bvh(width=8).config(8))
    check(dataclasses.replace(form), boxes.count, complete)
