"""Processes that compile kernels into folders of their own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import warp as wp

from wrt.kernels.compilation import precompiled_header

KERNELS = """
import json, sys, threading, time
import warp as wp
wp.config.log_level = wp.LOG_WARNING
from wrt.kernels.compilation.kernel_cache import init_warp
from wrt.kernels.compilation import module_compiler, compile_progress, shipped_kernels
from wrt.kernels.runtime.launch import expect, launch, load
from wrt.kernels.runtime.options import specialised_kernel

def make(value):
    def add(first: int, out: wp.array(dtype=int)):
        out[first + wp.tid()] += wp.static(value)
    return specialised_kernel(add)

def run(kernel):
    out = wp.zeros(3, dtype=int, device="cpu")
    launch(kernel, 3, [out], device=wp.get_device("cpu"))
    return out.numpy().tolist()

init_warp()
cpu = wp.get_device("cpu")
kernels = [make(value) for value in (3, 5, 7)]
"""
"""A program with three modules of a kernel each; all processes of a test compile the same."""


def script(code: str, folder: Path, name: str = "program.py") -> list[str]:
    """The command for a program in a file, which Warp needs to read the source of kernels."""
    path = folder / name
    path.write_text(KERNELS + code)
    return [sys.executable, str(path)]


def environment(folder: Path, **more: str) -> dict[str, str]:
    """Variables of a process whose kernel cache is a folder: empty but for Warp's header, which takes most of the time."""
    name = precompiled_header.FOLDER
    have, kept = Path(wp.config.kernel_cache_dir, name), folder / wp.config.version / name
    if have.is_dir() and not kept.exists():
        shutil.copytree(have, kept)
    own = ("WRT_TARGET", "WRT_WIDTH", *more)
    return {name: value for name, value in os.environ.items() if name not in own} | {"WARP_CACHE_PATH": str(folder)} | more


def done(code: str, folder: Path, **more: str) -> tuple[object, str]:
    """What a program prints last, from JSON, and its stderr."""
    command = script(code, folder)
    process = subprocess.run(
        command, env=environment(folder / "cache", **more), capture_output=True, text=True, check=False, timeout=300
    )
    assert process.returncode == 0, process.stderr
    lines = process.stdout.splitlines()
    return json.loads(lines[-1]), process.stderr
