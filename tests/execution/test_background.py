"""Tasks beside queries: none fails another one, and neither a fork nor the exit of the interpreter meets one under way."""

import os
import subprocess
import sys
import threading

import pytest

from wrt.engine.background import run_in_background

SECONDS = 10


def run_process(code: str) -> str:
    """Runs code in a process of its own; returns what it printed."""
    head = "import os, threading, time\nfrom wrt.engine.background import run_in_background\n"
    done = subprocess.run([sys.executable, "-c", head + code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_task_that_fails_stops_no_other():
    called = threading.Event()
    run_in_background(lambda: 1 / 0)
    run_in_background(called.set)
    assert called.wait(SECONDS)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_waits_for_the_task_under_way():
    """A lock that the task holds would stay locked in the child. The child has background tasks of its own."""
    code = """
lock, began, again = threading.Lock(), threading.Event(), threading.Event()
def task():
    with lock:
        began.set()
        time.sleep(0.3)
run_in_background(task)
began.wait()
child = os.fork()
if child == 0:
    free = lock.acquire(timeout=2)
    run_in_background(again.set)
    os._exit(0 if free and again.wait(10) else 1)
print(os.waitpid(child, 0)[1])
run_in_background(again.set)
assert again.wait(10)
"""
    assert run_process(code) == "0"


def test_the_interpreter_ends_with_the_task_under_way():
    code = """
began = threading.Event()
def task():
    began.set()
    time.sleep(0.3)
    print("ended", flush=True)
run_in_background(task)
run_in_background(lambda: print("begun at the exit", flush=True))
began.wait()
"""
    assert run_process(code) == "ended"
