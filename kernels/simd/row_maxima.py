"""The greatest float of each of several rows of W lanes, all rows at once.

Reducing one row takes log2 W rounds of a shuffle and a maximum, each waiting for the one before, and most of the lanes are
idle in the last rounds. Here two registers are folded into one in every round: two shuffles collect one half of the lanes of
each row in one register and the other half in another, and one maximum leaves both rows in half as many lanes. R rows take
about 2 R shuffles and R maxima in all, whatever W is. Halves are runs of four lanes as long as a row has several, then lanes
of a run, because shuffles between runs of four move whole runs.
"""

from collections.abc import Sequence

_RUN = 4
"""Lanes of 128 bits, within which shuffles are cheapest."""


def row_maxima(rows: Sequence[str], width: int, results: str) -> str:
    """C++ that sets `results[j]` to the greatest of the `width` floats at the j-th of `rows`, none of them NaN.

    rows: C++ expressions of pointers to floats; results: name of an array of floats, as many as rows.
    width: W, a power of two.
    """
    row = f"wrt_row_{width}"
    registers = [[number] * width for number in range(len(rows))]  # of each lane: the row that it is of
    names, unused = [f"row_{number}" for number in range(len(rows))], len(rows)
    code = [f"typedef float {row} __attribute__((ext_vector_type({width})));"]
    code += [f"{row} {name}; __builtin_memcpy(&{name}, {at}, sizeof({name}));" for name, at in zip(names, rows, strict=True)]
    while any(len(set(lanes)) < width for lanes in registers):
        if len(registers) % 2:  # folded with itself; what the copy gives is not read
            registers.append([number + unused for number in registers[-1]])
            names.append(names[-1])
            unused *= 2
        folded, folded_names = [], []
        for j in range(0, len(registers), 2):
            first, second = _halves(registers[j]), _halves(registers[j + 1])
            pair, name = f"{names[j]}, {names[j + 1]}", f"fold_{len(code)}"
            sides = [_side_by_side(*halves, width) for halves in zip(first, second, strict=True)]
            for side, lanes in zip("ab", sides, strict=True):
                code.append(f"const {row} {name}{side} = __builtin_shufflevector({pair}, {', '.join(map(str, lanes))});")
            code.append(f"const {row} {name} = {name}a > {name}b ? {name}a : {name}b;")
            folded.append([(registers[j] + registers[j + 1])[k] for k in sides[0]])
            folded_names.append(name)
        registers, names = folded, folded_names
    for lanes, name in zip(registers, names, strict=True):
        code += [f"{results}[{number}] = {name}[{k}];" for k, number in enumerate(lanes) if number < len(rows)]
    vectors, plain = "".join(f"        {line}\n" for line in code), _plain(rows, width, results)
    return f"\n#if defined(__clang__) && !defined(__CUDA_ARCH__)\n    {{\n{vectors}    }}\n#else\n{plain}#endif\n"


def _plain(rows: Sequence[str], width: int, results: str) -> str:
    """The same without vectors."""
    return "".join(
        f"    {results}[{j}] = ({row})[0];\n"
        f"    for (int i = 1; i < {width}; ++i) {results}[{j}] = ({row})[i] > {results}[{j}] ? ({row})[i] : {results}[{j}];\n"
        for j, row in enumerate(rows)
    )


def _halves(rows: list[int]) -> tuple[list[list[int]], list[list[int]]]:
    """Of a register whose lanes are of these rows: numbers of the lanes of the first half of each row and of the
    second half, in groups that stay together: all lanes, if rows have several runs, otherwise those of each run."""
    runs = [rows[k : k + _RUN] for k in range(0, len(rows), _RUN)]
    halves: tuple[list[list[int]], list[list[int]]] = ([], [])
    if rows.count(rows[0]) > _RUN:
        places = {row: [k for k, run in enumerate(runs) if run[0] == row] for row in rows}
        for side, chosen in enumerate(halves):
            kept = [run for own in places.values() for run in own[side * len(own) // 2 : (side + 1) * len(own) // 2]]
            chosen.append([run * _RUN + k for run in kept for k in range(_RUN)])
        return halves
    for number, run in enumerate(runs):
        places = {row: [number * _RUN + k for k, other in enumerate(run) if other == row] for row in run}
        for side, chosen in enumerate(halves):
            chosen.append([k for own in places.values() for k in own[side * len(own) // 2 : (side + 1) * len(own) // 2]])
    return halves


def _side_by_side(first: list[list[int]], second: list[list[int]], width: int) -> list[int]:
    """A shuffle's lanes: each group of the first register, followed by that of the second."""
    return [k for own, other in zip(first, second, strict=True) for k in (*own, *(k + width for k in other))]
