"""Algorithms on which tests of the engine run, and those that neither "auto" nor the defaults choose."""

from __future__ import annotations

from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.kernels.on_demand import OnDemand
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.triangle import CLASSIC_TESTS

ENGINE_TESTS = ("woop", "moeller_trumbore", "komatsu")
"""Triangle tests on which everything around them is tested: by hand, by steps, and with an origin that must be shared. What
the engine does with a test is the same for all others; `test_triangle_tests.py` shows that they fit in."""

OTHER_WAYS_TO_PACKETS = ("repacked_packet", "multi_frusta", "mlrta", "aepsa", "omnidirectional", "queued")
"""Traversals that meet leaves by the steps of "packet" (`wrt.kernels.traversal.packet.core.packet_kernel`), or of "single":
what they do with one triangle test, and with an origin that must be shared, is the same for all."""

CLASSICS = {
    *CLASSIC_TESTS,
    *(name for name, way in TRAVERSALS.items() if any(isinstance(make, OnDemand) for make in way.kernels.values())),
    *(name for name, one in CULLINGS.items() if any(isinstance(value, OnDemand) for value in vars(one).values())),
    *(name for name, one in MAILBOXES.items() if isinstance(one.filter, OnDemand)),
    *(name for table in (KDTREE_BUILDERS, BVH_BUILDERS) for name, one in table.items() if isinstance(one.build, OnDemand)),
} - {"none"}
"""Algorithms of kernels/classics and builders/classics. "none" is a key of several tables."""
