"""The CPU target of kernels and the lane count of their loops: two settings that apply to CPUs only.

    WRT_TARGET=x86-64-v3 wrt bench          code for any CPU with AVX2, 8 lanes
    WRT_WIDTH=16 python program.py          code for this CPU, 16 lanes, whatever its registers hold

**Target.** Warp compiles for the CPU on which it runs. `TARGETS` names other CPUs whose code this CPU can run, so that a
machine with AVX-512 can test and measure the code of machines without it. A target that this CPU cannot run is refused before
anything is compiled. Warp hashes the compiler flags together with the source of a module, so one kernel cache holds all
targets.

**Width.** A loop over more lanes than a register holds uses several registers; a loop over fewer lanes uses part of one. Both
are correct, so width and target are independent. The default is the number of lanes in a register of the target, but at least
8: with 4 lanes, nodes would have few children and leaves few triangles.

Both settings are read from the environment when `wrt.kernels` is imported, or set by `choose` before Warp starts. If neither is
set, the width is that of this CPU, and the code is what Warp's own flags give, except that Intel's CPUs with AVX-512 use their
full registers (`WIDE_REGISTERS`). Two more flags shorten compiling and do not change the code (`QUICKER`). CUDA is not
affected: its width is 2, and Warp compiles for the GPU that it finds.

References: lu-2020 (the levels x86-64-v2, v3 and v4).
"""

import os
import platform
from dataclasses import dataclass

import warp as wp

from wrt.kernels.compilation.host_cpu import cpu_features, cpu_information

TARGET_VARIABLE, WIDTH_VARIABLE = "WRT_TARGET", "WRT_WIDTH"

WIDTHS = (4, 8, 16)
"""Supported lane counts."""

AVX2 = frozenset({"abm", "avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"})
AVX512 = AVX2 | {"avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl"}
"""Features of the levels x86-64-v3 and v4, as `/proc/cpuinfo` names them."""

NEOVERSE_N1 = frozenset({"aes", "asimd", "asimddp", "asimdhp", "atomics", "lrcpc"})
NEOVERSE_V2 = NEOVERSE_N1 | {"bf16", "i8mm", "sve2"}
"""The same of two CPUs of ARM: of Graviton 2 and Altra, and of Graviton 4 and Grace. Jetson Orin's has those of the first."""


@dataclass(frozen=True)
class Target:
    """A CPU to compile for.

    Attributes:
        flags: options of Clang's compiler proper (cc1), which Warp runs without the driver that translates `-march`.
        needs: features that this CPU must have, as named in `/proc/cpuinfo`.
        simd_bits: width of the widest float32 SIMD registers that the code uses; None for those of this CPU.
    """

    flags: tuple[str, ...]
    needs: frozenset[str] = frozenset()
    simd_bits: int | None = None


TARGETS = {
    "native": Target(("-march=native",)),
    "x86-64-v3": Target(("-target-cpu", "x86-64-v3"), AVX2, 256),
    "x86-64-v4": Target(("-target-cpu", "x86-64-v4", "-mprefer-vector-width=512"), AVX512, 512),
    "neoverse-n1": Target(("-target-cpu", "neoverse-n1"), NEOVERSE_N1, 128),
    "neoverse-v2": Target(("-target-cpu", "neoverse-v2"), NEOVERSE_V2, 128),
}
"""Targets by name. For "x86-64-v4", and for Intel's CPUs with AVX-512, Clang prefers registers of 256 bits by default, which
suits the first CPUs of that level."""

WIDE_REGISTERS = "-mprefer-vector-width=512"
"""Option for Intel's CPUs with AVX-512: on a Sapphire Rapids, views and incoherent rays are 1.4 to 1.9 times as fast with it
(notebooks/records/2026-11-22-wide-registers.md). AMD's CPUs have full registers by default."""

QUICKER = ("-discard-value-names", "-fpch-instantiate-templates")
"""Options that leave the object code as it is, to the byte, and save 0.05 to 0.1 s a module. Clang's driver gives the first,
but Warp runs the compiler proper. By the second, templates that Warp's header itself uses are instantiated once, when the
header is precompiled, and not again for each module."""


