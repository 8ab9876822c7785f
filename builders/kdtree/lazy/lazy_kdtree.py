"""Lazy build of an SAH kd-tree: only the parts that rays reach are built (Hunt, Mark and Fussell 2007).

**Problem.** A frame sees a small part of a large scene. A build that sorts or even scans everything at every level takes longer
than tracing the rays.

**Algorithm.** A scanning build can build a part of a tree without reading the rest. It need not start from triangles: the nodes
of an existing hierarchy can represent them: the meshes of the scene, or the clusters of the previous frame (`given_clusters`,
`KdTreeConfig.hierarchy`), or groups of groups of meshes, which are opened one after the other (`scene_groups`). Without one the
presort is a grid (`triangle_clusters`), two passes over the triangles.
The binned builder (`binned`) builds the top of the tree from the clusters' boxes. It ends in *cells*: leaves with a list of
clusters, which are not built yet. When rays request cells, their triangles are found among those of their clusters
(`cell_lists`). The subtrees of all requested cells are built in one batch on all threads (`core.subtrees`), and inserted into
the tree (`kdtree_grafting`). A cell of many triangles is itself sorted into clusters and divided into cells, like the root. So
a small detailed object in a large scene is one cell until a ray reaches it.

**Data.** The skeleton holds the planes above the cells, and a leaf for each cell; it tells which cells are not built
(`wrt.kernels.traversal.single.lazy_requests`). The tree that is traced has the same planes and the subtrees built so far. Cells
that are not built are empty leaves, so that every traversal works unchanged.

**Complexity.** O(N) for the presort, once; with the meshes of a scene, O(meshes log meshes); with groups, O(nodes), for their
boxes. Then O(v log v) for v triangles in cells that are reached. The boxes of all triangles, a pass of their own, are an input
of every builder.

**What we changed.** The paper's tracer stops at a node that is not built, builds it and resumes. Warp kernels cannot stop. Here
rays are traced through the parts that are built, and record the cells that they reach before their hit. When these cells have
been built, the rays that recorded any are traced again, until there are none (`wrt.engine.launch.lazy_tracing`). A snapshot is
replaced, never modified, so several threads may trace while one of them builds.

**Limits.** A cell is built as a whole. As long as any cell is not built, rays pay for recording cells
(notebooks/records/2026-11-21-kdtree-builders.md). Planes above the cells are chosen without a count of triangles, so
`leaf_triangles` holds only below them.

References: hunt-2007; rahikainen-2013 (section 4.2).
"""

import threading
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from wrt.builders.core.subtrees import build_tasks, make_build_subtrees
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.kdtree import binned
from wrt.builders.kdtree.kdtree_config import GROUPS, MESHES, PREVIOUS, KdTreeConfig
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.builders.kdtree.lazy.cell_lists import Pair, as_roots, list_references, list_triangles
from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes, mesh_clusters, moved_clusters
from wrt.builders.kdtree.lazy.kdtree_grafting import EMPTY, close_finished, insert_gaps, joined, move_nodes, unbuilt_leaves
from wrt.builders.kdtree.lazy.scene_groups import OPENED, SceneGroups
from wrt.builders.kdtree.lazy.triangle_clusters import Clusters, count_cells, leaves_of, sort_into_clusters
from wrt.builders.kdtree.phases.assembly import copy_subtrees
from wrt.builders.kdtree.scan.exact_planes import values_for
from wrt.builders.kdtree.scan.reference_levels import LevelRules
from wrt.builders.kdtree.scan.scanning import Scan, make_tasks
from wrt.builders.tree import MAX_GROWTH, KdTree, Phases, StopLimits, StopRules
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import KdNodes
from wrt.kernels.runtime.launch import launch, load

LARGE = 1 << 13
"""Triangles of a cell above which it is divided into cells. The subtree of a smaller one is built at once."""

MAX_DUPLICATION = 16.0
"""A cell is not divided if its cells would have more than this many times its triangles in total."""

MESH_DUPLICATION = 4.0
"""`MAX_DUPLICATION` of a scene that is divided by the boxes of its meshes: where these overlap much, a sort finds better
planes."""

