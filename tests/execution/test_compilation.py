"""Compiling: side by side, with progress, ahead of a call; kernels that lie ready in a folder; several processes at once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest
import warp as wp
from support.compiling import done, environment, script

from wrt.kernels.compilation import compile_progress, kernel_cache, module_compiler, shipped_kernels
from wrt.kernels.runtime.launch import expect, load
from wrt.kernels.runtime.options import specialised_kernel


def modules_in(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.o"))


# -- side by side ------------------------------------------------------------------------------------------------------


class Module:
    """A module that takes as long to compile as a test wants."""

    def __init__(self, folder: Path, name: str, compile_module=lambda: None):
        self.folder, self.name, self.compile_module, self.loads = folder, name, compile_module, []
        self.options = {"cpu_compiler_flags": "none of these is shipped"}

    def get_module_identifier(self, block_dim):
        return self.name

    def _get_compile_output_name(self, device, block_dim):
        return f"{self.name}.o"

    def _get_meta_name(self, block_dim):
        return f"{self.name}.meta"

    def load(self, device, block_dim):
        self.loads.append(threading.current_thread().name)
        if not (self.folder / self.name).exists():
            self.compile_module()
            (self.folder / self.name).mkdir(parents=True, exist_ok=True)
            for ending in ("o", "meta"):
                (self.folder / self.name / f"{self.name}.{ending}").write_text("")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(module_compiler, "_is_exiting", False)
    module_compiler._close()  # threads of earlier tests, however many
    module_compiler._is_exiting = False
    monkeypatch.setenv("WRT_COMPILE_JOBS", "2")
    return tmp_path


CPU = wp.get_device("cpu")


def test_modules_are_compiled_side_by_side(cache):
    """Each of two modules waits until the other is being compiled too."""
    meet = threading.Barrier(2, timeout=60)
    modules = [Module(cache, name, meet.wait) for name in ("one", "two")]
    module_compiler.load_modules(modules, CPU, 1)
    assert not meet.broken
    assert all(module.loads[0].startswith("wrt-compile") for module in modules)
    assert all(module.loads[-1] == threading.current_thread().name for module in modules), "loaded where it is needed"


def test_what_is_expected_is_compiled_once(cache):
    go_on = threading.Event()
    module = Module(cache, "one", lambda: go_on.wait(60))
    assert len(module_compiler.expect([module, module], CPU, 1)) == 1
    module_compiler.expect([module], CPU, 1)
    go_on.set()
    module_compiler.load_modules([module], CPU, 1)
    assert [name.startswith("wrt-compile") for name in module.loads] == [True, False]
    assert module_compiler.expect([module], CPU, 1) == [], "the kernel cache has it"


def test_a_module_that_cannot_be_compiled(cache):
    """The caller gets the error; the others are compiled all the same."""

    def fail():
        raise RuntimeError("clang says something")

    good, bad = Module(cache, "good"), Module(cache, "bad", fail)
    with pytest.raises(RuntimeError, match="clang says"):
        module_compiler.load_modules([good, bad], CPU, 1)
    assert kernel_cache.is_compiled(good, CPU, 1)
    assert not module_compiler._pending


def test_ctrl_c_drops_what_is_not_begun(cache, monkeypatch):
    """The modules under way are completed, so that the cache has whole ones; the next call compiles the rest."""
    monkeypatch.setenv("WRT_COMPILE_JOBS", "1")
    go_on, begun = threading.Event(), threading.Event()

    def wait():
        begun.set()
        go_on.wait(60)

    modules = [Module(cache, "first", wait), *(Module(cache, f"other{i}") for i in range(3))]

    def interrupt():
        begun.wait(60)
        signal.raise_signal(signal.SIGINT) if threading.current_thread() is threading.main_thread() else os.kill(
            os.getpid(), signal.SIGINT
        )

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        module_compiler.load_modules(modules, CPU, 1)
    go_on.set()
    module_compiler.load_modules(modules[:1], CPU, 1)
    assert [len(module.loads) for module in modules[1:]] == [0, 0, 0]
    module_compiler.load_modules(modules, CPU, 1)
    assert all(kernel_cache.is_compiled(module, CPU, 1) for module in modules)


@pytest.mark.parametrize("text", ["0", "-1", "two", "65"])
def test_a_number_of_jobs_that_is_none(monkeypatch, text):
    monkeypatch.setenv("WRT_COMPILE_JOBS", text)
    with pytest.raises(ValueError, match="WRT_COMPILE_JOBS"):
        module_compiler.compile_jobs()


# -- progress ----------------------------------------------------------------------------------------------------------


def test_progress_is_for_a_terminal(cache, monkeypatch, capfd):
    """It counts, on stderr alone, before the first module is compiled; and says nothing of modules that are cached."""
    monkeypatch.delenv("WRT_SHOW_COMPILING", raising=False)
    monkeypatch.setattr(compile_progress, "_noticed", True)
    monkeypatch.setenv("WRT_COMPILE_JOBS", "1")  # so that the first to be compiled is the first to read
    monkeypatch.setattr(compile_progress, "_expected", 0)
    monkeypatch.setattr(compile_progress, "_done", 0)
    module_compiler.load_modules([Module(cache, "unseen")], CPU, 1)
    assert capfd.readouterr() == ("", ""), "no terminal, and the notice has been given"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    seen = []
    modules = [Module(cache, f"m{i}", lambda: seen.append(capfd.readouterr().err)) for i in range(3)]
    module_compiler.load_modules(modules, CPU, 1)
    assert "wrt: compiling kernels for this CPU, once: 1 of 4" in seen[0], "said before it compiles"
    out, err = capfd.readouterr()
    assert out == ""
    assert err.endswith("wrt: compiling kernels for this CPU, once: 4 of 4\n")
    module_compiler.load_modules(modules, CPU, 1)
    assert capfd.readouterr() == ("", ""), "cached"


def test_a_process_says_once_that_it_compiles(cache, monkeypatch, capfd):
    """Into a file or a pipe: a first call was silent for a minute there. Nothing is said where all is cached."""
    monkeypatch.delenv("WRT_SHOW_COMPILING", raising=False)
    monkeypatch.setenv("WRT_COMPILE_JOBS", "1")  # so that the first to be compiled is the first to read
    monkeypatch.setattr(compile_progress, "_noticed", False)
    cached = Module(cache, "cached")
    compile_progress.show_compiling(False)
    module_compiler.load_modules([cached], CPU, 1)
    compile_progress.show_compiling(None)
    module_compiler.load_modules([cached], CPU, 1)
    assert capfd.readouterr() == ("", ""), "silenced, then cached"
    seen = []
    modules = [Module(cache, f"m{i}", lambda: seen.append(capfd.readouterr().err)) for i in range(3)]
    module_compiler.load_modules(modules, CPU, 1)
    assert "".join(seen) == f"{compile_progress.NOTICE}\n", "said before it compiles, once"
    module_compiler.load_modules([Module(cache, "later")], CPU, 1)
    assert capfd.readouterr() == ("", "")
    monkeypatch.setattr(compile_progress, "_noticed", False)
    monkeypatch.setattr("sys.stderr", None)
    module_compiler.load_modules([Module(cache, "closed")], CPU, 1)


def test_progress_can_be_silenced_or_asked_for(cache, monkeypatch, capfd):
    monkeypatch.setenv("WRT_SHOW_COMPILING", "1")
    module_compiler.load_modules([Module(cache, "one")], CPU, 1)
    assert "compiling kernels" in capfd.readouterr().err
    compile_progress.show_compiling(False)
    module_compiler.load_modules([Module(cache, "two")], CPU, 1)
    assert capfd.readouterr().err == ""
    compile_progress.show_compiling(None)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("WRT_SHOW_COMPILING", "0")
    module_compiler.load_modules([Module(cache, "three")], CPU, 1)
    assert capfd.readouterr().err == ""
    monkeypatch.setenv("WRT_SHOW_COMPILING", "maybe")
    with pytest.raises(ValueError, match="WRT_SHOW_COMPILING"):
        compile_progress.is_shown()
    with pytest.raises(TypeError, match="show must be"):
        compile_progress.show_compiling("no")


def test_progress_goes_where_it_is_reported_to(cache, monkeypatch, capfd):
    monkeypatch.setenv("WRT_SHOW_COMPILING", "1")
    lines = []
    with compile_progress.report_to(lines.append):
        module_compiler.load_modules([Module(cache, "one")], CPU, 1)
    assert "compiling kernels" in lines[0]
    assert lines[-1] is None, "all is compiled"
    assert capfd.readouterr().err == ""


# -- processes ---------------------------------------------------------------------------------------------------------


def test_two_processes_share_an_empty_cache(tmp_path):
    """They start at once, compile the same modules into one folder, and both are right; a third one compiles nothing."""
    code = "load(kernels, cpu)\nprint(json.dumps([[run(k) for k in kernels], compile_progress.counts()[0]]))\n"
    command = script(code, tmp_path)
    kinds = {"env": environment(tmp_path / "cache"), "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen(command, **kinds) for _ in range(2)]
    for process in both:
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        assert json.loads(out.splitlines()[-1])[0] == [[3] * 3, [5] * 3, [7] * 3]
    assert len(modules_in(tmp_path / "cache")) == 3
    assert not list((tmp_path / "cache").rglob("*_p*_t*")), "folders of compiling that nobody removed"
    assert done(code, tmp_path)[0] == [[[3] * 3, [5] * 3, [7] * 3], 0]


def test_an_interrupted_process_leaves_a_usable_cache(tmp_path):
    """Ctrl-C while modules are compiled: the process ends soon, and the next one goes on with what is there."""
    code = "print('ready', flush=True)\nkernels += [make(v) for v in range(20, 40)]\nload(kernels, cpu)\nprint('[]')\n"
    command = script(code, tmp_path)
    process = subprocess.Popen(
        command, env=environment(tmp_path / "cache"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    process.stdout.readline()
    while process.poll() is None and not modules_in(tmp_path / "cache"):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=300)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in err
    kept = len([path for path in modules_in(tmp_path / "cache") if "_p" + str(process.pid) not in str(path)])
    assert 1 <= kept < 23
    code = "load(kernels, cpu)\nprint(json.dumps([run(k) for k in kernels]))\n"
    assert done(code, tmp_path)[0] == [[3] * 3, [5] * 3, [7] * 3]


def test_a_program_that_ends_does_not_wait_for_what_it_expected(tmp_path):
    code = "expect([make(v) for v in range(20, 40)], cpu)\nprint(json.dumps(len(module_compiler._pending)))\n"
    waiting, _ = done(code, tmp_path)
    assert waiting >= 15
    assert len(modules_in(tmp_path / "cache")) < waiting


# -- kernels that lie ready --------------------------------------------------------------------------------------------

EXPORT = (
    "load(kernels, cpu)\n"
    "from pathlib import Path\n"
    "print(json.dumps(shipped_kernels.export([kernel.module for kernel in kernels], Path(sys.path[0], 'ship'))))\n"
)
USE = (
    "answers = [run(k) for k in kernels]\n"
    "print(json.dumps([answers, compile_progress.counts()[0], shipped_kernels.loaded_count(), shipped_kernels.targets()]))\n"
)
ANSWERS = [[3] * 3, [5] * 3, [7] * 3]


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """A folder with a program and its kernels for AVX2, in `ship`."""
    if not shipped_kernels.TARGETS["x86-64-v3"].needs <= shipped_kernels.cpu_features():
        pytest.skip("this CPU cannot run code for x86-64-v3")
    folder = tmp_path_factory.mktemp("shipped")
    assert done(EXPORT, folder, WRT_TARGET="x86-64-v3")[0] == 3
    assert len(modules_in(folder / "ship" / "x86-64-v3")) == 3
    return folder


@pytest.mark.parametrize("target", [None, "x86-64-v3"])
def test_shipped_kernels_are_loaded(shipped, tmp_path, target):
    """Nothing is compiled, nor written to the kernel cache; also where the target is the CPU's own."""
    chosen = {} if target is None else {"WRT_TARGET": target}
    more = chosen | {"WRT_COMPILED_KERNELS": str(shipped / "ship"), "WARP_CACHE_PATH": str(tmp_path)}
    answers, err = done(USE, shipped, **more)
    assert answers == [ANSWERS, 0, 3, ["x86-64-v3"]], err
    assert modules_in(tmp_path) == []


