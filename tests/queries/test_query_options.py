"""The options of queries stand once, and the signatures that users see are made of them."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import wrt
from wrt.query import query_options
from wrt.query.query_options import DEFAULTS

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


@pytest.mark.parametrize("name", OPTIONS)
def test_type_checkers_and_help_see_the_same_options(name):
    """The annotation, which type checkers read, names the class of which the signature was made."""
    annotation = getattr(wrt.Scene, name).__annotations__["options"]
    options = getattr(query_options, annotation.removeprefix("Unpack[").removesuffix("]"))
    assert set(options.__annotations__) == OPTIONS[name]


def test_every_option_has_a_default():
    assert set(DEFAULTS) == set().union(*OPTIONS.values())


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
