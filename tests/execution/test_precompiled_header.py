"""Warp's precompiled header, kept beside the kernels: made once for all threads and processes, and never a cause of failure."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import types
from pathlib import Path

import pytest
import warp as wp
from support.compiling import done
from support.selection import slow

from wrt.kernels.compilation import precompiled_header

COUNT = """
from wrt.kernels.compilation import precompiled_header
made, keep = [], precompiled_header._keep
def note(place, own, before):
    made.extend(precompiled_header._names_in(own) - before)
    keep(place, own, before)
precompiled_header._keep = note
"""
"""Lists the headers that a program makes."""

ANSWERS = [[3] * 3, [5] * 3, [7] * 3]

LOAD = "load(kernels, cpu)\nprint(json.dumps([[run(k) for k in kernels], made]))\n"


def headers_in(cache: Path) -> list[Path]:
    return [path for path in (cache / wp.config.version / precompiled_header.FOLDER).rglob("*") if path.is_file()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder whose kernel cache has a header, made by the first of two threads that compile three modules."""
    folder = tmp_path_factory.mktemp("headers")
    (folder / "cache" / wp.config.version / precompiled_header.FOLDER).mkdir(parents=True)  # so that `done` puts none there
    (answers, made), err = done(COUNT + LOAD, folder, WRT_COMPILE_JOBS="2")
    assert answers == ANSWERS
    assert len(made) == 1, "the other thread takes the header of the first"
    assert [path.name for path in headers_in(folder / "cache")] == made
    assert err.count("\n") <= 1, err
    return folder


def fresh_cache(folder: Path, cache: Path) -> Path:
    """A kernel cache that has the header alone; returns where that is."""
    kept = Path(wp.config.version, precompiled_header.FOLDER)
    shutil.copytree(folder / "cache" / kept, cache / kept)
    (header,) = headers_in(cache)
    return header


def test_the_header_is_the_one_that_warp_asks_for_and_has_no_bfloat16(folder):
    """Were its name another, Warp would make one more."""
    (header,) = headers_in(folder / "cache")
    content = header.read_bytes()
    assert b"float16" in content
    assert b"bfloat16" not in content


def test_a_later_process_makes_no_header(folder, tmp_path):
    fresh_cache(folder, tmp_path / "cache")
    (answers, made), _ = done(COUNT + LOAD, tmp_path, WRT_COMPILE_JOBS="2")
    assert (answers, made) == (ANSWERS, [])


EXPECT = "from wrt.kernels.compilation.module_compiler import expect_header\nexpect_header(wp.get_device('cpu'))\n"


def test_a_header_is_made_before_there_is_a_module(tmp_path):
    """The modules take it; what is counted as compiled are they alone."""
    (tmp_path / "cache" / wp.config.version / precompiled_header.FOLDER).mkdir(parents=True)
    wait = "from time import sleep\nwhile not made:\n    sleep(0.01)\n"
    counted = LOAD.replace("made]", "made, compile_progress.counts()]")
    (answers, made, (compiled, asked)), _ = done(COUNT + EXPECT + wait + counted, tmp_path)
    assert answers == ANSWERS
    assert len(made) == 1
    assert compiled == asked == len(ANSWERS)


def test_no_header_is_made_for_a_cache_that_has_one(folder, tmp_path):
    fresh_cache(folder, tmp_path / "cache")
    threads = "import threading\nprint(json.dumps([thread.name for thread in threading.enumerate()]))\n"
    names, _ = done(EXPECT + threads, tmp_path)
    assert not [name for name in names if "compile" in name]


def test_commands_expect_the_header_of_the_flags_that_kernels_have(tmp_path):
    """Commands start Warp before any kernel is defined. A header of Warp's own flags would serve no module."""
    program = """
from wrt.cli.arguments import start_warp
from wrt.kernels.compilation import module_compiler, precompiled_header
keys = []
module_compiler.expect_header = lambda device: keys.append(precompiled_header._key_for(module_compiler._no_kernels()))
start_warp("cpu")
import wrt.builders.triangle_boxes
keys.append(precompiled_header._key_for(wrt.builders.triangle_boxes.compute_boxes.module))
assert None not in keys and len(keys) == 2 and keys[0] == keys[1], keys
"""
    environment = os.environ | {"WARP_CACHE_PATH": str(tmp_path)}
    result = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("damage", ["a byte changed", *slow("cut short", "refused by Clang")])