def target_name() -> str:
    """Key in `TARGETS` of the current target.

    Raises:
        ValueError: the environment names an unknown target, or one that this CPU cannot run.
    """
    name = os.environ.get(TARGET_VARIABLE) or "native"
    if name not in TARGETS:
        raise ValueError(f"target {name!r} ({TARGET_VARIABLE}) is unknown; choose from {', '.join(TARGETS)}")
    if missing := TARGETS[name].needs - cpu_features():
        able = ", ".join(other for other, target in TARGETS.items() if target.needs <= cpu_features())
        raise ValueError(f"this CPU cannot run code for {name}: it has no {', '.join(sorted(missing))}; choose from {able}")
    return name


def simd_bits() -> int:
    """Width in bits of the widest float32 SIMD registers that kernels use: 512, 256 or 128; 128 if unknown."""
    features = cpu_features()
    return TARGETS[target_name()].simd_bits or (512 if "avx512f" in features else 256 if "avx" in features else 128)


def lane_width() -> int:
    """Default number of lanes of CPU kernel loops: 4, 8 or 16.

    Raises:
        ValueError: the environment names a width that is not in `WIDTHS`, or a target that `target_name` refuses.
    """
    requested = os.environ.get(WIDTH_VARIABLE)
    if not requested:
        return max(simd_bits() // 32, 8)
    if requested not in map(str, WIDTHS):
        raise ValueError(f"width {requested!r} ({WIDTH_VARIABLE}) must be {', '.join(map(str, WIDTHS[:-1]))} or {WIDTHS[-1]}")
    return int(requested)


def choose(target: str | None = None, width: int | None = None) -> None:
    """Sets target and width for this process and its children; must be called before Warp starts. None keeps a setting.

    Args:
        target: key in `TARGETS`.
        width: one of `WIDTHS`.

    Raises:
        ValueError: unknown target or width, or a target that this CPU cannot run. The settings are then unchanged.
        RuntimeError: Warp has started, so kernels may have been compiled for another target.
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
    """Whether `wp.init` has run; compiler flags that are set later do not apply to kernels that are already defined."""
    return getattr(wp._src.context, "runtime", None) is not None


def apply_environment() -> None:
    """Sets Warp's flags so that CPU kernels are compiled for the target in the environment; other flags are kept.

    Raises:
        ValueError: as in `lane_width`.
    """
    lane_width()
    name = target_name()
    flags = "-march=native" if wp.config.cpu_compiler_flags is None else wp.config.cpu_compiler_flags
    given, others = split_flags(flags)
    native = given == list(TARGETS["native"].flags)
    options = flags.split()
    if os.environ.get(TARGET_VARIABLE) or (native and prefers_half_registers()):
        options = [*target_flags(name), *others]
    wp.config.cpu_compiler_flags = " ".join([*options, *(option for option in QUICKER if option not in options)])


def quiet_warp() -> None:
    """Turns off Warp's lines on stdout, unless `WRT_WARP_LOG=1` is set, Warp runs already or its level of messages was set."""
    is_asked_for = os.environ.get("WRT_WARP_LOG", "0") not in ("", "0")
    if wp.config.log_level == wp.LOG_INFO and not is_asked_for and not has_started():
        wp.config.log_level = wp.LOG_WARNING


def target_flags(name: str) -> tuple[str, ...]:
    """Compiler options of a target on this CPU."""
    flags = TARGETS[name].flags
    return (*flags, WIDE_REGISTERS) if name == "native" and prefers_half_registers() else flags


def prefers_half_registers() -> bool:
    """Whether Clang by default uses half of this CPU's registers of 512 bits."""
    return "avx512f" in cpu_features() and "GenuineIntel" in (cpu_information("vendor_id") or platform.processor())


def split_flags(flags: str) -> tuple[list[str], list[str]]:
    """Compiler flags that select the target, and all others."""
    options = flags.split()
    named = {i + offset for i, option in enumerate(options) if option == "-target-cpu" for offset in (0, 1)}
    named |= {i for i, option in enumerate(options) if option.startswith(("-march=", "-mprefer-vector-width="))}
    rest = [option for i, option in enumerate(options) if i not in named]
    return [option for i, option in enumerate(options) if i in named], rest
