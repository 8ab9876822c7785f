"""Runs in the emulated process: compares groups of cases with hashes that were found on another CPU.

python emulated.py HOST_PYTHON HASHES GROUP...
"""

from __future__ import annotations

import json
import platform
import sys
import time
from pathlib import Path

host_python, expected_file, *names = sys.argv[1:]
sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]  # tests, and the checkout

from arm64.cross_compiler import install  # noqa: E402

install(host_python)

import wrt  # noqa: E402
from arm64.cases import THREADS, groups  # noqa: E402

wrt.set_num_threads(THREADS)
expected: dict[str, str] = json.loads(Path(expected_file).read_text())
begin, wrong, count = time.monotonic(), 0, 0
known = groups()
print(f"emulated: {platform.machine()}, Python {platform.python_version()}, {THREADS} threads", flush=True)
for name in names:
    for case, engine, value in known[name]():
        count += 1
        if expected.get(case) != value:
            wrong += 1
            print(f"DIFFERENT {case}: {engine} gives {value}, another CPU {expected.get(case)}", flush=True)
    print(f"{time.monotonic() - begin:5.0f} s  {name}", flush=True)
print(f"{count - wrong} passed, {wrong} failed", flush=True)
sys.exit(bool(wrong))
