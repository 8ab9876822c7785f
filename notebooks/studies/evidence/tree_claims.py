"""Claims of the survey on trees, traversal and motion, and of Falcone 2024."""

from __future__ import annotations

from functools import partial

from studies.evidence.claims import Found, Held, claim, pairs, quotient
from studies.evidence.papers import FALCONE_PRECISION
from studies.evidence.verdicts import all_of, counted, judge, not_comparable, span


@claim(
    "sorting-sweep", "rahikainen", "4.1", "To sort once, O(N log N), is faster than to sort in every node", "kdtree_builders"
)
def sorted_once(held: Held) -> Found:
    times = held["kdtree_builders"].take("builders", "build", builder="sorting_sweep")
    return judge(times, at_least=1.0), f"{span(times, '.1f')} times as fast"


@claim(
    "between-medians",
    "rahikainen",
    "4.1",
    "Where no object is split, the plane of least cost lies between the spatial and the object median",
    "plane_places",
)
def between_medians(held: Held) -> Found:
    rows = held["plane_places"]
    points = rows.take("places", "between", scene="points")
    scenes, weighted = (rows.take("places", what, scene=("teapot", "atrium", "wood")) for what in ("between", "weighted"))
    return judge(points, at_least=99.9), (
        f"in {span(points, '.0f')} % of the nodes of tiny triangles; in {len(scenes)} scenes, whose triangles are split, in"
        f" {span(scenes, '.0f')} %, weighted by surface area {span(weighted, '.0f')} %"
    )


@claim("packets", "rahikainen", "3.2", "Packets are faster than single rays for a view", "traversal")
def packets(held: Held) -> Found:
    both = held["traversal"].take("speeds", "speed", traversal="packet")
    return judge(both, at_least=1.0), f"{', '.join(f'{one.value:.2f} times ({one.case})' for one in both)}"


@claim("omnidirectional-steps", "rahikainen", "5", "Omnidirectional packets need half the steps for camera rays", "bounces")
def omnidirectional(held: Held) -> Found:
    fewer, size = held["bounces"].take("steps", "fewer", bounce="0"), held["bounces"].settings["size"]
    return judge(fewer, at_least=2.0), f"{span(fewer)} times fewer on {len(fewer)} scenes, at {size} x {size} pixels"


@claim("omnidirectional-bounce-9", "rahikainen", "5", "and 1.5 times fewer at bounce 9", "bounces")
def omnidirectional_late(held: Held) -> Found:
    fewer = held["bounces"].take("steps", "fewer", bounce="9")
    return judge(fewer, at_least=1.5), f"{span(fewer)} times fewer on {len(fewer)} scenes"


@claim("rays-at-leaves", "rahikainen", "3.2", "On average only 2 rays of a packet reach a leaf", "bounces")
def rays_at_leaves(held: Held) -> Found:
    """Leaves that single rays visit, by leaves that packets by types visit; the claim is about how few rays there are."""
    late, first = (held["bounces"].take("leaves", "rays", bounce=bounce) for bounce in ("9", "0"))
    return judge(late, at_most=2.5), (
        f"{span(late, '.1f')} of 64 at bounce 9 on {len(late)} scenes, {span(first, '.0f')} of camera rays"
    )


@claim(
    "vertex-culling",
    "rahikainen",
    "3.3",
    "Vertex culling avoids more than 90 % of the tests in leaves of hundreds of triangles, with a tenth of the nodes",
    "leaf_sizes",
)
def vertex_culling(held: Held) -> Found:
    """Judged as the claim is put; the text says what of it is due to vertex culling."""
    leaves, size = held["leaf_sizes"], held["leaf_sizes"].settings["size"]
    avoided, others = (leaves.take("leaves", "avoided", leaf="512", culling=name) for name in ("vertex", "interval"))
    triangles, few = (leaves.take("leaves", what, leaf="512", culling="vertex") for what in ("triangles", "nodes"))
    fewer = pairs(leaves.take("leaves", "nodes", leaf="0", culling="vertex"), few)
    return all_of([judge(avoided, at_least=90.0), judge(fewer, at_least=10.0)]), (
        f"{span(avoided, '.1f')} % in leaves of {span(triangles, '.0f')} triangles, with {span(fewer, '.0f')}"
        f" times fewer nodes, for a view of {size} x {size}; the"
        f" interval test of the triangles' boxes alone avoids {span(others, '.1f')} %"
    )


@claim("subtrees", "rahikainen", "4.2", "Rebuilding the whole tree is not necessary: subtrees suffice", "dynamic")
def subtrees(held: Held) -> Found:
    keys = {"motion": ("figure", "figure in the court"), "tolerance": "1.3"}
    whole, parts = (held["dynamic"].take("rebuilds", what, **keys) for what in ("built", "in parts"))
    return judge(whole, at_most=0), (
        f"{span(whole, '.0f')} whole builds and {span(parts, '.0f')} partial ones in 23 frames of coherent"
        f" motion, with the default tolerance"
    )


