"""Warp as tests want it: imported before wrt by conftest.py and by what runs outside pytest (`tests.bits`, `tests.arm64`)."""

from __future__ import annotations

import os

import warp as wp

wp.config.log_level = wp.LOG_WARNING
AS_USERS = "WRT_TESTS_AS_USERS"
"""With 1 in this variable, kernels are compiled as users' are."""

if os.environ.get(AS_USERS) != "1":
    wp.config.cpu_compiler_flags = "-march=native -mllvm=-inline-threshold=1000 -O1"
"""Most of the time of the tests goes into compiling kernels. Users' have -O2 and inline nine times as much (9000): kernels
then run faster, which is not asked here. CPU seconds on a Zen CPU with AVX2, three packet kernels, three of builds, and
brute force: 14.9 with -O2 and 1000, 14.4 with 225, 10.3 with -O1 and 1000, 4.1 with -O0. The bits are the same;
`test_bits.py` asks for them of the kernels that users run first, compiled as theirs are. Processes that tests start
compile as users do, unless they are given these flags."""

os.environ.setdefault("WRT_SHOW_COMPILING", "0")
"""What processes that tests start say on stderr must not depend on what is in the kernel cache."""

os.environ.setdefault("WRT_COMPILE_LATER", "0")
"""Nor which plan "auto" chooses. Tests of stand-ins set it to 1."""

wp.init()

from wrt.kernels.compilation.cores import available_cores  # noqa: E402

if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 0)):
    os.environ.setdefault("WRT_COMPILE_JOBS", str(max(available_cores() // workers, 1)))
"""Processes that run tests side by side keep the cores busy, and every thread that compiles parses Warp's header (2 s).
Those that tests start inherit this."""

DEVICES = ["cpu", *(str(device) for device in wp.get_cuda_devices())]
"""Every device found: the CPU always, CUDA where there is one."""
