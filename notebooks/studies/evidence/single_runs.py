"""One run of each study whose figures stand in pages; several runs, each in its process, make a file in notebooks/results/.

python -m studies measure komatsu --models FOLDER --json run-1.json
python -m studies figures --collect komatsu run-*.json
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrt.meshes.mesh import TriangleMesh

LARGE_LEAF = 512
"""Triangles below which a node is not divided, for leaves of hundreds."""

Row = dict[str, Any]
Tables = dict[str, list[Row]]


@dataclass(frozen=True)
class Effort:
    """How much is measured: `rounds` in which contenders take turns, `size` of a view, `tests` of a call."""

    rounds: int = 5
    size: int = 256
    tests: int = 1 << 21

    @property
    def settings(self) -> dict[str, int]:
        """For the results."""
        return {"rounds": self.rounds, "size": self.size, "tests": self.tests}


@dataclass(frozen=True)
class Study:
    """Attributes: run: makes the tables, from a folder of models or None. sources: modules. is_counted: one run is enough."""

    run: Callable[[Path | None, Effort], Tables]
    sources: Sequence[str]
    is_counted: bool = False


def named(mesh: TriangleMesh, rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Rows with the name of their scene."""
    return [{"scene": mesh.name} | dict(row) for row in rows]


def komatsu_counts(models: Path | None, effort: Effort) -> Tables:
    """Table 1: operations; and bytes of the engine's records by test."""
    from studies.triangles.komatsu_tables import table_1
    from wrt.kernels.triangle import TRIANGLE_TESTS

    counts = ("triangle", "precomputation", "test")
    return {
        "1": [{"algorithm": row["algorithm"]} | {name: float(row[name]) for name in counts} for row in table_1()],
        "records": [{"test": name, "bytes": float(test.record.test_bytes)} for name, test in TRIANGLE_TESTS.items()],
    }


def komatsu_scenes(models: Path | None, effort: Effort) -> Tables:
    """Table 2 on the scenes of `komatsu_packets`."""
    from studies.triangles import komatsu_packets, komatsu_tables

    rows = []
    for mesh in komatsu_packets.scenes(models).values():
        found = komatsu_tables.contenders(mesh, rounds=effort.rounds, tests=effort.tests, pixels=effort.size)
        rows += named(mesh, [short(row, "contender") for row in found])
    return {"2": rows}


def komatsu(models: Path | None, effort: Effort) -> Tables:
    """Tables 3 and 4, the order of triangles, and bundles."""
    from studies.triangles import komatsu_packets, komatsu_tables

    meshes = [*komatsu_packets.scenes(models).values()][:2]
    tables: Tables = {"3": [], "4": [], "foreseen": [], "bundles": []}
    for mesh in meshes:
        shares = komatsu_tables.exit_shares(mesh, tests=effort.tests >> 3)
        tables["3"] += named(mesh, [short(row, "contender", "exit", measures=("tests",)) for row in shares])
        tree = komatsu_tables.with_tree(mesh, rounds=effort.rounds, pixels=effort.size)
        tables["4"] += named(mesh, [short(row, "contender", "traversal") for row in tree])
        bundled = komatsu_packets.bundles(mesh, rounds=effort.rounds, pairs=effort.tests >> 1)
        tables["bundles"] += named(
            mesh, [short(row, "contender", "kind", measures=("ratio", "ratio_counted")) for row in bundled]
        )
    order = komatsu_tables.foreseen(meshes[0], rounds=effort.rounds, tests=effort.tests)
    tables["foreseen"] = [short(row, "contender", "order", measures=("nanoseconds",)) for row in order]
    return tables


def komatsu_depths(models: Path | None, effort: Effort) -> Tables:
    """Table 4's large models: the second of the scenes with every triangle divided into 16, in trees of limited depth.

    Building takes most of a run, so one run has to do: rounds show the spread.
    """
    from studies.triangles import komatsu_packets, komatsu_tables

    mesh = komatsu_tables.tessellated([*komatsu_packets.scenes(models).values()][1], 2)
    found = komatsu_tables.depth_limits(mesh, pixels=effort.size, rounds=effort.rounds)
    spread = ("ratio", "least", "greatest")
    rows = [short(row, "contender", "traversal", "limit", measures=spread) | {"rounds": float(effort.rounds)} for row in found]
    return {"depths": named(mesh, rows)}


