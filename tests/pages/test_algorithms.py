"""The page of algorithms: every key of every table stands in its section, and no other."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import pairwise
from operator import attrgetter

import pytest
from support.algorithm_page import PAGE, keys_in, rows_of, sections

import wrt
from wrt.accelerators.accelerator import ACCELERATORS
from wrt.accelerators.projected_bvh import COSTS
from wrt.accelerators.ray_aware_bvh import TOP_LEVELS
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.bvh.phases.split_axes import AXIS_CHOICES
from wrt.builders.cost import COST_MODELS
from wrt.builders.kdtree import KDTREE_BUILDERS, LAYOUTS
from wrt.builders.kdtree.kdtree_config import AXES, CELL_TESTS, EMPTY_SPACE, HIERARCHIES, SEARCHED_AXES
from wrt.builders.tree import TERMINATIONS
from wrt.cli.catalogue import PAPERS, all_tables
from wrt.engine.plan.planner import DEFAULT_TEST
from wrt.imaging.integrators.render_settings import INTEGRATORS
from wrt.kernels.classics.studies.dammertz_keller import TEST as DAMMERTZ_KELLER
from wrt.kernels.classics.studies.komatsu_2008 import PUBLISHED
from wrt.kernels.classics.studies.pichler_2018 import STUDIED
from wrt.kernels.query.ordering.packet_orders import PACKET_ORDERS
from wrt.kernels.runtime.schedules import DEFAULT_SCHEDULE, SCHEDULES
from wrt.kernels.shading.wavefront.pixel_samples import SAMPLERS
from wrt.kernels.traversal import ORDERS, TRAVERSALS
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.shadows import SHADOW_TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS

TABLES: dict[str, Iterable[str]] = {
    "Accelerators": ACCELERATORS,
    "BVH builders": BVH_BUILDERS,
    "kd-tree builders": KDTREE_BUILDERS,
    "Termination": TERMINATIONS,
    "Axes of medians": AXES,
    "Searched axes": SEARCHED_AXES,
    "Cost models": COST_MODELS,
    "Tests of cells": CELL_TESTS,
    "Empty space": EMPTY_SPACE,
    "Hierarchies of lazy trees": HIERARCHIES,
    "Layouts": LAYOUTS,
    "Weights of boxes": COSTS,
    "Axes to split": AXIS_CHOICES,
    "Finding the area of a ray": TOP_LEVELS,
    "Traversals": TRAVERSALS,
    "Shadow rays": SHADOW_TRAVERSALS,
    "Packet cullings": CULLINGS,
    "Mailboxes": MAILBOXES,
    "Orders of rays": ORDERS,
    "Packet orders": PACKET_ORDERS,
    "Triangle tests": TRIANGLE_TESTS,
    "As published": PUBLISHED,
    "Tried by Pichler": (*STUDIED, DAMMERTZ_KELLER.name),
    "Schedules": SCHEDULES,
    "Integrators": INTEGRATORS,
    "Samplers": SAMPLERS,
}
"""Heading of a section -> the table that it lists. A new table needs a section and a line here."""

DEFAULTS = {
    "BVH builders": wrt.Bvh().builder,
    "kd-tree builders": wrt.KdTree().builder,
    "Termination": wrt.KdTree().termination,
    "Axes of medians": wrt.KdTree().axis,
    "Searched axes": wrt.KdTree().searched_axes,
    "Hierarchies of lazy trees": wrt.KdTree().hierarchy,
    "Cost models": wrt.KdTree().cost_model,
    "Tests of cells": wrt.KdTree().cell_tests,
    "Empty space": wrt.KdTree().empty_space,
    "Layouts": wrt.KdTree().layout,
    "Triangle tests": DEFAULT_TEST,
    "Schedules": DEFAULT_SCHEDULE,
    "Integrators": "path",
    "Samplers": wrt.pictures.RenderSettings().sampler,
}

WORTH_A_ROW = (
    "known_rays.ProjectedBvh",
    "known_rays.RayAwareBvh",
    "classics.FanScene",
    "moving.FuzzyScene",
    "moving.GroupedScene",
    "Instance",
    "moving.InstancedScene",
    "disk.PartitionedScene",
    "moving.SkinnedScene",
    "moving.UpdatePolicy",
)
"""Public names that stand for an algorithm."""


CASES = [(section, key) for section, table in TABLES.items() for key in table]


@pytest.mark.parametrize(("section", "key"), CASES, ids=[f"{section}-{key}" for section, key in CASES])
def test_every_key_has_a_row(section, key):
    assert keys_in(PAGE, section).count(key) == 1, f"docs/algorithms.md, section {section!r}, has no row for `{key}`"


@pytest.mark.parametrize("section", TABLES)
def test_no_row_without_a_key(section):
    assert set(keys_in(PAGE, section)) <= set(TABLES[section])
    assert all(paper for _, paper in rows_of(sections(PAGE)[section]))


@pytest.mark.parametrize("section", DEFAULTS)
def test_defaults_are_marked(section):
    (marked,) = [name for name, _ in rows_of(sections(PAGE)[section]) if "(default)" in name]
    assert marked.startswith(f"`{DEFAULTS[section]}`")


@pytest.mark.parametrize("name", WORTH_A_ROW)
def test_public_algorithms_have_a_row(name):
    assert attrgetter(name)(wrt)
    assert re.search(rf"^\| .*`wrt\.{re.escape(name)}\b.*\|.*\d{{4}}.*\|$", PAGE, re.MULTILINE)


@pytest.mark.parametrize("table", [BVH_BUILDERS, KDTREE_BUILDERS, TRAVERSALS, SHADOW_TRAVERSALS, CULLINGS, TRIANGLE_TESTS])
def test_years_are_those_of_the_entries(table):
    """Each row, or the one that it refers to, names a year of its entry's paper."""
    rows, above = {}, ""
    for name, paper in (
        row for section, entries in TABLES.items() if entries is table for row in rows_of(sections(PAGE)[section])
    ):
        above = f"{above} {paper}" if paper.startswith("the same") else paper
        rows |= dict.fromkeys(re.findall(r"`([^`]+)`", name), above)
    for name, entry in table.items():
        years = re.findall(r"\b(?:19|20)\d\d\b", entry.paper)
        assert not years or set(years) & set(re.findall(r"\b(?:19|20)\d\d\b", rows[name])), name


