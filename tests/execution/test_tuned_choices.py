"""What `wrt tune` stores for a machine: it is read back, and a file that is damaged or of another machine is left alone."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
import wrt.device
from wrt.bench.commands import tune_command
from wrt.bench.comparisons.auto_cases import cases
from wrt.bench.comparisons.auto_choices import Choice, class_of_case
from wrt.cli import main
from wrt.engine import executor
from wrt.engine.facts.facts import RayFacts, SceneFacts
from wrt.engine.plan import tuned_choices
from wrt.engine.plan.tuned_choices import class_name, read, this_machine, tuned_engine, write

SCENE, RAYS = SceneFacts(tree="bvh", width=16, triangles=1000), RayFacts(70_000, (70_000,), coherent=False)
NAME = "closest incoherent 2^16 rays 2^9 triangles"


@pytest.fixture(autouse=True)
def file(tmp_path, monkeypatch):
    """Where the file is, in this test."""
    path = tmp_path / "folder" / "tuned.json"
    monkeypatch.setenv(tuned_choices.VARIABLE, str(path))
    tuned_choices.forget()
    yield path
    monkeypatch.undo()
    tuned_choices.forget()


def test_classes():
    assert class_name(SCENE, RAYS, "closest") == NAME
    rays = RayFacts(64 * 64, (64, 64), shared_origin=True, columns=64)
    scene = SceneFacts(tree="bvh", width=16, triangles=1 << 20, instances=3)
    assert class_name(scene, rays, "any") == "any coherent one point picture instances 2^12 rays 2^20 triangles"


def test_what_was_written_is_read(file):
    assert tuned_engine(SCENE, RAYS, "closest", 2) is None
    write({"2": {NAME: "stream"}}, file)
    assert tuned_engine(SCENE, RAYS, "closest", 2) == "stream"
    assert tuned_engine(SCENE, RAYS, "closest", 4) is None
    assert tuned_engine(SCENE, RAYS, "any", 2) is None
    write({"4": {NAME: "interleaved"}}, file)
    assert [tuned_engine(SCENE, RAYS, "closest", threads) for threads in (2, 4)] == ["stream", "interleaved"]
    assert [*file.parent.iterdir()] == [file], "no temporary file is left"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b"null",
        b"[" * 100_000,
        b" " * (tuned_choices.MAX_BYTES + 1),
        json.dumps({**this_machine(), "engines": [1]}).encode(),
        json.dumps({**this_machine(), "engines": {"2": {NAME: 7}}}).encode(),
        json.dumps({**this_machine(), "engines": {"2": "stream"}}).encode(),
        json.dumps({"engines": {}}).encode(),
    ],
)
def test_damaged_files(file, content, capsys):
    """They are not used; one line says so, however often they are asked."""
    file.parent.mkdir()
    file.write_bytes(content)
    assert all(tuned_engine(SCENE, RAYS, "closest", 2) is None for _ in range(3))
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "is not used (it is damaged)" in message


@pytest.mark.parametrize(("name", "value"), [("cpu", "another"), ("target", "another"), ("lanes", 3), ("revision", 0)])
def test_files_of_other_machines(file, name, value, capsys):
    write({"2": {NAME: "stream"}}, file)
    file.write_text(json.dumps({**json.loads(file.read_text()), name: value}))
    tuned_choices.forget()
    assert tuned_engine(SCENE, RAYS, "closest", 2) is None
    assert "is not used (it is of another machine, target or version)" in capsys.readouterr().err
    write({"4": {NAME: "stream"}}, file)
    assert read(file) == {"4": {NAME: "stream"}}, "it is made anew"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="everybody's files can be read by root")
def test_files_that_cannot_be_read(file, capsys):
    write({"2": {NAME: "stream"}}, file)
    file.chmod(0)
    assert read(file) == {}
    assert "is not used" in capsys.readouterr().err


def test_a_query_begins_with_the_tuned_engine(file, monkeypatch):
    """Once its kernels are loaded; an engine that is none of the rivals is left alone."""
    monkeypatch.setattr(executor, "run_in_background", lambda task: task())
    monkeypatch.setattr(executor, "without_compiling", lambda: pytest.MonkeyPatch.context())
    mesh = wrt.scenes.build("teapot", level=4, ground=False)
    rng = np.random.default_rng(0)
    rays = wrt.Rays(rng.uniform(*mesh.bounds, (10_000, 3)).astype(np.float32), rng.normal(size=(10_000, 3)).astype(np.float32))
    for tuned, expected in (("interleaved", "interleaved"), ("stream", "stream"), ("packet, vertex", None)):
        scene = wrt.Scene(mesh, device="cpu", num_threads=1)
        wrt.device.set_auto("rules")
        rules = scene.explain(rays).traversal
        wrt.device.set_auto(None)
        name = class_name(scene.state.facts, RayFacts(10_000, (10_000,), coherent=False), "closest")
        write({"1": {name: tuned}}, file)
        assert scene.intersect(rays).plan.traversal == (expected or rules)


def choice(milliseconds: dict[str, float], rules: str, name: str) -> Choice:
    best = min(milliseconds, key=milliseconds.__getitem__)
    return Choice("model", "random", 1000, 70_000, name, rules, rules, "", best, 1.0, 1.0, 1.0, milliseconds)


def test_what_is_stored():
    """The best in the mean of a class, if it is worth it, among the engines that took part in all its cases."""
    seen = [
        choice({"a": 1.0, "b": 2.0}, "b", "clear"),
        choice({"a": 1.0, "b": 1.04}, "b", "close"),
        choice({"a": 1.0, "b": 2.0}, "a", "right"),
        choice({"a": 1.0, "b": 1.5, "c": 0.1}, "b", "mixed"),
        choice({"a": 2.6, "b": 2.5}, "b", "mixed"),
        choice({"a": 1.0, "b": 1.2}, "b", "against"),
        choice({"a": 2.0, "b": 1.0}, "b", "against"),
    ]
    assert tune_command.fastest(seen) == {"clear": "a", "mixed": "a"}


def test_command(file, tmp_path, monkeypatch):
    monkeypatch.setattr(tune_command, "compare_choices", made_up)
    path = tmp_path / "small.ply"
    wrt.scenes.build("teapot", level=2, ground=False).save(path)
    done = CliRunner().invoke(main, ["tune", str(path), "--threads", "2", "--size", "64", "--kind", "random"])
    assert done.exit_code == 0, done.output
    assert "1 cases on 2 threads; other engines than the rules choose for 1 classes: " in done.output
    found = json.loads(Path(file).read_text())
    assert {key: found[key] for key in this_machine()} == this_machine()
    assert found["engines"] == {"2": {"closest incoherent 2^12 rays 2^7 triangles": "a"}}


def made_up(name, scene, mesh, *, kinds, sizes, rounds, on_turn):
    for case in cases(mesh, kinds, sizes):
        yield choice({"a": 1.0, "b": 2.0}, "b", class_of_case(scene, case))


def test_sizes_divide_into_tiles():
    done = CliRunner().invoke(main, ["tune", "teapot", "--size", "18"], standalone_mode=False)
    assert "multiple of 4" in str(done.exception) + done.output
