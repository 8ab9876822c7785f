"""The tutorial on adding an algorithm, followed to the letter: its code is registered and must pass the tests of the table."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import test_algorithms
import test_kdtree_builders
import test_split_clipping
import test_traversal
import test_triangle_properties
import test_triangle_tests
from conftest import SCENES

import wrt
from studies.kdtrees.kdtree_pictures import color_of
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities, KdTreeBuilder
from wrt.engine.facts.query_kinds import Query
from wrt.engine.rays.rays import as_rays
from wrt.kernels.answers import ANSWERS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.query.answers import ray_values

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "adding.md").read_text(encoding="utf-8")

TABLES = {"KDTREE_BUILDERS": KDTREE_BUILDERS, "TRIANGLE_TESTS": TRIANGLE_TESTS}
EXAMPLES = {"mean_split": "KDTREE_BUILDERS", "dot_products": "TRIANGLE_TESTS"}
"""The tutorial's algorithms, and the table that each goes into."""


def block(mark: str) -> str:
    """The only code block of the page after a comment."""
    (code,) = re.findall(rf"^<!-- {re.escape(mark)} -->\n```\w+\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return code


def rows() -> list[str]:
    """The rows that the page adds to docs/algorithms.md."""
    return re.findall(r"^<!-- row -->\n```markdown\n(.*?)\n```", PAGE, re.DOTALL | re.MULTILINE)


def module_of(name: str, folder: Path) -> ModuleType:
    """The tutorial's file, imported."""
    path = folder / f"{name}.py"
    path.write_text(block(f"file: {path.name}"), encoding="utf-8")
    spec = spec_from_file_location(name, path)
    module = module_from_spec(spec)
    sys.modules[name] = module  # Warp looks for the source of kernels by the module's name
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    """The tutorial's query kind, in the table while tests ask for it."""
    folder = tmp_path_factory.mktemp("kind")
    kind = eval(block("entry: ANSWERS"), {"odd_crossings": module_of("odd_crossings", folder)})
    assert kind.name not in ANSWERS
    ANSWERS[kind.name] = kind
    yield kind.name
    del ANSWERS[kind.name]
    sys.modules.pop("odd_crossings")


ABLE = [(name, tree) for name, way in TRAVERSALS.items() for tree, on in way.on.items() if on.each_hit and on.kinds is None]
"""Traversals and trees on which each hit is offered to a kind of query."""


def rays_through(mesh: wrt.TriangleMesh) -> tuple:
    """Origins and directions of rays in and around a mesh; some end, some start between crossings."""
    rng = np.random.default_rng(11)
    low, high = mesh.bounds
    origins = rng.uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (400, 3)).astype(np.float32)
    t_max = np.where(rng.random(400) < 0.3, rng.random(400), np.inf).astype(np.float32)
    return origins, rng.normal(size=(400, 3)).astype(np.float32), 0.0, t_max


@pytest.mark.parametrize(("traversal", "tree"), ABLE)
@pytest.mark.parametrize("mesh", ["teapot", "grid"])
def test_query_kind_on_every_traversal(odd, mesh, traversal, tree):
    """As the parity of counts by brute force; both parities occur."""
    mesh = SCENES[mesh]()
    scene = wrt.Scene(mesh, wrt.KdTree() if tree == "kdtree" else wrt.Bvh(), device="cpu")
    rays = rays_through(mesh)
    expected = scene.count(*rays, traversal="brute") % 2 == 1
    assert 20 < expected.sum() < 380
    found = ray_values(scene.state, as_rays(*rays), Query(odd, traversal))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
def test_query_kind_through_instances(odd, tree):
    mesh = SCENES["teapot"]()
    moved = np.eye(4)
    moved[:3, 3] = 0.25 * np.ptp(mesh.bounds, axis=0)
    scene = wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, moved)], tree, device="cpu")
    rays = rays_through(mesh)
    found = ray_values(scene.state, as_rays(*rays), Query(odd))
    np.testing.assert_array_equal(found, scene.count(*rays) % 2 == 1)
    if tree == "bvh":
        found = ray_values(scene.state, as_rays(*rays), Query(odd, "stream"))
        np.testing.assert_array_equal(found, scene.count(*rays) % 2 == 1)


