"""Samples of one span of time after the other, read no further than the spans ask."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sinstool.core.errors import AlignmentError
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import SECOND

# So many samples are held at most, where no end is set: an hour at 200 Hz. They take 200 MB, with
# all that is computed of them.
MOST_SAMPLES = 720_000
NO_SAMPLES = "there are no IMU samples to align with"


class SpanReader:
    """Samples from a beginning up to any end, read no further than the spans ask.

    Parameters
    ----------
    blocks : iterable of Imu
        In order; increments as mean rates.
    most : int, optional
        Samples beyond so many are not read, whatever the span.

    Attributes
    ----------
    cut : bool
        Samples have been left out.
    """

    def __init__(self, blocks: Iterable[Imu], most: int | None = MOST_SAMPLES) -> None:
        self._waiting = iter(blocks)
        self._most = most
        self._imu: Imu | None = None
        self._ended = False
        self.cut = False

    @property
    def first_ns(self) -> int:
        """Time of the first sample, of those read."""
        assert self._imu is not None
        return int(self._imu.time_ns[0])

    def until(self, end_ns: int | None) -> Imu:
        """Samples up to a time; None for the last one.

        Raises
        ------
        AlignmentError
            There are none at all.
        """
        parts = [] if self._imu is None else [self._imu]
        count = sum(map(len, parts))
        while not self._ended and (
            not parts or end_ns is None or int(parts[-1].time_ns[-1]) <= end_ns
        ):
            block = next(self._waiting, None)
            if block is None:
                self._ended = True
            elif self._most is not None and count + len(block) > self._most:
                self._ended = self.cut = True
                parts.append(block.rows(slice(0, self._most - count)))
            elif len(block):
                parts.append(block)
                count += len(block)
        if not parts:
            raise AlignmentError(NO_SAMPLES, "widen start and end")
        self._imu = imu = concatenate(parts)
        if end_ns is None:
            return imu
        return imu.rows(slice(0, int(np.searchsorted(imu.time_ns, end_ns, "right"))))

    def cut_short(self, end_ns: int | None) -> tuple[str, ...]:
        """A warning where samples up to a time, which have been read, are not all there are."""
        if not self.cut or self._imu is None:
            return ()
        last_ns = int(self._imu.time_ns[-1])
        if end_ns is not None and end_ns <= last_ns:
            return ()
        return (
            f"aligned with the first {len(self._imu)} samples"
            f" ({(last_ns - self.first_ns) / SECOND:.0f} s); --align-end uses more",
        )
