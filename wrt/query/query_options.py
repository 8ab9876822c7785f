"""The options of queries, for type checkers, and the checks of their values.

The signatures of the methods list the options, with their defaults (`wrt.query.api`). The classes below name those of methods
whose results are of the kind of the rays, once for all overloads of a method; a test compares the two.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from functools import wraps
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, TypeVar

from wrt.engine.facts.query_kinds import Query
from wrt.kernels.validation import as_bool

if TYPE_CHECKING:
    from wrt.array_types import Numbers
    from wrt.engine.plan.plan import Plan
    from wrt.query.hits import Hits

Method = TypeVar("Method", bound=Callable[..., Any])

QueryKind: TypeAlias = Literal["closest", "any", "count", "all", "winding"]


class PlanOptions(TypedDict, total=False):
    """Of queries in memory: how they are answered."""

    traversal: str | Plan
    triangle_test: str
    cull_backfaces: bool


class MaskOptions(PlanOptions, total=False):
    """Of queries that trace rays."""

    mask: Numbers | None
    environment: Numbers | None


class Counted(MaskOptions, total=False):
    """Of `count`."""

    skip: Hits | Numbers | None


class Occluded(Counted, total=False):
    """Of `occluded`."""

    areas: Numbers | None


class Closest(Occluded, total=False):
    """Of `intersect`."""

    counters: bool
    precise: bool


class Listed(MaskOptions, total=False):
    """Of `intersect_all`."""

    max_hits: int | None


def unknown_option(method: Callable[..., Any], given: Iterable[str]) -> TypeError:
    """The error of an option that a method does not take: it lists those that there are."""
    parameters = inspect.signature(method).parameters
    unknown = next(name for name in given if name not in parameters)
    options = ", ".join(name for name, one in parameters.items() if name != "self" and one.kind is not one.VAR_KEYWORD)
    return TypeError(f"{method.__name__}() got an unexpected keyword argument {unknown!r}; its options are {options}")


def lists_options(method: Method) -> Method:
    """A decorator: an option that a method does not take is refused by `unknown_option`.

    A method of few microseconds has a parameter `**unknown`, which it looks at itself: it is not wrapped, and its signature is
    that without the parameter.
    """
    signature = inspect.signature(method)
    known = [one for one in signature.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
    if len(known) < len(signature.parameters):
        method.__signature__ = signature.replace(parameters=known)  # type: ignore[attr-defined]
        return method

    @wraps(method)
    def call(*arguments: Any, **given: Any) -> Any:
        try:
            return method(*arguments, **given)
        except TypeError:
            if given.keys() <= signature.parameters.keys():
                raise
        raise unknown_option(method, given)

    return call  # type: ignore[return-value]


def checked(query: Query) -> Query:
    """A query whose switches are bools.

    Raises:
        TypeError: one is not.
    """
    return query._replace(
        cull_backfaces=as_bool("cull_backfaces", query.cull_backfaces),
        counters=as_bool("counters", query.counters),
        precise=as_bool("precise", query.precise),
    )


def chosen(**options: Any) -> dict[str, Any]:
    """The options that are not the defaults, of which the identity of a batch does not depend."""
    defaults = Query._field_defaults
    return {
        name: value for name, value in options.items() if type(value) is not type(defaults[name]) or value != defaults[name]
    }
