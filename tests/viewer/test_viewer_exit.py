"""A process that shows a scene ends: after `close`, at a Ctrl-C, and by itself, whatever its browsers do."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import warp as wp

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")

TESTS = Path(__file__).resolve().parents[1]

PROGRAM = """
import sys, threading, time
import warp as wp
wp.config.log_level, wp.config.cpu_compiler_flags = wp.LOG_WARNING, FLAGS
sys.path.insert(0, TESTS)
import wrt
from wrt import scenes
from support.viewer_page import Page, until

scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
camera = wrt.PinholeCamera(80, 60, **scenes.BUILTIN_SCENES["teapot"].camera)
viewer = wrt.view(scene, block=False, port=0, camera=camera, options={"ambient": {"ambient_samples": 2}})
address = viewer.url.replace("http", "ws")
background = Page(address, answers=False)  # it never answers for its picture
busy = Page(address)
for page in (background, busy):
    page.look(camera)
    until(lambda: page.pictures)
for session in [*viewer.sessions.values()]:
    session.change(samples=1000)  # work for minutes
print("ready", flush=True)
if HOW == "close":
    viewer.close()
    print([t.name for t in threading.enumerate() if t.name in ("wrt-frames", "wrt-panels", "wrt-prepare")], viewer.sessions)
elif HOW == "interrupt":
    viewer.wait()
"""

LONGEST = 20.0
"""Seconds to the end of a process, on a busy machine. Those that hung took for ever."""


@pytest.fixture(scope="module")
def ends():
    """How each process ended: its status, its last line, and the seconds that it took; they run side by side."""
    processes = {}
    for how in ("close", "interrupt", "nothing"):
        given = f"FLAGS, TESTS, HOW = {wp.config.cpu_compiler_flags!r}, {str(TESTS)!r}, {how!r}"
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        processes[how] = subprocess.Popen([sys.executable, "-c", given + PROGRAM], text=True, env=dict(os.environ), **pipes)
    begun, found = {}, {}
    for how, process in processes.items():
        assert process.stdout.readline() == "ready\n", process.stderr.read()
        begun[how] = time.monotonic()
        if how == "interrupt":
            time.sleep(0.2)  # until it waits
            process.send_signal(signal.SIGINT)
    for how, process in processes.items():
        try:
            process.wait(LONGEST / 2)
        except subprocess.TimeoutExpired:
            if how == "interrupt":  # Python drops an exception that is raised while it deletes an object, Ctrl-C too
                process.send_signal(signal.SIGINT)
        try:
            out, err = process.communicate(timeout=LONGEST + 10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
        found[how] = process.returncode, out, err, time.monotonic() - begun[how]
    return found


@pytest.mark.parametrize(
    ("how", "status"), [("close", (0,)), ("nothing", (0,)), pytest.param("interrupt", (-signal.SIGINT, 1, 130))]
)
def test_a_process_with_a_viewer_ends(ends, how, status):
    """A thread that waited for the answer of a page in the background kept the process alive for ever."""
    code, out, err, seconds = ends[how]
    assert code in status, err
    assert seconds < LONGEST
    assert ("KeyboardInterrupt" in err) == (how == "interrupt")
    if how == "close":
        assert out == "[] {}\n"