def test_shipped_kernels_that_do_not_fit_are_compiled(shipped, tmp_path):
    """Those of another version of Warp, of kernels that have changed since, and for another CPU than was asked for."""
    here = {"WRT_COMPILED_KERNELS": str(shipped / "ship")}
    assert done(USE, shipped, **here, WRT_TARGET="native", WARP_CACHE_PATH=str(tmp_path / "a"))[0] == [ANSWERS, 3, 0, []]
    changed = "kernels = [make(value) for value in (4, 5, 7)]\n" + USE
    found, _ = done(changed, shipped, **here, WARP_CACHE_PATH=str(tmp_path / "b"))
    assert found == [[[4] * 3, [5] * 3, [7] * 3], 1, 2, ["x86-64-v3"]]
    made_for = shipped / "ship" / "x86-64-v3" / shipped_kernels.MADE_FOR
    text = made_for.read_text()
    try:
        made_for.write_text(text.replace(wp.config.version, "0.0.1"))
        assert done(USE, shipped, **here, WARP_CACHE_PATH=str(tmp_path / "c"))[0] == [ANSWERS, 3, 0, []]
    finally:
        made_for.write_text(text)


def test_shipped_kernels_that_are_damaged_are_compiled(shipped, tmp_path):
    damaged = tmp_path / "ship" / "x86-64-v3"
    damaged.mkdir(parents=True)
    for path in (shipped / "ship" / "x86-64-v3").iterdir():
        (damaged / path.name).write_bytes(b"not an object" if path.suffix == ".o" else path.read_bytes())
    more = {"WRT_COMPILED_KERNELS": str(tmp_path / "ship"), "WARP_CACHE_PATH": str(tmp_path / "cache")}
    (answers, _, loaded, _), err = done(USE, shipped, **more)
    assert (answers, loaded) == (ANSWERS, 0)
    assert err.count("its kernels are compiled instead") == 3


