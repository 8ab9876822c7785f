"""Revisions of what is stored. They, not the version of wrt, decide whether a file of an earlier version may still be used.

Raise a number in the commit that changes the results. `tests/bits` keeps hashes of trees, hits and pictures, each with the
revision at which it was recorded: a test fails if one changes and the other does not, and `python -m tests.bits --write`
refuses to record changed hashes at the same revision.
"""

from __future__ import annotations

TREE_REVISION = {"bvh": 1, "kdtree": 1}
"""For each family of builders: raised when a builder makes another tree of the same triangles and description. Stored trees
of another revision (`wrt.Scene.save`, `cache=`, pickles, `wrt.disk.PartitionedScene`) are built again."""

ANSWER_REVISION = 2
"""Raised when a query gives other hits. Jobs (`wrt.cluster.Job`) and saved samples of another revision are refused."""

SAMPLE_REVISION = 1
"""Raised when an integrator makes other samples. Saved ones (`wrt.pictures.Rendering.save_samples`) of another revision are
refused."""

TUNING_REVISION = 1
"""Raised when engines or their classes change so that files of `wrt tune` of another revision mislead."""