def inside_first(models: Path | None, effort: Effort) -> Tables:
    """Where Plücker's test ends if the edges are asked first; counted."""
    from studies.triangles import komatsu_packets
    from studies.triangles.inside_first import compare_orders

    rows = []
    for mesh in [*komatsu_packets.scenes(models).values()][:2]:
        found = compare_orders(mesh, tests=effort.tests, rounds=1)
        rows += named(mesh, [short(row, "order", "exit", measures=("tests", "vectors")) for row in found])
    return {"orders": rows}


def pichler(models: Path | None, effort: Effort) -> Tables:
    """Tables 6.1 to 6.4."""
    from studies.triangles import pichler_tables as tables

    size, rounds = effort.size // 16 * 8, effort.rounds
    first = tables.pruning_tests(size=effort.size // 8)
    fourth = tables.errors(("stadium",), size=40, samples=12, reference_samples=96, rounds=rounds)
    return {
        "6.1": [short(row, "scene", "variant", measures=("percent",)) for row in first],
        "6.2": [
            short(row, "scene", "mode", "test") for row in tables.pruning_times(size=size, rounds=rounds, modes=("alone",))
        ],
        "6.3": [
            short(row, "scene", "mode", "test", measures=("ratio", "hit_rate"))
            for row in tables.times(size=size, rounds=rounds)
        ],
        "6.4": [short(row, "scene", "test", measures=("error", "bias")) for row in fourth],
    }


def fans(models: Path | None, effort: Effort) -> Tables:
    """Brute force over fans, and leaves of fans."""
    from studies.triangles.fan_comparison import compare, compare_trees

    alone, trees = compare(size=16, rounds=effort.rounds), compare_trees(size=effort.size // 8 * 4, rounds=effort.rounds)
    return {
        "brute force": [short(row, "way", "scene") for row in alone],
        "trees": [short(row, "way", "scene") for row in trees],
    }


def traversal(models: Path | None, effort: Effort) -> Tables:
    """Packets against single rays, for a view."""
    from studies.kdtrees.packet_speeds import packet_speeds

    return {"speeds": packet_speeds(effort.size, effort.rounds)}


def kdtree_builders(models: Path | None, effort: Effort) -> Tables:
    """Builders of Algorithms 4.1.3 and 4.1.4."""
    from studies.kdtrees.kdtree_comparison import compare_builders
    from wrt.scenes import build

    rows = []
    for mesh in (build("teapot", level=12, ground=False), build("wood", trees=4)):
        for row in compare_builders(mesh, ("sweep", "sorting_sweep"), rounds=effort.rounds, size=64):
            rows.append(
                {"scene": mesh.name, "builder": row.builder, "build": float(row.build_ratio), "cost": float(row.sah_ratio)}
            )
    return {"builders": rows}


def dynamic(models: Path | None, effort: Effort) -> Tables:
    """Rebuilds of subtrees, instances, groups, two trees, split threads."""
    from studies.moving.motion_run import motion_tables

    return motion_tables(effort.rounds)


def thread_growth(models: Path | None, effort: Effort) -> Tables:
    """Builds, updates of groups and rays by the number of threads, on the second scene of `komatsu_packets`."""
    from studies.kdtrees.thread_growth import thread_growth as compare
    from studies.triangles import komatsu_packets

    mesh = [*komatsu_packets.scenes(models).values()][1]
    rows = compare(mesh, rounds=effort.rounds, size=4 * effort.size)
    return {"threads": [short(row, "what", "threads", measures=("seconds", "speed")) for row in rows]}


def leaf_sizes(models: Path | None, effort: Effort) -> Tables:
    """Tests that cullings avoid in small and in large leaves; counted."""
    from studies.kdtrees.leaf_sizes import compare_leaf_sizes
    from studies.triangles import komatsu_packets

    rows = []
    for mesh in [*komatsu_packets.scenes(models).values()][:2]:
        options = {"leaves": (0, LARGE_LEAF), "cullings": ("vertex", "interval"), "size": effort.size, "rounds": 1}
        for found in compare_leaf_sizes(mesh, **options):
            leaf = {"scene": mesh.name, "leaf": str(found.leaf_triangles), "culling": found.culling}
            rows.append(leaf | {"avoided": 100.0 * found.culled, "triangles": found.mean_leaf, "nodes": float(found.nodes)})
    return {"leaves": rows}


def bounces(models: Path | None, effort: Effort) -> Tables:
    """Steps of packets through a kd-tree over those of omnidirectional packets, and rays of a packet at a leaf; counted."""
    from studies.light.bounce_comparison import compare_bounces
    from studies.triangles import komatsu_packets
    from wrt.scenes import build

    steps, leaves = [], []
    for mesh in [*[*komatsu_packets.scenes(models).values()][:2], build("atrium"), build("cornell_box")]:
        ways = ("kd-tree packets", "omnidirectional", "types", "single")
        found = {(r.bounce, r.way): r for r in compare_bounces(mesh, mesh.name, size=effort.size, rounds=1, ways=ways)}
        last = min(9, max(bounce for bounce, _ in found))
        for bounce, name in ((0, "0"), (last, "9")):
            packets, omnidirectional, types, single = (found[bounce, way] for way in ways)
            key = {"scene": mesh.name, "bounce": name}
            steps.append(key | {"fewer": packets.steps / omnidirectional.steps})
            leaves.append(key | {"rays": single.leaves / types.leaves})
    return {"steps": steps, "leaves": leaves}


def fuzzy_boxes(models: Path | None, effort: Effort) -> Tables:
    """Areas of fuzzy boxes and triangle tests in trees of them, by clusters and frames; counted."""
    from studies.moving.motion_run import fuzzy_boxes as compare

    return {"boxes": [short(row, "clusters", "frames", measures=("area", "tests")) for row in compare(rounds=1)]}


def plane_places(models: Path | None, effort: Effort) -> Tables:
    """Whether planes of least cost lie between the medians; counted."""
    from studies.kdtrees.plane_places import compare_places

    return {"places": compare_places()}


def ray_distribution(models: Path | None, effort: Effort) -> Tables:
    """Sections 6.2.1 to 6.2.3, 6.2.6 and 6.2.7: precision of estimates, and what each heuristic gains; counted."""
    from studies.known_rays.area_tables import gains, precision

    return {"precision": precision(), "gains": gains()}


def short(row: Mapping[str, Any], *keys: str, measures: Sequence[str] = ("ratio",)) -> Row:
    """Some of the parts of a row: the key as text, the measures as floats."""
    return {key: str(row[key]) for key in keys} | {name: float(row[name]) for name in measures}


STUDIES = {
    "komatsu_counts": Study(komatsu_counts, ("studies.triangles.komatsu_tables",), is_counted=True),
    "komatsu_scenes": Study(komatsu_scenes, ("studies.triangles.komatsu_tables",)),
    "komatsu": Study(komatsu, ("studies.triangles.komatsu_tables", "studies.triangles.komatsu_packets")),
    "komatsu_depths": Study(komatsu_depths, ("studies.triangles.komatsu_tables",)),
    "inside_first": Study(inside_first, ("studies.triangles.inside_first",), is_counted=True),
    "pichler": Study(pichler, ("studies.triangles.pichler_tables",)),
    "fans": Study(fans, ("studies.triangles.fan_comparison",)),
    "traversal": Study(traversal, ("studies.kdtrees.packet_speeds",)),
    "kdtree_builders": Study(kdtree_builders, ("studies.kdtrees.kdtree_comparison",)),
    "thread_growth": Study(thread_growth, ("studies.kdtrees.thread_growth",)),
    "leaf_sizes": Study(leaf_sizes, ("studies.kdtrees.leaf_sizes",), is_counted=True),
    "bounces": Study(bounces, ("studies.light.bounce_comparison",), is_counted=True),
    "fuzzy_boxes": Study(fuzzy_boxes, ("studies.moving.motion_run", "studies.moving.motion_costs"), is_counted=True),
    "plane_places": Study(plane_places, ("studies.kdtrees.plane_places",), is_counted=True),
    "ray_distribution": Study(ray_distribution, ("studies.known_rays.area_tables",), is_counted=True),
    "dynamic": Study(dynamic, ("studies.moving.motion_run", "studies.moving.motion_costs")),
}
"""By the name of the results."""
