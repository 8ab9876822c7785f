"""Every command, with inputs that are no files, numbers that are none, and closed streams: one line, and status 1 or 2."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

from wrt.bench.commands.benchmark import COMPARISONS
from wrt.cli import LazyCommand, main
from wrt.cli.number_types import MAX_INT

NO_NUMBERS = ("", "x", "nan", "inf", "-inf", "1e999", str(10**300), str(-(10**300)), "0x10", "1,5")
"""None is in the range of any option. (`MAX_INT` bounds whole numbers.)"""


def commands() -> dict[tuple[str, ...], click.Command]:
    """Every command of the command line, by the words that call it."""
    found = {}
    for name, command in main.commands.items():
        real = getattr(import_module(command.module), command.attribute) if isinstance(command, LazyCommand) else command
        inner = real.commands if isinstance(real, click.Group) else {"": real}
        found |= {(name, *below.split()): one for below, one in inner.items()}
    for name, (module, attribute) in COMPARISONS.items():
        found["bench", name] = getattr(import_module(f"wrt.bench.commands.{module}"), attribute)
    return found


COMMANDS = commands()
READERS = [words for words, command in COMMANDS.items() if any(p.name in ("model", "models") for p in command.params)]
"""Commands that take mesh files."""


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def assert_one_line(result: Result, *statuses: int) -> None:
    """It failed with one line on stderr, and no exception other than the end of the process."""
    assert result.exit_code in statuses, (result.exit_code, result.output)
    assert isinstance(result.exception, SystemExit)
    assert result.stderr.startswith("error: "), result.stderr
    assert result.stderr.count("\n") == 1, result.stderr
    assert "unexpected" not in result.stderr, "an error that nobody has thought of"


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_numbers_that_are_none(words):
    """`--fov nan` was in every range, and whole numbers beyond 32 bits went on to kernels that count with these."""
    for parameter in COMMANDS[words].params:
        numeric = isinstance(parameter.type, click.types.IntParamType | click.types.FloatParamType)
        if not (isinstance(parameter, click.Option) and numeric):
            continue
        for text in NO_NUMBERS:
            result = run(*words, parameter.opts[0], *[text] * parameter.nargs)
            assert_one_line(result, 2)
            assert parameter.opts[0] in result.stderr
        if not isinstance(parameter.type, click.types.FloatParamType):
            assert parameter.type.max <= MAX_INT


@pytest.fixture(scope="module")
def hostile(tmp_path_factory) -> dict[str, Path]:
    """Paths that are no mesh files, by what they are."""
    folder = tmp_path_factory.mktemp("hostile")
    found = {name: folder / f"{name}.ply" for name in ("folder", "pipe", "empty", "noise", "missing", "locked")}
    found["folder"].mkdir()
    if hasattr(os, "mkfifo"):
        os.mkfifo(found["pipe"])
    else:
        del found["pipe"]
    found["empty"].touch()
    noise = np.random.default_rng(0).bytes(1000)
    for suffix in ("ply", "obj", "stl", "glb", "gltf", "off", "unheard"):
        found[f"noise.{suffix}"] = folder / f"noise.{suffix}"
        found[f"noise.{suffix}"].write_bytes(noise)
    found["noise"].write_bytes(b"ply\n" + noise)
    found["locked"].write_bytes(noise)
    found["locked"].chmod(0)
    for device in ("/dev/zero", "/dev/null"):
        if os.path.exists(device):
            found[device] = Path(device)
    return found


@pytest.mark.parametrize("words", READERS, ids=" ".join)
def test_what_is_no_mesh_file(words, hostile, tmp_path, monkeypatch):
    """Reading a pipe that nobody writes to, or a device, would never end."""
    if words == ("view",) and find_spec("viser") is None:
        pytest.skip("the viewer is not installed")
    monkeypatch.chdir(tmp_path)
    options = {("render",): ["-o", "a.png"], ("view",): ["--port", "0"]}.get(words, [])
    for name, path in hostile.items():
        result = run(*words, path, *options)
        assert_one_line(result, 1, 2)
        assert path.name in result.stderr, name
    assert not list(tmp_path.iterdir())


def test_pictures_that_cannot_be_written(tmp_path, monkeypatch):
    """Said before rays are traced: a picture may take hours."""
    monkeypatch.setattr("wrt.cli.render.load_mesh", lambda *args, **options: pytest.fail("too late"))
    (tmp_path / "folder.png").mkdir()
    assert_one_line(run("render", "-o", tmp_path / "folder.png"), 2)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.png")
        assert_one_line(run("render", "-o", tmp_path / "pipe.png"), 2)
    assert_one_line(run("render", "-o", tmp_path / "none" / "a.png"), 1)
    result = run("render", "-o", tmp_path / "a.png", "--width", MAX_INT, "--height", MAX_INT)
    assert_one_line(result, 2)
    assert "choose a smaller --width or --height" in result.stderr


def test_figures_that_cannot_be_written(tmp_path):
    """Said before what takes minutes is measured."""
    for words, command in COMMANDS.items():
        for parameter in command.params:
            if parameter.name in ("json_file", "plot_file"):
                result = run(*words, parameter.opts[0], tmp_path / "none" / "figures")
                assert_one_line(result, 2)
                assert f"there is no folder '{tmp_path / 'none'}'" in result.stderr


def test_values_of_scenes(tmp_path):
    """Literals nested without end are none of Python's, and long ones are not repeated in full."""
    too_many = run("info", "--scene", "atrium", "--option", "bays=(100000000,100000000)")
    assert_one_line(too_many, 2)
    assert "bays is 100000000; it must be at most 10000" in too_many.stderr
    assert_one_line(run("info", "--scene", ""), 2)
    assert "size is nan" in run("info", "--scene", "random_triangles", "--option", "size=nan").stderr
    assert_one_line(run("render", "-o", "a.png", "--camera", "1e300,0,0"), 2)
    for value in ("(" * 3000, "[" * 100_000, "-" * 50_000 + "1", "9" * 5000, "nan", "(1,", "{}"):
        result = run("info", "--option", f"level={value}")
        assert_one_line(result, 1, 2)
        assert len(result.stderr) < 2200


