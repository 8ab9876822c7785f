"""What "auto" chooses, by two tables, which are all that tests say of it: the traversal and the reason for every kind of scene,
batch and query on both sides of each limit; and a grid of cases with what a sample of their packets shares.

Nothing is traced. The grid holds first guesses by the rules of notebooks/records/2026-11-28-auto.md, and for few rays
notebooks/records/2026-11-23-few-rays.md; `wrt bench auto` makes the cases and times the choices on any machine. A changed
choice is no error, but needs a new record.
"""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest

import wrt.engine
import wrt.kernels
from wrt.engine.facts.facts import RayFacts, SceneFacts
from wrt.engine.facts.query_kinds import few_rays
from wrt.engine.facts.wide_trees import wide_form_pays
from wrt.engine.plan.planner import choose_culling, choose_traversal, packet_rays, situation_of
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.traversal_scores import GREATEST_SHARE, Overlap
from wrt.kernels.triangle import TRIANGLE_TESTS

SCENES = ("bvh", "kdtree", "lazy", "instances bvh", "instances kdtree", "spaces")
RAYS = (1, 1024, 1025, 100_000, 10_000_000)
QUERIES = ("closest", "any", "count", "all")


def make_scene(kind: str, triangles: int, cuda: bool = False, width: int = 16) -> SceneFacts:
    """The facts about a scene that a choice depends on; `width`: children of a node."""
    return SceneFacts(
        tree="kdtree" if kind in ("kdtree", "lazy", "instances kdtree") else "bvh",
        width=width,
        triangles=triangles,
        instances=8 if kind.startswith("instances") else 0,
        is_cuda=cuda,
        own_spaces=kind == "spaces",
        is_lazy=kind == "lazy",
    )


def make_rays(count: int, coherent: bool, shared: bool) -> RayFacts:
    """The facts about rays that a choice depends on."""
    return RayFacts(count, (count,), shared, coherent)


def choose(
    scene: SceneFacts, rays: RayFacts, query: str, culls: bool = False, wide: bool = False, savings: float = 0.0
) -> tuple[str, str]:
    """The choice, without a sample; `wide`: the wide form exists; `savings`: what it would have saved."""
    cache = SimpleNamespace(wide=wide or None, missed_savings=savings)
    state = SimpleNamespace(facts=scene, triangle_count=scene.triangles, cache=cache)
    return choose_traversal(scene, situation_of(scene, rays, query, culls, has_wide_form=wide_form_pays(state, rays)))