@claim("fuzzy-boxes", "rahikainen", "4.2", "Motion decomposition makes fuzzy boxes smaller", "fuzzy_boxes")
def fuzzy_boxes(held: Held) -> Found:
    """Of all 24 frames, against one cluster, whose boxes hold the whole motion but for the mean."""
    take, frames = held["fuzzy_boxes"].take, {"frames": "24"}
    (one,), (tested,) = (take("boxes", what, clusters="one cluster", **frames) for what in ("area", "tests"))
    several = ("found", "found, best rest pose", "bones")
    areas, tests = (take("boxes", what, clusters=several, **frames) for what in ("area", "tests"))
    return judge([quotient(area, one) for area in areas], at_most=0.99), (
        f"{span(areas)} times the area of the triangles' own boxes with clusters, {one.value:.0f} times with one;"
        f" {span(tests)} and {tested.value:.1f} times the triangle tests of a tree for the frame"
    )


@claim("instance-updates", "rahikainen", "4.2", "Of rigid copies only matrices are updated, which costs little", "dynamic")
def instance_updates(held: Held) -> Found:
    """All numbers of copies, one included."""
    gains = pairs(*(held["dynamic"].take("instances", "update", way=way) for way in ("built", "instances")))
    return judge(gains, at_least=5.0), "updates are " + ", ".join(
        f"{one.value:.0f} ({one.case})" for one in gains
    ) + " times as fast as a build, by copies"


@claim("instance-rays", "rahikainen", "4.2", "Transforming rays costs little", "dynamic")
def instance_rays(held: Held) -> Found:
    longer = pairs(*(held["dynamic"].take("instances", "trace", way=way) for way in ("instances", "built")))
    return judge(longer, at_most=1.3), "views take " + ", ".join(
        f"{one.value:.2f} ({one.case})" for one in longer
    ) + " times as long as through one tree, by copies"


@claim("gkdtree", "rahikainen", "4.2", "Updates of groups are 1.1 to 166 times as fast as of one kd-tree", "dynamic")
def groups(held: Held) -> Found:
    speed = held["dynamic"].take("groups", "speed", way="groups, built")
    return judge(speed, at_least=1.1), ", ".join(f"{one.value:.1f} times with {one.case} of 16 moving" for one in speed)


@claim(
    "threads-benthin",
    "rahikainen",
    "4.1",
    "Lists of candidates sorted in parts, and a subtree for each thread, make builds 2 times as fast on 2 cores",
    "thread_growth",
)
def two_threads(held: Held) -> Found:
    """Benthin's division of the work is not built; those that are say how much two threads gain here."""
    each = held["thread_growth"].take("threads", "speed", threads="2", what=("streaming", "in_place", "binned", "nested"))
    here = ", ".join(f"{one.value:.1f} times ({one.case.split(', ')[0]})" for one in each)
    return not_comparable("other divisions of the work"), f"with 2 threads {here}"


def with_threads(held: Held, what: str, threads: int, at_least: float) -> Found:
    """The claim on a build or an update with some threads; the figures are also those of 16."""
    take = held["thread_growth"].take
    gains = take("threads", "speed", what=what, threads=str(threads))
    shown = {count: take("threads", "speed", what=what, threads=str(count))[0].value for count in sorted({threads, 16})}
    here = ", ".join(f"{value:.1f} times with {count}" for count, value in shown.items())
    return judge(gains, at_least=at_least), f"{here} threads"


for name, place, says, what, threads, at_least in (
    ("threads-streaming", "4.1", "The streaming build is up to 2.43 times as fast with 4 threads", "streaming", 4, 2.43),
    ("threads-binned", "4.1", "The build by bins is 3.9 times as fast with 4 threads", "binned", 4, 3.9),
    ("threads-nested", "4.1", "The nested build is 5 to 8 times as fast with 20 threads", "nested", 16, 5.0),
    ("threads-in-place", "4.1", "The build in place is up to 7 times as fast with 24 threads", "in_place", 16, 7.0),
    ("threads-groups", "4.2", "Updates of groups are 3.5 to 5 times as fast with 6 threads", "groups", 6, 3.5),
):
    growth = partial(with_threads, what=what, threads=threads, at_least=at_least)
    claim(name, "rahikainen", place, says, "thread_growth")(growth)


@claim("threads-rays", "rahikainen", "5", "Rays gain nearly linearly from threads, to 128", "thread_growth")
def ray_threads(held: Held) -> Found:
    """Nearly: 0.8 times the number of threads and more."""
    gains = held["thread_growth"].take("threads", "speed", what=("view", "random"), threads="16")
    each = ", ".join(f"{one.value:.1f} times ({one.case.split(', ')[0]})" for one in gains)
    return judge(gains, at_least=0.8 * 16), f"with 16 threads {each}, where linear is 16 and at least 12.8 is asked"


