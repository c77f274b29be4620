"""Where a run gives what it computes, for whoever wants to show it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from sinstool.core.streams import Solution
from sinstool.methods.height.layout import ACCEPTED
from sinstool.methods.height.reference import HeightReference

if TYPE_CHECKING:
    from sinstool.pipelines.process.ins_gnss.run import FilterRun


class Sink(Protocol):
    """Takes what a run computes, while it runs."""

    def push(self, solution: Solution) -> None:
        """Take the next solutions, in the order of time."""

    def refer_height(self, name: str, time_ns: np.ndarray, height: np.ndarray) -> None:
        """Take the heights (m) that the run is held to."""

    def refer_track(self, latitude: np.ndarray, longitude: np.ndarray) -> None:
        """Take the fixes (rad); NaN where one has no position."""

    def refer_filter(self, run: FilterRun) -> None:
        """Take a filter's innovations and biases, at its end."""


def show_reference(reference: HeightReference, sink: Sink) -> None:
    """Give a sink the heights that could be used."""
    good = reference.reason == ACCEPTED
    sink.refer_height(reference.topic, reference.time_ns[good], reference.height[good])
