"""Numbers of a page's figures in compact, lossless form.

All arrays lie in one compressed block; in the figures' JSON stand their types, places and lengths.
Within an array the first bytes of all numbers come first, then all second ones, and so on: the
signs and exponents of neighbours are alike, so that they shrink to almost nothing. Of times, which
ascend, the steps between the bit patterns are written: they are small numbers.
"""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np


class Numbers:
    """A block of numbers that grows while figures are written."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._places: dict[bytes, int] = {}
        self._size = 0

    def as_json(self, spec: Any) -> str:
        """JSON of a figure, with references where it has arrays.

        Parameters
        ----------
        spec : dict
            Of :func:`~sinstool.report.draw.plotly_figure`.
        """
        return json.dumps(spec, default=self._reference, ensure_ascii=False, separators=(",", ":"))

    def _reference(self, values: np.ndarray) -> dict[str, Any]:
        size = values.dtype.itemsize
        bits = values.view(f"<u{size}")
        steps = size == 4 and bool(np.all(values[1:] >= values[:-1]))
        if steps:
            bits = np.diff(bits, prepend=bits.dtype.type(0))
        content = bits.view(np.uint8).reshape(len(bits), size).T.tobytes()
        # Curves of a figure often share their times
        place = self._places.setdefault(content, self._size)
        if place == self._size and content:
            self._parts.append(content)
            self._size += len(content)
        return {"type": f"f{size}", "at": place, "n": len(values), "steps": steps}

    def packed(self) -> str:
        """The block, compressed with gzip and written in base64."""
        return base64.b64encode(gzip.compress(b"".join(self._parts), mtime=0)).decode("ascii")
