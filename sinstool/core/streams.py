"""Streams of samples as columns, in sinstool's own frames and units.

Each stream is a frozen dataclass of equally long arrays; a block is just a short stream. A row
is one sample. ``time_ns`` is the time of measurement on the clock chosen for the run (the
header stamp unless that is unusable); ``log_time_ns`` is when the recorder received it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from sinstool.core.arrays import ArrayLike

if TYPE_CHECKING:
    import pandas
    import polars

S = TypeVar("S", bound="Stream")
R = TypeVar("R")
# Largest plausible height or depth of a vehicle, m
HIGHEST = 1e6


def take_rows(record: R, which: slice | np.ndarray) -> R:
    """The same rows, by slice, mask or index array, of all arrays of a dataclass.

    The same rows of fields that are dataclasses of arrays are taken; None stays None.
    """
    columns: dict[str, Any] = vars(record)
    return type(record)(
        **{
            name: column[which] if isinstance(column, np.ndarray) else take_rows(column, which)
            for name, column in columns.items()
            if column is not None
        }
    )


@dataclass(frozen=True, repr=False)
class Stream:
    """Samples of one sensor.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    log_time_ns : ndarray of int64, shape (n,)
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray

    def __len__(self) -> int:
        return len(self.time_ns)

    def rows(self: S, which: slice | np.ndarray) -> S:
        """Rows by slice, mask or index array."""
        return take_rows(self, which)

    def __repr__(self) -> str:
        names = ", ".join(name for name, column in vars(self).items() if column is not None)
        span = (int(self.time_ns[-1]) - int(self.time_ns[0])) / 1e9 if len(self) else 0.0
        return f"<{type(self).__name__}: {len(self)} rows over {span:.3f} s; {names}>"

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame: a column for each component, with its unit in the name.

        Returns
        -------
        pandas.DataFrame
            Angles of attitude and position in degrees (``roll_deg``, ``latitude_deg``), standard
            deviations in place of covariances, all else in SI units.

        Raises
        ------
        SinstoolError
            pandas is not installed.
        """
        from sinstool.core.table import pandas_frame, table_of

        return pandas_frame(table_of(self))

    def to_polars(self) -> polars.DataFrame:
        """The same columns as :meth:`to_pandas`, as a polars DataFrame.

        Returns
        -------
        polars.DataFrame

        Raises
        ------
        SinstoolError
            polars is not installed.
        """
        from sinstool.core.table import polars_frame, table_of

        return polars_frame(table_of(self))

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The same columns as Arrow data, for ``pyarrow.table(imu)``, DuckDB or polars.

        Raises
        ------
        SinstoolError
            pyarrow is not installed.
        """
        from sinstool.core.table import arrow_stream, table_of

        return arrow_stream(table_of(self), requested_schema)


