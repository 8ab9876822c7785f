"""Compiles Warp's modules for ARM by a compiler that runs on the CPU that emulates: `install` in the emulated process."""

from __future__ import annotations

import os
import subprocess
from typing import Any

import warp
import warp._src.build as build

BY_WARP = ("wrt.kernels.runtime.job_queue",)
"""Modules that Warp's own compiler makes, emulated: those whose C++ differs by processor."""

FLAGS = (
    "-triple aarch64-linux-gnu -target-cpu neoverse-n1 -target-feature +reserve-x28 -emit-obj -x c++ -std=c++17 -O1 -DNDEBUG"
)
FLAGS += " -DNDEBUG -mrelocation-model pic -Wno-everything"

HEADERS = os.path.join(os.path.dirname(warp.__file__), "native")


def install(host_python: str) -> None:
    """From now on, Warp's modules are compiled by the `ziglang` wheel of a Python on the other CPU.

    An emulated process can start programs of that CPU: the kernel runs them as what they are.
    """
    by_warp = build.build_cpu

    def build_cpu(obj_path: str, cpp_path: str, *args: Any, **options: Any) -> None:
        if any(name in os.path.basename(cpp_path) for name in BY_WARP):
            by_warp(obj_path, cpp_path, *args, **options)
            return
        folders = [word for folder in (HEADERS, *options.get("extra_include_dirs", ())) for word in ("-I", str(folder))]
        contract = "on" if options.get("fuse_fp", True) else "off"
        more = [f"-ffp-contract={contract}", f"-DWP_TILE_BLOCK_DIM={options.get('block_dim', 256)}", *folders]
        command = [host_python, "-m", "ziglang", "clang", "-cc1", *FLAGS.split(), *more, "-o", obj_path, cpp_path]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{cpp_path} does not compile for ARM: {done.stderr[:2000]}")

    build.build_cpu = build_cpu
