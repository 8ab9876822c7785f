"""Processes that run a script, whose output is judged."""

from __future__ import annotations

import subprocess
import sys

HEAD = """
import os, random, signal, sys, threading, time
import numpy as np, warp as wp
wp.config.log_level = wp.LOG_WARNING
import wrt
from wrt.kernels.runtime import pool as pools
wrt.set_num_threads(4)
scene = wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")
rays = np.random.default_rng(0).normal(size=(60_000, 3)).astype(np.float32)
def ask():
    return scene.intersect(rays * 9, -rays).t
expected = ask()
"""
"""How the processes begin that the tests start."""


def run_process(code: str, returncode: int = 0, seconds: float = 120) -> str:
    """Runs code after `HEAD` in a process of its own; returns what it printed."""
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", HEAD + code], capture_output=True, text=True, timeout=seconds, check=False
    )
    assert result.returncode == returncode, result.stderr
    return result.stdout
