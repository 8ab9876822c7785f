"""What this CPU is and what it can do: as Linux says it, or elsewhere as Warp's compiler does."""

from __future__ import annotations

import ctypes
import platform
from functools import cache
from pathlib import Path

import warp as wp

LINUX_NAMES = {"bmi": "bmi1", "lzcnt": "abm", "neon": "asimd", "lse": "atomics", "fullfp16": "asimdhp", "dotprod": "asimddp"}
LINUX_NAMES |= {"rcpc": "lrcpc"}
"""Features that LLVM and Linux do not call the same."""


@cache
def cpu_information(*names: str) -> str | None:
    """The value of the first line of `/proc/cpuinfo` with one of these names; None if there is no such line."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as text:
            for line in text:
                if line.startswith(names):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return None


@cache
def told_by_compiler(what: str) -> str:
    """What the library of Warp's compiler says of this CPU: its "name" or its "features", as LLVM names them; "" if nothing.

    The library is loaded, but Warp is not started.
    """
    for library in sorted((Path(wp.__file__).parent / "bin").glob("*warp-clang*")):
        try:
            tell = getattr(ctypes.CDLL(str(library)), f"wp_get_host_cpu_{what}")
        except (OSError, AttributeError):
            continue
        tell.argtypes, tell.restype = [], ctypes.c_char_p
        return (tell() or b"").decode()
    return ""


def cpu_name() -> str:
    """Name of the processor according to the operating system, or to the compiler."""
    return cpu_information("model name") or told_by_compiler("name") or platform.processor() or platform.machine()


def cpu_features() -> frozenset[str]:
    """The SIMD extensions of this CPU, as `/proc/cpuinfo` names them."""
    told = cpu_information("flags", "Features")
    return words_of(told) if told else features_of_compiler()


@cache
def words_of(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


@cache
def features_of_compiler() -> frozenset[str]:
    """Those that the compiler knows of, by Linux's names."""
    return frozenset(LINUX_NAMES.get(name, name) for name in told_by_compiler("features").split(",") if name)