def test_query_kind_needs_a_traversal_that_offers_each_hit(odd):
    scene = wrt.Scene(SCENES["teapot"](), "bvh", device="cpu")
    with pytest.raises(ValueError, match="'packet' does not answer the query 'odd'"):
        ray_values(scene.state, as_rays([0.0, 0, 9], [0.0, 0, -1], 0.0, 9.0), Query(odd, "packet"))


def entry_of(name: str, folder: Path):
    """The entry that the tutorial adds to a table."""
    names = {"KdTreeBuilder": KdTreeBuilder, "BuilderCapabilities": BuilderCapabilities}
    return eval(block(f"entry: {EXAMPLES[name]}"), {name: module_of(name, folder), **names})


@pytest.fixture(scope="module")
def entries(tmp_path_factory) -> dict[str, object]:
    """Both entries, made once."""
    folder = tmp_path_factory.mktemp("tutorial")
    made = {name: entry_of(name, folder) for name in EXAMPLES}
    yield made
    for name in EXAMPLES:
        sys.modules.pop(name, None)


@pytest.fixture
def builder(entries, monkeypatch) -> str:
    """The tutorial's builder, in the table."""
    monkeypatch.setitem(KDTREE_BUILDERS, "mean_split", entries["mean_split"])
    return "mean_split"


@pytest.fixture
def triangle_test(entries, monkeypatch) -> str:
    """The tutorial's triangle test, in the table."""
    monkeypatch.setitem(TRIANGLE_TESTS, "dot_products", entries["dot_products"])
    return "dot_products"


def test_entries_are_named_as_their_files(entries):
    assert {name: entry.name for name, entry in entries.items()} == {name: name for name in EXAMPLES}
    assert BuilderCapabilities.CLIPS in entries["mean_split"].capabilities
    assert BuilderCapabilities.LEAST_COST not in entries["mean_split"].capabilities


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_is_not_there_yet(name):
    assert name not in TABLES[EXAMPLES[name]], "the suite adds this example of docs/adding.md itself: give yours another name"
    assert name not in wrt.__all__


@pytest.mark.parametrize("width", [1, 8])
@pytest.mark.parametrize("mesh", ["teapot", "grid", "degenerate", "needles"])
def test_builder_keeps_the_invariants(builder, mesh, width):
    test_kdtree_builders.test_invariants(SCENES[mesh](), builder, width)


@pytest.mark.parametrize("count", [1, 2, 8])
def test_builder_takes_tiny_and_flat_meshes(builder, count):
    test_kdtree_builders.test_tiny_and_flat_meshes(builder, count)


def test_builder_takes_hard_meshes(builder):
    test_kdtree_builders.test_hard_meshes(builder)


def test_builder_gives_the_same_hits(builder):
    test_traversal.test_every_kdtree_builder_gives_the_same_hits(SCENES["random_triangles"](), builder)


def test_builder_clips(builder):
    """What its entry says: leaves list the triangles that they meet, and no others."""
    test_split_clipping.test_leaves_list_what_they_meet(builder, "random_triangles")
    test_split_clipping.test_needles_are_crossed_once(builder, 100.0)


def test_builder_splits_at_the_mean(builder):
    """The tutorial's own claim, worked out in NumPy."""
    mesh = wrt.scenes.build("teapot", level=4)
    tree, _ = test_kdtree_builders.build(mesh, builder)
    corners = mesh.vertices.astype("float32")[mesh.faces]
    axis = int((corners.max((0, 1)) - corners.min((0, 1))).argmax())
    middles = (corners.min(1) + corners.max(1))[:, axis] / 2
    flat = test_kdtree_builders.unpack(tree)
    assert flat.axis[0] == axis
    assert flat.position[0] == pytest.approx(middles.mean(dtype=float), rel=1e-6, abs=1e-6)


