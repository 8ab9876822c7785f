"""Finds what in a C++ snippet is for one kind of CPU only, or needs an assembler."""

from __future__ import annotations

import re

FOR_X86 = re.compile(r"(?<!!)defined\((__x86_64__|__AVX\w*__|__SSE\w*__|__NO_PERMUTATION__)\)")
ASSEMBLY = re.compile(r"\basm\b|__asm__|__asm\b")
SYMBOL = re.compile(r"\)\s*__asm__\(\"\w+\"\)")
"""The name of a function in the library, behind its declaration."""


def has_assembly(snippet: str) -> bool:
    """Whether a snippet has instructions in assembly, beside names of functions in libraries."""
    return bool(ASSEMBLY.search(SYMBOL.sub(")", snippet)))


def x86_without_guard(snippet: str) -> list[str]:
    """Lines with builtins of x86 that are compiled for other CPUs, too."""
    found: list[str] = []
    conditions: list[str] = []
    for line in snippet.splitlines():
        word = line.strip()
        if word.startswith("#if"):
            conditions.append(word)
        elif word.startswith("#el"):
            conditions[-1] = word
        elif word.startswith("#endif"):
            conditions.pop()
        elif "__builtin_ia32_" in line and not any(FOR_X86.search(condition) for condition in conditions):
            found.append(word)
    return found
