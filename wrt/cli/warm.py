"""`wrt warm`: compiles the kernels of the default paths ahead, into the kernel cache or into a folder to ship.

Meant for container images, continuous integration and clusters, whose first call would otherwise compile. Several processes may
use one kernel cache at the same time.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.arguments import busy, start_warp, target_options
from wrt.cli.number_types import Whole
from wrt.cli.warm_features import FEATURES, Samples

if TYPE_CHECKING:
    from collections.abc import Iterable

    import warp as wp

    from wrt.engine.launch.expected_kernels import ExpectedRays
    from wrt.scene.scene import Scene

STACK_DEPTHS = (8, 16)
"""Depths of trees whose kernels are compiled. With 8 children a node, trees of 200,000 triangles are 7 deep."""

RAY_COUNTS = (1 << 12, 1 << 14, 1 << 16, 1 << 20)
"""Numbers of rays whose kernels are compiled: they decide on the length of streams, and on what packets are culled by."""

GRID = 128
"""Squares along a side of the mesh that is built: its triangles are divided among threads."""

LIST = "list"
"""In place of a feature: what there is."""


class FeatureNames(click.ParamType):
    """Names of features, separated by commas."""

    name = "NAME,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(dict.fromkeys(name.strip() for name in value.split(",")))
        for name in names:
            if name not in (*FEATURES, LIST):
                self.fail(f"{name!r} is unknown; choose from {', '.join(FEATURES)}, or {LIST} to see what they are", param, ctx)
        return names


@click.command()
@target_options
@click.option("--jobs", type=Whole(1, 64), help="Modules that are compiled at a time. [all cores]")
@click.option("--export", type=click.Path(path_type=Path, file_okay=False), help="Folder to copy the kernels to.")
@click.option("--first-hit", is_flag=True, help="Only the kernels for building a scene and tracing small batches.")
@click.option("--feature", "features", type=FeatureNames(), multiple=True, help=f"Only what these need; {LIST}: lists them.")
def warm(jobs: int | None, export: Path | None, first_hit: bool, features: tuple[tuple[str, ...], ...]) -> None:
    """Compiles the kernels of the default paths ahead: builds, closest hits and occlusion of few and many rays, pictures.

    With --feature, what the first calls of these features compile, by small calls of them; several are separated by commas.

    What the kernel cache has already is left alone. With --export, kernels for a --target other than native are
    also copied to a folder, which wrt uses in place of compiling (WRT_COMPILED_KERNELS).
    """
    from wrt.kernels.compilation import compile_progress, kernel_cache, module_compiler, shipped_kernels
    from wrt.kernels.compilation.target import target_name

    names = tuple(dict.fromkeys(name for some in features for name in some))
    if LIST in names:
        for name, feature in FEATURES.items():
            click.echo(f"{name:13} {feature.what}")
        return
    if names and first_hit:
        raise click.UsageError("--first-hit and --feature choose different kernels: leave one of them out")
    if export is not None and target_name() == "native":
        raise click.BadParameter("needs a --target other than native, such as x86-64-v3", param_hint="--export")
    if jobs is not None:
        os.environ[module_compiler.VARIABLE] = str(jobs)
    if export is not None:
        os.environ[shipped_kernels.VARIABLE] = os.devnull  # they are compiled, not copied from where they were shipped to
    start_warp("cpu", compiles_later=False)
    import warp as wp

    start = time.perf_counter()
    with busy("compiling kernels"):
        modules = feature_modules(names) if names else loaded(first_hit_kernels() if first_hit else default_kernels())
    seconds, compiled = time.perf_counter() - start, compile_progress.counts()[0]
    found = f"{len(modules) - compiled} were there or shipped" if compiled < len(modules) else "none was there"
    click.echo(f"{len(modules)} modules of kernels for {target_name()}: {compiled} compiled in {seconds:.1f} s, {found}")
    click.echo(f"kernel cache: {wp.config.kernel_cache_dir}, {kernel_cache.folder_size()[1] / 1e6:.1f} MB")
    if export is not None:
        count = shipped_kernels.export(modules, export)
        click.echo(f"{count} modules exported to {export / target_name()}")


def feature_modules(names: Iterable[str]) -> list[wp.Module]:
    """Makes the calls of features; the modules that this process has loaded then."""
    import warp as wp

    from wrt.kernels.compilation.module_compiler import loaded_modules

    samples = Samples()
    for name in names:
        FEATURES[name].call(samples)
    return loaded_modules(wp.get_device("cpu"))


def loaded(kernels: list[wp.Kernel]) -> list[wp.Module]:
    """Compiles and loads kernels; their modules."""
    import warp as wp

    from wrt.kernels.runtime.launch import load

    load(kernels, wp.get_device("cpu"))
    return [*dict.fromkeys(kernel.module for kernel in kernels)]


def default_kernels() -> list[wp.Kernel]:
    """One kernel of each module that the default paths on the CPU need: builds, closest hits and occlusion, pictures."""
    from wrt.engine.facts.query_kinds import ANY, CLOSEST
    from wrt.engine.launch.expected_kernels import expected_rays
    from wrt.imaging.ambient_rendering import shading_kernels

    rays = []
    for count in RAY_COUNTS:
        for kind in (CLOSEST, ANY):
            rays += [expected_rays(kind, count, shared_origin=shared) for shared in (True, False)]
            rays.append(expected_rays(kind, count, coherent=False))
    kernels = [*shading_kernels(smooth=True, ambient_rays=True), *first_hit_kernels(), *_tracing_kernels(_grid(), rays)]
    return [*dict.fromkeys(kernels)]


def first_hit_kernels() -> list[wp.Kernel]:
    """One kernel of each module that builds a scene and traces few rays."""
    import numpy as np
    import warp as wp

    from wrt.accelerators.tree_descriptions import Bvh
    from wrt.engine.launch.expected_kernels import FEW, build_kernels
    from wrt.kernels.query.hit_attributes import hit_positions

    kernels, device = [hit_positions], wp.get_device("cpu")
    for dtype in (np.float32, np.float64):
        for triangles in (1, 2 * GRID * GRID):  # few are built by kernels of their own
            kernels += build_kernels(Bvh(), device, dtype, triangles)
    return [*dict.fromkeys([*kernels, *_tracing_kernels(_grid(), FEW)])]


def _grid() -> Scene:
    """A wavy sheet."""
    import numpy as np

    from wrt.meshes.mesh import TriangleMesh
    from wrt.scene.scene import Scene

    x, y = np.meshgrid(np.linspace(0, 1, GRID + 1), np.linspace(0, 1, GRID + 1), indexing="ij")
    vertices = np.stack([x, y, 0.1 * np.sin(9 * x) * np.cos(7 * y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(GRID)[:, None] * (GRID + 1) + np.arange(GRID)).ravel()
    above = corner + GRID + 1
    faces = np.concatenate([np.stack([corner, above, above + 1], 1), np.stack([corner, above + 1, corner + 1], 1)])
    return Scene(TriangleMesh(vertices, faces), device="cpu")


def _tracing_kernels(scene: Scene, rays: Iterable[ExpectedRays]) -> list[wp.Kernel]:
    """The kernels that trace rays, as it were through trees of several depths."""
    from dataclasses import replace

    from wrt.engine.launch.expected_kernels import query_kernels

    found = []
    for depth in STACK_DEPTHS:
        tree = replace(scene.state.built_tree, level_first=tuple(range(depth + 1)))
        found += query_kernels(replace(scene.state, built_tree=tree), rays)
    return found
