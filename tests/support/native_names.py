"""Finds the names in a C++ snippet that neither the snippet nor its function declares."""

from __future__ import annotations

import re
from collections.abc import Iterable

TYPES = frozenset(
    re.findall(
        r"\w+",
        "auto bool char double float int long short signed unsigned void size_t int32_t int64_t uint8_t uint32_t uint64_t "
        "float2 float4",
    )
)
"""Types that Clang and NVRTC know in every snippet."""

QUALIFIERS = frozenset(re.findall(r"\w+", "const constexpr static volatile __restrict__ __shared__"))

KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        "__asm__ alignas break case continue decltype do else enum false for if namespace nullptr operator return sizeof "
        "struct switch true typedef using while",
    )
)

SUPPLIED = frozenset(
    re.findall(
        r"\w+",
        "INFINITY NAN memcpy fabsf __brev __ffs __popc __ldcg __threadfence threadIdx _Pragma __ATOMIC_SEQ_CST "
        "__ATOMIC_RELAXED __ATOMIC_ACQUIRE __ATOMIC_RELEASE static_assert "
        "atomicAdd atomicMin sqrt sqrtf __attribute__ aligned ext_vector_type noinline",
    )
)
"""What the compilers or Warp's headers supply; names that begin with `__builtin_` or `__atomic_` count too."""

_NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'|\\\n', re.DOTALL)
_MACRO = re.compile(r"^[ \t]*#[ \t]*define[ \t]+(\w+)(?:\(([^)]*)\))?(.*)$", re.MULTILINE)
_DIRECTIVE = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
_OFFSET = re.compile(r"__builtin_offsetof\(([^,]*), *\w+\)")
"""A member's place: its name is the struct's."""

_TOKEN = re.compile(r"(?P<number>\.?\d(?:[eEpP][+-]|[\w.])*)|\w+|->|::|&&|##|\S")

Macros = dict[str, tuple[list[str] | None, list[str]]]
"""Parameters, None without parentheses, and body of each macro."""


def free_names(snippet: str, parameters: Iterable[str]) -> set[str]:
    """Names that a snippet uses and that are not parameters, part of the language, or declared in the snippet.

    Both branches of an `#if` are read; of two definitions of a macro, the last one. Scopes are not told apart: a name that is
    declared anywhere in the snippet counts as declared everywhere.
    """
    code = _OFFSET.sub(r"sizeof(\1)", _NOISE.sub(" ", snippet))
    macros: Macros = {}
    for match in _MACRO.finditer(code):
        macros[match[1]] = (None if match[2] is None else re.findall(r"\w+", match[2]), tokens_of(match[3]))
    tokens = expanded(tokens_of(_DIRECTIVE.sub(" ", code)), macros)
    known = {*parameters, *TYPES, *QUALIFIERS, *KEYWORDS, *SUPPLIED} | declared_names(tokens)
    return {name for name in used_names(tokens) - known if not name.startswith(("__builtin_", "__atomic_"))}


def tokens_of(code: str) -> list[str]:
    """Names and punctuation; every number is "0"."""
    return ["0" if match["number"] else match[0] for match in _TOKEN.finditer(code)]


def is_name(token: str) -> bool:
    """Whether a token is an identifier or a keyword."""
    return token[0].isalpha() or token[0] == "_"


def expanded(tokens: list[str], macros: Macros) -> list[str]:
    """The tokens with macros replaced by their bodies."""
    found: list[str] = []
    i = 0
    while i < len(tokens):
        token, i = tokens[i], i + 1
        parameters, body = macros.get(token, (None, None))
        if body is None or (parameters is not None and tokens[i : i + 1] != ["("]):
            found.append(token)
            continue
        if parameters is not None:
            end = closing(tokens, i)
            values = dict(zip(parameters, split_at_commas(tokens[i + 1 : end]), strict=True))
            body, i = [part for word in body for part in values.get(word, [word])], end + 1
        while "##" in body:
            at = body.index("##")
            body = [*body[: at - 1], body[at - 1] + body[at + 1], *body[at + 2 :]]
        found += expanded(body, {name: macro for name, macro in macros.items() if name != token})
    return found


def closing(tokens: list[str], i: int) -> int:
    """Index of the bracket that closes the one at i."""
    depth = 0
    for j in range(i, len(tokens)):
        depth += (tokens[j] in "([{") - (tokens[j] in ")]}")
        if depth == 0:
            return j
    raise ValueError(f"a bracket is not closed: {' '.join(tokens[i : i + 20])}")


def split_at_commas(tokens: list[str]) -> list[list[str]]:
    """The parts between commas that are in no brackets."""
    parts: list[list[str]] = [[]]
    depth = 0
    for token in tokens:
        depth += (token in "([{") - (token in ")]}")
        if token == "," and depth == 0:
            parts.append([])
        else:
            parts[-1].append(token)
    return parts


def used_names(tokens: list[str]) -> set[str]:
    """All names but members and those in a namespace: of `wp::vec3`, neither part counts."""
    around = zip(["", *tokens], tokens, [*tokens[1:], ""], strict=False)
    return {name for before, name, after in around if is_name(name) and before not in (".", "->", "::") and after != "::"}


def declared_names(tokens: list[str]) -> set[str]:
    """Names of types, enumerators, variables, and parameters of lambdas."""
    types, found = set(TYPES), set()
    for i, token in enumerate(tokens):
        if token in ("struct", "using"):
            types.add(tokens[i + 1])
        elif token == "enum":
            begin = tokens.index("{", i)
            found |= {name for part in split_at_commas(tokens[begin + 1 : closing(tokens, begin)]) for name in part[:1]}
        elif token == "typedef":  # the name is last, or in (*name)(...)
            last = next(j for j in range(i, len(tokens)) if tokens[j] in (";", "__attribute__", ")"))
            types.add(tokens[last - 1])
    for i, token in enumerate(tokens):
        if token in types or (i > 0 and tokens[i - 1] == "::"):
            found |= declarators(tokens, i + 1, types)
    return found | types


def declarators(tokens: list[str], i: int, types: set[str]) -> set[str]:
    """Names that a declaration introduces; i: index of the token after its type. Empty if this is no declaration."""
    found: set[str] = set()
    if tokens[i : i + 1] == ["<"] and ">" in tokens[i:]:  # arguments of a template
        i = tokens.index(">", i) + 1
    while i + 1 < len(tokens):
        while tokens[i] in ("*", "&", "&&") or tokens[i] in QUALIFIERS:
            i += 1
        if (
            not is_name(tokens[i])
            or tokens[i] in types | KEYWORDS
            or tokens[i + 1] not in ("=", ";", ",", "[", "(", ")", ":", "{")
        ):
            return found
        found.add(tokens[i])
        while tokens[i] not in (",", ";", ")"):
            i = closing(tokens, i) + 1 if tokens[i] in ("(", "[", "{") else i + 1
        if tokens[i] != ",":
            return found
        i += 1
    return found
