"""Trajectories in the TUM format, which evo and most SLAM programs read."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from sinstool.io.readers.frames import enu_to_ned, q_for_log
from sinstool.io.readers.results import ResultBlock
from sinstool.io.writers.export.rows import Value, text_rows
from sinstool.io.writers.export.target import Described, Writer

HEADER = """\
# time (s) x y z (m; east, north, up) qx qy qz qw
# The quaternion takes vectors from the body's axes, Forward-Left-Up, to East-North-Up.
"""
NO_POSITION = "# The result has no position: x, y and z are 0.\n"


class TumWriter(Writer):
    """A line for each instant: time, position, quaternion with the scalar part last."""

    columns = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")

    def __init__(self, stream: BinaryIO, about: Described) -> None:
        super().__init__(stream, about)
        self.columns = type(self).columns
        self._begun = False

    def push(self, block: ResultBlock) -> None:
        """Write rows."""
        if not self._begun:
            self._begun = True
            absent = NO_POSITION if block.local_n is None else ""
            self.stream.write((HEADER + absent).encode())
        solution = block.solution
        local = np.zeros((len(block), 3)) if block.local_n is None else enu_to_ned(block.local_n)
        q = q_for_log(solution.q_nb, "flu", "enu")
        parts: list[str | Value] = [Value(solution.time_ns, 9)]
        for column in local.T:
            parts += [" ", Value(column, 6)]
        for k in (1, 2, 3, 0):
            parts += [" ", Value(q[:, k], 15)]
        for text in text_rows([*parts, "\n"]):
            self.stream.write(text)
