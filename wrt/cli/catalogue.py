"""What `wrt list` lists: every algorithm with its paper, section by section as in the documentation's page of algorithms.

Names come from the tables. Entries that know their papers are asked; the papers of plain names and of public classes stand
here. A test compares all of it with the tables and with the page.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any

Rows = list[dict[str, Any]]

FALCONE = "Falcone: Ray distribution aware heuristics for bounding volume hierarchies construction in ray tracing (2024)"
HAVRAN = "Havran: Heuristic ray shooting algorithms (2001)"
SAME = "stands for the description"

PAPERS: dict[str, dict[str, str]] = {
    "accelerators": {"auto": f"{SAME} wrt.Bvh()", "bvh": f"{SAME} wrt.Bvh()", "kdtree": f"{SAME} wrt.KdTree()"},
    "termination": {
        "cost": "MacDonald, Booth (1990); Wald, Havran (2006)",
        "automatic": "Havran, Bittner: On improving kd-trees for ray shooting (2002)",
        "fixed": "Fussell, Subramanian (1988)",
    },
    "axes of medians": dict.fromkeys(
        ("longest", "round_robin"), "compared in Wald: Realtime ray tracing and interactive global illumination (2004)"
    ),
    "searched axes": dict.fromkeys(
        ("all", "longest", "mixed"),
        "Hunt, Mark, Stoll: Fast kd-tree construction with an adaptive error-bounded heuristic (2006)",
    ),
    "cost models": {
        "surface_area": "Goldsmith, Salmon (1987); MacDonald, Booth (1990)",
        "blocking": f"after {HAVRAN}",
    },
    "tests of cells": {
        "none": "Wald, Havran (2006)",
        **dict.fromkeys(("leaves", "nodes"), "Havran, Bittner: On improving kd-trees for ray shooting (2002)"),
    },
    "empty space": {
        "priced": "Hurley, Kapustin, Reshetov, Soupikov (2002); Wald, Havran (2006)",
        **dict.fromkeys(("early", "late", "both"), HAVRAN),
    },
    "hierarchies of lazy trees": {
        "grid": "after Shevtsov, Soupikov, Kapustin (2007)",
        **dict.fromkeys(
            ("meshes", "previous", "groups"),
            "Hunt, Mark, Fussell: Fast and lazy build of acceleration structures from scene hierarchies (2007)",
        ),
    },
    "layouts": {
        **dict.fromkeys(("random", "breadth_first", "depth_first", "subtrees", "pages"), HAVRAN),
        "van_emde_boas": "Prokop: Cache-oblivious algorithms (1999)",
    },
    "weights of boxes": {"pah": FALCONE, "sah": "MacDonald, Booth (1990)"},
    "axes to split": dict.fromkeys(("all", "longest", "facing", "in_turn"), FALCONE),
    "finding the area of a ray": dict.fromkeys(("auto", "octree", "kdtree", "array"), FALCONE),
    "orders of rays": {
        "none": "the rays' own order",
        "cells": "Pharr, Kolb, Gershbein, Hanrahan (1997); Månsson, Munkberg, Akenine-Möller (2007); Garanzha, Loop (2010)",
        "tiles": "a picture, tile by tile",
    },
    "as published": dict.fromkeys(
        ("moeller", "projection", "pluecker", "proposed"), "Komatsu et al. (2008), with the exits of the paper"
    )
    | {"projection": "Wald (2004), to which Komatsu et al. (2008) refer"},
    "tried by Pichler": dict.fromkeys(
        (
            *("utm_matrix", "utm_rows", "utm_free_matrix", "utm_free_columns", "utm_free_rows"),
            *("sphere_cross", "sphere_projection", "sphere_parametric", "box_sphere"),
            *("range_first", "range_delayed", "range_last"),
        ),
        "Pichler: Fast CPU Ray-Triangle Intersection Method (2018)",
    )
    | {
        "edge_planes": "Amanatides, Choi: Ray tracing triangular meshes (1997), the first of their tests",
        "dammertz_keller": (
            "Dammertz, Keller: Improving ray tracing precision by object space intersection computation (2006)"
        ),
    },
    "integrators": {
        "ambient": "Zhukov, Iones, Kronin: An ambient light illumination model (1998); Landis (2002)",
        "whitted": "Whitted: An improved illumination model for shaded display (1980); Hall, Greenberg (1983)",
        "distribution": "Cook, Porter, Carpenter: Distributed ray tracing (1984)",
        "path": "Kajiya: The rendering equation (1986); Arvo, Kirk (1990); Veach, Guibas (1995)",
    },
    "samplers": {
        "regular": "a grid",
        "random": "independent points",
        "jittered": "Cook: Stochastic sampling in computer graphics (1986); Kensler (2013)",
        "halton": "Halton (1960); Cranley, Patterson (1976)",
        "sobol": "Sobol (1967); Owen (1995); Laine, Karras (2011); Burley (2020)",
    },
}
"""Papers of the names in tables whose entries do not tell them."""

OTHERS: dict[str, dict[str, str]] = {
    "BVH builders": {
        "wrt.Bvh(reinsertion=3)": "Meister, Bittner: Parallel reinsertion for bounding volume hierarchy optimization (2018)",
        "wrt.Bvh(subset=1/32)": "Tessari, Dittebrandt, Doyle, Benthin: Stochastic subsets for BVH construction (2023)",
    },
    "clipping and costs": {
        "wrt.KdTree(split_clipping=True)": (
            "Wald, Havran (2006); Soupikov, Shevtsov, Kapustin (2008); Sutherland, Hodgman (1974)"
        ),
        "wrt.KdTree(mailbox=True)": "Hunt: Corrections to the surface area metric with respect to mail-boxing (2008)",
        "wrt.KdTree(empty_factor=0.8)": "Wald, Havran (2006)",
        'wrt.KdTree(builder="adaptive_sampling", resamplings=3)': "Popov, Günther, Seidel, Slusallek (2006)",
        'wrt.KdTree(builder="binned", median_levels=3)': "Shevtsov, Soupikov, Kapustin (2007)",
    },
    "trees for known rays": {
        "wrt.known_rays.ProjectedBvh": FALCONE,
        "wrt.known_rays.ProjectedBvh(spatial_splits=0.3)": (
            "Stich, Friedrich, Dietrich: Spatial splits in bounding volume hierarchies (2009)"
        ),
        "wrt.known_rays.RayAwareBvh": FALCONE,
        "wrt.known_rays.InfluenceAreas.from_rays": "Ester, Kriegel, Sander, Xu (1996); Fischler, Bolles (1981)",
        "wrt.known_rays.PlaneCaster": FALCONE,
        "wrt.known_rays.CircularCapCaster": FALCONE,
        "wrt.known_rays.SquareCapCaster": FALCONE,
    },
    "moving geometry": {
        "wrt.Instance": "Rubin, Whitted (1980); Wald, Benthin, Slusallek (2003)",
        "wrt.moving.InstancedScene": "Rubin, Whitted (1980); Wald, Benthin, Slusallek (2003)",
        "Scene.update": "Wald, Boulos, Shirley (2007); Lauterbach, Yoon, Tuft, Manocha (2006); Yang, Xu, Zhao (2008)",
        "Scene.updating": "Wald, Boulos, Shirley (2007); Lauterbach, Yoon, Tuft, Manocha (2006); Yang, Xu, Zhao (2008)",
        "wrt.moving.UpdatePolicy": "Lauterbach et al. (2006); Yang, Xu, Zhao (2008)",
        "wrt.moving.GroupedScene": "Kang, Nah, Park, Yang: gkDtree (2013); lists: Bikker (2007), Parker et al. (1999)",
        "wrt.moving.FuzzyScene": (
            "Günther, Friedrich, Wald, Seidel, Slusallek (2006); Günther, Friedrich, Seidel, Slusallek (2006); Lloyd (1982)"
        ),
        "wrt.moving.SkinnedScene": (
            "Günther, Friedrich, Seidel, Slusallek: Interactive ray tracing of skinned animations (2006)"
        ),
    },
    "scenes larger than memory": {
        "wrt.disk.PartitionedScene": "Pharr, Kolb, Gershbein, Hanrahan (1997); Navrátil, Fussell, Lin, Mark (2007)",
    },
    "fans": {
        "brute force over fans": "Galin, Akkouche: Fast processing of triangle meshes using triangle fans (2005)",
        "wrt.classics.FanScene": "Galin, Akkouche (2005): a BVH or a kd-tree with leaves of fans",
        'form="planes"': "Havel, Herout: Yet faster ray-triangle intersection (using SSE4) (2010), in fans",
        "files of fans": "Galin, Akkouche (2005): M + 2 vertices a fan",
    },
    "for measurements": {
        "shevtsov_flag": "Shevtsov, Soupikov, Kapustin (2007), with its flag of axis-aligned triangles",
        "wald_table": "Wald (2004): axes by a table",
        "wald_modulo": "Wald (2004): axes by division",
        "wald_shifts": "Wächter: Realtime ray tracing (2004): axes by shifts",
        "unit_ray": "Schmittler, Woop, Wagner, Paul, Slusallek (2004); Woop, Schmittler, Slusallek: RPU (2005)",
        "watertight_prune3": "after Ferko and Ferko: Pichler (2018); Woop, Benthin, Wald (2013)",
        "compact_subtrees": "Havran: Heuristic ray shooting algorithms (2001): kd-tree nodes without indices",
        "coupled_trees": "Cadet, Lécussan: Coupled use of BSP and BVH trees in order to exploit ray bundle performance (2007)",
    },
    "around a hit": {
        "Hits.smooth_normal": "Thürmer, Wüthrich: Computing vertex normals from polygonal facets (1998)",
        "Hits.spawn": "Wächter, Binder (2019); Pharr, Jakob, Humphreys (2016)",
        "samples of a pixel": "Hammersley (1960); Cranley, Patterson (1976)",
        "samples of ambient light": "Sobol (1967); Owen (1995); Laine, Karras (2011); Burley (2020)",
    },
    "materials and light": {
        "glossy": "Walter, Marschner, Li, Torrance (2007); Smith (1967); Ashikhmin, Shirley (2000)",
        "dielectric": "Walter, Marschner, Li, Torrance (2007); Fresnel; Schlick (1994)",
        "priority": "Schmidt, Budge: Simple nested dielectrics in ray traced images (2002)",
        "points on lamps": "Shirley, Wang, Zimmerman (1996); Turk (1990)",
        "thin lens": "Potmesil, Chakravarty (1981); Shirley, Chiu (1997)",
        "motion blur by slices of time": "Haeberli, Akeley: The accumulation buffer (1990)",
        "Fresnel's equations, and their approximation": "Fresnel; Schlick (1994)",
        "tone mapping": "Reinhard, Stark, Shirley, Ferwerda (2002); Narkowicz (2016)",
    },
}
"""Algorithms that are in no table: options, public classes and functions."""


def all_tables() -> dict[str, Rows]:
    """Sections with a row an algorithm, and the built-in scenes."""
    from wrt.accelerators.accelerator import ACCELERATORS
    from wrt.accelerators.projected_bvh import COSTS
    from wrt.accelerators.ray_aware_bvh import TOP_LEVELS
    from wrt.builders.bvh import BVH_BUILDERS
    from wrt.builders.bvh.phases.split_axes import AXIS_CHOICES
    from wrt.builders.cost import COST_MODELS
    from wrt.builders.kdtree import KDTREE_BUILDERS, LAYOUTS
    from wrt.builders.kdtree.kdtree_config import AXES, CELL_TESTS, EMPTY_SPACE, HIERARCHIES, SEARCHED_AXES
    from wrt.builders.tree import TERMINATIONS
    from wrt.imaging.integrators import INTEGRATORS
    from wrt.kernels.query.ordering.packet_orders import PACKET_ORDERS
    from wrt.kernels.runtime.schedules import SCHEDULES
    from wrt.kernels.shading.wavefront.pixel_samples import SAMPLERS
    from wrt.kernels.traversal import ORDERS, TRAVERSALS
    from wrt.kernels.traversal.mailbox import MAILBOXES
    from wrt.kernels.traversal.packet import CULLINGS
    from wrt.kernels.traversal.shadows import SHADOW_TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS
    from wrt.scenes import BUILTIN_SCENES

    tests = ("name", "paper", "watertight", "accurate", "two_sided", "needs_shared_origin")
    return {
        "accelerators": named("accelerators", ACCELERATORS),
        "BVH builders": entries(BVH_BUILDERS, ("name", "paper")) + others("BVH builders"),
        "kd-tree builders": entries(KDTREE_BUILDERS, ("name", "paper")),
        "termination": named("termination", TERMINATIONS),
        "axes of medians": named("axes of medians", AXES),
        "searched axes": named("searched axes", SEARCHED_AXES),
        "clipping and costs": others("clipping and costs"),
        "cost models": named("cost models", COST_MODELS),
        "tests of cells": named("tests of cells", CELL_TESTS),
        "empty space": named("empty space", EMPTY_SPACE),
        "hierarchies of lazy trees": named("hierarchies of lazy trees", HIERARCHIES),
        "layouts": named("layouts", LAYOUTS),
        "trees for known rays": others("trees for known rays"),
        "weights of boxes": named("weights of boxes", COSTS),
        "axes to split": named("axes to split", AXIS_CHOICES),
        "finding the area of a ray": named("finding the area of a ray", TOP_LEVELS),
        "moving geometry": others("moving geometry"),
        "scenes larger than memory": others("scenes larger than memory"),
        "traversals": entries(TRAVERSALS, ("name", "trees", "paper")),
        "shadow rays": entries(SHADOW_TRAVERSALS, ("name", "light", "paper")),
        "packet cullings": entries(CULLINGS, ("name", "paper")),
        "mailboxes": entries(MAILBOXES, ("name", "paper")),
        "orders of rays": named("orders of rays", ORDERS),
        "packet orders": entries(PACKET_ORDERS, ("name", "paper")),
        "triangle tests": entries(TRIANGLE_TESTS.rows, tests),
        "fans": others("fans"),
        "as published": named("as published", PAPERS["as published"]),
        "tried by Pichler": named("tried by Pichler", PAPERS["tried by Pichler"]),
        "for measurements": others("for measurements"),
        "schedules": [{"name": schedule.name, "paper": schedule.source} for schedule in SCHEDULES.values()],
        "around a hit": others("around a hit"),
        "integrators": named("integrators", INTEGRATORS),
        "samplers": named("samplers", SAMPLERS),
        "materials and light": others("materials and light"),
        "built-in scenes": entries(BUILTIN_SCENES, ("name", "description", "options")),
    }


def with_words(tables: Mapping[str, Rows], words: Iterable[str]) -> dict[str, Rows]:
    """The rows that have all words in them or in the title of their table, and the tables that have such rows."""
    wanted = [plain(word) for word in words]
    found = {}
    for title, rows in tables.items():
        texts = [plain(" ".join([title, *map(str, row.values())])) for row in rows]
        chosen = [row for row, text in zip(rows, texts, strict=True) if all(word in text for word in wanted)]
        if chosen:
            found[title] = chosen
    return found


def plain(text: str) -> str:
    """Text without capitals and accents."""
    return "".join(letter for letter in unicodedata.normalize("NFKD", text.casefold()) if not unicodedata.combining(letter))


def entries(table: Mapping[str, Any], columns: tuple[str, ...]) -> Rows:
    """A row an entry, with some of its attributes."""
    values = ({column: getattr(entry, column) for column in columns} for entry in table.values())
    return [{k: dict(v) if isinstance(v, Mapping) else v for k, v in row.items()} for row in values]


def named(section: str, names: Iterable[str]) -> Rows:
    """A row a name of a table whose entries do not know their papers.

    Raises:
        KeyError: a name has no paper here.
    """
    return [{"name": name, "paper": PAPERS[section][name]} for name in names]


def others(section: str) -> Rows:
    """The rows of a section that are in no table."""
    return [{"name": name, "paper": paper} for name, paper in OTHERS[section].items()]