CELL_SPARE_MEMORY = 3.0
"""Working memory of a cell relative to its own lists; doubled whenever it is too small."""

CLUSTERS = 8
"""Clusters of a cell that cost CLUSTER_COST together, like a block of triangles. Fewer clusters per cell build fewer triangles
that no ray reaches; more of them leave more planes to a search that sees triangles."""

CLUSTER_COST = 1.0
"""Cost of CLUSTERS clusters, relative to the cost of visiting an inner node."""

MESH_COST = 4.0
"""Cost of a mesh that is a cluster, likewise: high enough that meshes apart from each other get cells of their own, low enough
that meshes are seldom cut."""

CELL = np.dtype(
    [
        ("low", np.float32, 3),
        ("high", np.float32, 3),
        ("depth", np.int32),
        ("growth", np.float32),
        ("clusters", np.int32),
        ("clusters_first", np.int32),
        ("node", np.int32),
        ("leaf", np.int32),
        ("unbuilt", np.bool_),
    ]
)
"""A cell: its box; its depth; the growth of references on its path (`PathState.growth`); the number of its clusters and their
start in the list of all cells' clusters; its indices in the tree and in the skeleton."""


@dataclass(frozen=True)
class Snapshot:
    """The current tree and the cells that are not built.

    Attributes:
        tree: the parts that are built; cells that are not built are empty leaves.
        skeleton: (nodes,) vec2i, the planes above the cells. A leaf with triangles is not built; its first block is the cell's
            number.
        cells: number of cells so far.
        unbuilt: number of cells that are not built.
    """

    tree: KdTree
    skeleton: wp.array
    cells: int
    unbuilt: int

    def struct(self) -> KdNodes:
        """The skeleton for a kernel."""
        nodes = KdNodes()
        nodes.nodes, nodes.low, nodes.high = self.skeleton, self.tree.low, self.tree.high
        return nodes


