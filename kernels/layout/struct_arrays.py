"""Warp structs with a cached NumPy layout, for arrays of structs that are created often.

Warp computes the NumPy layout of a struct whenever an array of structs is converted from or to NumPy. For nested structs this
takes a large part of the time of a small build (notebooks/records/2026-11-22-launches.md).
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import warp as wp


def with_known_layout(struct: Any) -> Any:
    """Caches the NumPy dtype of a struct; a decorator to be written above `@wp.struct`."""
    find = struct.numpy_dtype
    struct.numpy_dtype = cache(lambda: np.dtype(find()))
    return struct


def array_of_structs(items: Sequence[Any], struct: Any, device: wp.Device) -> wp.array:
    """An array of struct instances, for structs decorated by `with_known_layout`.

    Warp's own conversion lets NumPy derive the layout from the C type, which is slower and turns a Ctrl-C that arrives
    meanwhile into a RuntimeError.
    """
    raw = b"".join(bytes(item.__ctype__()) for item in items)
    return wp.array(np.frombuffer(raw, dtype=struct.numpy_dtype()), dtype=struct, device=device)
