"""The command `wrt`: images, statistics and lists from the command line.

    wrt render -o teapot.png        the built-in teapot
    wrt render bunny.ply -o b.png   any mesh file
    wrt view bunny.ply              the same in a web browser, live
    wrt info bunny.ply              the mesh and its tree
    wrt verify bunny.ply            hits against brute force in float64
    wrt list                        every builder, traversal, triangle test and built-in scene
    wrt warm                        compiles the kernels of the default paths ahead
    wrt tune model.ply              finds out which engines are the fastest on this machine
    wrt release                     a wheel with compiled kernels, and a source distribution
    wrt job run job.toml            a resumable batch of rays
    wrt bench bunny.ply             against other ray tracers

An error is one line on stderr, and so is a warning. Exit status: 0 for success, 1 for a failure, 2 for wrong usage, 130 for
Ctrl-C. With WRT_TRACEBACK=1, an error that no command expects comes with its traceback. Commands are imported when they are
called, so that `wrt --help` answers at once.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

import click

from wrt import __version__
from wrt.cli.standard_streams import drop_unwritten, replace_closed_streams, say

OBJECTS_TO_COLLECT = 100_000
"""New objects after which Python looks for garbage, 700 by default: what is imported stays, and searching it again and again
took a tenth of the time to start (notebooks/records/2026-11-23-warm-start.md)."""

LONGEST = 2000
"""Characters of an error: texts that it quotes may be of any length."""

TRACEBACK = "WRT_TRACEBACK"
"""Variable that asks for tracebacks of unexpected errors."""


class LazyCommand(click.Command):
    """A command that is imported only when it is called.

    Args:
        name: name of the command.
        module: module that defines it.
        attribute: its name in the module.
        help: its line in the list of commands.
    """

    def __init__(self, name: str, module: str, attribute: str, help: str) -> None:
        super().__init__(name, help=help)
        self.module, self.attribute = module, attribute

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """The context of the real command, which click continues with."""
        return getattr(import_module(self.module), self.attribute).make_context(*args, **kwargs)


class CommandLine(click.Group):
    """A group of commands that print errors as one line."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Runs a command and ends the process with its exit status."""
        kwargs["standalone_mode"] = False
        replace_closed_streams()
        thresholds, plain = gc.get_threshold(), warnings.formatwarning
        warnings.formatwarning = partial(_warning, plain)
        gc.set_threshold(OBJECTS_TO_COLLECT, *thresholds[1:])
        # Python looks for garbage twice at its exit, among all that is imported (notebooks/records/2026-11-28-kernels-later.md)
        atexit.unregister(gc.freeze)
        atexit.register(gc.freeze)
        try:
            status = super().main(*args, **kwargs)
            sys.stdout.flush()  # at the end of the process an error would be a traceback
        except click.UsageError as error:
            path = error.ctx.command_path if error.ctx else "wrt"
            _fail(f"{error.format_message()} (see '{path} --help')", 2)
        except click.ClickException as error:
            _fail(error.format_message(), 1)
        except (click.Abort, KeyboardInterrupt):
            say("interrupted")
            sys.exit(130)
        except BrokenPipeError:  # whoever read has enough
            drop_unwritten()
            sys.exit(1)
        except MemoryError:
            _fail("out of memory; use a smaller mesh or image", 1)
        except (OSError, ValueError, TypeError, RuntimeError, ImportError) as error:
            _fail(str(error) or type(error).__name__, 1)
        except Exception as error:
            if os.environ.get(TRACEBACK, "") not in ("", "0"):
                raise
            reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
            _fail(f"unexpected {reason}; with {TRACEBACK}=1, the traceback says where", 1)
        finally:
            gc.set_threshold(*thresholds)
            warnings.formatwarning = plain
        sys.exit(status if isinstance(status, int) else 0)


def _one_line(message: object) -> str:
    line = " ".join(str(message).split())
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."


def _warning(plain: Callable[..., str], message: Warning | str, category: type[Warning], *place: Any) -> str:
    """A warning for users as one line, without the place in the code; others, which are for programmers, as Python has them."""
    return f"warning: {_one_line(message)}\n" if category is UserWarning else plain(message, category, *place)


def _fail(message: str, status: int) -> None:
    say(f"error: {_one_line(message)}")
    drop_unwritten()
    sys.exit(status)


@click.group("wrt", cls=CommandLine, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="wrt", message="%(prog)s %(version)s")
def main() -> None:
    """Ray tracing of triangle meshes, on all CPU cores and on CUDA."""


for command in (
    LazyCommand("render", "wrt.cli.render", "render", "Renders a mesh file or a built-in scene to an image."),
    LazyCommand("view", "wrt.cli.view_command", "view", "Shows mesh files or a built-in scene in a web browser."),
    LazyCommand("info", "wrt.cli.figures", "info", "Shows statistics of a mesh and of its tree."),
    LazyCommand("verify", "wrt.cli.verify", "verify", "Checks hits on a mesh against brute force in float64."),
    LazyCommand("list", "wrt.cli.figures", "list_tables", "Lists every algorithm with its paper, and the built-in scenes."),
    LazyCommand("warm", "wrt.cli.warm", "warm", "Compiles the kernels of the default paths ahead."),
    LazyCommand("tune", "wrt.bench.commands.tune_command", "tune", "Finds out which engines are the fastest on this machine."),
    LazyCommand("release", "wrt.cli.release", "release", "Makes a wheel with compiled kernels, and a source distribution."),
    LazyCommand("job", "wrt.cli.jobs", "job", "Runs resumable batches of rays, and shows their progress."),
    LazyCommand("bench", "wrt.bench.commands.benchmark", "bench", "Compares wrt with other ray tracers, on the same rays."),
):
    main.add_command(command)
