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
from support import algorithm_page
from support.built_kdtrees import assert_leaves_list_what_they_meet, build
from support.meshes import SCENES

import wrt
from studies.kdtrees.kdtree_pictures import color_of
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities, KdTreeBuilder
from wrt.builders.kdtree.kdtree_statistics import unpack
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


def test_entries_are_named_as_their_files(entries):
    assert {name: entry.name for name, entry in entries.items()} == {name: name for name in EXAMPLES}
    assert BuilderCapabilities.CLIPS in entries["mean_split"].capabilities
    assert BuilderCapabilities.MIN_COST not in entries["mean_split"].capabilities


@pytest.mark.parametrize("name", EXAMPLES)
def test_it_is_not_there_yet(name):
    assert name not in TABLES[EXAMPLES[name]], "the suite adds this example of docs/adding.md itself: give yours another name"
    assert name not in wrt.__all__


def test_builder_clips(builder):
    """What its entry says: leaves list the triangles that they meet, and no others."""
    assert_leaves_list_what_they_meet(SCENES["random_triangles"](), builder)


def test_builder_splits_at_the_mean(builder):
    """The tutorial's own claim, worked out in NumPy."""
    mesh = wrt.scenes.build("teapot", level=4)
    tree, _ = build(mesh, builder)
    corners = mesh.vertices.astype("float32")[mesh.faces]
    axis = int((corners.max((0, 1)) - corners.min((0, 1))).argmax())
    middles = (corners.min(1) + corners.max(1))[:, axis] / 2
    flat = unpack(tree)
    assert flat.axis[0] == axis
    assert flat.position[0] == pytest.approx(middles.mean(dtype=float), rel=1e-6, abs=1e-6)


def test_builder_has_a_colour_of_its_own(builder):
    assert color_of(builder) not in [color_of(name) for name in KDTREE_BUILDERS if name != builder]


@pytest.mark.parametrize("name", EXAMPLES)
def test_rows_fit_the_page_of_algorithms(name):
    """Without the row the test of the page fails; with it, in the right section, it passes."""
    section = {"KDTREE_BUILDERS": "kd-tree builders", "TRIANGLE_TESTS": "Triangle tests"}[EXAMPLES[name]]
    (row,) = [row for row in rows() if f"`{name}`" in row]
    assert name not in algorithm_page.keys_in(algorithm_page.PAGE, section)
    last = [line for line in algorithm_page.sections(algorithm_page.PAGE)[section].splitlines() if line.startswith("| `")][-1]
    page = algorithm_page.PAGE.replace(last, f"{last}\n{row}")
    assert algorithm_page.keys_in(page, section)[-1] == name


PLUGIN = """
import dot_products, mean_split
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities, KdTreeBuilder
from wrt.kernels.triangle import TRIANGLE_TESTS

KDTREE_BUILDERS["mean_split"] = BUILDER
TRIANGLE_TESTS["dot_products"] = TRIANGLE_TEST


def pytest_collection_finish(session):
    for item in session.items:  # with triangles at any scale all tests of the table run together: here only the new one
        if item.module.__name__.endswith("test_triangle_properties"):
            item.module.TRIANGLE_TESTS = {"dot_products": TRIANGLE_TESTS["dot_products"]}
"""
"""The tutorial's files and lines, before tests are collected."""

MORE = "test_hits_are_where_float64_has_them or test_table_is_complete"
"""Tests that run all entries of a table together."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> dict[str, str]:
    """The outcome of each test that `pytest -k` selects by the names of the examples, which are in the tables."""
    folder = tmp_path_factory.mktemp("plugin")
    for name in EXAMPLES:
        (folder / f"{name}.py").write_text(block(f"file: {name}.py"), encoding="utf-8")
    code = PLUGIN.replace("BUILDER\n", block("entry: KDTREE_BUILDERS")).replace(
        "TRIANGLE_TEST\n", block("entry: TRIANGLE_TESTS")
    )
    (folder / "two_more_keys.py").write_text(code, encoding="utf-8")
    names = f"({' or '.join(EXAMPLES)} or {MORE}) and not test_adding"
    options = [
        "-v",
        "-p",
        "support.environment",
        "-p",
        "two_more_keys",
        "-p",
        "no:cacheprovider",
        "-k",
        names,
        str(ROOT / "tests"),
    ]
    paths = [str(folder), str(ROOT), str(ROOT / "tests")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    run = subprocess.run([sys.executable, "-m", "pytest", *options], cwd=ROOT, env=environment, capture_output=True, text=True)
    found = dict(re.findall(r"^(tests/[\w/]+\.py::.+?) (PASSED|FAILED|ERROR|SKIPPED)\b", run.stdout, re.MULTILINE))
    assert len(found) > 50, run.stdout + run.stderr
    wrong = [name for name, outcome in found.items() if outcome in ("FAILED", "ERROR")]
    assert all(name.startswith("tests/pages/test_algorithms.py") for name in wrong), run.stdout
    return found


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_named_tests_run(outcomes, name):
    """`pytest -k NAME` selects tests in each file that the page names for it, and in no file that it is silent about."""
    (told,) = re.findall(rf"^<!-- tests: {name} -->\n(.*?)\n\n", PAGE, re.DOTALL | re.MULTILINE)
    found = {test.partition("::")[0] for test in outcomes if re.search(rf"\b{name}\b", test)}
    assert found == set(re.findall(r"`(tests/[\w/]+\.py)`", told))


@pytest.mark.parametrize(
    ("name", "tests"),
    [
        (
            "mean_split",
            "test_invariants test_tiny_and_flat_meshes test_hard_meshes test_every_kdtree_builder_gives_the_same_hits",
        ),
        ("mean_split", "test_needles_are_crossed_once test_tree_is_the_same_for_any_number_of_threads"),
        ("dot_products", "test_closed_form test_edges_and_vertices_belong_to_the_triangle test_rays_in_the_plane_miss"),
        (
            "dot_products",
            "test_against_float64 test_degenerate_triangles_miss test_a_nan_anywhere_is_a_miss test_lanes_equal_scalar",
        ),
        ("dot_products", "test_in_the_engine"),
        ("", "test_hits_are_where_float64_has_them test_table_is_complete"),
    ],
)
def test_examples_pass_the_tests_of_their_tables(outcomes, name, tests):
    for test in tests.split():
        assert {outcome for one, outcome in outcomes.items() if f"::{test}" in one and name in one} == {"PASSED"}, test


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_row_is_missed(outcomes, name):
    """Without the row the test of the page fails."""
    (row,) = [one for one in outcomes if "test_algorithms.py::test_every_key_has_a_row" in one and name in one]
    assert outcomes[row] == "FAILED"
