"""The method of builders that search planes by scanning a node's references, with or without split clipping."""

from functools import cache

import warp as wp

from wrt.builders.kdtree.phases.kdtree_subtrees import Method
from wrt.builders.kdtree.scan.reference_lists import ReferenceLists, divide, emit_leaf
from wrt.builders.kdtree.scan.split_clipping import divide_clipping


@cache
def scanning(search: wp.Function, clipping: bool = False) -> Method:
    """The method of a builder that searches by scanning references. clipping: whether straddlers are clipped."""
    if not clipping:
        return Method(ReferenceLists, search, divide, emit_leaf)
    return Method(ReferenceLists, search, divide_clipping, emit_leaf)
