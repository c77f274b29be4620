"""The interface of a coning algorithm: samples of one update in, rotation vector out.

Everything that feeds an algorithm (streams, comparisons, the closed-form response) knows
only :class:`ConingAlgorithm`; everything that is one lives in a file of its own family and
is named in :mod:`sinstool.methods.coning.registry`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import numpy as np

from sinstool.core import plugins
from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.errors import ConfigurationError

Takes = Literal["increments", "rates"]
GyroKind = Literal["rate", "mean-rate", "increment"]


def of_rates(gyro_kind: str) -> GyroKind:
    """Kind of samples after increments have been divided by their intervals."""
    return "rate" if gyro_kind == "rate" else "mean-rate"


class ConingAlgorithm(ABC):
    """Rotation vectors of the body over consecutive updates, from gyro samples.

    An algorithm has no memory. The rotation vector of an update that starts at row ``s`` depends
    only on rows ``s - before`` to ``s + samples + after - 1``, bit for bit, so the cutting of a log
    into blocks does not matter.

    Attributes
    ----------
    name : str
        As on the command line.
    summary : str
        One line for a user.
    source : str
        Paper and equation it comes from.
    takes : {"increments", "rates"}
        Integrated angular increments (rad, row k over (t[k-1], t[k]]) or angular rates at
        the instants (rad/s, row k at t[k]).
    samples : int
        Intervals per update: 1, but for a :class:`MultiSampleAlgorithm`.
    before : int
        Earlier rows used where they exist. With rates the row before the first interval is
        its starting point and always needed.
    after : int
        Later rows used where they exist.
    caveat : str
        Warning for a user who chooses it; usually empty.
    """

    name: str
    summary: str
    source: str
    takes: Takes = "increments"
    before: int = 0
    after: int = 0
    caveat: str = ""

    @property
    def samples(self) -> int:
        """Intervals per update."""
        return 1

    def caveats(self, gyro_kind: str) -> tuple[str, ...]:
        """Warnings for a user who chooses it, for samples of this kind."""
        late = ""
        if self.takes == "rates" and gyro_kind != "rate":
            late = (
                f"{self.name} takes each sample for the rate at its stamp, but samples are means"
                " over the interval before it: the attitude is half an interval late, and coning"
                " is compensated in part only"
            )
        return tuple(text for text in (self.caveat, late) if text)

    def rotation_vectors(self, x: ArrayLike, dt: ArrayLike, first: int, count: int) -> FloatArray:
        """Rotation vectors of `count` consecutive updates.

        Parameters
        ----------
        x : array_like, shape (m, 3)
            Increments, rad, or rates, rad/s, in the body frame; see :attr:`takes`.
        dt : array_like, shape (m,)
            Interval that ends at each row, s.
        first : int
            Row of the first interval of the first update. The rows before it are history.
            Fewer than :attr:`before` mean that the segment starts here: the algorithm then
            uses the most accurate form for the history that there is.
        count : int
            Number of updates. The rows after them are look-ahead; fewer than :attr:`after`
            mean that the segment ends here.

        Returns
        -------
        ndarray, shape (count, 3)
            Rotation vector of each update, rad: ``q_nb(end) = q_nb(start) exp(phi)`` for
            an ``n`` that does not rotate.

        Raises
        ------
        ValueError
            If shapes do not fit or rows are missing.
        ConfigurationError
            If an algorithm of somebody else fails, or leaves or makes what is no number.
        """
        rows = np.ascontiguousarray(x, dtype=np.float64)
        intervals = np.ascontiguousarray(dt, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise ValueError(f"Expected `x` to have shape (m, 3), got {rows.shape}.")
        if intervals.shape != rows.shape[:1]:
            raise ValueError(
                f"Expected `dt` to have shape {rows.shape[:1]}, got {intervals.shape}."
            )
        earliest = 1 if self.takes == "rates" else 0
        if first < earliest or count < 0 or first + count * self.samples > len(rows):
            raise ValueError(
                f"{count} updates of {self.samples} intervals from row {first} do not fit "
                f"into {len(rows)} rows."
            )
        out = np.full((count, 3), np.nan)
        if count:
            with plugins.blamed(self, self._failed):
                self._fill(rows, intervals, first, out)
            if not np.isfinite(out).all() and np.isfinite(rows).all():
                raise self._failed("it gives rotations that are no finite numbers")
        return out

    def _failed(self, text: str) -> ConfigurationError:
        return ConfigurationError(
            f"coning algorithm {self.name} fails: {text}", "choose another algorithm, or repair it"
        )

    def for_kind(self, gyro_kind: GyroKind) -> ConingAlgorithm:
        """Form of this algorithm for the kind of sample that a log has.

        Callers must use the form that this returns. Most algorithms have a single form, and
        samples are converted to its input; one that gains from knowing the kind of sample returns
        another form here.

        Parameters
        ----------
        gyro_kind : {"rate", "mean-rate", "increment"}
            What the samples are; see `sinstool.core.conventions`.

        Returns
        -------
        ConingAlgorithm
            This one, unless it has a form of its own for the kind; of the same name and with
            as many samples per update.
        """
        return self

    @abstractmethod
    def _fill(self, x: FloatArray, dt: FloatArray, first: int, out: FloatArray) -> None:
        """Write the rotation vectors of ``len(out)`` updates; arguments are checked."""

    def shorter(self, samples: int) -> ConingAlgorithm:
        """Algorithm of the same family and order for the samples left over at a segment's end.

        Parameters
        ----------
        samples : int
            Intervals of the one shorter update, 1 to ``self.samples``.

        Returns
        -------
        ConingAlgorithm
            Of that many samples per update; earlier samples replace the missing ones.

        Raises
        ------
        ValueError
            If `samples` is not in that range.
        """
        if not 1 <= samples <= self.samples:
            raise ValueError(
                f"{self.name} has {self.samples} samples per update, so not {samples} are left."
            )
        return self

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"


class MultiSampleAlgorithm(ConingAlgorithm):
    """An algorithm whose updates may have several samples: one of a family."""

    samples = 1

    def shorter(self, samples: int) -> ConingAlgorithm:
        """See :meth:`ConingAlgorithm.shorter`."""
        super().shorter(samples)
        return self if samples == self.samples else self._of_samples(samples)

    @abstractmethod
    def _of_samples(self, samples: int) -> ConingAlgorithm:
        """Member of the family with fewer samples per update."""