def test_kernels_for_this_cpu_alone_are_not_shipped(tmp_path, monkeypatch):
    monkeypatch.delenv("WRT_TARGET", raising=False)
    with pytest.raises(ValueError, match="x86-64-v3"):
        shipped_kernels.export([], tmp_path)


def test_the_key_of_a_module_does_not_depend_on_the_cpu(monkeypatch):
    def same(first: int, out: wp.array(dtype=int)):
        out[first + wp.tid()] = 41

    kernels = []
    for flags in ("-march=native", "-target-cpu x86-64-v3"):
        monkeypatch.setattr(wp.config, "cpu_compiler_flags", flags)
        kernel = specialised_kernel(same)
        kernel.module.mark_modified()
        kernels.append((shipped_kernels.key_of(kernel.module), kernel.module.get_module_hash(1)))
    assert kernels[0][0] == kernels[1][0]
    assert kernels[0][1] != kernels[1][1]


def test_expecting_kernels_that_are_loaded_does_nothing(monkeypatch):
    def nothing(first: int, out: wp.array(dtype=int)):
        out[first + wp.tid()] = 42

    kernel = specialised_kernel(nothing)
    load([kernel], CPU)
    monkeypatch.setattr(module_compiler, "expect", lambda *arguments: pytest.fail("asked again"))
    expect([kernel], CPU)


