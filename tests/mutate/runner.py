"""Runs tests in copies: as they are, then with each mutation."""

from __future__ import annotations

import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from .copies import ROOT, Copy, link_kernels, module_of
from .mutation import Mutation

KILLED, SURVIVED, ERROR = "killed", "survived", "error"

PASSED, FAILED = 0, 1
"""Exit statuses of pytest. The others mean that tests did not run: not found, not collected, usage."""

NOT_RUNNABLE = re.compile(
    r"^E\s+.*\b(SyntaxError|IndentationError|NameError|UnboundLocalError|WarpCodegen\w*Error|kernel build failed)\b.*",
    re.MULTILINE,
)
"""Failures that say that the mutated code is no program, not that a test has noticed a fault."""

LOG_LINES = 15
"""Of the output of tests that did not run, what is shown."""


@dataclass(frozen=True)
class Outcome:
    """What became of a mutation.

    Attributes:
        name: of the mutation.
        mutation: itself.
        state: KILLED, SURVIVED or ERROR.
        seconds: that its tests took.
        reason: of an error, and what failed of a killed one.
    """

    name: str
    mutation: Mutation
    state: str
    seconds: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class Ended:
    """How a process ended: its exit status (negative: by that signal; None: it took too long), output, and seconds."""

    status: int | None
    output: str
    seconds: float


