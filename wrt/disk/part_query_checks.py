"""What queries of partitioned scenes refuse before a part is loaded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.plan.plan_checks import check_culling, check_query
from wrt.engine.plan.planner import DEFAULT_TEST
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.engine.facts.query_kinds import Query


def check_traversal(query: Query) -> None:
    """Refuses a traversal that cannot answer a query in a part.

    Raises:
        TypeError: not a name.
        ValueError: an unknown name; it does not walk BVHs, or does not answer the query.
    """
    if not isinstance(query.traversal, str):
        raise TypeError(f"traversal must be a name, not {type(query.traversal).__name__}: a plan is for one tree")
    if query.traversal == AUTO:
        return
    traversal = lookup(TRAVERSALS, query.traversal, "traversal")
    tree = "bvh" if traversal.walks_tree else "none"
    if tree not in traversal.trees:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if tree in entry.trees)
        raise ValueError(f"traversal {traversal.name!r} does not walk a bvh, the tree of each part; choose from auto, {able}")
    if traversal.needs_shared_origin:
        raise ValueError(
            f"traversal {traversal.name!r} takes rays from one point, and those in a part have their own; choose auto"
        )
    test = (
        TRIANGLE_TESTS[DEFAULT_TEST]
        if query.triangle_test == AUTO
        else lookup(TRIANGLE_TESTS, query.triangle_test, "triangle_test")
    )
    check_query(query.kind, traversal, tree, test)
    check_culling(query.cull_backfaces, traversal, tree)


def check_test(triangle_test: str) -> None:
    """Refuses tests with records for one origin.

    Raises:
        ValueError: it is one.
    """
    if triangle_test != AUTO and TRIANGLE_TESTS[triangle_test].record.per_origin:
        raise ValueError(
            f"triangle_test is {triangle_test!r}, whose records depend on the origin of all rays; a partitioned scene supports "
            "the others, such as 'woop'"
        )