def test_a_thread_that_asks_for_kernels_at_the_exit(monkeypatch):
    """While the exit waited for the threads that compile, another thread asked for a kernel: a new thread took from the queue
    what was to end an old one, and the process never ended."""
    begun, go = threading.Event(), threading.Event()

    class Module:
        """A module that is compiled until `go` is set."""

        def load(self, device, block_dim):
            begun.set()
            go.wait(30.0)

    for name, value in {"_threads": [], "_queue": module_compiler.SimpleQueue(), "_pending": {}, "_is_exiting": False}.items():
        monkeypatch.setattr(module_compiler, name, value)
    monkeypatch.setattr(module_compiler, "is_compiled", lambda *_: False)
    monkeypatch.setattr(module_compiler, "_close_at_exit", lambda: None)
    monkeypatch.setattr(shipped_kernels, "find", lambda *_: None)
    monkeypatch.setenv("WRT_COMPILE_JOBS", "1")
    cpu, refused = wp.get_device("cpu"), []

    def ask():
        try:
            module_compiler.load_modules([Module()], cpu, 1)
        except RuntimeError as error:
            refused.append(str(error))

    module_compiler.expect([Module()], cpu, 1)
    assert begun.wait(10.0)
    (compiling,) = module_compiler._threads
    close = threading.Thread(target=module_compiler._close, daemon=True)
    close.start()
    end = time.monotonic() + 10.0
    while not module_compiler._is_exiting and time.monotonic() < end:
        time.sleep(0.001)
    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    asking.join(10.0)
    go.set()
    close.join(10.0)
    assert not close.is_alive()
    assert not compiling.is_alive()
    assert refused == ["no kernel is compiled any more: the interpreter is exiting"]
