"""The options of queries: the name and the type of each stand here, once, and their defaults in `wrt.state.query_kinds.Query`.

A query takes its options as `**options: Unpack[...]` of one of the classes below, from which type checkers and editors know
the keywords. `takes` gives the method a signature that lists them, for `help`, `inspect` and the documentation. What the
options mean is in the docstrings of the methods (`wrt.query.api`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

from wrt.kernels.validation import as_bool
from wrt.query.blocks import MEMORY
from wrt.state.query_kinds import CLOSEST, QUERIES, Query

if TYPE_CHECKING:
    from wrt.planning.plan import Plan

Method = TypeVar("Method", bound=Callable[..., Any])


class PlanOptions(TypedDict, total=False):
    """Of every query: how it is answered."""

    traversal: str | Plan
    triangle_test: str


class FacingOptions(PlanOptions, total=False):
    """Of queries in memory."""

    cull_backfaces: bool


class MaskOptions(FacingOptions, total=False):
    """Of queries that trace rays."""

    mask: Any
    environment: Any


class ValueOptions(MaskOptions, total=False):
    """Of `occluded` and `count`."""

    skip: Any


class OcclusionOptions(ValueOptions, total=False):
    """Of `occluded`."""

    areas: Any


class PrecisionOptions(TypedDict, total=False):
    """Of closest hits."""

    precise: bool


class ClosestOptions(OcclusionOptions, PrecisionOptions, total=False):
    """Of `intersect`."""

    counters: bool


class ListOptions(MaskOptions, total=False):
    """Of `intersect_all`."""

    max_hits: int | None


class ExplainOptions(MaskOptions, total=False):
    """Of `explain`."""

    query: str


class BlockOptions(PlanOptions, total=False):
    """Of `occluded_blocks` and `count_blocks`."""

    mask: Any
    environment: Any
    skip: Any
    memory: int | str
    progress: bool
    executor: Any
    reduce: Any
    axis: Any


class ClosestBlockOptions(BlockOptions, PrecisionOptions, total=False):
    """Of `intersect_blocks`."""


class PartOptions(FacingOptions, total=False):
    """Of a `wrt.disk.PartitionedScene`."""

    mode: str


SWITCHES = frozenset({"cull_backfaces", "counters", "precise"})
"""Options of queries that are True or False."""

OF_BLOCKS = {"memory": MEMORY, "progress": False, "executor": None, "reduce": None, "axis": None}

DEFAULTS: Mapping[str, Any] = {"query": CLOSEST, **OF_BLOCKS, **Query._field_defaults}
"""The default of each option, in the order in which signatures list them."""


def takes(options: type, **defaults: Any) -> Callable[[Method], Method]:
    """A decorator for methods with `**options`: their signature lists the options, each with its type and default.

    Args:
        options: the names and the types.
        defaults: those of options that are not in `DEFAULTS`; listed first.
    """

    def sign(method: Method) -> Method:
        signature = inspect.signature(method)
        fixed = [one for one in signature.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
        types = {name: getattr(kind, "__forward_arg__", kind) for name, kind in options.__annotations__.items()}
        listed = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=types[name])
            for name, default in {**defaults, **DEFAULTS}.items()
            if name in types
        ]
        method.__signature__ = signature.replace(parameters=[*fixed, *listed])
        method.options = frozenset(one.name for one in listed)  # looked up in every call
        return method

    return sign


def check_options(method: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Refuses options that a method does not take.

    Raises:
        TypeError: there is one; the message lists those that the method takes.
    """
    if options.keys() <= method.options:
        return
    known = [one.name for one in method.__signature__.parameters.values() if one.kind is inspect.Parameter.KEYWORD_ONLY]
    name, listed = next(name for name in options if name not in known), ", ".join(known)
    raise TypeError(f"{method.__name__}() got an unexpected keyword argument {name!r}; its options are {listed}")


def as_query(method: Callable[..., Any], kind: str, options: Mapping[str, Any]) -> Query:
    """A query of a kind with the options that a method was called with.

    Raises:
        TypeError: the method does not take one of them.
    """
    if not options:  # most calls of few rays, whose time is Python's
        return QUERIES[kind]
    check_options(method, options)
    return new_query(kind, options)


def new_query(kind: str, options: Mapping[str, Any]) -> Query:
    """A query of a kind with options.

    Raises:
        TypeError: a switch is no bool.
    """
    switches = {name: as_bool(name, options[name]) for name in SWITCHES & options.keys()}
    return Query(kind, **{**options, **switches})