def test_a_damaged_header_is_made_again(folder, tmp_path, damage):
    """One with a wrong checksum is not used; what has the right one, and Clang refuses, is removed with it."""
    header = fresh_cache(folder, tmp_path / "cache")
    content = header.read_bytes()
    changed = bytearray(content)
    changed[len(content) // 2] ^= 1
    junk = b"no header" * 100
    refused = precompiled_header._checksum(junk) + b"\n" + junk
    header.write_bytes({"cut short": content[:-1], "a byte changed": bytes(changed), "refused by Clang": refused}[damage])
    (answers, made), err = done(COUNT + LOAD, tmp_path, WRT_COMPILE_JOBS="1")
    assert answers == ANSWERS
    assert made == [header.name]
    assert ("PCH failed" in err) == (damage == "refused by Clang")
    assert len(header.read_bytes()) == len(content)


@pytest.mark.slow
def test_a_cache_that_takes_no_header(tmp_path):
    """Kernels are compiled as ever, in silence: on a full disk, say, or where a file has the folder's name."""
    place = tmp_path / "cache" / wp.config.version / precompiled_header.FOLDER
    place.parent.mkdir(parents=True)
    place.write_text("no folder")
    (answers, made), err = done(COUNT + LOAD, tmp_path, WRT_COMPILE_JOBS="2")
    assert answers == ANSWERS
    assert len(made) == 1
    assert "header" not in err
    assert place.read_text() == "no folder"


# -- in this process ----------------------------------------------------------------------------------------------------


class Module(wp.Module):
    """A module with options alone: what is compiled is up to the test."""

    def __init__(self, flags: str | None = None):
        self.options = {"cpu_compiler_flags": flags}


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder of each thread, in place of Warp's, and an empty kernel cache."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))

    def folder_of_thread() -> Path:
        folder = tmp_path / threading.current_thread().name
        folder.mkdir(exist_ok=True)
        return folder

    monkeypatch.setattr(precompiled_header, "_folder_of_thread", folder_of_thread)
    monkeypatch.setattr(precompiled_header, "_without", set())
    return folder_of_thread


def compile_on(name: str, work) -> None:
    thread = threading.Thread(target=work, name=name)
    thread.start()
    thread.join(30.0)
    assert not thread.is_alive()


def make(folder: Path, name: str = "a.pch", content: bytes = b"header") -> None:
    (folder / name).write_bytes(content)


def test_threads_share_what_one_has_made(own):
    def first():
        with precompiled_header.shared_header(Module(), 1):
            make(own())

    def second():
        with precompiled_header.shared_header(Module(), 1):
            assert (own() / "a.pch").read_bytes() == b"header"
            make(own(), "b.pch")

    compile_on("first", first)
    compile_on("second", second)
    place = Path(wp.config.kernel_cache_dir, precompiled_header.FOLDER)
    assert sorted(path.name for path in place.glob("*/*")) == ["a.pch", "b.pch"]
    assert not precompiled_header._makers


def test_a_thread_waits_for_the_header_and_not_for_the_module(own):
    is_taken, begun = threading.Event(), threading.Event()

    def first():
        with precompiled_header.shared_header(Module(), 1):
            begun.set()
            make(own())
            assert is_taken.wait(30.0), "the other thread waited for the module"

    def second():
        begun.wait(30.0)
        with precompiled_header.shared_header(Module(), 1):
            is_taken.set()

    threads = [threading.Thread(target=work, name=work.__name__) for work in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert is_taken.is_set()
    assert not precompiled_header._makers


def test_a_thread_whose_compiling_fails_lets_others_go_on(own):
    def first():
        with pytest.raises(RuntimeError, match="clang says"), precompiled_header.shared_header(Module(), 1):
            raise RuntimeError("clang says something")

    def second():
        with precompiled_header.shared_header(Module(), 1):
            make(own())

    compile_on("first", first)
    compile_on("second", second)
    assert (Path(wp.config.kernel_cache_dir, precompiled_header.FOLDER)).is_dir()


def test_where_no_header_is_made_threads_wait_once(own):
    """As with a compiler that is not Warp's: a second module need not wait for the end of a first."""
    meet = threading.Barrier(2, timeout=30.0)

    def work():
        with precompiled_header.shared_header(Module(), 1):
            meet.wait()

    with precompiled_header.shared_header(Module(), 1):
        pass
    threads = [threading.Thread(target=work, name=f"work{i}") for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert not meet.broken


def test_headers_of_other_flags_lie_apart(own):
    """A thread keeps headers of all flags in one folder; the kernel cache has those of each CPU and flags by themselves."""

    def work():
        for flags, name in (("-march=native", "native.pch"), ("", "generic.pch")):
            with precompiled_header.shared_header(Module(flags), 1):
                make(own(), name)

    compile_on("first", work)
    found = sorted(Path(wp.config.kernel_cache_dir, precompiled_header.FOLDER).glob("*/*"))
    assert sorted(path.name for path in found) == ["generic.pch", "native.pch"]
    assert found[0].parent != found[1].parent


def test_a_header_of_warp_that_changes_leads_to_another_key(monkeypatch):
    key = precompiled_header._key.__wrapped__
    before = key("-march=native")
    assert key("-march=native") == before
    monkeypatch.setattr(precompiled_header, "_headers", lambda: "/warp/native/builtin.h 1 2")
    assert key("-march=native") != before


def test_few_keys_stay(tmp_path):
    for age in range(12):
        (tmp_path / f"key{age}").mkdir()
        os.utime(tmp_path / f"key{age}", (1e9 - age, 1e9 - age))
    precompiled_header._remove_old(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {f"key{age}" for age in range(precompiled_header.KEYS)}


def test_a_full_disk_leaves_nothing_half(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="No space"):
        precompiled_header._write(tmp_path / "a.pch", b"header")
    assert list(tmp_path.iterdir()) == []


def test_a_warp_that_keeps_headers_elsewhere(tmp_path, monkeypatch):
    """Or that makes none: this thread compiles as it would without."""
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(wp._src.context, "runtime", types.SimpleNamespace())
    with precompiled_header.shared_header(Module(), 1):
        pass
    monkeypatch.undo()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(wp.config, "use_precompiled_headers", False)
    with precompiled_header.shared_header(Module(), 1):
        pass
    assert list(tmp_path.iterdir()) == []