class LazyKdTree:
    """A tree that is built on demand. Several threads may use it; one at a time builds.

    Args:
        triangles: boxes of the triangles, on the CPU.
        config: cost model and stop rules.
        device: device on which the tree is traced.
        given: clusters of all triangles; None if they are to be sorted.
        groups: the nodes of the scene, from which cells are divided first; None if there are none.
    """

    def __init__(
        self,
        triangles: TriangleBoxes,
        config: KdTreeConfig,
        device: wp.Device,
        given: Clusters | None = None,
        groups: SceneGroups | None = None,
    ) -> None:
        self.presort = given
        """The clusters of the root, if it is divided."""
        self.groups = groups
        self.opened: set[int] = set()
        """The groups that were opened."""
        self.sorted_triangles = 0
        """Length of all sorts together."""
        self.triangles, self.config, self.device = triangles, config, device
        self.build_device = triangles.boxes.low.device
        self.phase = Phases(self.build_device)
        self.lock = threading.Lock()
        self.limits: StopLimits = config.stop.limits(triangles.count, triangles.size)
        self.order = wp.array(np.arange(triangles.count, dtype=np.int32), dtype=int, device=self.build_device)
        """Triangle ids, cluster after cluster."""
        self.clusters = np.zeros((0, 2), dtype=np.int64)
        """Start and end of each cluster in `order`."""
        self.nodes_of = np.zeros(0, dtype=np.int64)
        """Node of the scene that each cluster is; -1 for none."""
        self.listed = np.zeros(0, dtype=np.int64)
        """Clusters of the cells, cell after cell."""
        self.cells = np.zeros(1, dtype=CELL)
        self.cells["low"], self.cells["high"], self.cells["unbuilt"] = triangles.low, triangles.high, True
        self.nodes = wp.array([EMPTY], dtype=wp.vec2i, device=self.build_device)
        self.skeleton = wp.array(unbuilt_leaves(np.zeros(1, dtype=int)), dtype=wp.vec2i, device=self.build_device)
        self.primitive = wp.empty(0, dtype=int, device=self.build_device)
        self.current = self._snapshot()
        """The current snapshot: replaced, never modified."""
        if triangles.count > LARGE:
            self.build_cells(np.zeros(1, dtype=int))

    def build_cells(self, numbers: np.ndarray) -> None:
        """Builds cells, or divides large ones into cells. Cells that are already built are not changed."""
        with self.lock:
            numbers = numbers[self.cells["unbuilt"][numbers]]
            if len(numbers) == 0:
                return
            if self.groups is not None:
                with self.phase("groups"):
                    numbers = numbers[[not self._divide_by_groups(number) for number in numbers]]
            if len(numbers):
                self._build_triangles(numbers)
            launch(close_finished, 1, [self.skeleton], device=self.build_device)
            self.current = self._snapshot()

    def _build_triangles(self, numbers: np.ndarray) -> None:
        """Builds cells from their triangles, or divides large ones by these."""
        with self.phase("lists"):
            ids, first, sizes = self._list_triangles(numbers)
        small = sizes <= max(LARGE, self.config.stop.leaf_triangles)
        for i in np.flatnonzero(~small):
            with self.phase("top levels"):
                small[i] = not self._divide(numbers[i], ids[int(first[i]) : int(first[i] + sizes[i])])
        if small.any():
            with self.phase("subtrees"):
                self._build(numbers[small], ids, first[small], sizes[small])

    def finish(self) -> KdTree:
        """Builds all remaining cells, and returns the whole tree."""
        while self.current.unbuilt:
            self.build_cells(np.flatnonzero(self.cells["unbuilt"]))
        return self.current.tree

    def _snapshot(self) -> Snapshot:
        boxes = self.triangles.boxes
        self.phase.stats.reserve(boxes.low, boxes.high, self.order, self.nodes, self.skeleton, self.primitive)
        low, high = wp.vec3(*self.triangles.low), wp.vec3(*self.triangles.high)
        tree = KdTree(self.nodes, self.primitive, low, high, self.config.cost.width, self.phase.stats)
        unbuilt = int(self.cells["unbuilt"].sum())
        return Snapshot(tree.to(self.device), self.skeleton.to(self.device), len(self.cells), unbuilt)

    def _list_triangles(self, numbers: np.ndarray) -> tuple[wp.array, np.ndarray, np.ndarray]:
        """The triangles of cells: (ids, start of each cell's ids, number of each cell's ids)."""
        if numbers[0] == 0:  # the root, which is then the only cell
            return self.order, np.zeros(1, dtype=int), np.array([self.triangles.count])
        cells = self.cells[numbers]
        owner = np.repeat(np.arange(len(cells)), cells["clusters"])
        before = np.cumsum(cells["clusters"]) - cells["clusters"]
        cluster = self.listed[np.arange(len(owner)) + (cells["clusters_first"] - before)[owner]]
        pairs = np.zeros(len(owner), dtype=Pair.numpy_dtype())
        pairs["low"], pairs["high"] = cells["low"][owner], cells["high"][owner]
        at_end = pairs["high"] == self.triangles.high
        pairs["planar_end"] = np.where(at_end, np.float32(np.inf), pairs["high"])
        pairs["begin"], pairs["end"] = self.clusters[cluster].T
        ids, found = list_triangles(self.triangles.boxes, self.order, pairs)
        sizes = np.bincount(owner, found, len(cells)).astype(np.int64)
        return ids, np.cumsum(sizes) - sizes, sizes

    def _divide_by_groups(self, number: int) -> bool:
        """Divides a cell by the members of its groups; False if it holds few triangles, or if these do not divide it."""
        groups, cell = self.groups, self.cells[number].copy()
        listed = self.listed[cell["clusters_first"] :][: cell["clusters"]]
        nodes = self.nodes_of[listed] if number else np.array([groups.root])
        if len(nodes) and nodes[0] < 0:
            return False
        few, clusters = max(LARGE, self.config.stop.leaf_triangles), None
        while groups.count(nodes) > few and nodes[-1] >= groups.meshes:  # meshes come first
            nodes, opened = groups.opened(nodes, cell["low"], cell["high"], max(OPENED, 2 * len(nodes)))
            self.opened.update(opened)
            clusters = groups.clusters(nodes, cell["low"], cell["high"])
            if len(nodes) and self._divide_by(number, clusters, MESH_DUPLICATION):
                return True
        if number and clusters is not None:
            self.cells["clusters"][number], self.cells["clusters_first"][number] = len(nodes), len(self.listed)
            self._list_clusters(np.arange(len(nodes)), clusters, 0)
        return False

    def _divide(self, number: int, ids: wp.array) -> bool:
        """Divides a cell into cells, the root by the given clusters if these suit; False if it cannot be divided."""
        given = self.presort if number == 0 else None
        if given is not None and self._divide_by(number, given, MESH_DUPLICATION if given.are_meshes else MAX_DUPLICATION):
            return True
        parent = self.cells[number]
        clusters = sort_into_clusters(self.triangles.boxes, ids, parent["low"], parent["high"])
        self.sorted_triangles += len(ids)
        divided = self._divide_by(number, clusters, MAX_DUPLICATION)
        if number == 0:
            self.presort = clusters if divided else None
        return divided

    def _divide_by(self, number: int, clusters: Clusters, max_duplication: float) -> bool:
        """Divides a cell into cells by its clusters; False if no plane does, or if too many triangles straddle the planes:
        most is the largest number of triangles in the cells, relative to those of the divided cell."""
        parent = self.cells[number]
        min_size, size = self.config.stop.least_size * self.triangles.size, float((parent["high"] - parent["low"]).max())
        if not size > min_size or not min_size / size < 1.0:  # NaN is not divided either
            return False
        top = self._build_top(parent, clusters, min_size / size)
        flat = unpack(top)
        leaf, listed = leaves_of(clusters, top.nodes)
        sizes = clusters.sizes
        duplication = sizes[listed].sum() / sizes.sum()
        if len(flat.axis) == 1 or duplication > max_duplication:
            return False
        leaves, begins, numbers = np.unique(leaf, return_index=True, return_counts=True)
        cells = np.zeros(len(leaves), dtype=CELL)
        cells["low"], cells["high"] = flat.low[leaves], flat.high[leaves]
        cells["depth"] = parent["depth"] + flat.depth[leaves]
        cells["growth"] = min((1.0 + parent["growth"]) * duplication, float(MAX_GROWTH)) - 1.0
        cells["clusters"] = numbers
        cells["clusters_first"] = len(self.listed) + begins
        cells["unbuilt"] = True
        planes = top.nodes.numpy().copy()
        planes[flat.is_leaf] = EMPTY
        cells["node"] = leaves + self._graft("node", number, planes)
        planes[leaves] = unbuilt_leaves(len(self.cells) + np.arange(len(leaves)))
        cells["leaf"] = leaves + self._graft("leaf", number, planes)
        self.cells = np.concatenate([self.cells, cells])
        self._list_clusters(listed, clusters, len(self.order) if number and clusters.order is not None else 0)
        if clusters.order is not None:
            self.order = joined(self.order, clusters.order) if number else clusters.order
        self.cells["unbuilt"][number] = False
        return True

    def _list_clusters(self, listed: np.ndarray, clusters: Clusters, base: int) -> None:
        """Adds clusters, whose order will begin at `base` in that of the tree, and their numbers in cells."""
        self.listed = np.concatenate([self.listed, listed + len(self.clusters)])
        self.clusters = np.concatenate([self.clusters, clusters.bounds + base])
        nodes = np.full(len(clusters.low), -1) if clusters.nodes is None else clusters.nodes
        self.nodes_of = np.concatenate([self.nodes_of, nodes])

    def _build_top(self, parent: np.void, clusters: Clusters, least_size: float) -> KdTree:
        """The tree of a cell's clusters. least_size: `StopRules.least_size`, relative to the cell."""
        boxes, corners = Boxes(), (clusters.core_low.T, clusters.core_high.T)
        boxes.low, boxes.high = (wp.array(np.ascontiguousarray(c), dtype=float, device=self.build_device) for c in corners)
        cost = self.config.cost
        depth = min(StopRules().limits(len(clusters.low)).depth, self.limits.depth - int(parent["depth"]))
        block, width = (MESH_COST, 1) if clusters.are_meshes else (CLUSTER_COST, CLUSTERS)
        config = KdTreeConfig(
            SurfaceAreaCost(1.0, block, width=width, empty_factor=cost.empty_factor),
            StopRules(max_depth=depth, bad_splits=0, least_size=least_size),
        )
        return binned.build(TriangleBoxes(boxes, len(clusters.low), parent["low"], parent["high"]), config)

    def _graft(self, name: str, number: int, part: np.ndarray) -> int:
        """Replaces a cell by a part, in the tree ("node") or in the skeleton ("leaf"); returns the part's first index."""
        enlarged, (base,) = self._insert_gaps(name, np.array([number]), np.array([len(part)]))
        right = np.where(part[:, 1] & 3 == kdtree.LEAF, 0, base << 2)
        enlarged.numpy()[base : base + len(part)] = part + np.stack([np.zeros_like(right), right], axis=1)
        return base

    def _insert_gaps(self, name: str, numbers: np.ndarray, sizes: np.ndarray) -> tuple[wp.array, np.ndarray]:
        """Makes room for parts that replace cells; returns the enlarged array and the first index of each part."""
        field = {"node": "nodes", "leaf": "skeleton"}[name]
        enlarged, shift = insert_gaps(getattr(self, field), self.cells[name][numbers], sizes)
        self.cells[name] += shift[self.cells[name]]
        setattr(self, field, enlarged)
        return enlarged, self.cells[name][numbers]

    def _build(self, numbers: np.ndarray, ids: wp.array, first: np.ndarray, sizes: np.ndarray) -> None:
        """Builds the subtrees of cells and inserts them into the tree."""
        device, width = self.build_device, self.config.cost.width
        references, roots = as_roots(self.triangles.boxes, self.cells[numbers], ids, first, sizes)
        scan = Scan(binned.binned_method(self.config), LevelRules(LARGE, binned.BINS, binned.SAMPLED), values_for(binned.BINS))
        tasks = partial(make_tasks, references, roots, self.triangles, self.config, scan)
        reservation, _, results = build_tasks(scan.method, self.config.rules(self.triangles), tasks, CELL_SPARE_MEMORY)
        made = results.numpy()
        nodes, base = self._insert_gaps("node", numbers, made["nodes"])
        blocks = len(self.primitive) // width + np.cumsum(made["blocks"])
        primitive = joined(self.primitive, wp.empty(int(made["blocks"].sum()) * width, dtype=int, device=device))
        bases = [wp.array(places, dtype=int, device=device) for places in (base, blocks - made["blocks"])]
        inputs = [reservation.parts, reservation.tasks, results, *bases, width, nodes, primitive]
        launch(copy_subtrees, len(numbers), inputs, device=device, chunk=1)
        self.primitive = primitive
        self.skeleton = wp.clone(self.skeleton)  # the old one may be in use
        self.skeleton.numpy()[self.cells["leaf"][numbers]] = EMPTY
        self.cells["unbuilt"][numbers] = False


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the whole tree, as if rays had requested all cells."""
    return start(triangles, config, triangles.boxes.low.device).finish()


def start(
    triangles: TriangleBoxes,
    config: KdTreeConfig,
    device: wp.Device,
    meshes: MeshBoxes | None = None,
    previous: LazyKdTree | None = None,
) -> LazyKdTree:
    """Starts a tree that is built on demand.

    Args:
        triangles, config, device: as in `LazyKdTree`.
        meshes: the meshes of the scene, for `config.hierarchy` "meshes" and "groups"; None for one mesh.
        previous: the tree of the same triangles in the previous frame, for "previous"; None if there is none.
    """
    load(
        (count_cells, list_references, move_nodes, copy_subtrees, make_build_subtrees(binned.binned_method(config))),
        triangles.boxes.low.device,
    )
    given = groups = None
    if config.hierarchy == MESHES and meshes is not None:
        given = mesh_clusters(meshes, triangles.boxes.low.device)
    elif config.hierarchy == GROUPS and meshes is not None:
        groups = SceneGroups.of(meshes)
    elif config.hierarchy == PREVIOUS and previous is not None and previous.presort is not None:
        given = moved_clusters(previous.presort, triangles)
    return LazyKdTree(triangles, config, device, given, groups)
