"""Builders of the literature that neither "auto" nor the defaults choose, one file or folder per method.

The tables (`wrt.builders.kdtree.KDTREE_BUILDERS`, `wrt.builders.kdtree.LAYOUTS`, `wrt.builders.bvh.BVH_BUILDERS`) name these
modules, which are imported when they are asked for (`wrt.builders.core.late_import`). Nothing else in `wrt.builders` depends
on them.

* `kdtree`: builders of kd-trees, orders of their nodes, and passes over finished trees.
* `bvh`: the exact sweep, reinsertion, and builds on a random subset.
"""
