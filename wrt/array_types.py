"""Types of the arrays that callers pass, for type checkers and editors; results are of the same kind."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
import warp as wp

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    ArrayT = TypeVar("ArrayT", covariant=True, default=Any)
else:
    from typing import TypeVar

    ArrayT = TypeVar("ArrayT", covariant=True)
"""Of results: `np.ndarray`, or `wp.array`; Any where it depends on values."""

__all__ = ["ArrayLike", "ArrayT", "Indices", "Numbers", "NumpyLike", "WarpLike"]


class Table(Protocol):
    """Objects such as a pandas.DataFrame, which NumPy reads."""

    def to_numpy(self) -> np.ndarray: ...


class DlpackArray(Protocol):
    """Arrays that other libraries hand out by DLPack, such as tensors of PyTorch and arrays of JAX; they are read in place.

    These two name the kind of a device by an Enum; NumPy's arrays have the method, too, and name it by an int.
    """

    def __dlpack_device__(self) -> tuple[Enum, int]: ...


WarpLike: TypeAlias = "wp.array | DlpackArray"
"""Arrays of Warp, and those that become such. Results for these are Warp arrays."""

NumpyLike: TypeAlias = "np.ndarray | list[Any] | tuple[Any, ...] | Table"
"""Arrays of NumPy, and what it converts. Results for these are NumPy arrays."""

ArrayLike: TypeAlias = "NumpyLike | WarpLike"
"""Any array; (..., 3) of vectors may be (...) of vec3 or vec3d in Warp's."""

Numbers: TypeAlias = "float | np.number | ArrayLike"
"""One number, or an array."""

Indices: TypeAlias = "int | np.integer | Sequence[int] | set[int] | ArrayLike"
"""One index, or several."""
