"""Fixtures: the devices found here, meshes to test on, and rays of every kind."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
import support.environment  # noqa: F401 (before wrt)
from support.algorithms import CLASSICS
from support.environment import DEVICES, workers
from support.meshes import SCENES, load_model
from support.selection import ASKED_FOR, LEFT_OUT, LONGEST, SLOW, Skipped, as_sample, is_alone, named, sample

import wrt


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "of the chosen cases of each file one in N, but at least one; N turns that follow each other draw all"
    parser.addoption("--sample", metavar="N:TURN", type=as_sample, help=text)
    text = "with --sample: draws among the tests with one of these markers, and runs all others"
    parser.addoption("--sampled", metavar="MARKER,MARKER", default="", help=text)
    text = "writes the ids of skipped tests into a file; `pytest @FILE` runs them again, as after installing what they need"
    parser.addoption("--write-skipped", metavar="FILE", help=text)
    text = "marks what such a file names as `was_skipped`, so that `-m` can choose it beside other tests"
    parser.addoption("--was-skipped", metavar="FILE", help=text)


def pytest_configure(config: pytest.Config) -> None:
    if config.option.write_skipped:
        os.environ.pop("PYTEST_ADDOPTS", None)  # which may have asked for it: tests that start pytest mean another one
        config.pluginmanager.register(Skipped(config))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is made while tests are collected stays: looking for garbage in it again and again took half of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput["is_alone"] = is_alone(node.config)


def pytest_report_header(config: pytest.Config) -> str | None:
    others = f"without {', '.join(LEFT_OUT)}; `pytest tests` runs those, too, -m '{' or '.join(LEFT_OUT)}' only those"
    return others if is_alone(config) else None


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Marks the tests that have a classic as a parameter, those of studies, and those of slow files; files about classics alone
    mark themselves. Leaves out what is marked with a name of `ASKED_FOR`, unless `-m` has that, of `LEFT_OUT`, if nothing
    on the command line chooses tests, and what is not in the sample. Where several processes run tests, notebooks
    come first: the last, of a minute, would keep one busy after all others."""
    for file, own in groupby(items, lambda item: item.nodeid.partition("::")[0]):
        names = ["slow"] * (file in SLOW) + ["studies"] * file.startswith("tests/studies/")
        for item in own:
            for name in names:
                item.add_marker(name)
            given = item.callspec.params.values() if hasattr(item, "callspec") else ()
            if any(isinstance(one, str) and one in CLASSICS for one in given):
                item.add_marker("classics")
    if config.option.was_skipped:
        for item in named(items, Path(config.option.was_skipped).read_text(encoding="utf-8").splitlines()):
            item.add_marker("was_skipped")
    left_out = [name for name in ASKED_FOR if name not in config.option.markexpr] + [*LEFT_OUT] * is_alone(config)
    items[:] = [item for item in items if not any(name in item.keywords for name in left_out)]
    if workers:
        items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))
    yield
    if config.option.sample:
        chosen = sample(items, *config.option.sample, [name for name in config.option.sampled.split(",") if name])
        kept = {*chosen}
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = chosen


@pytest.fixture(autouse=True, scope="module")
def frozen() -> None:
    """What earlier files left, kernels above all, is not scanned again at every garbage collection. Studies collect before each
    round, which took longer than what they measure in tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> str:
    """Every device found: the CPU always, CUDA where there is one."""
    return request.param


@pytest.fixture(scope="session")
def bunny() -> wrt.TriangleMesh:
    """The Stanford bunny, 69,630 triangles."""
    return load_model("bunny.ply")


@pytest.fixture(scope="session", params=SCENES)
def scene_mesh(request: pytest.FixtureRequest) -> wrt.TriangleMesh:
    """Built-in scenes, a soup on a coarse grid (equal events, planar triangles, ties), one full of degenerate ones, needles."""
    return SCENES[request.param]()
