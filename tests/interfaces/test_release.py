"""`wrt release`: what is in a source distribution and in a wheel, and the tag of a wheel."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from support.commands import run

import wrt
from wrt.cli import release

CODE = b"code of a kernel"


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """The files of this checkout, and what looks like a compiled kernel."""
    try:
        root = release.checkout()
        place = release.copy_source(root, tmp_path_factory.mktemp("release") / "source")
    except Exception as error:
        pytest.skip(f"no checkout: {error}")
    compiled = place / "kernels" / "compiled" / "x86-64-v3"
    compiled.mkdir(parents=True)
    (compiled / "0.o").write_bytes(CODE)
    return place


def test_a_wheel_has_kernels_and_the_tag_of_its_platform(source, tmp_path):
    wheel = release.build_wheel(source, tmp_path, "manylinux_2_28_x86_64")
    assert wheel.name == f"wrt-{wrt.__version__}-py3-none-manylinux_2_28_x86_64.whl"
    with zipfile.ZipFile(wheel) as archive:
        about = archive.read(f"wrt-{wrt.__version__}.dist-info/WHEEL").decode().splitlines()
        assert "Root-Is-Purelib: false" in about
        assert "Tag: py3-none-manylinux_2_28_x86_64" in about
        assert archive.read("wrt/kernels/compiled/x86-64-v3/0.o") == CODE
        names = archive.namelist()
    assert "wrt/builders/__init__.py" in names
    assert not [name for name in names if name.startswith(("tests/", "notebooks/", "docs/", "kernels/"))]


def test_a_wheel_without_kernels_is_for_every_platform(source, tmp_path):
    wheel = release.build_wheel(source, tmp_path, "any")
    assert wheel.name == f"wrt-{wrt.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        assert "Root-Is-Purelib: true" in archive.read(f"wrt-{wrt.__version__}.dist-info/WHEEL").decode()


@pytest.mark.slow
def test_a_source_distribution_can_be_built(source, tmp_path):
    """It has what a wheel is made of."""
    archive = release.build_sdist(source, tmp_path)
    assert archive.name == f"wrt-{wrt.__version__}.tar.gz"
    with tarfile.open(archive) as opened:
        opened.extractall(tmp_path)
    wheel = release.build_wheel(tmp_path / archive.name.removesuffix(".tar.gz"), tmp_path, "any")
    with zipfile.ZipFile(wheel) as opened:
        assert {"wrt/__init__.py", "wrt/kernels/native/loops.h", "wrt/builders/__init__.py"} <= {*opened.namelist()}


def test_the_platform_is_that_of_the_installed_wheel(tmp_path):
    """Warp's wheels are for one platform, pure ones for any."""
    assert release.platform_of("click") == release.PURE
    assert release.platform_of("warp-lang").endswith(("_x86_64", "_aarch64", "_arm64", "_amd64"))


def test_kernels_are_exported_by_a_process_for_each_target(tmp_path, monkeypatch):
    """The environment's own target and width have no say in it."""
    calls = []
    monkeypatch.setenv("WRT_TARGET", "native")
    monkeypatch.setenv("WRT_WIDTH", "4")

    def note(command, env, check):
        calls.append((command, env))
        return subprocess.CompletedProcess(command, len(calls) - 1)

    monkeypatch.setattr(subprocess, "run", note)
    release.export_kernels("x86-64-v3", tmp_path, first_hit=True, jobs=2)
    ((command, environment),) = calls
    expected = ["-m", "wrt", "warm", "--target", "x86-64-v3", "--export", str(tmp_path), "--first-hit", "--jobs", "2"]
    assert command == [sys.executable, *expected]
    assert not {"WRT_TARGET", "WRT_WIDTH"} & {*environment}
    with pytest.raises(release.click.ClickException, match="x86-64-v3 could not be compiled"):
        release.export_kernels("x86-64-v3", tmp_path, first_hit=False, jobs=None)


def test_targets_of_other_machines_are_refused():
    result = run("release", "--target", "z80")
    assert result.exit_code == 2
    assert "'z80' cannot be made here" in result.stderr
    assert "native" not in release.able_targets()


def test_an_installed_package_is_no_checkout(tmp_path, monkeypatch):
    monkeypatch.setattr(wrt, "__file__", str(tmp_path / "wrt" / "__init__.py"))
    result = run("release")
    assert result.exit_code == 2
    assert "needs a Git checkout" in result.stderr
