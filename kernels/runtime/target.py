"""Which CPU kernels are compiled for, and how many lanes their loops have: two settings, both for CPUs only.

    WRT_TARGET=x86-64-v3 wrt bench          code for any CPU with AVX2, 8 lanes
    WRT_WIDTH=16 python program.py          code for this CPU, 16 lanes, whatever its registers hold

**Target.** Warp compiles for the CPU that it finds. Another CPU that this one can stand in for is chosen by name, from
`TARGETS`: so that a machine with AVX-512 shows what machines without it do, in tests and in measurements. A target that this
CPU cannot run is refused before anything is compiled. Warp hashes the flags together with a module's source, so that one cache
of kernels holds all targets side by side.

**Width.** A loop over more lanes than a register holds takes several registers; with fewer lanes, part of a register. Either is
correct, so width and target are independent. The default is what a register of the target holds, but at least 8: with 4, nodes
have few children and leaves few triangles.

Both come from the environment when `wrt.kernels` is imported, or from `choose` before Warp starts. Unset, the width is that of
this CPU, and Warp's flags stay as they are. Neither touches CUDA: there the width is 2, and Warp compiles for the GPU that it
finds.

References:
    H. J. Lu, M. Matz, M. Girkar, J. Hubička, A. Jaeger, M. Mitchell (editors): System V Application Binary Interface, AMD64
        Architecture Processor Supplement (the levels x86-64-v2, v3 and v4, there since 2020).
"""

import os
import platform
from dataclasses import dataclass
from functools import cache

import warp as wp

TARGET_VARIABLE, WIDTH_VARIABLE = "WRT_TARGET", "WRT_WIDTH"

WIDTHS = (4, 8, 16)
"""Lanes that can be asked for."""

AVX2 = frozenset({"abm", "avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"})
AVX512 = AVX2 | {"avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl"}


@dataclass(frozen=True)
class Target:
    """A CPU to compile for.

    Attributes:
        flags: of Clang's compiler proper, which Warp runs without the driver that translates `-march`.
        needs: features that this CPU must have, as `/proc/cpuinfo` names them.
        simd_bits: width of the widest float32 SIMD registers that code for it uses; None for those of this CPU.
    """

    flags: tuple[str, ...]
    needs: frozenset[str] = frozenset()
    simd_bits: int | None = None


TARGETS = {
    "native": Target(("-march=native",)),
    "x86-64-v3": Target(("-target-cpu", "x86-64-v3"), AVX2, 256),
    "x86-64-v4": Target(("-target-cpu", "x86-64-v4", "-mprefer-vector-width=512"), AVX512, 512),
}
"""Targets by name. Clang prefers registers of 256 bits for "x86-64-v4", as suits the first CPUs of that kind."""


@cache
def cpu_information(*names: str) -> str | None:
    """The value of the first line of `/proc/cpuinfo` with one of these names; None where there is none."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as text:
            for line in text:
                if line.startswith(names):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return None


def cpu_name() -> str:
    """The processor's name as the operating system gives it."""
    return cpu_information("model name") or platform.processor() or platform.machine()


def cpu_features() -> frozenset[str]:
    """SIMD extensions of this CPU that matter here, as far as the operating system tells."""
    return frozenset((cpu_information("flags", "Features") or "").split())


def target_name() -> str:
    """Key in `TARGETS` of what kernels are compiled for.

    Raises:
        ValueError: the environment names none, or one that this CPU cannot run.
    """
    name = os.environ.get(TARGET_VARIABLE) or "native"
    if name not in TARGETS:
        raise ValueError(f"target {name!r} ({TARGET_VARIABLE}) is unknown; choose from {', '.join(TARGETS)}")
    if missing := TARGETS[name].needs - cpu_features():
        able = ", ".join(other for other, target in TARGETS.items() if target.needs <= cpu_features())
        raise ValueError(f"this CPU cannot run code for {name}: it has no {', '.join(sorted(missing))}; choose from {able}")
    return name


def simd_bits() -> int:
    """Width of the widest float32 SIMD registers that kernels use: 512, 256 or 128; 128 if unknown."""
    features = cpu_features()
    return TARGETS[target_name()].simd_bits or (512 if "avx512f" in features else 256 if "avx" in features else 128)


def lane_width() -> int:
    """Lanes of the loops of CPU kernels where nobody asks for others: 4, 8 or 16.

    Raises:
        ValueError: the environment asks for a width that is none of `WIDTHS`, or for a target that `target_name` refuses.
    """
    asked = os.environ.get(WIDTH_VARIABLE)
    if not asked:
        return max(simd_bits() // 32, 8)
    if asked not in map(str, WIDTHS):
        raise ValueError(f"width {asked!r} ({WIDTH_VARIABLE}) must be {', '.join(map(str, WIDTHS[:-1]))} or {WIDTHS[-1]}")
    return int(asked)


def choose(target: str | None = None, width: int | None = None) -> None:
    """Sets target and width for this process and those that it starts; to be called before Warp starts. None: as it is.

    Args:
        target: key in `TARGETS`.
        width: one of `WIDTHS`.

    Raises:
        ValueError: unknown target or width, or a target that this CPU cannot run; nothing has changed.
        RuntimeError: Warp has started, and kernels may have been compiled for another target.
    """
    wanted = {TARGET_VARIABLE: target, WIDTH_VARIABLE: None if width is None else str(width)}
    wanted = {name: value for name, value in wanted.items() if value is not None and value != os.environ.get(name)}
    if not wanted:
        return
    before = dict(os.environ)
    os.environ.update(wanted)
    try:
        lane_width()
        target_name()
        if has_started():
            raise RuntimeError(f"Warp has started already; set {' and '.join(wanted)} in the environment of a new process")
    except (ValueError, RuntimeError):
        for name in wanted:
            del os.environ[name]
        os.environ.update(before)
        raise
    apply_environment()


def has_started() -> bool:
    """Whether `wp.init` has run, which is when Warp takes flags for the last time for kernels that are defined already."""
    return getattr(wp._src.context, "runtime", None) is not None


def apply_environment() -> None:
    """Makes Warp compile CPU kernels for the target that the environment names; its other flags stay.

    Raises:
        ValueError: as of `lane_width`.
    """
    lane_width()
    name = target_name()
    if os.environ.get(TARGET_VARIABLE):
        wp.config.cpu_compiler_flags = " ".join([*TARGETS[name].flags, *_without_target(wp.config.cpu_compiler_flags or "")])


def _without_target(flags: str) -> list[str]:
    """Compiler flags but those that say what to compile for."""
    words = flags.split()
    named = {i + offset for i, word in enumerate(words) if word == "-target-cpu" for offset in (0, 1)}
    about = ("-march=", "-mprefer-vector-width=")
    return [word for i, word in enumerate(words) if i not in named and not word.startswith(about)]
