"""Kernels compiled for CUDA without a device, and where the compiler may fuse."""

from __future__ import annotations

import re

import warp as wp

ARCHITECTURE = 75

FUSIBLE = re.compile(r"\b(?:fma\.rn|mad|mul|add|sub)\.f32")
"""A multiply-add in one, or an operation without `.rn`, which later steps may make one of: it breaks watertightness and the
equality of devices."""

HEAD = re.compile(r"^(?:\.\w+ )*\.(entry|func) *(?:\([^)]*\))?\s*([\w$]+)\s*\(", re.MULTILINE)
"""The head of a kernel or of a function, declared or defined."""

CALL = re.compile(r"\bcall(?:\.uni)?\s*(?:\([^)]*\),)?\s*([\w$]+)")


def compile_to_ptx(module, folder) -> str:
    """The code of a module's kernels and of the functions that they call, themselves or by others: NVRTC, not optimising, keeps
    all functions of Warp's header."""
    wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=folder, use_ptx=True)
    (text,) = (path.read_text() for path in folder.glob("*.ptx"))
    heads = list(HEAD.finditer(text))
    ends = [*(head.start() for head in heads[1:]), len(text)]
    bodies = {head[2]: text[head.start() : end] for head, end in zip(heads, ends, strict=True) if "{" in text[head.end() : end]}
    found = [head[2] for head in heads if head[1] == "entry"]
    for name in found:  # grows
        found += (set(CALL.findall(bodies[name])) & bodies.keys()) - set(found)
    return "\n".join(map(bodies.get, found))


BOX_PLANES = 12
"""Fused multiply-adds in a node's step: a plane each of the boxes of two children; one, where their function is not inlined."""


def assert_fuses_boxes_alone(text: str, walks: int = 1) -> None:
    """Of persistent threads: the steps of nodes in so many walks fuse, and nothing else does."""
    fused = FUSIBLE.findall(text)
    assert set(fused) == {"fma.rn.f32"}
    assert len(fused) in (1, walks * BOX_PLANES)