# scene, lanes, query, what is said of the rays, triangles, rays, the wide form of a kd-tree (it exists, or rays so far would
# have saved this many steps by it); choice and reason, in short. Each limit has a case below it and one at it.
TABLE = """
bvh               16 closest -                         500      1024 -      single      few rays
bvh               16 closest -                         500      1025 -      stream      incoherent
bvh               16 closest coherent                  500      1024 -      single      few rays
bvh               16 closest coherent                  500      1025 -      packet      coherent
bvh               16 closest -                       49999      8192 -      stream      incoherent
bvh               16 closest -                       50000      8192 -      interleaved incoherent
bvh                8 any     -                       49999     65536 -      stream      incoherent
bvh                8 any     -                       50000     65536 -      interleaved incoherent
bvh               16 closest coherent                40000      4999 -      stream      coherent, but triangles are small
bvh               16 closest coherent                40000      5000 -      packet      coherent
bvh               16 any     -                      249999     65536 -      stream      incoherent
bvh               16 any     -                      249999     65535 -      interleaved incoherent
bvh               16 any     -                      250000     65536 -      interleaved incoherent
bvh               16 any     coherent+point         249999      2000 -      stream      coherent, but triangles are small
bvh               16 any     coherent+point         250000      2000 -      interleaved coherent, but triangles are small
bvh                4 any     coherent+point          50000      2000 -      interleaved coherent, but triangles are small
bvh                8 closest coherent+point          80000      9999 -      interleaved coherent, but triangles are small
bvh               16 count   -                         500      8192 -      stream      all hits of many rays
bvh               16 all     coherent+point            500      8192 -      stream      all hits of many rays
bvh               16 closest fronts                    500      8192 -      stream      front faces of many rays
bvh               16 any     coherent+fronts           500      8192 -      stream      front faces of many rays
kdtree            16 closest -                         500      1024 wide   single      few rays
kdtree            16 closest -                         500      1025 wide   wide_stream incoherent
kdtree            16 closest coherent+point          80000      9999 -      single      coherent, but triangles are small
kdtree            16 closest coherent+point          80000     10000 -      packet      coherent
kdtree            16 any     coherent                 5000      9999 -      single      coherent, but triangles are small
kdtree            16 any     coherent                 5000     10000 -      packet      coherent
kdtree             8 any     -                         500      8192 -      wide_stream incoherent
kdtree            16 any     coherent                80000      9999 wide   wide_stream coherent, but triangles are small
kdtree            16 any     coherent                80000     10000 wide   wide_packet coherent
kdtree            16 closest -                       80000      9999 wide   wide_stream incoherent
kdtree            16 closest -                       98192      8192 90000  wide_stream incoherent
kdtree            16 closest -                       98193      8192 90000  lockstep    incoherent
kdtree            16 closest coherent                90512      8192 90000  wide_stream coherent, but triangles are small
kdtree            16 closest coherent                90513      8192 90000  single      coherent, but triangles are small
kdtree            16 count   -                         500      8192 wide   single      finds all hits
kdtree            16 all     coherent+point            500      8192 wide   single      finds all hits
kdtree            16 closest fronts                    500      8192 wide   single      finds front faces
kdtree            16 any     coherent+fronts           500      8192 wide   single      finds front faces
lazy              16 closest -                         500      8192 wide   lockstep    incoherent
lazy              16 closest coherent+point            500      8192 90000  packet      coherent
lazy              16 count   -                         500      8192 -      single      finds all hits
instances bvh     16 closest coherent+point            500      1024 -      single      few rays
instances bvh     16 closest coherent+point          80000      9999 -      single      one by one: triangles are small
instances bvh     16 closest coherent+point          80000     10000 -      packet      two levels, coherent
instances bvh      8 any     coherent+point          80000     10000 -      packet      two levels, coherent
instances bvh     16 closest coherent                  500    262143 -      single      one by one
instances bvh     16 closest coherent                  500    262144 -      stream      two levels, rays sorted by instance
instances bvh     16 any     coherent+point+fronts     500    262143 -      single      one by one
instances bvh     16 any     coherent+point+fronts     500    262144 -      stream      two levels, rays sorted by instance
instances bvh     16 closest -                         500    262143 -      single      one by one
instances bvh     16 closest -                         500    262144 -      stream      two levels, rays sorted by instance
instances bvh     16 count   coherent+point            500    262144 -      stream      two levels, rays sorted by instance
instances bvh     16 all     coherent+point            500  10000000 -      single      one by one
instances kdtree  16 closest coherent+point            500     10000 -      single      one by one
instances kdtree  16 any     -                         500  10000000 -      single      one by one
spaces            16 closest coherent+point            500     10000 -      single      each tree has its own coordinate space
spaces             8 count   -                         500  10000000 -      single      each tree has its own coordinate space
"""


@pytest.mark.parametrize("line", TABLE.strip().splitlines(), ids=lambda line: " ".join(line[:66].split()))
def test_choices_on_the_cpu(line):
    """Without a sample, for every kind of scene."""
    fields = line.replace("instances ", "instances_").split(maxsplit=8)
    kind, lanes, query, said, triangles, count, wide, name, reason = fields
    reason = re.sub(r"\b(in)?coherent", r"neighbouring rays are \g<0>", reason)
    reason = reason.replace("one by one", "two levels, one ray at a time")
    reason = re.sub("^finds .*", r"the traversal that \g<0> on a kd-tree", reason)
    scene = make_scene(kind.replace("_", " "), int(triangles), width=int(lanes))
    rays = make_rays(int(count), "coherent" in said, "point" in said)
    savings = 0.0 if wide in ("-", "wide") else float(wide)
    assert choose(scene, rays, query, "fronts" in said, wide == "wide", savings) == (name, reason)


