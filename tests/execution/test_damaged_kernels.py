"""Compiled kernels that were damaged on disk are compiled again. Once every process ended with a bare traceback, or crashed."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from support.compiling import environment, script

from wrt.kernels.compilation import damaged_kernels, kernel_cache, shipped_kernels
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import specialised_kernel

CPU = wp.get_device("cpu")


def overwrite(path: Path, place: int, values: bytes) -> None:
    content = bytearray(path.read_bytes())
    content[place : place + len(values)] = values
    path.write_bytes(content)


def in_place_of(path: Path, make) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    make(path)


DAMAGES = {
    "code cut short": lambda code, about, seal: code.write_bytes(code.read_bytes()[:500]),
    "code cut short before it was sealed": lambda code, about, seal: (seal.unlink(), code.write_bytes(code.read_bytes()[:-1])),
    "an empty file before it was sealed": lambda code, about, seal: (seal.unlink(), about.write_bytes(b"")),
    "machine code overwritten": lambda code, about, seal: overwrite(code, 70, b"\xff" * 8),
    "data cut short before it was sealed": lambda code, about, seal: (seal.unlink(), about.write_bytes(about.read_bytes()[:9])),
    "data missing": lambda code, about, seal: about.unlink(),
    "a folder in place of the code": lambda code, about, seal: in_place_of(code, Path.mkdir),
    "a file in place of the folder": lambda code, about, seal: in_place_of(code.parent, Path.touch),
    "seal is garbage": lambda code, about, seal: seal.write_bytes(b"\x00\xff"),
}

PROGRAM = f"""
kernels = [make(value) for value in range(100, {100 + len(DAMAGES)})]
load(kernels, cpu)
print(json.dumps([[run(k)[0] for k in kernels], [str(kernel_cache.cached_files(k.module, cpu, 1)[0]) for k in kernels]]))
"""


def test_damaged_modules_are_compiled_again(tmp_path):
    """Each in another way, in one cache: one line says so, the answers are right, and the next process finds nothing to say.

    Only the seal finds the overwritten code; it ended the process by an illegal instruction.
    """
    command = script("from wrt.kernels.compilation import kernel_cache\n" + PROGRAM, tmp_path)
    expected = [*range(100, 100 + len(DAMAGES))]

    def answers() -> tuple[list[int], list[str], str]:
        done = subprocess.run(
            command,
            env=environment(tmp_path / "cache", WRT_COMPILE_JOBS="1"),
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        return *json.loads(done.stdout.splitlines()[-1]), done.stderr

    values, places, err = answers()
    assert values == expected
    assert "damaged" not in err
    for damage, place in zip(DAMAGES.values(), places, strict=True):
        code = Path(place)
        (about,) = code.parent.glob("*.meta")
        damage(code, about, damaged_kernels.seal_of(code))
    values, _, err = answers()
    assert values == expected
    assert err.count("are damaged") == 1, err
    values, places, err = answers()
    assert values == expected
    assert "damaged" not in err
    assert all(damaged_kernels.seal_of(Path(place)).exists() for place in places)
    assert not list((tmp_path / "cache").rglob("damaged-*"))


def test_a_cache_that_cannot_be_written_while_a_module_loads(tmp_path, monkeypatch, capfd):
    """The cache's folder is gone when a module is needed, and cannot be made: below a file, which stops root, too."""

    def fill(first: int, out: wp.array(dtype=int)):
        out[first + wp.tid()] = 4711

    (tmp_path / "file").write_text("")
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "file" / "cache"))
    out = wp.zeros(3, dtype=int, device=CPU)
    launch(specialised_kernel(fill), 3, [out], device=CPU)
    np.testing.assert_array_equal(out.numpy(), 4711)
    assert "wrt-kernels-" in wp.config.kernel_cache_dir
    assert capfd.readouterr().err.count("compiled kernels cannot be kept") == 1


def test_a_full_cache_is_left_before_anything_is_compiled(tmp_path, monkeypatch, capfd):
    """LLVM said "IO failure on output stream: No space left on device", and ended Python."""
    full = str(tmp_path)
    error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(wp.config, "kernel_cache_dir", full)
    monkeypatch.setattr(kernel_cache, "find_fault", lambda folder, wait=True: error if folder == full else None)

    def fill(first: int, out: wp.array(dtype=int)):
        out[first + wp.tid()] = 4712

    def fill_more(first: int, out: wp.array(dtype=int)):
        out[first + wp.tid()] = 4713

    out = wp.zeros(3, dtype=int, device=CPU)
    launch(specialised_kernel(fill), 3, [out], device=CPU)
    np.testing.assert_array_equal(out.numpy(), 4712)
    assert not [*tmp_path.iterdir()]
    assert capfd.readouterr().err.count("compiled kernels cannot be kept ([Errno 28]") == 1
    monkeypatch.setattr(kernel_cache, "find_fault", lambda folder, wait=True: error)
    with pytest.raises(OSError, match=r"No space left on device: .*wrt-kernels-"):
        launch(specialised_kernel(fill_more), 3, [out], device=CPU)


class Module:
    """A module whose files are in the kernel cache."""

    options = {"cpu_compiler_flags": None}  # noqa: RUF012

    def get_module_identifier(self, block_dim):
        return "one"

    def _get_compile_output_name(self, device, block_dim):
        return "one.o"

    def _get_meta_name(self, block_dim):
        return "one.meta"

    def load(self, device, block_dim):
        raise RuntimeError("cannot be loaded")


def test_a_damaged_cache_that_cannot_be_mended(tmp_path, monkeypatch, capfd):
    """The folder of a damaged module cannot be removed: this process uses another cache."""
    (tmp_path / "one").mkdir()
    for name in ("one.o", "one.meta"):
        (tmp_path / "one" / name).write_text("{}")
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))

    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(damaged_kernels.tempfile, "mkdtemp", refuse)
    with pytest.raises(PermissionError):
        damaged_kernels.remove(tmp_path / "one", "no reason")
    monkeypatch.undo()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(damaged_kernels, "remove", refuse)
    assert kernel_cache.is_compiled(Module(), CPU, 1)
    assert not kernel_cache.load_compiled(Module(), CPU, 1)
    assert "wrt-kernels-" in wp.config.kernel_cache_dir
    assert "Permission denied" in capfd.readouterr().err


def test_shipped_kernels_with_another_checksum_are_compiled(tmp_path, monkeypatch, capfd):
    """Changed bytes of a wheel's code would run: only the seal tells."""
    monkeypatch.setenv(shipped_kernels.VARIABLE, str(tmp_path))
    monkeypatch.setattr(shipped_kernels, "targets", lambda: ("x86-64-v3",))
    folder = tmp_path / "x86-64-v3"
    folder.mkdir()
    for key in ("sound", "changed"):
        code, about = folder / f"{key}.o", folder / f"{key}.meta"
        code.write_bytes(b"code"), about.write_bytes(b"{}")
        damaged_kernels.seal(code, about)
    (folder / "changed.o").write_bytes(b"kode")
    monkeypatch.setattr(damaged_kernels, "_sound", set())
    monkeypatch.setattr(shipped_kernels, "key_of", lambda module: "sound")
    assert shipped_kernels.find(Module(), CPU, 1) == (folder / "sound.o", folder / "sound.meta")
    monkeypatch.setattr(shipped_kernels, "key_of", lambda module: "changed")
    assert shipped_kernels.find(Module(), CPU, 1) is None
    assert shipped_kernels.find(Module(), CPU, 1) is None
    assert capfd.readouterr().err.count("its kernels are compiled instead") == 1