@dataclass(frozen=True, repr=False)
class Imu(Stream):
    """Inertial measurements in body axes (FRD).

    Attributes
    ----------
    gyro : ndarray, shape (n, 3)
        Angular rate omega_ib_b in rad/s, or its integral over the sample interval in rad.
    accel : ndarray, shape (n, 3)
        Specific force in m/s^2 (or its integral in m/s).
    orientation : ndarray, shape (n, 4), optional
        q_nb as the log gives it; NaN rows where it gives none.
    """

    gyro: np.ndarray
    accel: np.ndarray
    orientation: np.ndarray | None = None

    @classmethod
    def of(cls, time_ns: ArrayLike, gyro: ArrayLike, accel: ArrayLike) -> Imu:
        """Make a stream of arrays.

        Parameters
        ----------
        time_ns : array_like of int, shape (n,)
            In ascending order; ns.
        gyro : array_like, shape (n, 3)
            Angular rate in body axes (FRD), rad/s.
        accel : array_like, shape (n, 3)
            Specific force in body axes (FRD), m/s^2: -9.8 on z of a body that is level and at rest.

        Raises
        ------
        ConfigurationError
            If a shape is wrong, times are not ascending integers, or a value is not finite.

        Examples
        --------
        >>> import sinstool
        >>> sinstool.Imu.of([0, 10_000_000], [[0, 0, 0.1]] * 2, [[0, 0, -9.81]] * 2)
        <Imu: 2 rows over 0.010 s; time_ns, log_time_ns, gyro, accel>
        """
        from sinstool.core.errors import ConfigurationError

        times = np.array(time_ns)
        if times.ndim != 1 or not np.issubdtype(times.dtype, np.integer):
            raise ConfigurationError(
                "time_ns is not a column of integers", "give nanoseconds: np.round(1e9 * seconds)"
            )
        if not (np.diff(times) > 0).all():
            raise ConfigurationError(
                "time_ns is not in ascending order", "sort the samples, without repeated times"
            )
        columns = []
        for name, values in (("gyro", gyro), ("accel", accel)):
            try:
                column = np.array(values, np.float64)
            except (TypeError, ValueError):
                raise ConfigurationError(f"{name} is not made of numbers") from None
            if column.shape != (len(times), 3) or not np.isfinite(column).all():
                raise ConfigurationError(
                    f"{name} has the shape {column.shape}, or a value that is not finite",
                    f"give finite numbers in the shape ({len(times)}, 3)",
                )
            columns.append(column)
        times = times.astype(np.int64)
        return cls(times, times, *columns)


@dataclass(frozen=True, repr=False)
class Gnss(Stream):
    """Position fixes.

    Attributes
    ----------
    latitude, longitude : ndarray, shape (n,)
        Radians, WGS-84.
    height : ndarray, shape (n,)
        Metres above the ellipsoid.
    covariance_n : ndarray, shape (n, 3, 3)
        Position covariance in NED, m^2; zeros where the log gives none.
    covariance_type : ndarray of int, shape (n,)
        0 unknown, 1 approximated, 2 diagonal known, 3 known.
    status : ndarray of int, shape (n,)
        Negative: no fix.
    """

    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    covariance_n: np.ndarray
    covariance_type: np.ndarray
    status: np.ndarray

    @property
    def has_fix(self) -> np.ndarray:
        """Rows with a fix. Receivers without one may report exactly 0 deg, 0 deg instead."""
        finite = np.isfinite(self.latitude) & np.isfinite(self.longitude)
        return (self.status >= 0) & finite & ((self.latitude != 0.0) | (self.longitude != 0.0))

    @property
    def on_earth(self) -> np.ndarray:
        """Rows with a plausible position; the height may be missing."""
        level = (np.abs(self.latitude) <= 0.5 * np.pi) & (np.abs(self.longitude) <= 2.0 * np.pi)
        return np.asarray(level & ~(np.abs(self.height) >= HIGHEST))


@dataclass(frozen=True, repr=False)
class Velocity(Stream):
    """Velocity over ground.

    Attributes
    ----------
    velocity_n : ndarray, shape (n, 3)
        North, east, down in m/s.
    covariance_n : ndarray, shape (n, 3, 3)
        In NED, m^2/s^2; zeros where the log gives none.
    """

    velocity_n: np.ndarray
    covariance_n: np.ndarray


@dataclass(frozen=True, repr=False)
class Readings(Stream):
    """Numbers of a topic before their meaning has been determined.

    Attributes
    ----------
    values : ndarray, shape (n, k)
    """

    values: np.ndarray


@dataclass(frozen=True, repr=False)
class Baro(Stream):
    """Static pressure.

    Attributes
    ----------
    pressure : ndarray, shape (n,)
        Pa.
    variance : ndarray, shape (n,)
        Pa^2, 0 where unknown.
    """

    pressure: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, repr=False)
class BaroHeight(Stream):
    """Height that was computed from pressure before it was logged.

    Attributes
    ----------
    height : ndarray, shape (n,)
        m, up.
    """

    height: np.ndarray


@dataclass(frozen=True, repr=False)
class Magnetometer(Stream):
    """The magnetic field.

    Attributes
    ----------
    field : ndarray, shape (n, 3)
        In body axes (FRD), T.
    """

    field: np.ndarray


