"""Claims of Komatsu et al. 2008 and of Pichler 2018."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from studies.evidence.claims import Found, Held, claim, inverse, pairs, speeds
from studies.evidence.papers import KOMATSU_2, KOMATSU_3, KOMATSU_4, PICHLER_61, PICHLER_62, PICHLER_63, break_even
from studies.evidence.verdicts import Measure, counted, judge, not_comparable, span

SMALL = ("bunny", "dragon", "happy buddha", "armadillo")
LARGE = ("asian dragon", "thai statue")
PRECOMPUTED = ("wald", "benthin", "havel_herout", "moeller_trumbore_precomputed")
QUERIES = "percentages of whole rendering times there, of queries here"


@claim("komatsu-operations", "komatsu", "Table 1", "The test needs half the operations of Möller's", "komatsu_counts")
def operations(held: Held) -> Found:
    (ours,) = held["komatsu_counts"].take("1", "test", algorithm="Proposed")
    (plain,) = held["komatsu_counts"].take("1", "test", algorithm="Möller")
    return judge([counted(ours.value / plain.value)], at_most=0.5), f"{ours.value:.0f} against {plain.value:.0f}"


@claim(
    "komatsu-break-even",
    "komatsu",
    "section 3",
    "From six rays of a frustum on it needs the fewest operations of all four tests",
    "komatsu_counts",
)
def fewest_operations(held: Held) -> Found:
    counts = held["komatsu_counts"]
    names = ("Möller", "Projection", "Pluecker", "Proposed")
    once, each = ({n: counts.take("1", what, algorithm=n)[0].value for n in names} for what in ("precomputation", "test"))
    first = next(
        f for f in range(1, 1000) if all(once["Proposed"] + each["Proposed"] * f < once[n] + each[n] * f for n in names[:3])
    )
    printed = max(break_even("Proposed", name) for name in names[:2])
    return judge([counted(first)], at_most=6), f"from {first} rays on by our counts, from {printed} on by the table as printed"


@claim(
    "komatsu-without-tree",
    "komatsu",
    "Table 2, Fig. 6",
    "Without a tree it has 1.1 to 1.3 times the speed of Möller's test, on all scenes",
    "komatsu_scenes",
)
def without_tree(held: Held) -> Found:
    ours = speeds(held["komatsu_scenes"], "2", contender="Proposed")
    printed = KOMATSU_2.ratio("Möller", "Proposed").values()
    return judge(
        ours, at_least=1.1
    ), f"{span(ours)} times on {len(ours)} scenes (paper: {min(printed):.2f} to {max(printed):.2f})"


@claim("komatsu-pluecker", "komatsu", "Table 2, Fig. 6", "It is faster than Plücker's test on all scenes", "komatsu_scenes")
def against_pluecker(held: Held) -> Found:
    ours, theirs = (speeds(held["komatsu_scenes"], "2", contender=name) for name in ("Proposed", "Pluecker"))
    both = pairs(ours, theirs)
    ahead = sum(one.value < 1 for one in both)
    return judge(both, at_least=1.0), f"{span(both)} times its speed; Plücker's is ahead on {ahead} of {len(both)} scenes"


@claim("komatsu-exits", "komatsu", "Table 3", "86.5 % of the tests without a hit end before the last exit", "komatsu")
def exits(held: Held) -> Found:
    last = held["komatsu"].take("3", "tests", contender="Proposed", exit="u + v > 1")
    early = [counted(100 * (1 - one.value), one.case) for one in last]
    first = held["komatsu"].take("3", "tests", contender="Proposed", exit="turned away")
    at_first = KOMATSU_3.row("Proposed")["first"]
    return judge(early, at_least=100 - KOMATSU_3.row("Proposed")["last"]), (
        f"{span(early, '.1f')} %; {span(first, '.0f', 100)} % at the first exit (paper: {at_first:.0f} %),"
        f" for half of a closed surface faces away"
    )


@claim("komatsu-prediction", "komatsu", "Fig. 7", "Early exits make the test faster", "komatsu")
def exits_help(held: Held) -> Found:
    times = {
        form: held["komatsu"].take("foreseen", "nanoseconds", contender=f"Proposed, {form}") for form in ("no exits", "exits")
    }
    gains = pairs(times["no exits"], times["exits"])
    return judge(
        gains, at_least=1.0
    ), f"{span(gains)} times the speed without exits, in three orders of the triangles of one mesh"


@claim(
    "komatsu-precomputation",
    "komatsu",
    "Fig. 7",
    "Precomputation alone makes it 1.07 to 1.23 times as fast as Möller's test, without exits in both",
    "komatsu",
)
def precomputation_helps(held: Held) -> Found:
    plain, ours = (
        held["komatsu"].take("foreseen", "nanoseconds", contender=f"{test}, no exits") for test in ("Möller", "Proposed")
    )
    gains = pairs(plain, ours)
    return judge(gains, at_least=1.07), f"{span(gains)} times, in three orders of the triangles of one mesh"


@claim(
    "komatsu-both",
    "komatsu",
    "Fig. 7",
    "With precomputation and exits it is 1.31 to 1.43 times as fast as Möller's test without exits",
    "komatsu",
)
def both_help(held: Held) -> Found:
    plain, ours = (
        held["komatsu"].take("foreseen", "nanoseconds", contender=way) for way in ("Möller, no exits", "Proposed, exits")
    )
    gains = pairs(plain, ours)
    each = ", ".join(f"{one.value:.2f} times ({one.case})" for one in gains)
    return judge(gains, at_least=1.31), f"{each}, by order of the triangles"


@claim(
    "komatsu-tree",
    "komatsu",
    "Table 4, Fig. 9",
    "With a SAH-BVH it has 1.02 to 1.03 times Möller's speed on the four smaller models",
    "komatsu",
)
def with_tree(held: Held) -> Found:
    packets, single = (speeds(held["komatsu"], "4", contender="komatsu", traversal=way) for way in ("packet", "single"))
    printed = [KOMATSU_4.ratio("Möller", "Proposed")[name] for name in SMALL]
    both = speeds(held["komatsu"], "4", contender="komatsu", traversal=("packet", "single"))
    return judge(both, at_least=1.0), (
        f"{span(packets)} times in packets, {span(single)} times for single rays, before records are made"
        f" (paper: {min(printed):.2f} to {max(printed):.2f}, 2 x 2 rays)"
    )


@claim(
    "komatsu-large",
    "komatsu",
    "Table 4, Fig. 9",
    "The gain with a tree grows with the scene: 1.43 and 1.31 times on 7 and 10 million triangles, in trees of depth 12 and 10",
    "komatsu_depths",
)
def grows(held: Held) -> Found:
    """By packets, as the paper traces frusta; single rays in the text."""
    printed = KOMATSU_4.ratio("Möller", "Proposed")
    quote = " and ".join(f"{printed[name]:.2f}" for name in LARGE)
    by_limit = {
        (way, limit): speeds(held["komatsu_depths"], "depths", contender="komatsu", traversal=way, limit=limit)
        for way in ("packet", "single")
        for limit in ("none", "12", "10")
    }
    shown = {key: span(values) for key, values in by_limit.items()}
    texts = [
        f"{way} {shown[way, 'none']} times in a whole tree, {shown[way, '12']} and {shown[way, '10']} times"
        for way in ("packet", "single")
    ]
    limited = [*by_limit["packet", "12"], *by_limit["packet", "10"]]
    return judge(limited, at_least=1.1), f"{'; '.join(texts)} with depths 12 and 10 (paper: {quote})"


@claim(
    "komatsu-bundles",
    "komatsu",
    "section 5",
    "It is expected to be useful for bundles of shadow and of diffuse rays",
    "komatsu",
)
def bundles(held: Held) -> Found:
    kinds = {kind: speeds(held["komatsu"], "bundles", contender="Proposed", kind=kind) for kind in ("shadow", "diffuse")}
    counts = held["komatsu"].take("bundles", "ratio_counted", contender="Proposed", kind=("shadow", "diffuse"))
    whole = [inverse(one) for one in counts]
    left_out = ", ".join(f"{span(values)} times for {kind} rays" for kind, values in kinds.items())
    return judge(
        whole, at_least=1.0
    ), f"{span(whole)} times Möller's speed with sixteen rays of an origin, records counted; without them {left_out}"


def faster_scenes(cases: Sequence[Measure], name: str) -> Measure:
    """On how many scenes a test is faster than the reference: by the medians, in all runs, and in some."""
    number, surely, perhaps = (sum(getattr(case, part) < 1.0 for case in cases) for part in ("value", "greatest", "least"))
    return Measure(number, surely, perhaps, min(case.runs for case in cases), name)


@claim(
    "pichler-probability",
    "pichler",
    "Table 6.1",
    "An order by estimated probability saves comparisons of 3-fold pruning",
    "pichler",
)
def probability(held: Held) -> Found:
    ordered, circle = (held["pichler"].take("6.1", "percent", variant=name) for name in ("3x, p.es.", "3x, circle"))
    first, second = PICHLER_61.rows["3x, p.es."], PICHLER_61.rows["3x"]
    printed = [100 * a / b for a, b in zip(first, second, strict=True)]
    saved = pairs(ordered, circle)
    return judge(saved, at_most=0.999), (
        f"{span(ordered, '.0f')} % of plain pruning (thesis: {min(printed):.0f} to {max(printed):.0f} %),"
        f" and {span(saved, '.2f')} times what the circle"
        " with the plain order needs: the circle saves, the order does not"
    )


@claim(
    "pichler-variants",
    "pichler",
    "Table 6.2",
    "No variant of pruning is faster than the unit triangle on most scenes",
    "pichler",
)
def variants(held: Held) -> Found:
    ratios = {
        test: held["pichler"].take("6.2", "ratio", mode="alone", test=test)
        for test in dict.fromkeys(row.key["test"] for row in held["pichler"].rows if row.table == "6.2")
        if test != "ferko_utm"
    }
    faster = [faster_scenes(cases, test) for test, cases in ratios.items()]
    ours, scenes = [case for cases in ratios.values() for case in cases], max(map(len, ratios.values()))
    printed = [value for row in PICHLER_62.rows.values() for value in row]
    return judge(faster, at_most=scenes / 2), (
        f"{span(ours, '.0f', 100)} % of the unit triangle's time (thesis: {min(printed):.0f} to {max(printed):.0f} %);"
        f" by variant, faster on {span(faster, '.0f')} of {scenes} scenes; {QUERIES}"
    )


@claim("pichler-unit-triangle", "pichler", "Table 6.3", "The unit triangle is faster than PBRT's watertight test", "pichler")
def unit_triangle(held: Held) -> Found:
    return against_watertight(held, "ferko_utm", "UTM")


@claim("pichler-baldwin-weber", "pichler", "Table 6.3", "So is Baldwin and Weber's test", "pichler")
def baldwin_weber(held: Held) -> Found:
    return against_watertight(held, "baldwin_weber", "Baldwin-Weber")


def against_watertight(held: Held, test: str, printed_as: str) -> Found:
    """A test against Woop's, which is PBRT's; judged for one triangle at a time, as in the thesis."""
    one, lanes = (held["pichler"].take("6.3", "ratio", mode=mode, test=test) for mode in ("alone", "lanes"))
    printed = [value for name in PICHLER_63.rows if (value := PICHLER_63.row(name)[printed_as]) is not None]
    return judge(one, at_most=1.0), (
        f"one triangle at a time {span(one, '.0f', 100)} % of its time, in lanes {span(lanes, '.0f', 100)} %"
        f" (thesis: {min(printed):.0f} to {max(printed):.0f} %); {QUERIES}"
    )


@claim("pichler-hybrid", "pichler", "6.3.1", "The hybrid is no gain over the unit triangle on most scenes", "pichler")
def hybrid(held: Held) -> Found:
    both = pairs(*(held["pichler"].take("6.3", "ratio", mode="alone", test=test) for test in ("ferko_hybrid", "ferko_utm")))
    faster = faster_scenes(both, "")
    return judge(
        [faster], at_most=len(both) / 2
    ), f"{span(both)} times its time, faster on {faster.value} of {len(both)} scenes"


@claim("pichler-errors", "pichler", "Table 6.4", "At equal time the tests make pictures of different error", "pichler")
def errors(held: Held) -> Found:
    bias = max(one.value for one in held["pichler"].take("6.4", "bias"))
    error = held["pichler"].take("6.4", "error")
    verdict = not_comparable("three scenes in PBRT there; one scene of 40 x 40 pixels here")
    return (
        verdict,
        f"errors of {span(error, '.1e')}, of which a test's own rounding makes at most {bias:.0e}: they are"
        f" those of the number of samples",
    )


@claim(
    "inside-first",
    "rahikainen",
    "2.1",
    "With the edges asked first, Plücker's test ends there in at least 52 % of the tests",
    "inside_first",
)
def edges_first(held: Held) -> Found:
    edges = held["inside_first"].take("orders", "tests", order="inside first", exit="outside an edge")
    facing = held["inside_first"].take("orders", "tests", order="facing first", exit="turned away")
    return judge(edges, at_least=0.52), (
        f"{span(edges, '.1f', 100)} % of the tests without a hit end at the edges if they are asked first,"
        f" {span(facing, '.0f', 100)} % at the first exit as printed (paper: {KOMATSU_3.row('Pluecker')['first']:.0f} %)"
    )


@claim(
    "memory-of-vertices",
    "rahikainen",
    "2.1",
    "To store vertices only, as Möller and Trumbore do, saves 25 to 50 % of the memory of triangles",
    "komatsu_counts",
)
def memory_of_vertices(held: Held) -> Found:
    take = held["komatsu_counts"].take
    (plain,) = take("records", "bytes", test="moeller_trumbore")
    others = take("records", "bytes", test=PRECOMPUTED)
    saved = [counted(100 * (1 - plain.value / other.value), other.case) for other in others]
    return judge(saved, at_least=25, at_most=50), (
        f"{span(saved, '.0f')} % against records with precomputation: {plain.value:.0f} bytes and "
        + ", ".join(f"{other.value:.0f} ({other.case})" for other in others)
    )


@claim("fans-brute-force", "rahikainen", "2.1", "Fans are nearly 40 % faster", "fans")
def fans_alone(held: Held) -> Found:
    """Like for like: both precompute, or neither does."""
    plain, full = (held["fans"].take("brute force", "ratio", way=way) for way in ("fans", "fans, edges, normals"))
    other = held["fans"].take("brute force", "ratio", way="moeller_trumbore_precomputed")
    both = pairs(full, other)
    cases = [
        replace(one, case=f"{one.case}, {what}") for part, what in ((plain, "plain"), (both, "precomputed")) for one in part
    ]
    return judge(cases, at_most=0.65), (
        f"{span(plain)} times the time of Möller and Trumbore's test, nothing precomputed; {span(both)}"
        f" times with edges and normals precomputed in both"
    )


@claim("fans-planes", "rahikainen", "2.1", "Havel and Herout's test makes fans faster than Möller and Trumbore's", "fans")
def fans_by_planes(held: Held) -> Found:
    """Both with all that they can precompute."""
    both = pairs(*(held["fans"].take("brute force", "ratio", way=way) for way in ("fans, planes", "fans, edges, normals")))
    return judge(both, at_most=1.0), f"{span(both)} times the time with edges and normals"


@claim("fans-trees", "rahikainen", "2.1", "Fans in leaves of trees are faster than triangles", "fans")
def fans_in_trees(held: Held) -> Found:
    bvh, kdtree, lanes = (held["fans"].take("trees", "ratio", way=way) for way in ("fans, bvh", "fans, kdtree", "bvh"))
    trees = held["fans"].take("trees", "ratio", way=("fans, bvh", "fans, kdtree"))
    return judge(trees, at_most=1.0), (
        f"in a BVH {span(bvh)} times the time of triangles one by one, in a kd-tree {span(kdtree)} times;"
        f" 16 triangles at once take {span(lanes)} times"
    )