def listed_on(page: str) -> dict[str, set[str]]:
    """Section, in lower case -> what its tables list in their first columns: names, or the words of a cell without any."""
    found: dict[str, set[str]] = {}
    for section, text in sections(page).items():
        lines = [line for line in text.splitlines() if line.startswith("|")]
        cells = [line.strip("|").split("|")[0].strip() for k, line in enumerate(lines) if "---" not in line]
        heads = [line.strip("|").split("|")[0].strip() for line, under in pairwise(lines) if "---" in under]
        names = {name for cell in cells if cell not in heads for name in re.findall(r"`([^`]+)`", cell) or [cell]}
        if names:
            found[section.lower()] = names
    return found


def years(text: str) -> set[str]:
    """The years that a text names."""
    return set(re.findall(r"\b(?:19|20)\d\d\b", text))


def test_the_command_lists_what_the_page_lists():
    """`wrt list` left out layouts, clipping, termination, trees for known rays, moving scenes and fans."""
    tables = {title.lower(): {row["name"] for row in rows} for title, rows in all_tables().items()}
    assert tables.pop("built-in scenes")
    assert tables == listed_on(PAGE)
    assert {section.lower() for section in TABLES} <= tables.keys()
    listed = {name for names in tables.values() for name in names}
    assert all(f"wrt.{name}" in listed for name in WORTH_A_ROW)


def test_the_command_names_papers_of_the_page():
    """Every year that it lists stands in the row, or in one that the row refers to; and every row says something."""
    for title, rows in all_tables().items():
        if title == "built-in scenes":
            continue
        (text,) = (text for section, text in sections(PAGE).items() if section.lower() == title.lower())
        for row in rows:
            assert row["paper"]
            assert years(row["paper"]) <= years(text), f"{title}: {row['name']}"
    for section, papers in PAPERS.items():
        assert papers.keys() == {row["name"] for row in all_tables()[section]}, "no paper of a name that is gone"
