"""What "auto" chooses: the traversal and the reason, and the culling, for every kind of scene, batch and query."""

from __future__ import annotations

import ast
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest

import wrt.engine
import wrt.kernels
from wrt.engine.facts.facts import RayFacts, SceneFacts
from wrt.engine.facts.wide_trees import wide_form_pays
from wrt.engine.plan.planner import choose_culling, choose_traversal, situation_of
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.triangle import TRIANGLE_TESTS

SCENES = ("bvh", "kdtree", "lazy", "instances bvh", "instances kdtree", "spaces")
RAYS = (1, 1024, 1025, 100_000, 10_000_000)
QUERIES = ("closest", "any", "count", "all")
TRIANGLES = (500, 49_999, 50_000, 1_000_000)

SIMILAR, DISSIMILAR = "neighbouring rays are coherent", "neighbouring rays are incoherent"
SINGLE_RAYS = "two levels, one ray at a time"


def make_scene(kind: str, triangles: int, cuda: bool = False) -> SceneFacts:
    """The facts about a scene that a choice depends on."""
    return SceneFacts(
        tree="kdtree" if kind in ("kdtree", "lazy", "instances kdtree") else "bvh",
        width=16,
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


def expected(
    kind: str,
    triangles: int,
    wide: bool,
    savings: float,
    count: int,
    coherent: bool,
    shared: bool,
    query: str,
    culls: bool,
) -> tuple[str, str]:
    """The choice on the CPU, case by case."""
    if kind == "spaces":
        return "single", "each tree has its own coordinate space"
    if count <= 1024:
        return "single", "few rays"
    if kind == "instances kdtree" or (kind == "instances bvh" and query == "all"):
        return "single", SINGLE_RAYS
    if kind == "instances bvh" and coherent and shared and query in ("closest", "any") and not culls:
        if 8 * count >= triangles:
            return "packet", f"two levels, {SIMILAR}"
        return "single", f"{SINGLE_RAYS}: triangles are small"
    if kind == "instances bvh":
        return ("stream", "two levels, rays sorted by instance") if count >= 8 * 32768 else ("single", SINGLE_RAYS)
    if query in ("count", "all") or culls:
        hits = "all hits" if query in ("count", "all") else "front faces"
        if kind == "bvh":
            return "stream", f"{hits} of many rays"
        return "single", f"the traversal that finds {hits} on a kd-tree"
    is_wide = kind == "kdtree" and (wide or savings + count / (16 if coherent else 1) >= triangles)
    if kind != "bvh" and not is_wide and coherent:
        crowd = (8 * count if shared else count // 2) >= triangles
        return ("packet", SIMILAR) if crowd else ("single", f"{SIMILAR}, but triangles are small")
    if kind != "bvh" and not is_wide:
        return "lockstep", DISSIMILAR
    stream, packet = ("wide_stream", "wide_packet") if is_wide else ("stream", "packet")
    if kind == "bvh" and triangles >= 50_000:
        stream = "interleaved"
    if not coherent:
        return stream, DISSIMILAR
    return (packet, SIMILAR) if 8 * count >= triangles else (stream, f"{SIMILAR}, but triangles are small")


@pytest.mark.parametrize("kind", SCENES)
def test_choices_on_the_cpu(kind):
    """Every combination of facts, which no scene of a test's size would reach."""
    chosen = set()
    for facts in product(
        TRIANGLES, (False, True), (0.0, 990_000.0), RAYS, (False, True), (False, True), QUERIES, (False, True)
    ):
        triangles, wide, savings, count, coherent, shared, query, culls = facts
        scene = make_scene(kind, triangles)
        choice = choose(scene, make_rays(count, coherent, shared), query, culls, wide, savings)
        assert choice == expected(kind, *facts), facts
        chosen.add(choice)
    assert (
        len(chosen)
        == {
            "bvh": 8,
            "kdtree": 9,
            "lazy": 6,
            "instances bvh": 5,
            "instances kdtree": 2,
            "spaces": 1,
        }[kind]
    )


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
