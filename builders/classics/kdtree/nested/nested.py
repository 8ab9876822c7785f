"""Nested parallel build of an SAH kd-tree: parallel over nodes and within nodes (Choi et al. 2010).

**Problem.** The sequential build (`sweep`) has one node, then two, then four to share among the cores. Most of the time at the
top goes into passes over long lists of events, which a single thread makes.

**Algorithm.** The build is the sequential one, with both levels of parallelism nested. Nodes are independent of each other.
Within a large node, the lists of events are divided into chunks. The search takes three steps: each chunk counts its starts and
ends; a sum over the chunks gives the counts before each of them; each chunk then evaluates its planes, and the best plane of
all chunks is the node's. The lists are divided in three steps too: each chunk counts its events on both sides; a sum gives the
places; each chunk moves its events. The SAH is exact everywhere, so the tree is that of `sweep`.

**Data.** One list of sorted events per axis and node, as in `sweep`: data moves with the nodes. This is the difference to
`in_place`, in which events stay where they are.

**Phases.** Large nodes: those of `event_levels`. The others: the phases
of `event_method`, in tasks of one pool, each of which builds a subtree depth first. Assembly: `assemble`.

**Complexity.** O(N log N): the sort, then O(N) per level.

**What we changed.** The paper makes a task of each node. Here the large nodes of a level are one batch, and its chunks are
shared among the threads. The paper does not classify in parallel, because marks that threads write share cache lines. Here
triangles are classified by their boxes, in chunks of a node's list of triangles, so each chunk writes its own range. The tree
is the same for any number of threads, chunks and tasks, also if triangles are clipped, in large nodes (`event_levels`)
and in tasks (`clipped_events`).

References: choi-2010; rahikainen-2013 (section 4.2).
"""

from wrt.builders.classics.kdtree.nested.clipped_event_chunks import merge_lists
from wrt.builders.classics.kdtree.nested.event_chunks import search_chunks
from wrt.builders.classics.kdtree.nested.event_levels import EventLevels
from wrt.builders.core.subtrees import build_tasks, make_build_subtrees
from wrt.builders.kdtree.events.clipped_events import arrays_of
from wrt.builders.kdtree.events.event_method import event_method
from wrt.builders.kdtree.events.event_sort import emit_events
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.assembly import assemble, copy_subtrees
from wrt.builders.tree import KdTree, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import get_num_threads, load, specialise

TASKS_PER_THREAD = 2
"""Tasks per thread that define a large node: one with more than the average share of triangles is split by all threads."""

MIN_LARGE = 1 << 12
"""Triangles below which a node is not worth more than one thread."""

SPARE_MEMORY = 1.5
"""Working memory of a task relative to its own lists; doubled whenever it is too small."""


def large_node(count: int) -> int:
    """Nodes of more triangles are split by all threads."""
    threads = get_num_threads()
    return max(MIN_LARGE, count // (TASKS_PER_THREAD * threads)) if threads > 1 else count


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    phase, method = Phases(triangles.boxes.low.device), event_method(config)
    clipping = (merge_lists,) if config.tests_nodes else ()
    kernels = (emit_events, search_chunks, copy_subtrees, *clipping, specialise(make_build_subtrees, method))
    load(kernels, phase.device)
    with phase("sort"):
        levels = EventLevels(triangles, config, large_node(triangles.count))
    with phase("top levels"):
        levels.split()
    reservation, lists, results = build_tasks(method, config.rules(triangles), levels.make_tasks, SPARE_MEMORY, phase, "copy")
    work = [levels.lists.event, levels.lists.triangle, levels.lists.child, *arrays_of(lists)]
    return assemble(triangles, config, phase, levels.levels, (reservation, results), work)
