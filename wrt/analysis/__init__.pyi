# Written by `python -m tests.typed.stubs` from the table of names in wrt/analysis/__init__.py.
from wrt.analysis.baked_values import BakedTexture as BakedTexture
from wrt.analysis.baked_values import bake as bake
from wrt.analysis.distance_grids import DistanceGrid as DistanceGrid
from wrt.analysis.distance_grids import distance_grid as distance_grid
from wrt.analysis.mesh_pairs import ClosestPair as ClosestPair
from wrt.analysis.mesh_pairs import clearance as clearance
from wrt.analysis.mesh_pairs import closest_pair as closest_pair
from wrt.analysis.mesh_pairs import overlapping_triangles as overlapping_triangles
from wrt.analysis.seen_faces import viewshed as viewshed
from wrt.analysis.seen_faces import visible_faces as visible_faces
from wrt.analysis.signed_distances import sign_rule as sign_rule
from wrt.analysis.signed_distances import signed_distance as signed_distance
from wrt.analysis.sky_exposure import ambient_occlusion as ambient_occlusion
from wrt.analysis.sky_exposure import exposure as exposure
from wrt.analysis.sky_exposure import sky_directions as sky_directions
from wrt.analysis.surface_samples import sample_surface as sample_surface
from wrt.analysis.wall_thickness import shape_diameter as shape_diameter
from wrt.analysis.wall_thickness import thickness as thickness
from wrt.analysis.winding_numbers import winding_number as winding_number

__all__ = [
    "BakedTexture",
    "ClosestPair",
    "DistanceGrid",
    "ambient_occlusion",
    "bake",
    "clearance",
    "closest_pair",
    "distance_grid",
    "exposure",
    "overlapping_triangles",
    "sample_surface",
    "shape_diameter",
    "sign_rule",
    "signed_distance",
    "sky_directions",
    "thickness",
    "viewshed",
    "visible_faces",
    "winding_number",
]
