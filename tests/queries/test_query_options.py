"""The options of queries: signatures agree with each other and with what type checkers are told, and help explains them."""

from __future__ import annotations

import inspect
import re
import typing

import numpy as np
import pytest

import wrt
from wrt.accelerators.accelerator import ACCELERATORS, AcceleratorName
from wrt.disk.partitioned_scene import MODES
from wrt.disk.queries_of_parts import Mode, Parts
from wrt.engine.facts.query_kinds import CLOSEST, QUERIES, Query
from wrt.query.blocks import MEMORY
from wrt.query.hits import SIDES, Side
from wrt.query.query_options import Closest, Counted, Listed, Occluded, QueryKind
from wrt.scene.updates import ALWAYS, AUTO, NEVER, When

OF_PLANS = {"traversal", "triangle_test"}

OF_BLOCKS = {"mask", "environment", "skip", "memory", "progress", "executor", "reduce", "axis"}

OPTIONS = {
    "intersect": OF_PLANS | {"mask", "environment", "areas", "cull_backfaces", "skip", "counters", "precise"},
    "occluded": OF_PLANS | {"mask", "environment", "areas", "cull_backfaces", "skip"},
    "count": OF_PLANS | {"mask", "environment", "cull_backfaces", "skip"},
    "intersect_all": OF_PLANS | {"mask", "environment", "cull_backfaces", "max_hits"},
    "explain": OF_PLANS | {"mask", "environment", "cull_backfaces", "query"},
    "intersect_blocks": OF_PLANS | OF_BLOCKS | {"precise"},
    "occluded_blocks": OF_PLANS | OF_BLOCKS,
    "count_blocks": OF_PLANS | OF_BLOCKS,
}

OF_CHECKERS = {"intersect": Closest, "occluded": Occluded, "count": Counted, "intersect_all": Listed}

NOT_OF_QUERIES = {"query": CLOSEST, "memory": MEMORY, "progress": False, "executor": None, "reduce": None, "axis": None}

DEFAULTS = {**NOT_OF_QUERIES, **Query._field_defaults}

RAYS = {"origins": inspect.Parameter.empty, "directions": None, "t_min": 0.0, "t_max": float("inf")}

DOWN = ((0.2, 0.1, 9.0), (0.0, 0.0, -1.0))

SCENES = (wrt.Scene, wrt.moving.InstancedScene, wrt.moving.GroupedScene, wrt.moving.FuzzyScene)


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu")


def keywords(method: object) -> dict[str, inspect.Parameter]:
    parameters = inspect.signature(method).parameters
    return {name: one for name, one in parameters.items() if one.kind is inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("kind", SCENES)
def test_signatures_agree(kind, name):
    """Every query takes rays in the same way, and an option has the same type and default wherever it occurs."""
    method = getattr(kind, name)
    parameters = inspect.signature(method).parameters
    assert {key: parameters[key].default for key in [*parameters][1:5]} == RAYS
    options = keywords(method)
    assert set(options) == OPTIONS[name] == set(parameters) - {"self", *RAYS}
    for key, option in options.items():
        assert option.default == DEFAULTS[key]
        others = [keywords(getattr(kind, other)).get(key, option) for other in OPTIONS]
        assert {one.annotation for one in others} == {option.annotation} != {inspect.Parameter.empty}


@pytest.mark.parametrize(
    ("method", "options"),
    [
        *((getattr(wrt.Scene, name), options) for name, options in OF_CHECKERS.items()),
        *((getattr(wrt.disk.PartitionedScene, name), Parts) for name in ("intersect", "occluded", "count")),
    ],
    ids=lambda value: getattr(value, "__qualname__", None),
)
def test_type_checkers_and_help_see_the_same_options(method, options):
    """The overloads, which type checkers read, take the class of options that has the names and types of the signature."""
    told = {name: getattr(kind, "__forward_arg__", kind) for name, kind in options.__annotations__.items()}
    assert told == {name: option.annotation for name, option in keywords(method).items()}


@pytest.mark.parametrize("name", [*OPTIONS, "points_on", "contains", "visible", "verify"])
def test_help_explains_every_argument(name):
    method = getattr(wrt.Scene, name)
    listed = re.search(r"\nArgs:\n(.*?)\n\n", inspect.getdoc(method), re.DOTALL)
    explained = {word for line in re.findall(r"^ {4}(\w[\w, ]*): ", listed[1], re.MULTILINE) for word in line.split(", ")}
    assert explained == set(inspect.signature(method).parameters) - {"self"}


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (AcceleratorName, ACCELERATORS),
        (Side, SIDES),
        (QueryKind, QUERIES),
        (Mode, MODES),
        (When, (AUTO, ALWAYS, NEVER)),
    ],
)
def test_names_that_type_checkers_know(kind, names):
    assert typing.get_args(kind) == tuple(names)


@pytest.mark.parametrize("name", OPTIONS)
def test_every_option_is_taken(scene, name):
    """A call that passes all defaults is the call without them."""
    method = getattr(scene, name)
    defaults = {key: option.default for key, option in keywords(method).items()}
    given = [wrt.Rays(*(np.array([part]) for part in DOWN))]
    if name.endswith("_blocks"):
        one, other = (next(answer for _, answer in method(*given, **options)) for options in (defaults, {}))
    else:
        one, other = method(*given, **defaults), method(*given)
    one, other = (getattr(answer, "t", answer) for answer in (one, other))
    assert np.array_equal(one, other)


@pytest.mark.parametrize("name", OPTIONS)
def test_unknown_options_are_refused(scene, name):
    """At once, before rays are looked at, with the names of the options that there are."""
    unknown = {"cul_backfaces", "kind", "self_", *DEFAULTS} - OPTIONS[name]
    for key in unknown:
        with pytest.raises(TypeError, match=rf"^{name}\(\) got an unexpected keyword argument '{key}'") as refused:
            getattr(scene, name)("no rays", **{key: DEFAULTS.get(key)})
        assert all(option in str(refused.value) for option in OPTIONS[name])
    with pytest.raises(TypeError, match="positional"):
        getattr(scene, name)(*DOWN, 0.0, 1.0, "single")