@pytest.mark.parametrize("kind", SCENES)
def test_choices_on_cuda(kind):
    """On CUDA each thread traces a ray, whatever the rays are."""
    for count, coherent, shared, query, culls in product(RAYS, (False, True), (False, True), QUERIES, (False, True)):
        scene, rays = make_scene(kind, 1000, cuda=True), make_rays(count, coherent, shared)
        assert choose(scene, rays, query, culls, wide=True) == ("single", "one CUDA thread per ray")


@pytest.mark.parametrize("triangle_test", TRIANGLE_TESTS)
def test_choices_of_a_culling(triangle_test):
    """Cullings by vertices need a test without hits beside the triangle; frusta at leaves need boxes, and rays that do not
    crowd. Where pairs are filtered, crowded rays do without."""
    test = TRIANGLE_TESTS[triangle_test]
    filtered = bool(test.packet_form.pairs)
    packets = [way for way in TRAVERSALS.values() if Capabilities.PACKETS in way.capabilities]
    for way, kind, count, shared in product(packets, ("bvh", "kdtree", "instances bvh"), (3999, 4000, 100_000), (False, True)):
        scene, rays = make_scene(kind, 500), make_rays(count, True, shared)
        crowded = shared and count >= 4000 and kind != "instances bvh"
        boxes = Capabilities.WIDE_FORM in way.capabilities or kind != "kdtree"
        accurate = "vertex" if crowded or not boxes else "transient_frustum"
        if filtered:
            accurate = "interval" if crowded else "leaf_boxes" if boxes else "vertex"
        assert choose_culling(scene, rays, way, test) == (accurate if test.accurate else "interval")


def test_a_new_traversal_is_chosen_by_its_entry(monkeypatch):
    """A line in the table is enough: "auto" takes the entry with the best score where it can answer, and nowhere else."""
    entry = replace(TRAVERSALS["packet"], name="new", score=lambda situation: (9.0, f"{situation.rays} rays"))
    monkeypatch.setitem(TRAVERSALS, "new", entry)
    rays = make_rays(5000, False, False)
    scene = make_scene("bvh", 500)
    assert choose(scene, rays, "closest") == ("new", "5000 rays")
    assert choose(scene, rays, "count")[0] == "stream", "packets do not count"
    assert choose(scene, rays, "closest", culls=True)[0] == "stream", "packets do not cull back faces"
    assert choose(make_scene("spaces", 500), rays, "closest")[0] == "single"
    assert choose(make_scene("instances kdtree", 500), rays, "closest")[0] == "single"
    wide = replace(entry, capabilities=entry.capabilities | Capabilities.WIDE_FORM)
    monkeypatch.setitem(TRAVERSALS, "new", wide)
    assert choose(make_scene("lazy", 500), rays, "closest")[0] == "lockstep", "it is not complete"


