"""Native snippets compile for every CPU and every width; for snippets as they are, see `test_native_snippets.py`.

Warp's Clang has no assembler, so an instruction in assembly ended the process on ARM. The packing of paths chose its
instruction by the target alone, so a width other than the target's was an error of Clang.
"""

from __future__ import annotations

import ctypes
import platform

import numpy as np
import pytest
import warp as wp
from support.native_guards import has_assembly, x86_without_guard

from wrt.kernels.compilation.target import AVX2, AVX512, TARGETS, WIDTHS, cpu_features
from wrt.kernels.runtime import native


def test_what_is_no_snippet_for_every_cpu():
    assert has_assembly('__asm__ volatile("yield");')
    assert not has_assembly('int wrt_yield(void) __asm__("sched_yield");')
    call = "__builtin_ia32_pause();\n"
    assert not x86_without_guard(f"#if defined(__x86_64__)\n{call}#endif")
    for other in (f"#if defined(__x86_64__)\n#else\n{call}#endif", f"#if !defined(__AVX2__)\n{call}#endif", call):
        assert x86_without_guard(other)


def test_threads_relax_by_a_builtin_on_arm():
    """The builtin is of Clang for ARM, and what compiles here says nothing of it: it is spelt out."""
    assert "#elif defined(__aarch64__)\n    __builtin_arm_yield();" in native.read_header("pool.h")


WORDS = {
    "packed": lambda width: (
        "wrt::save(to, wrt::chosen_lanes(wrt::load<wrt::Ints<W>>(from), wrt::lanes_of<W>(mask)));"
        "return __builtin_popcount(mask);"
    ),
    "append": lambda width: "return wrt::append<wrt::block_lanes(W)>(to, from, mask);",
    "reversed": lambda width: "wrt::push_reversed<W>(to, from, mask); return __builtin_popcount(mask);",
    "sorted": lambda width: (
        "int key[W]; for (int i = 0; i < W; ++i) key[i] = mask >> i & 1u ? ((100 - i) << 4) | i : -1;"
        "const int n = wrt::push_sorted<W, DEPTH>(key, mask, from, to); "
        "for (int i = 0; i < n; ++i) to[i] = to[DEPTH + i]; return n;"
    ),
}
"""C++ that moves those of W numbers together that a mask selects; "reversed" puts the lowest last."""

LEVELS = {"any": ("-target-cpu x86-64", frozenset()), "x86-64-v3": (None, AVX2), "x86-64-v4": (None, AVX512)}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the targets are of x86-64")
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("width", WIDTHS)
def test_width_and_target_are_independent(width, level, tmp_path):
    """Compiled for each pair, and run where this CPU can."""
    flags, needs = LEVELS[level]
    wp.init()
    for name, words in WORDS.items():
        source, code = tmp_path / f"{name}.cpp", tmp_path / f"{name}.o"
        head = native.text_of(("interleaved.h", "shading_vectors.h"))
        source.write_text(
            f"typedef __SIZE_TYPE__ size_t;\n#define CUDA_CALLABLE\n{head}\n"
            'extern "C" int probe(const int* from, unsigned mask, int* to) {\n'
            f"    constexpr int W = {width}, DEPTH = 64;\n{words(width)}\n}}\n"
        )
        wp._src.build.build_cpu(str(code), str(source), extra_flags=flags or " ".join(TARGETS[level].flags), fuse_fp=False)
        assert code.stat().st_size > 0
        if needs <= cpu_features():
            check(name, width, code)


def check(name: str, width: int, code) -> None:
    """Runs the probe for some masks."""
    llvm, handle = wp._src.context.runtime.llvm, f"probe {code}".encode()
    assert llvm.wp_load_obj(str(code).encode(), handle, False) == 0
    address = llvm.wp_lookup(handle, b"probe")
    probe = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p)(address)
    numbers, found = np.arange(1000, 1064, dtype=np.int32), np.zeros(256, dtype=np.int32)
    for mask in {1, (1 << width) - 1, 1 << (width - 1), *(number % (1 << width) for number in (5, 0xA6, 0x9C31))} - {0}:
        chosen = [1000 + lane for lane in range(width) if mask >> lane & 1]
        assert probe(numbers.ctypes.data, mask, found.ctypes.data) == len(chosen)
        got = found[: len(chosen)].tolist()
        if name == "reversed":  # the lowest comes last, the others in any order
            assert (got[-1], sorted(got)) == (chosen[0], chosen)
        else:
            assert got == chosen
    llvm.wp_unload_obj(handle)
