"""What "auto" chooses in a grid of cases, for 8 and 16 lanes: first guesses by the rules of
notebooks/records/2026-11-28-auto.md; for few rays notebooks/records/2026-11-23-few-rays.md.

Nothing is traced: each line holds what a sample of packets of the case shares. `wrt bench auto` makes the cases and times the
choices on any machine. A changed choice is no error, but needs a new record.
"""

from __future__ import annotations

import pytest

from wrt.engine.facts.facts import RayFacts, SceneFacts
from wrt.engine.facts.query_kinds import few_rays
from wrt.engine.plan import planner
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.traversal_scores import Overlap

# scene, triangles, instances, kind of rays, rays, neighbours; with 16 lanes, share of different steps : steps a ray, choice;
# the same with 8
GRID = """
bunny         69630  0 view      4096 coherent 0.327:2.1   interleaved 0.399:2.7   interleaved
bunny         69630  0 scan      4096 coherent 0.252:6.4   interleaved 0.327:9.2   interleaved
bunny         69630  0 random    4096 parted   -           interleaved -           interleaved
bunny         69630  0 shadow     908 coherent -           interleaved -           interleaved
bunny         69630  0 ao         908 parted   -           interleaved -           interleaved
bunny         69630  0 view     65536 coherent 0.191:2.4   packet      0.207:2.6   packet
bunny         69630  0 scan     65536 coherent 0.173:6.5   packet      0.168:9.1   packet
bunny         69630  0 random   65536 parted   -           interleaved -           interleaved
bunny         69630  0 shadow   14567 coherent 0.312:5.8   interleaved 0.325:8.5   interleaved
bunny         69630  0 ao       14567 parted   -           interleaved -           interleaved
bunny         69630  0 view   1048576 coherent 0.168:1.9   packet      0.146:2.6   packet
bunny         69630  0 scan   1048576 coherent 0.155:6.5   packet      0.137:9.2   packet
bunny         69630  0 random 1048576 parted   -           interleaved -           interleaved
bunny         69630  0 shadow  233064 coherent 0.186:7.4   packet      0.169:9.6   packet
bunny         69630  0 ao      233064 parted   -           interleaved -           interleaved
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
dragon       202520  0 shadow     850 coherent -           interleaved -           interleaved
dragon       202520  0 ao         850 parted   -           interleaved -           interleaved
dragon       202520  0 view     65536 coherent 0.242:2.2   interleaved 0.326:3.1   interleaved
dragon       202520  0 scan     65536 coherent 0.153:10.4  packet      0.161:13.9  packet
dragon       202520  0 random   65536 parted   -           interleaved -           interleaved
dragon       202520  0 shadow   13588 coherent 0.353:7.1   interleaved 0.374:9.7   interleaved
dragon       202520  0 ao       13588 parted   -           interleaved -           interleaved
dragon       202520  0 view   1048576 coherent 0.15:1.8    packet      0.181:3.7   packet
dragon       202520  0 scan   1048576 coherent 0.14:10.4   packet      0.14:13.4   packet
dragon       202520  0 random 1048576 parted   -           interleaved -           interleaved
dragon       202520  0 shadow  217356 coherent 0.18:6.9    packet      0.182:8.7   packet
dragon       202520  0 ao      217356 parted   -           interleaved -           interleaved
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
def test_choices(lanes):
    """Every case of the grid; a sample is traced exactly where only it can tell."""
    for scene, triangles, instances, kind, rays, coherent, found in CASES:
        overlap, expected = found[lanes]
        few = few_rays(triangles, not instances)
        facts = SceneFacts(tree="bvh", width=lanes, triangles=triangles, instances=instances, few_rays=few)
        known = RayFacts(rays, (rays,), kind in ("view", "scan"), coherent)
        told = planner.situation_of(facts, known, "any" if kind in ("shadow", "ao") else "closest")
        assert told.needs_sample == (overlap is not None), (scene, kind, rays)
        told = told if overlap is None else told._replace(overlap=overlap)
        assert planner.choose_traversal(facts, told)[0] == expected, (scene, kind, rays)


def test_the_grid_has_all_kinds():
    """Each traversal for rays on a BVH is somewhere the best."""
    assert len(CASES) == 90
    for lanes in (8, 16):
        assert {found[lanes][1] for *_, found in CASES} == {"single", "packet", "interleaved", "stream"}


@pytest.mark.parametrize(
    ("lanes", "tree", "count", "shared", "vectors"),
    [
        (16, "bvh", 799, True, 2),
        (16, "bvh", 800, True, 4),
        (8, "bvh", 799, True, 4),
        (8, "bvh", 800, True, 8),
        (8, "bvh", 800, False, 4),
        (4, "bvh", 800, False, 8),
        (8, "kdtree", 799, True, 2),
        (8, "kdtree", 800, True, 8),
    ],
)
def test_rays_of_packets(lanes, tree, count, shared, vectors):
    """Packets on boxes have 32 rays, and 64 where rays from one point crowd (notebooks/records/2026-11-28-auto.md)."""
    scene, rays = SceneFacts(tree=tree, width=lanes, triangles=100), RayFacts(count, (count,), shared_origin=shared)
    assert planner.packet_vectors(scene, rays, TRAVERSALS["packet"]) == vectors


@pytest.mark.parametrize("elsewhere", [{"is_cuda": True}, {"instances": 3}])
def test_packets_have_two_vectors_elsewhere(elsewhere):
    scene, rays = SceneFacts(tree="bvh", width=8, triangles=100, **elsewhere), RayFacts(100, (100,), shared_origin=True)
    assert planner.packet_vectors(scene, rays, TRAVERSALS["packet"]) == 2