# scene, triangles, instances, kind of rays, rays, neighbours; with 16 lanes, share of different steps : steps a ray, choice;
# the same with 8
GRID = """
bunny         69630  0 view      4096 coherent 0.327:2.1   interleaved 0.399:2.7   interleaved
bunny         69630  0 scan      4096 coherent 0.252:6.4   interleaved 0.327:9.2   interleaved
bunny         69630  0 random    4096 parted   -           interleaved -           interleaved
bunny         69630  0 shadow     908 coherent -           stream      -           interleaved
bunny         69630  0 ao         908 parted   -           interleaved -           interleaved
bunny         69630  0 view     65536 coherent 0.191:2.4   packet      0.207:2.6   packet
bunny         69630  0 scan     65536 coherent 0.173:6.5   packet      0.168:9.1   packet
bunny         69630  0 random   65536 parted   -           interleaved -           interleaved
bunny         69630  0 shadow   14567 coherent 0.312:5.8   stream      0.325:8.5   interleaved
bunny         69630  0 ao       14567 parted   -           interleaved -           interleaved
bunny         69630  0 view   1048576 coherent 0.168:1.9   packet      0.146:2.6   packet
bunny         69630  0 scan   1048576 coherent 0.155:6.5   packet      0.137:9.2   packet
bunny         69630  0 random 1048576 parted   -           interleaved -           interleaved
bunny         69630  0 shadow  233064 coherent 0.186:7.4   packet      0.169:9.6   packet
bunny         69630  0 ao      233064 parted   -           stream      -           interleaved
world        788410  0 view      4096 coherent 0.223:1.9   packet      0.155:1.5   packet
world        788410  0 scan      4096 coherent 0.235:11.1  packet      0.29:13.9   interleaved
world        788410  0 random    4096 parted   -           interleaved -           interleaved
world        788410  0 shadow    1291 coherent -           interleaved -           interleaved
world        788410  0 ao        1291 parted   -           interleaved -           interleaved
world        788410  0 view     65536 coherent 0.129:1.8   packet      0.147:2.0   packet
world        788410  0 scan     65536 coherent 0.196:10.1  packet      0.166:13.1  packet
world        788410  0 random   65536 parted   -           interleaved -           interleaved
world        788410  0 shadow   20738 coherent 0.189:1.9   packet      0.169:2.4   packet
world        788410  0 ao       20738 parted   -           interleaved -           interleaved
world        788410  0 view   1048576 coherent 0.125:1.5   packet      0.128:1.5   packet
world        788410  0 scan   1048576 coherent 0.165:10.3  packet      0.135:13.2  packet
world        788410  0 random 1048576 parted   -           interleaved -           interleaved
world        788410  0 shadow  331619 coherent 0.153:1.9   packet      0.198:2.9   packet
world        788410  0 ao      331619 parted   -           interleaved -           interleaved
instances    788410 11 view      4096 coherent -           single      -           single
instances    788410 11 scan      4096 coherent -           single      -           single
instances    788410 11 random    4096 parted   -           single      -           single
instances    788410 11 shadow    1291 coherent -           single      -           single
instances    788410 11 ao        1291 parted   -           single      -           single
instances    788410 11 view     65536 coherent 0.127:2.4   packet      0.142:2.5   packet
instances    788410 11 scan     65536 coherent 0.204:11.2  packet      0.166:13.0  packet
instances    788410 11 random   65536 parted   -           single      -           single
instances    788410 11 shadow   20738 coherent 0.182:3.4   packet      0.171:3.8   packet
instances    788410 11 ao       20738 parted   -           single      -           single
instances    788410 11 view   1048576 coherent 0.125:2.1   packet      0.127:2.0   packet
instances    788410 11 scan   1048576 coherent 0.181:11.3  packet      0.141:13.1  packet
instances    788410 11 random 1048576 parted   -           stream      -           stream
instances    788410 11 shadow  331619 coherent 0.16:3.7    packet      0.146:4.4   packet
instances    788410 11 ao      331619 parted   -           single      -           single
city         995330  0 view      4096 coherent 0.501:3.1   interleaved 0.525:4.2   interleaved
city         995330  0 scan      4096 coherent 0.25:9.4    interleaved 0.299:11.6  interleaved
city         995330  0 random    4096 parted   -           interleaved -           interleaved
city         995330  0 shadow    1555 coherent -           interleaved -           interleaved
city         995330  0 ao        1555 parted   -           interleaved -           interleaved
city         995330  0 view     65536 coherent 0.353:3.0   interleaved 0.35:4.1    interleaved
city         995330  0 scan     65536 coherent 0.17:9.0    packet      0.183:11.3  packet
city         995330  0 random   65536 parted   -           interleaved -           interleaved
city         995330  0 shadow   25081 coherent 0.485:6.7   interleaved 0.437:8.6   interleaved
city         995330  0 ao       25081 parted   -           interleaved -           interleaved
city         995330  0 view   1048576 coherent 0.211:2.7   packet      0.223:3.9   packet
city         995330  0 scan   1048576 coherent 0.145:8.7   packet      0.138:11.1  packet
city         995330  0 random 1048576 parted   -           interleaved -           interleaved
city         995330  0 shadow  401215 coherent 0.304:7.0   interleaved 0.277:9.2   interleaved
city         995330  0 ao      401215 parted   -           interleaved -           interleaved
dragon       202520  0 view      4096 coherent 0.396:2.5   interleaved 0.44:2.4    interleaved
dragon       202520  0 scan      4096 coherent 0.21:11.0   packet      0.261:14.0  interleaved
dragon       202520  0 random    4096 parted   -           interleaved -           interleaved
dragon       202520  0 shadow     850 coherent -           stream      -           interleaved
dragon       202520  0 ao         850 parted   -           interleaved -           interleaved
dragon       202520  0 view     65536 coherent 0.242:2.2   interleaved 0.326:3.1   interleaved
dragon       202520  0 scan     65536 coherent 0.153:10.4  packet      0.161:13.9  packet
dragon       202520  0 random   65536 parted   -           interleaved -           interleaved
dragon       202520  0 shadow   13588 coherent 0.353:7.1   stream      0.374:9.7   interleaved
dragon       202520  0 ao       13588 parted   -           interleaved -           interleaved
dragon       202520  0 view   1048576 coherent 0.15:1.8    packet      0.181:3.7   packet
dragon       202520  0 scan   1048576 coherent 0.14:10.4   packet      0.14:13.4   packet
dragon       202520  0 random 1048576 parted   -           interleaved -           interleaved
dragon       202520  0 shadow  217356 coherent 0.18:6.9    packet      0.182:8.7   packet
dragon       202520  0 ao      217356 parted   -           stream      -           interleaved
large_dragon 810080  0 view      4096 coherent 0.462:2.7   interleaved 0.506:2.8   interleaved
large_dragon 810080  0 scan      4096 coherent 0.233:11.6  packet      0.294:15.3  interleaved
large_dragon 810080  0 random    4096 parted   -           interleaved -           interleaved
large_dragon 810080  0 shadow     850 coherent -           interleaved -           interleaved
large_dragon 810080  0 ao         850 parted   -           interleaved -           interleaved
large_dragon 810080  0 view     65536 coherent 0.294:2.3   interleaved 0.394:3.5   interleaved
large_dragon 810080  0 scan     65536 coherent 0.179:11.1  packet      0.18:15.9   packet
large_dragon 810080  0 random   65536 parted   -           interleaved -           interleaved
large_dragon 810080  0 shadow   13588 coherent 0.455:8.2   interleaved 0.467:11.2  interleaved
large_dragon 810080  0 ao       13588 parted   -           interleaved -           interleaved
large_dragon 810080  0 view   1048576 coherent 0.176:2.0   packet      0.211:3.9   packet
large_dragon 810080  0 scan   1048576 coherent 0.159:11.2  packet      0.145:15.7  packet
large_dragon 810080  0 random 1048576 parted   -           interleaved -           interleaved
large_dragon 810080  0 shadow  217356 coherent 0.247:7.6   interleaved 0.22:10.3   packet
large_dragon 810080  0 ao      217356 parted   -           interleaved -           interleaved
"""