def test_unexpected_errors_are_one_line(monkeypatch):
    """Also those that no command thinks of; a variable asks for the traceback."""

    def broken(*args, **options):
        raise KeyError("inner")

    monkeypatch.setattr("wrt.cli.catalogue.all_tables", broken)
    monkeypatch.delenv("WRT_TRACEBACK", raising=False)
    result = run("list")
    assert result.exit_code == 1
    assert result.stderr == "error: unexpected KeyError: 'inner'; with WRT_TRACEBACK=1, the traceback says where\n"
    monkeypatch.setenv("WRT_TRACEBACK", "1")
    assert isinstance(run("list").exception, KeyError)


# -- streams -----------------------------------------------------------------------------------------------------------

CLOSED = "error: stdout is closed; redirect it to a file, or to /dev/null"
STREAMS = [
    ("{wrt} --help >&-", {1}, CLOSED),  # by click
    ("{wrt} list spatial >&-", {1}, CLOSED),  # by rich
    ("{wrt} nothing >&- 2>&- <&-", {2}, ""),
    ("{wrt} list --json | true", {1}, ""),
    ("{wrt} --help | true", {0, 1}, ""),  # it fits into the pipe, if that is not closed before
    ("{wrt} nothing 2>&1 | true", {2}, ""),
]
if os.path.exists("/dev/full"):
    STREAMS.append(("{wrt} --help >/dev/full", {1}, "error: [Errno 28] No space left on device"))


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs a shell")
def test_streams_that_nobody_reads(tmp_path):
    """`wrt info >&-` ended in an AttributeError; all at once, because each is a process."""
    script = "set -o pipefail\n"
    for number, (line, _, _) in enumerate(STREAMS):
        command = line.format(wrt=f"{sys.executable} -m wrt")
        script += f"( {command} ) 2>err{number} & pids[{number}]=$!\n"
    script += f"for n in $(seq 0 {len(STREAMS) - 1}); do wait ${{pids[$n]}}; echo $? >rc$n; done\n"
    subprocess.run(["bash", "-c", script], cwd=tmp_path, check=True, timeout=120)
    for number, (line, statuses, message) in enumerate(STREAMS):
        said = (tmp_path / f"err{number}").read_text()
        assert said.strip() == message, line
        assert int((tmp_path / f"rc{number}").read_text()) in statuses, line