@dataclass(frozen=True, repr=False)
class GnssEpochs(Stream):
    """Output of a receiver at its epochs: position, velocity, or both.

    Attributes
    ----------
    latitude, longitude, height : ndarray, shape (n,)
        rad, rad, m above the ellipsoid; NaN where there is none (height alone: a 2-D fix).
    velocity_n : ndarray, shape (n, 3)
        m/s; NaN where there is none.
    sigma_position_n, sigma_velocity_n : ndarray, shape (n, 3)
        Standard deviations along north, east and down, m and m/s; NaN where the log gives none.
    """

    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity_n: np.ndarray
    sigma_position_n: np.ndarray
    sigma_velocity_n: np.ndarray

    @property
    def has_position(self) -> np.ndarray:
        """Rows with a position, shape (n,)."""
        return np.isfinite(self.latitude)

    @property
    def has_velocity(self) -> np.ndarray:
        """Rows with a horizontal velocity at least, shape (n,)."""
        return np.asarray(np.isfinite(self.velocity_n[:, :2]).all(axis=1))


@dataclass(frozen=True, repr=False)
class DerivedEpochs(GnssEpochs):
    """Epochs with velocities that are derived from their positions.

    Attributes
    ----------
    derived_s : ndarray, shape (n,)
        Half of the time over which a velocity is a mean, s: to third order the velocity equals the
        slope of a parabola that is fitted to the true positions at all times from so long before
        the fix to so long after it.
    """

    derived_s: np.ndarray


@dataclass(frozen=True, repr=False)
class Encoder(Stream):
    """Position of one joint.

    Attributes
    ----------
    position : ndarray, shape (n,)
        rad.
    """

    position: np.ndarray


@dataclass(frozen=True, repr=False)
class Solution(Stream):
    """Attitude at sample instants, and the measurements as used there.

    Attributes
    ----------
    q_nb : ndarray, shape (n, 4)
        Unit quaternions, body to navigation frame.
    omega_ib_b : ndarray, shape (n, 3)
        Angular rate in rad/s, corrected.
    specific_force_b : ndarray, shape (n, 3)
        m/s^2, corrected.
    position : ndarray, shape (n, 3), optional
        Latitude, longitude (rad) and ellipsoidal height (m), where a run computes them.
    velocity_n : ndarray, shape (n, 3), optional
        m/s.
    vertical : ndarray, shape (n, 3), optional
        State of the vertical channel: height (m), velocity up (m/s), and the correction that the
        damping subtracts from the accelerometer (m/s^2).
    covariance_position_n, covariance_velocity_n : ndarray, shape (n, 3, 3), optional
        m^2 and m^2/s^2, in NED.
    covariance_attitude_n : ndarray, shape (n, 3, 3), optional
        Covariance of the small rotation in NED from this attitude to the true one, rad^2.
    q_vb : ndarray, shape (n, 4), optional
        The mount: from body axes to those of the vehicle, both forward, right, down.
    """

    q_nb: np.ndarray
    omega_ib_b: np.ndarray
    specific_force_b: np.ndarray
    position: np.ndarray | None = None
    velocity_n: np.ndarray | None = None
    vertical: np.ndarray | None = None
    covariance_position_n: np.ndarray | None = None
    covariance_velocity_n: np.ndarray | None = None
    covariance_attitude_n: np.ndarray | None = None
    q_vb: np.ndarray | None = None


@dataclass(frozen=True, repr=False)
class Diagnostics(Stream):
    """A filter's own diagnostics at its measurements.

    Attributes
    ----------
    level : ndarray of int, shape (n,)
        0 where all is well, 1 where something was held back, 2 where it began anew.
    values : ndarray, shape (n, k)
        The filter that makes them defines their names.
    """

    level: np.ndarray
    values: np.ndarray


def concatenate(parts: Sequence[R]) -> R:
    """Join streams, or other dataclasses of arrays, of one kind in order.

    Parameters
    ----------
    parts : sequence of Stream
        At least one. Fields that are None stay so.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, column in vars(first).items()
        if column is not None
    }
    return type(first)(**columns)
