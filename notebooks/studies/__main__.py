"""`python -m studies`, in the folder notebooks/: lists the studies. `python -m studies NAME --help`: what one takes."""

from __future__ import annotations

from importlib import import_module

import click

from studies.row_studies import ROW_STUDIES, row_command
from wrt.cli.arguments import start_warp

COMMANDS = {
    "animation": ("animation", "animation_command"),
    "bounces": ("bounces", "bounces_command"),
    "build-sizes": ("build_sizes", "build_sizes_command"),
    "builders": ("builders", "builders_command"),
    "cluster": ("cluster", "cluster_command"),
    "figures": ("evidence.evidence_commands", "figures_command"),
    "komatsu": ("komatsu", "komatsu_command"),
    "layouts": ("builders", "layouts_command"),
    "measure": ("evidence.evidence_commands", "measure_command"),
    "pichler": ("komatsu", "pichler_command"),
    "ray-aware": ("ray_aware", "ray_aware_command"),
    "scheduling": ("scheduling", "scheduling_command"),
    "shading": ("bounces", "shading_command"),
    "shadows": ("shadows", "shadows_command"),
    "triangle-tests": ("triangle_tests", "triangle_tests"),
}
"""Module of this package, and the command in it, by the name of a study that has options of its own."""


class Studies(click.Group):
    """A group whose commands are imported when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all studies."""
        return sorted({*COMMANDS, *ROW_STUDIES})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command of a study; None if there is no such study."""
        if name in ROW_STUDIES:
            return row_command(name)
        if name not in COMMANDS:
            return None
        module, attribute = COMMANDS[name]
        return getattr(import_module(f"studies.{module}"), attribute)


@click.group("studies", cls=Studies)
def studies() -> None:
    """Tables, figures and claims of papers, measured again."""
    start_warp(None)


if __name__ == "__main__":
    studies(prog_name="python -m studies")