@claim("two-trees", "rahikainen", "4.2", "Two trees slow rays down, for each ray goes through both", "dynamic")
def two_trees(held: Held) -> Found:
    (two,), (one,) = (held["dynamic"].take("ways", "trace", way=way) for way in ("static and moving kdtree", "groups, kdtree"))
    both = pairs([two], [one])
    return judge(both, at_least=1.0), f"{span(both)} times the time through the upper tree of groups"


@claim("split-threads", "rahikainen", "4.2", "Threads should be split between building and tracing", "dynamic")
def split_threads(held: Held) -> Found:
    gains = pairs(*(held["dynamic"].take("threads", what) for what in ("turns", "split")))
    return judge(gains, at_least=1.0), f"{span(gains)} times the speed of taking turns, two threads in both"


@claim(
    "pah-precision",
    "falcone",
    "6.2.1, Fig. 6.9",
    "PAH is off by 7 % on average, by 2 % for planes and 12 % for points",
    "ray_distribution",
)
def pah_precision(held: Held) -> Found:
    """By the casters of the thesis: planes, and caps for points. Rays uniform over the window fit by construction."""
    take = held["ray_distribution"].take
    (plane,), (square,), (circular,) = (
        take("precision", "percent", error=error)
        for error in (
            "PAH, plane",
            "PAH, point, square cap",
            "PAH, point, circular cap",
        )
    )
    printed = FALCONE_PRECISION.row("eight scenes")
    cases = [counted(square.value, "square cap"), counted(circular.value, "circular cap")]
    verdict = all_of([judge([plane], at_most=printed["PAH, planes"]), judge(cases, at_most=printed["PAH, points"])])
    return verdict, (
        f"{plane.value:.1f} % for planes, {square.value:.1f} % for points with the square cap and"
        f" {circular.value:.1f} % with the circular one; the thesis"
        " does not say which it casts, nor its angle"
    )


@claim("sah-precision", "falcone", "6.2.1, Fig. 6.9", "SAH is off by more than PAH: 36 %", "ray_distribution")
def sah_precision(held: Held) -> Found:
    take = held["ray_distribution"].take
    (sah,) = take("precision", "percent", error="SAH, plane and point")
    (worst,) = take("precision", "percent", error="PAH, point, circular cap")
    return judge([counted(sah.value / worst.value)], at_least=1.0), f"{sah.value:.0f} %, PAH {worst.value:.0f} % at most"


@claim(
    "pah-culling",
    "falcone",
    "6.2.2",
    "Without culling at the near plane PAH is off by 12 % (planes) and 23 % (points)",
    "ray_distribution",
)
def culling(held: Held) -> Found:
    take = held["ray_distribution"].take
    without = [take("precision", "percent", error=f"PAH, {kind}, not clipped")[0] for kind in ("plane", "point")]
    with_it = [take("precision", "percent", error=f"PAH, {kind}")[0] for kind in ("plane", "point")]
    worse = [counted(a.value / b.value, kind) for a, b, kind in zip(without, with_it, ("planes", "points"), strict=True)]
    return judge(
        worse, at_least=2.0
    ), f"{without[0].value:.0f} and {without[1].value:.0f} %, {with_it[0].value:.1f} and {with_it[1].value:.1f} % with it"


@claim(
    "pah-spfh",
    "falcone",
    "6.2.3, Fig. 6.11",
    "PAH and SPFH together are better than SAH and LSPH for planes whose rays are parallel to an axis, else at most comparable",
    "ray_distribution",
)
def both_heuristics(held: Held) -> Found:
    """Comparable: up to 5 % better."""
    take, way = held["ray_distribution"].take, {"tree": "PAH + SPFH"}
    (along,) = take("gains", "percent", **way, kind="plane", way="parallel")
    others = [one for one in take("gains", "percent", **way) if one.case != "plane, parallel"]
    return all_of([judge([along], at_least=0.0), judge(others, at_most=5.0)]), (
        f"{along.value:.0f} % better there, {span(others, '.0f')} % for other rays, means of eight scenes"
    )


@claim(
    "sah-spfh",
    "falcone",
    "6.2.6, Fig. 6.17",
    "SAH and SPFH make better trees than both new heuristics together",
    "ray_distribution",
)
def facing_alone(held: Held) -> Found:
    alone, both = (held["ray_distribution"].take("gains", "percent", tree=tree) for tree in ("SAH + SPFH", "PAH + SPFH"))
    more = [counted(a.value - b.value, a.case) for a, b in zip(alone, both, strict=True)]
    return judge(more, at_least=0.0), (
        f"{span(alone, '.0f')} % better than SAH and LSPH, both together {span(both, '.0f')} %, by area and direction"
    )


@claim("pah-alone", "falcone", "6.2.7, Fig. 6.18", "PAH and LSPH make worse trees than SAH and LSPH", "ray_distribution")
def projected_alone(held: Held) -> Found:
    gains = held["ray_distribution"].take("gains", "percent", tree="PAH + LSPH")
    return judge(gains, at_most=0.0), f"{span(gains, '.0f')} % better, by area and direction"
