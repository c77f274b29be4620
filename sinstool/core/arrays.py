"""Array types for annotations, and arrays for compiled loops."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ROUNDING",
    "ArrayLike",
    "BoolArray",
    "ComplexArray",
    "FloatArray",
    "IntArray",
    "zeros_on_lines",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]

ROUNDING = 1e-9
"""A change by less than this share of a value is by rounding, as of rates made of angles."""

LINE = 64
"""Bytes of a line of a processor's cache."""


def zeros_on_lines(shape: tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """Zeros that begin where a line of the cache does, so that wide loads do not cross two.

    Parameters
    ----------
    shape : tuple of int
    kind : dtype, optional
    """
    size = int(np.prod(shape)) * np.dtype(kind).itemsize
    room = np.zeros(size + LINE, np.uint8)
    first = -room.ctypes.data % LINE
    return room[first : first + size].view(kind).reshape(shape)
