"""The command line as users call it."""

from __future__ import annotations

from click.testing import CliRunner

from wrt.cli import main


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])
