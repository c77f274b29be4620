"""The log in results: the file, the time span of its IMU, its losses."""

from __future__ import annotations

from dataclasses import dataclass

from sinstool.io.readers.lost import LogLosses
from sinstool.survey.source import Source


@dataclass(frozen=True)
class LogFile:
    """The log that was read.

    Attributes
    ----------
    path : str
        As given.
    size : int
        Of the file or bag, bytes.
    """

    path: str
    size: int


@dataclass(frozen=True)
class ImuTime:
    """Samples of an IMU topic.

    Attributes
    ----------
    topic : str
        The topic that was used.
    n : int
        Samples in order, without repeated ones.
    rate_hz : float
        By the median interval.
    first_ns, last_ns : int
        Times of the first and last sample.
    time_source : str
        ``stamp`` (header stamps), or ``log`` (log times, if stamps are unusable).
    gaps, gap_total_s : int, float
        Intervals that are not integrated across, and their length in total.
    duplicates, backward : int
        Samples that repeat a stamp, and samples stamped before their predecessor.
    dropped : int
        Samples left out for any reason.
    """

    topic: str
    n: int
    rate_hz: float
    first_ns: int
    last_ns: int
    time_source: str
    gaps: int
    gap_total_s: float
    duplicates: int
    backward: int
    dropped: int

    @classmethod
    def of(cls, source: Source) -> ImuTime:
        """From the survey of a log."""
        s = source.survey
        return cls(
            topic=s.topic,
            n=s.count,
            rate_hz=s.rate_hz,
            first_ns=s.first_ns,
            last_ns=s.last_ns,
            time_source=s.time_source,
            gaps=s.gap_count,
            gap_total_s=s.gap_total_s,
            duplicates=s.order.duplicates,
            backward=s.order.backward,
            dropped=s.order.duplicates + s.order.late + s.losses.malformed + s.losses.nonfinite,
        )


@dataclass(frozen=True)
class Lost(LogLosses):
    """Parts of the log that could not be used.

    Attributes
    ----------
    malformed : int
        Messages that do not fit their definition.
    not_finite : int
        Samples with values that no sensor measures.
    late : int
        Samples too late in the file to be sorted.
    """

    malformed: int
    not_finite: int
    late: int

    @classmethod
    def of(cls, source: Source) -> Lost:
        """From a log that was read to its end."""
        s = source.survey
        return cls(
            **vars(source.log.account()),
            malformed=s.losses.malformed,
            not_finite=s.losses.nonfinite,
            late=s.order.late,
        )