def facts_of(line: str) -> tuple[str, int, int, str, int, bool, dict[int, tuple[Overlap | None, str]]]:
    scene, triangles, instances, kind, rays, neighbours, share16, choice16, share8, choice8 = line.split()
    overlaps = [None if share == "-" else Overlap(*map(float, share.split(":"))) for share in (share16, share8)]
    found = {16: (overlaps[0], choice16), 8: (overlaps[1], choice8)}
    return scene, int(triangles), int(instances), kind, int(rays), neighbours == "coherent", found


CASES = [facts_of(line) for line in GRID.strip().splitlines()]


@pytest.mark.parametrize("lanes", [8, 16])
def test_choices_in_the_grid(lanes):
    """Every case of the grid; a sample is traced exactly where only it can tell."""
    for scene, triangles, instances, kind, rays, coherent, found in CASES:
        overlap, expected = found[lanes]
        few = few_rays(triangles, not instances, threads=2)
        facts = SceneFacts(tree="bvh", width=lanes, triangles=triangles, instances=instances, few_rays=few)
        known = RayFacts(rays, (rays,), kind in ("view", "scan"), coherent)
        told = situation_of(facts, known, "any" if kind in ("shadow", "ao") else "closest")
        assert told.needs_sample == (overlap is not None), (scene, kind, rays)
        told = told if overlap is None else told._replace(overlap=overlap)
        assert choose_traversal(facts, told)[0] == expected, (scene, kind, rays)