@dataclass
class Processes:
    """Processes under way, which `stop` ends together with all that they started."""

    timeout: float
    stopped: bool = False
    running: set[subprocess.Popen] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def run(self, command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Ended:
        """Runs a command to its end, or until it has taken too long.

        Raises:
            InterruptedError: `stop` was called.
        """
        start = time.monotonic()
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        with self.lock:
            if self.stopped:
                raise InterruptedError
            process = subprocess.Popen(command, cwd=folder, env=environment, start_new_session=True, **streams)
            self.running.add(process)
        try:
            output, status = process.communicate(timeout=self.timeout)[0], process.returncode
        except subprocess.TimeoutExpired:
            end(process)
            output, status = process.communicate()[0], None
        finally:
            end(process)
            with self.lock:
                self.running.discard(process)
        if self.stopped:
            raise InterruptedError
        return Ended(status, output.decode(errors="replace"), time.monotonic() - start)

    def stop(self) -> None:
        """Ends all, and lets no other begin."""
        with self.lock:
            self.stopped = True
            for process in self.running:
                end(process)


def end(process: subprocess.Popen) -> None:
    """Ends a process and all processes of its session."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        if process.poll() is None:
            process.kill()


class Runner:
    """Runs mutations in copies of a checkout, which are removed at the end.

    Each mutation has a kernel cache of its own that begins with the kernels of the unmutated code: whatever it compiles is gone
    with it.

    Args:
        root: the checkout.
        jobs: mutations at a time, each in a copy of its own.
        timeout: seconds after which tests count as never ending.
        tell: called with a line whenever something has been done.
        kernel_cache: folder of compiled kernels that tests without mutations use and fill. None: a temporary one.
    """

    def __init__(
        self,
        root: Path = ROOT,
        jobs: int = 1,
        timeout: float = 600.0,
        tell: Callable[[str], None] = lambda line: None,
        kernel_cache: Path | None = None,
    ) -> None:
        self.root, self.jobs, self.tell, self.kernel_cache = root, jobs, tell, kernel_cache
        self.processes = Processes(timeout)

    def run(self, mutations: Mapping[str, Mutation]) -> list[Outcome]:
        """Outcomes in the order of the mutations.

        On Ctrl-C, all processes are ended, the copies removed, and KeyboardInterrupt is raised.
        """
        with TemporaryDirectory(prefix="wrt-mutate-") as folder:
            self.tell(f"copying {self.root} {self.jobs} times")
            copies: queue.SimpleQueue[Copy] = queue.SimpleQueue()
            for number in range(self.jobs):
                copies.put(Copy(self.root, Path(folder, str(number))))
            kernels = self.kernel_cache or Path(folder, "kernels")

            def tested(tests: tuple[str, ...]) -> Callable[[Copy], str]:
                return lambda copy: self._fault_before(copy, tests, kernels)

            def tried(name: str, mutation: Mutation) -> Callable[[Copy], Outcome]:
                return lambda copy: self._outcome(copy, name, mutation, faults[mutation.test_ids], kernels)

            faults = self._in_parallel({tests: tested(tests) for tests in distinct(mutations)}, copies)
            found = self._in_parallel({name: tried(name, mutation) for name, mutation in mutations.items()}, copies)
            return [found[name] for name in mutations]

    def _in_parallel(self, work: Mapping, copies: queue.SimpleQueue) -> dict:
        """Results of functions of a copy, by their keys."""

        def one(function: Callable) -> object:
            copy = copies.get()
            try:
                return function(copy)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(self.jobs) as pool:
            try:
                keys = {pool.submit(one, function): key for key, function in work.items()}
                return {keys[done]: done.result() for done in as_completed(keys)}
            except BaseException:
                self.processes.stop()
                pool.shutdown(cancel_futures=True)
                raise

    def _pytest(self, copy: Copy, tests: Sequence[str], kernels: Path) -> Ended:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=short", "-p", "no:cacheprovider", *tests]
        return self.processes.run(command, copy.root, copy.environment(kernels))

    def _fault_before(self, copy: Copy, tests: Sequence[str], kernels: Path) -> str:
        """Why tests say nothing about mutations: they fail or are skipped without one. Empty if they pass."""
        ended = self._pytest(copy, tests, kernels)
        fault = ""
        if ended.status != PASSED:
            fault = f"the tests do not pass without the mutation ({how(ended)}):\n{tail(ended.output)}"
        elif not re.search(r"\b\d+ passed", ended.output):
            fault = f"no test ran:\n{tail(ended.output)}"
        self.tell(f"{'FAULT' if fault else 'passed'} without mutation, {ended.seconds:.1f} s: {' '.join(tests)}")
        return fault

    def _outcome(self, copy: Copy, name: str, mutation: Mutation, fault: str, kernels: Path) -> Outcome:
        """Puts a mutation into the copy and runs its tests."""
        if fault:
            found = Outcome(name, mutation, ERROR, reason=fault)
        else:
            try:
                with copy.mutated(mutation), TemporaryDirectory(prefix="wrt-mutate-kernels-") as own:
                    link_kernels(kernels, Path(own))
                    ended = self._pytest(copy, mutation.test_ids, Path(own))
                    found = Outcome(name, mutation, *self.judged(copy, mutation, ended, Path(own)))
            except (ValueError, UnicodeDecodeError) as error:
                found = Outcome(name, mutation, ERROR, reason=str(error))
        self.tell(f"{found.state} {name}, {found.seconds:.1f} s")
        return found

    def judged(self, copy: Copy, mutation: Mutation, ended: Ended, kernels: Path) -> tuple[str, float, str]:
        """State, seconds and reason of a mutation whose tests have ended."""
        if ended.status is None:
            return ERROR, ended.seconds, f"the tests did not end within {self.processes.timeout:.0f} s:\n{tail(ended.output)}"
        if ended.status == PASSED:
            return SURVIVED, ended.seconds, ""
        if ended.status > FAILED:
            return ERROR, ended.seconds, f"the tests did not run ({how(ended)}):\n{tail(ended.output)}"
        if broken := NOT_RUNNABLE.search(ended.output):
            return ERROR, ended.seconds, f"the mutated code does not run: {broken.group(0)}"
        if mutation.path.endswith(".py"):
            command = [sys.executable, "-c", f"import {module_of(mutation.path)}"]
            imported = self.processes.run(command, copy.root, copy.environment(kernels))
            if imported.status != 0:
                return ERROR, ended.seconds, f"the mutated file cannot be imported:\n{tail(imported.output)}"
        return KILLED, ended.seconds, how(ended)


def distinct(mutations: Mapping[str, Mutation]) -> list[tuple[str, ...]]:
    """Every set of tests that some mutation names, once."""
    return list(dict.fromkeys(mutation.test_ids for mutation in mutations.values()))


def how(ended: Ended) -> str:
    """How tests ended, in words: the first that failed, a signal, or the exit status."""
    if ended.status is None:
        return "never"
    if ended.status < 0:
        return f"ended by {signal.Signals(-ended.status).name}"
    failed = re.search(r"^(?:FAILED|ERROR) (.*)$", ended.output, re.MULTILINE)
    return failed.group(1) if failed else f"exit status {ended.status}"


def tail(output: str) -> str:
    """The last lines of an output."""
    return "\n".join(f"    {line}" for line in output.strip().splitlines()[-LOG_LINES:])
