"""`wrt verify`: compares hits on a mesh with brute force, on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import click

from wrt.cli.arguments import busy, check_name, load_mesh, make_scene, model_options, start_warp
from wrt.cli.cloud_models import refuse_cloud
from wrt.cli.number_types import Whole


@click.command()
@model_options
@click.option("--triangle-test", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--samples", default=1000, show_default=True, type=Whole(4), help="Rays, a quarter of each kind.")
@click.option("--seed", default=0, show_default=True, type=Whole(0), help="Seed of the rays.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of tables.")
def verify(triangle_test: str, samples: int, seed: int, as_json: bool, **given: Any) -> int:
    """Checks hits on MODEL (or on a built-in scene) against brute force in float64.

    Rays are random, aimed at vertices and edges, and grazing. The exit status is 1 if an answer is wrong.
    """
    start_warp(given["device"])
    check_test(triangle_test)
    refuse_cloud(given["model"], "verify")
    mesh, _ = load_mesh(given)
    scene = make_scene(mesh, given, triangle_test)
    with busy("comparing with brute force"):
        report = scene.verify(samples, seed)
    if as_json:
        click.echo(json.dumps({"ok": report.ok, **asdict(report)}, indent=1))
    else:
        from rich.console import Console

        report.print(Console())
    return 0 if report.ok else 1


def check_test(name: str) -> None:
    """Refuses an unknown name, and a test that needs a shared origin: the rays of this check have different origins."""
    from wrt.kernels.triangle import TRIANGLE_TESTS

    if check_name("triangle_test", name) != "auto" and TRIANGLE_TESTS[name].needs_shared_origin:
        able = ", ".join(test.name for test in TRIANGLE_TESTS.values() if not test.needs_shared_origin)
        message = f"{name!r} needs rays that share their origin; choose from auto, {able}"
        raise click.BadParameter(message, param_hint="--triangle-test")
