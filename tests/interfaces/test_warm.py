"""`wrt warm` and what is compiled ahead: just the kernels that a build, a query and a picture need."""

import numpy as np
import pytest
from support.commands import run

import wrt
import wrt.engine.launch.expected_kernels
import wrt.engine.rays.coherence
import wrt.kernels.runtime.launch
from wrt.cli.warm_features import FEATURES, Samples
from wrt.engine.free_list import FreeList

COMPILED_FOR_LONG = ("kdtree", "instances", "partitioned", "whitted", "distribution", "path")
"""Features whose kernels no other test compiles: a minute each."""


@pytest.fixture
def needed_modules(monkeypatch):
    """The modules that are needed from now on."""
    from wrt.kernels.compilation import module_compiler

    needed = set()
    load_modules = module_compiler.load_modules

    def note(wanted, device, block_dim):
        wanted = list(wanted)
        needed.update(wanted)
        return load_modules(wanted, device, block_dim)

    monkeypatch.setattr(module_compiler, "load_modules", note)
    monkeypatch.setattr(wrt.kernels.runtime.launch, "_loaded", set())
    return needed


def test_warm_compiles_what_a_first_hit_needs(needed_modules):
    """Those kernels are what the wheel of the tests is shipped with."""
    from wrt.cli.warm import first_hit_kernels

    modules = {kernel.module for kernel in first_hit_kernels()}
    needed_modules.clear()
    for dtype in (np.float32, np.float64):
        sheet = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=dtype)
        assert wrt.Scene(wrt.TriangleMesh(sheet, [[0, 1, 2]])).intersect([0.2, 0.2, 1.0], [0, 0, -1]).position.shape == (3,)
    assert not {module.name for module in needed_modules - modules}


def test_warm_compiles_what_queries_and_pictures_need(needed_modules):
    """After it, a build, few rays, many rays and a picture begin to compile nothing."""
    from wrt.cli.warm import default_kernels

    modules = {kernel.module for kernel in default_kernels()}
    needed_modules.clear()
    scene = wrt.Scene(wrt.scenes.build("teapot"), device="cpu")
    camera = wrt.PinholeCamera.framing(scene, 160, 120)
    wrt.render(scene, camera, ambient_samples=2)
    hits = scene.intersect(camera.rays())
    assert hits.position.shape == (120, 160, 3)
    scene.intersect([0.0, 0.0, 9.0], [0.0, 0.0, -1.0])
    assert not {module.name for module in needed_modules - modules}


def test_a_scene_and_a_picture_expect_just_the_kernels_that_they_need(monkeypatch):
    """What is compiled ahead is needed, and what is needed was begun in one of two batches: the build's and the picture's.

    By the rules alone: where calls take long, "auto" loads other kernels to compare.
    """
    from wrt.kernels.compilation import module_compiler

    monkeypatch.setenv("WRT_AUTO", "rules")
    expected, needed = [], set()
    begin, load_modules = module_compiler.expect, module_compiler.load_modules

    def note(wanted, device, block_dim):
        wanted = list(wanted)
        needed.update(wanted)
        return load_modules(wanted, device, block_dim)

    def ahead(wanted, device, block_dim):
        wanted = list(wanted)
        if not set(wanted) <= needed:
            expected.append(set(wanted))
        return begin(wanted, device, block_dim)

    monkeypatch.setattr(module_compiler, "expect", ahead)
    monkeypatch.setattr(module_compiler, "load_modules", note)
    monkeypatch.setattr(wrt.kernels.runtime.launch, "_loaded", set())
    monkeypatch.setattr(wrt.engine.launch.expected_kernels, "_expected", set())
    monkeypatch.setattr(wrt.engine.rays.coherence, "_detectors", FreeList())
    scene = wrt.Scene(wrt.scenes.build("teapot"), device="cpu")
    wrt.render(scene, wrt.PinholeCamera.framing(scene, 640, 480), ambient_samples=2)
    ahead_of_need = set().union(*expected)
    assert {module.name for module in needed - ahead_of_need} <= {"wrt.kernels.runtime.job_queue"}
    assert {module.name for module in ahead_of_need - needed} <= {"wrt.kernels.runtime.job_queue"}


@pytest.mark.parametrize(
    ("arguments", "message"), [(["--jobs", "0"], "jobs"), (["--export", "here"], "x86-64-v3"), (["--target", "z80"], "z80")]
)
def test_warm_refuses(arguments, message, monkeypatch):
    monkeypatch.delenv("WRT_TARGET", raising=False)
    result = run("warm", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr


# -- features ----------------------------------------------------------------------------------------------------------


def test_features_are_listed_and_unknown_ones_refused():
    listed = run("warm", "--feature", "list")
    assert listed.exit_code == 0
    assert [line.split()[0] for line in listed.stdout.splitlines()] == list(FEATURES)
    result = run("warm", "--feature", "hits,nothing")
    assert result.exit_code == 2
    assert all(name in result.stderr for name in ("'nothing' is unknown", *FEATURES))
    assert "leave one of them out" in run("warm", "--feature", "hits", "--first-hit").stderr


def test_a_feature_compiles_what_its_first_call_needs(needed_modules):
    """After it, the same calls in another scene begin to compile nothing."""
    result = run("warm", "--feature", "hits,spawn")
    assert result.exit_code == 0, result.stderr
    count = int(result.stdout.split()[0])
    assert count >= len(needed_modules) > 10
    modules = set(needed_modules)
    needed_modules.clear()
    scene = wrt.Scene(wrt.scenes.build("teapot", level=17), device="cpu")
    camera = wrt.PinholeCamera.framing(scene, 150, 130)
    hits = scene.intersect(camera.rays())
    assert hits.normal.shape == (130, 150, 3)
    scene.occluded(hits.spawn(-camera.rays().directions), -camera.rays().directions)
    assert not {module.name for module in needed_modules - modules}


@pytest.mark.parametrize("name", [name for name in FEATURES if name not in COMPILED_FOR_LONG])
def test_features_call_what_there_is(name):
    FEATURES[name].call(Samples())
