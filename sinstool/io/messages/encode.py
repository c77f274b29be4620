"""Bytes from columns: many messages of one layout at once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from sinstool.io.messages.definitions import Definition, parse_definition, schema_text
from sinstool.io.messages.layout import LayoutError, template


class Encoder:
    """Writes messages of one standard type, all with the same strings and sequence lengths.

    Parameters
    ----------
    type_name : str
        Standard type, ROS 2 spelling.
    encoding : {'cdr', 'ros1'}
        Serialisation.
    strings : mapping of str to str, optional
        Text of string fields by path, such as ``{"header.frame_id": "odom"}``.
    lengths : mapping of str to int, optional
        Length of sequences by path.
    """

    def __init__(
        self,
        type_name: str,
        encoding: str,
        strings: Mapping[str, str] | None = None,
        lengths: Mapping[str, int] | None = None,
    ) -> None:
        self.type_name = type_name
        self.encoding = encoding
        self.layout, self._template = template(
            standard_definition(type_name, encoding), dict(strings or {}), dict(lengths or {})
        )
        self._runs: set[tuple[str, int]] = set()  # found to fit
        self._places: dict[str, tuple[int, np.dtype[Any], int]] = {}

    def encode(self, columns: Mapping[str, np.ndarray], count: int) -> np.ndarray:
        """Serialise ``count`` messages.

        Parameters
        ----------
        columns : mapping of str to ndarray
            Path to values, (n,) or (n, k) with k elements from that path on (k > 1 covers the
            following primitives of the same type too, as x, y, z), or a scalar for all. ``path[i]``
            is where element i of an array lies.
        count : int
            How many messages.

        Returns
        -------
        ndarray, shape (count, size), uint8
            One payload a row.

        Raises
        ------
        LayoutError
            A path is not in the type, or the values run over into fields of another type.
        """
        out = np.empty((count, len(self._template)), np.uint8)
        out[:] = self._template
        if not count:
            return out
        for path, values in columns.items():
            offset, dtype, room = self._places.get(path) or self._place(path)
            array = np.asarray(values)
            width = array.shape[1] if array.ndim == 2 else 1
            if width > room and (path, width) not in self._runs:
                self._check_run(path, offset, dtype, width)
                self._runs.add((path, width))
            end = offset + dtype.itemsize * width
            # numpy's field view writes straight into the rows at any byte offset
            view = np.ndarray(
                (count, width), dtype, out.data, offset, (out.strides[0], dtype.itemsize)
            )
            assert end <= out.shape[1]
            view[:] = array.reshape(-1, width) if array.ndim else array
        return out

    def _place(self, path: str) -> tuple[int, np.dtype[Any], int]:
        """Offset and type of a path, and how many elements its own array has from there on."""
        leaf, first = self.layout.leaves.get(path), 0
        if leaf is None and path.endswith("]"):
            whole, _, number = path[:-1].rpartition("[")
            if number.isdecimal():
                leaf, first = self.layout.leaves.get(whole), int(number)
        if leaf is None or first >= leaf.count:
            raise LayoutError(f"{self.type_name} has no field {path}")
        dtype = np.dtype("<" + leaf.dtype)
        place = leaf.offset + first * dtype.itemsize, dtype, leaf.count - first
        self._places[path] = place
        return place

    def _check_run(self, path: str, offset: int, dtype: np.dtype, width: int) -> None:
        starts = {
            leaf.offset + i * dtype.itemsize
            for leaf in self.layout.leaves.values()
            if "<" + leaf.dtype == dtype.str or leaf.dtype == dtype.str.lstrip("<|")
            for i in range(leaf.count)
        }
        for i in range(width):
            if offset + i * dtype.itemsize not in starts:
                raise LayoutError(f"{width} values do not fit at {path} of {self.type_name}")


@lru_cache(maxsize=64)
def standard_definition(type_name: str, encoding: str) -> Definition:
    """Definition of a standard type in an encoding."""
    flavour = "ros1msg" if encoding == "ros1" else "ros2msg"
    return parse_definition(type_name, flavour, schema_text(type_name, encoding), encoding)