@pytest.mark.parametrize(
    ("triangles", "in_bvh", "threads", "limit"),
    [(49_999, True, 2, 1024), (50_000, True, 7, 512), (50_000, True, 8, 1024), (50_000, False, 2, 1024)],
)
def test_few_rays(triangles, in_bvh, threads, limit):
    """A case on both sides of each limit."""
    assert few_rays(triangles, in_bvh, threads) == limit


@pytest.mark.parametrize("shared", [False, True])
def test_the_greatest_share(shared):
    """Packets up to it, whatever the length of walks, and not beyond."""
    scene, rays = make_scene("bvh", 1_000_000), make_rays(65_536, True, shared)
    told = situation_of(scene, rays, "closest")
    for steps in (2.0, 9.0):
        assert choose_traversal(scene, told._replace(overlap=Overlap(GREATEST_SHARE, steps)))[0] == "packet"
        assert choose_traversal(scene, told._replace(overlap=Overlap(GREATEST_SHARE + 0.001, steps)))[0] == "interleaved"


def test_the_grid_has_all_kinds():
    """Each traversal for rays on a BVH is somewhere the best."""
    assert len(CASES) == 90
    for lanes in (8, 16):
        assert {found[lanes][1] for *_, found in CASES} == {"single", "packet", "interleaved", "stream"}


@pytest.mark.parametrize(
    ("width", "tree", "count", "shared", "expected"),
    [
        (16, "bvh", 799, True, 32),
        (16, "bvh", 800, True, 64),
        (16, "bvh", 99, True, 32),
        (8, "bvh", 799, True, 32),
        (8, "bvh", 100, False, 32),
        (8, "bvh", 99, False, 16),
        (4, "bvh", 99, True, 16),
        (8, "bvh", 800, True, 64),
        (4, "bvh", 800, False, 32),
        (2, "bvh", 800, False, 32),
        (8, "kdtree", 799, True, 16),
        (8, "kdtree", 800, True, 64),
    ],
)
def test_rays_of_packets(width, tree, count, shared, expected):
    """Packets on boxes have 32 rays; 16 of 8 lanes if triangles are more than rays; 64 where rays from one point crowd
    (notebooks/records/2026-11-28-auto.md, 2026-11-28-engines-by-name.md)."""
    scene, rays = SceneFacts(tree=tree, width=width, triangles=100), RayFacts(count, (count,), shared_origin=shared)
    assert packet_rays(scene, rays, TRAVERSALS["packet"], width) == expected


@pytest.mark.parametrize("elsewhere", [{"is_cuda": True}, {"instances": 3}])
def test_packets_have_two_vectors_elsewhere(elsewhere):
    scene, rays = SceneFacts(tree="bvh", width=8, triangles=100, **elsewhere), RayFacts(100, (100,), shared_origin=True)
    assert packet_rays(scene, rays, TRAVERSALS["packet"], 8) == 16


ROOMS = [Path(room.__file__).parent for room in (wrt.engine, wrt.kernels)]


def test_nothing_compares_the_name_of_a_traversal():
    """What a traversal can do is in its entry: no `if name == "packet"`, no list of names."""
    files = [file for room in ROOMS for file in sorted(room.rglob("*.py"))]
    assert len(files) > 50
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Compare):
                values = {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)}
                assert not values & TRAVERSALS.keys(), f"{file}:{node.lineno} compares {values}"
