"""Interface between a binned build and its cost model, and the model for rays in all directions.

The loops of the binned build and of the collapse are written once (`bvh_levels`, `bvh_subtrees`, `collapse`) and compiled for
each `Heuristic`. Rays in all directions meet a box in proportion to its surface area. `projected_binned` has the model for
known rays.

References: macdonald-booth-1990.
"""

from dataclasses import dataclass

import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, half_area, half_area_of_both
from wrt.builders.bvh.phases.bvh_bins import Binning, Scratch, best_plane


@dataclass(frozen=True)
class Heuristic:
    """The weight of boxes and the choice of planes.

    Attributes:
        rays: a Warp struct with the heuristic's knowledge of the rays.
        search: (rules, rays, binning, scratch, slot, tree, frame) -> Plane, the best one of a node whose bins are filled.
        is_leaf: (rules, rays, tree, frame) -> bool, whether a node that `is_small` would divide is a leaf. It must fit into a
            leaf of the wide tree.
        weigh: (rays, tree, node) -> float, a node's weight, proportional to the number of rays that meet it.
        weigh_parent: (rays, tree, pair) -> float, the weight of the box around a pair, with the same bits as its parent's.
    """

    rays: type
    search: wp.Function
    is_leaf: wp.Function
    weigh: wp.Function
    weigh_parent: wp.Function


@wp.struct
class AllDirections:
    """No knowledge of the rays."""


@wp.func
def cheapest_by_surface(
    rules: BuildRules, rays: AllDirections, binning: Binning, scratch: Scratch, slot: int, tree: BinaryTree, frame: Frame
):
    """The plane of least cost over all axes."""
    return best_plane(rules.cost, scratch, slot, binning.bins, binning.axes, frame.count)


@wp.func
def never_leaf(rules: BuildRules, rays: AllDirections, tree: BinaryTree, frame: Frame):
    """Always false: the collapse makes the leaves."""
    return False


@wp.func
def surface_of(rays: AllDirections, tree: BinaryTree, node: int):
    """Half the surface area of a node's box."""
    return half_area(tree.box, node)


@wp.func
def surface_of_parent(rays: AllDirections, tree: BinaryTree, pair: int):
    """Half the surface area of the box around a pair."""
    return half_area_of_both(tree.box, pair)


SURFACE = Heuristic(AllDirections, cheapest_by_surface, never_leaf, surface_of, surface_of_parent)
"""The surface area heuristic."""
