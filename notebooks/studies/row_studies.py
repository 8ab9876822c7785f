"""Studies whose result is a list of rows: each is a function, and its command prints what it returns."""

from __future__ import annotations

from dataclasses import asdict, is_dataclass
from importlib import import_module
from inspect import getdoc, signature
from pathlib import Path

import click

from studies.study_options import number
from wrt.bench.commands.command_options import json_option, load_model, progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_results import machine

ROW_STUDIES = {
    "area-axes": ("known_rays.area_tables", "axes_tried"),
    "area-break-even": ("known_rays.area_tables", "break_evens"),
    "area-build-times": ("known_rays.area_tables", "build_times"),
    "area-costs": ("known_rays.area_tables", "costs"),
    "area-gains": ("known_rays.area_tables", "gains"),
    "area-memory": ("known_rays.area_tables", "memory"),
    "area-precision": ("known_rays.area_tables", "precision"),
    "area-thresholds": ("known_rays.area_tables", "thresholds"),
    "area-walks": ("known_rays.area_tables", "walk_orders"),
    "area-work": ("known_rays.affinity", "compare_work"),
    "axis-flag": ("triangles.axis_variants", "compare_flag"),
    "axis-selections": ("triangles.axis_variants", "compare_selections"),
    "entry-point-tiles": ("kdtrees.entry_point_tiles", "compare_levels"),
    "fan-trees": ("triangles.fan_comparison", "compare_trees"),
    "fans": ("triangles.fan_comparison", "compare"),
    "first-frames": ("kdtrees.kdtree_claims", "compare_first_frames"),
    "fuzzy-boxes": ("moving.motion_run", "fuzzy_boxes"),
    "gpu-warps": ("gpu_warps", "compare_warps"),
    "inside-first": ("triangles.inside_first", "compare_orders"),
    "lazy-groups": ("kdtrees.lazy_groups", "compare_hierarchies"),
    "leaf-sizes": ("kdtrees.leaf_sizes", "compare_leaf_sizes"),
    "mailbox-costs": ("kdtrees.kdtree_claims", "mailbox_costs"),
    "memory-traffic": ("memory_traffic", "compare_traffic"),
    "motion-drift": ("moving.motion_run", "drifts"),
    "octree-levels": ("known_rays.area_tables", "octree_levels"),
    "octree-top-levels": ("known_rays.ray_distribution", "top_levels"),
    "packet-widths": ("kdtrees.packet_widths", "compare_widths"),
    "plane-places": ("kdtrees.plane_places", "compare_places"),
    "thread-growth": ("kdtrees.thread_growth", "thread_growth"),
    "tree-coupling": ("kdtrees.tree_coupling", "compare_coupling"),
    "volume-search": ("triangles.volume_search", "compare_forms"),
}
"""Module of this package, and the function in it, by the name of the study."""


def row_command(name: str) -> click.Command:
    """The command of a study: MODEL where the function takes a mesh, an option for each of its whole numbers."""
    module, attribute = ROW_STUDIES[name]
    study = getattr(import_module(f"studies.{module}"), attribute)
    taken = signature(study).parameters

    def run(json_file: Path | None, model: str | None = None, **options: int) -> None:
        from studies.komatsu import print_rows

        meshes = () if model is None else (load_model(model),)
        with progress() as on_turn, usage_errors():
            on_turn(name)
            rows = [asdict(row) if is_dataclass(row) else row for row in study(*meshes, **options)]
        print_rows(table_console(200), name, rows)
        write_json(json_file, {"machine": machine("cpu"), "rows": rows})

    arguments = [click.Argument(["model"], default="teapot")] if "mesh" in taken else []
    command = click.Command(name, callback=run, params=arguments, help=getdoc(study).split("\n\n")[0])
    for key, parameter in taken.items():
        if type(parameter.default) is int:
            command = number(f"--{key}", parameter.default, "", 0 if key == "seed" else 1)(command)
    return json_option(command)
