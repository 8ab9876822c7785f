"""C++ around the calls of functions that shade W rays in lanes, which are for the CPU only."""


def in_lanes(call: str, *checks: str) -> str:
    """C++ that returns the result of a call, after checks; on CUDA 0."""
    return "\n".join(("#if WRT_VECTORS", *checks, f"return {call};", "#else", "return 0;", "#endif\n"))


def same(**values: float) -> str:
    """C++ that checks constants of a header."""
    return "\n".join(
        f"static_assert(wrt::{name} == {value if isinstance(value, int) else f'{value!r}f'});" for name, value in values.items()
    )
