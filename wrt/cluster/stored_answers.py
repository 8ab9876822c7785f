"""Answers of blocks as named arrays, for files: arrays, hits' attributes, and states of reductions. No pickles.

A state may be made of arrays, numbers, tuples and dicts. Its structure is a JSON text, its arrays are numbered. Integers of any
size, of which exact sums consist, are decimal text.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from wrt.query.batches.exact_sums import ExactSum

STRUCTURE = "structure"


def pack_answer(answer: Any) -> dict[str, np.ndarray]:
    """An answer as named arrays.

    Raises:
        TypeError: a part of a state is neither an array nor a number, a tuple or a dict.
    """
    arrays: dict[str, np.ndarray] = {}
    structure = _packed(answer, arrays)
    return {STRUCTURE: np.array(json.dumps(structure)), **arrays}


def unpack_answer(arrays: Mapping[str, np.ndarray]) -> Any:
    """The answer from named arrays.

    Raises:
        ValueError, KeyError, TypeError: they hold none.
    """
    return _unpacked(json.loads(str(arrays[STRUCTURE])), arrays)


def _packed(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(value, ExactSum):
        return {"sum": [_packed(one, arrays) for one in value]}
    if isinstance(value, Mapping):
        return {"dict": [[str(key), _packed(one, arrays)] for key, one in value.items()]}
    if isinstance(value, tuple):
        return {"tuple": [_packed(one, arrays) for one in value]}
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        name = f"array.{len(arrays)}"
        if array.dtype == object:
            arrays[name] = np.array([str(int(one)) for one in array.reshape(-1)], dtype=str).reshape(array.shape)
            return {"integers": name}
        arrays[name] = array
        return {"array": name}
    if isinstance(value, (bool, int, float)):
        return {"number": value}
    raise TypeError(f"the state of a reduction holds a {type(value).__name__}; make it of arrays, numbers, tuples and dicts")


def _unpacked(structure: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    ((kind, value),) = structure.items()
    if kind == "number":
        return value
    if kind == "array":
        return arrays[value]
    if kind == "integers":
        texts = arrays[value]
        whole = np.empty(texts.shape, dtype=object)
        whole.reshape(-1)[:] = [int(one) for one in texts.reshape(-1)]
        return whole
    if kind == "dict":
        return {key: _unpacked(one, arrays) for key, one in value}
    parts = [_unpacked(one, arrays) for one in value]
    return ExactSum(*parts) if kind == "sum" else tuple(parts)