def test_builder_has_a_colour_of_its_own(builder):
    assert color_of(builder) not in [color_of(name) for name in KDTREE_BUILDERS if name != builder]


def test_triangle_test_keeps_the_contract(triangle_test, device):
    for check in (
        test_triangle_tests.test_closed_form,
        test_triangle_tests.test_edges_and_vertices_belong_to_the_triangle,
        test_triangle_tests.test_rays_in_the_plane_miss,
        test_triangle_tests.test_against_float64,
        test_triangle_tests.test_degenerate_triangles_miss,
    ):
        check(triangle_test, device)
    for form in ("scalar", "lanes"):
        test_triangle_tests.test_a_nan_anywhere_is_a_miss(triangle_test, form, device)
    for width in (4, 16):
        test_triangle_tests.test_lanes_equal_scalar(triangle_test, width, device)
    test_triangle_tests.test_table_is_complete()


@pytest.mark.parametrize(("tree", "traversal"), [("kdtree", "single"), ("bvh", "packet"), ("bvh", "stream")])
def test_triangle_test_works_in_the_engine(triangle_test, tree, traversal, device):
    test_triangle_tests.test_in_the_engine(triangle_test, tree, traversal, device)


def test_triangle_test_is_right_at_any_scale(triangle_test, monkeypatch):
    alone = {triangle_test: TRIANGLE_TESTS[triangle_test]}
    monkeypatch.setattr(test_triangle_properties, "TRIANGLE_TESTS", alone)
    test_triangle_properties.test_hits_are_where_float64_has_them()


@pytest.mark.parametrize("name", EXAMPLES)
def test_rows_fit_the_page_of_algorithms(name):
    """Without the row the test of the page fails; with it, in the right section, it passes."""
    section = {"KDTREE_BUILDERS": "kd-tree builders", "TRIANGLE_TESTS": "Triangle tests"}[EXAMPLES[name]]
    (row,) = [row for row in rows() if f"`{name}`" in row]
    assert name not in test_algorithms.keys_in(test_algorithms.PAGE, section)
    last = [line for line in test_algorithms.sections(test_algorithms.PAGE)[section].splitlines() if line.startswith("| `")][-1]
    page = test_algorithms.PAGE.replace(last, f"{last}\n{row}")
    assert test_algorithms.keys_in(page, section)[-1] == name


PLUGIN = """
import sys
sys.path[:0] = {tests!r}
import wrt
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.kernels.answers import ANSWERS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.query.answers import ray_values
from wrt.engine.rays.rays import as_rays
from wrt.engine.facts.query_kinds import Query
KDTREE_BUILDERS["mean_split"] = KDTREE_BUILDERS["object_median"]
TRIANGLE_TESTS["dot_products"] = TRIANGLE_TESTS["badouel"]
"""
"""Two more keys, before the tests are collected."""


def test_the_named_tests_run(tmp_path):
    """`pytest -k NAME` selects tests in each file that the page names for it, and in no file that it is silent about."""
    paths = [str(ROOT / "tests"), str(ROOT / "tests" / "support")]
    (tmp_path / "two_more_keys.py").write_text(PLUGIN.format(tests=paths), encoding="utf-8")
    names = f"({' or '.join(EXAMPLES)}) and not test_adding"
    options = ["--collect-only", "-q", "-p", "two_more_keys", "-p", "no:cacheprovider", "-k", names, str(ROOT / "tests")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    run = subprocess.run([sys.executable, "-m", "pytest", *options], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    for name in EXAMPLES:
        (told,) = re.findall(rf"^<!-- tests: {name} -->\n(.*?)\n\n", PAGE, re.DOTALL | re.MULTILINE)
        found = set(re.findall(rf"^(tests/[\w/]+\.py)::.*\b{name}\b", run.stdout, re.MULTILINE))
        assert found == set(re.findall(r"`(tests/[\w/]+\.py)`", told)), run.stdout
