"""Fixed-interval smoothing of a filter's outputs: at each IMU update, over a whole run.

The errors of rows are those of :mod:`~sinstool.methods.ins_gnss.smoothed_epochs`.
Between two epochs the error goes from ``d[k]`` to ``d[k+1] + dx[k+1]``, which are both known, and
the navigation has no step there: its step at the next epoch is the filter's own correction, which
takes ``dx`` off. In between, errors of velocity, attitude and sensors are taken linear in time and
those of position cubic with the errors of velocity as slopes, so that the smoothed velocity is
the derivative of the smoothed position. (A damped height does not integrate its velocity: its
error is linear.) Over a second this differs from the exact smoother by the bend of the errors:
some mm/s where specific force changes by several m/s^2 with a tilt corrected by a milliradian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import displaced
from sinstool.core.rotation import wrapped
from sinstool.methods.ins_gnss.between_rows import (
    ALONE,
    BEFORE,
    BETWEEN,
    covariances_between,
    errors_between,
    take_off,
    turn,
)
from sinstool.methods.ins_gnss.results import FilterBlock, StoredEpochs, UpdateColumns
from sinstool.methods.ins_gnss.rts import CORNER, Packed, pack
from sinstool.methods.ins_gnss.smoothed_epochs import OF_ROWS, SmoothedEpochs, smooth_columns
from sinstool.methods.ins_gnss.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    ACCEL_SCALE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    FilterKind,
)
from sinstool.methods.ins_gnss.storage import DEFAULT_LIMIT, Storage
from sinstool.methods.strapdown.navigation import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    Q_W,
    Q_Z,
    V_DOWN,
    V_NORTH,
)

# Of an update, what smoothing replaces everywhere but where nothing is known beyond the filter.
COVARIANCES = ("covariance_position_n", "covariance_velocity_n", "covariance_attitude_n")


def corrected_navigation(nav: FloatArray, error: FloatArray) -> FloatArray:
    """Navigations less the errors that were estimated in them.

    Parameters
    ----------
    nav : ndarray, shape (n, 10)
        As :func:`sinstool.methods.strapdown.navigation.initial_state` has it.
    error : ndarray, shape (n, states)
        Of the filter's states.
    """
    out = nav.copy()
    lat, lon, height = _moved(nav[:, LATITUDE], nav[:, LONGITUDE], nav[:, HEIGHT], error)
    out[:, LATITUDE], out[:, LONGITUDE], out[:, HEIGHT] = lat, lon, height
    out[:, V_NORTH : V_DOWN + 1] -= error[:, VELOCITY : VELOCITY + 3]
    out[:, Q_W : Q_Z + 1] = _turned(nav[:, Q_W : Q_Z + 1], error)
    return out


def _moved(
    latitude: FloatArray, longitude: FloatArray, height: FloatArray, error: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions less their errors."""
    north, east, down = error[:, POSITION], error[:, POSITION + 1], error[:, POSITION + 2]
    lat, lon = displaced(latitude, longitude, height, -north, -east)
    return lat, wrapped(lon), height + down


def _turned(q_nb: FloatArray, error: FloatArray) -> FloatArray:
    """Attitudes turned by psi."""
    out = np.empty(q_nb.shape)
    turn(error, q_nb, out)
    return out


def smooth_updates(
    updates: UpdateColumns, first_update: int, smoothed: SmoothedEpochs
) -> UpdateColumns:
    """Smooth the outputs of some consecutive IMU updates.

    Parameters
    ----------
    updates : UpdateColumns
        As the filter gave them.
    first_update : int
        Number, from the start of the run, of the first of them.
    smoothed : SmoothedEpochs
        Of the whole run.

    Returns
    -------
    UpdateColumns
        After the last row, and between a segment's last row and the next segment, nothing is
        known beyond the filter: there they are its own.
    """
    kind, rows = smoothed.kind, len(smoothed)
    number = first_update + np.arange(len(updates))
    # Span j lies between rows j-1 and j; an update with a measurement begins the next one.
    span = np.searchsorted(smoothed.update, number, side="right")
    left, right = np.maximum(span - 1, 0), np.minimum(span, rows - 1)
    begin = np.where(span > 0, smoothed.time_ns[left], smoothed.start_ns)
    length: FloatArray = (smoothed.time_ns[right] - begin).astype(np.float64) * 1e-9
    length[length <= 0.0] = 1.0
    s: FloatArray = np.clip((updates.time_ns - begin) * 1e-9 / length, 0.0, 1.0)
    place = np.where(span > 0, BETWEEN, BEFORE)
    place[(span == rows) | smoothed.starts[right]] = ALONE
    error = np.empty((len(number), kind.size))
    errors_between(
        smoothed.error,
        smoothed.error_before,
        smoothed.first_error,
        left,
        right,
        place,
        s,
        length,
        kind.network,
        error,
    )
    lat, lon, height = _moved(updates.latitude, updates.longitude, updates.height, error)
    velocity, rate, force = (
        np.array(column)
        for column in (updates.velocity_n, updates.omega_ib_b, updates.specific_force_b)
    )
    take_off(
        error,
        kind.first(ACCEL_SCALE),
        kind.first(ACCEL_AXES),
        kind.first(ACCEL_BIAS),
        kind.first(GYRO_BIAS),
        velocity,
        rate,
        force,
    )

    # Of the large matrices in the file, only those of a few rows, and of these the corner.
    lowest = int(left.min())
    corners = np.array(smoothed.covariance[lowest : int(right.max()) + 1, :CORNER, :CORNER])

    covariances = [getattr(updates, name).copy() for name in COVARIANCES]
    covariances_between(
        corners, smoothed.first_covariance, left - lowest, right - lowest, place, s, *covariances
    )
    return replace(
        updates,
        latitude=lat,
        longitude=lon,
        height=height,
        velocity_n=velocity,
        q_nb=_turned(updates.q_nb, error),
        omega_ib_b=rate,
        specific_force_b=force,
        **dict(zip(COVARIANCES, covariances, strict=True)),
    )


class Smoother:
    """Collects a filter's blocks, and smooths them once all are there.

    Parameters
    ----------
    kind : FilterKind
        Of the filter, which has to give outputs and to store.
    limit : int, optional
        Bytes kept in memory; more goes to a temporary file.
    outputs : bool, optional
        Keep the filter's outputs, too, for :meth:`blocks`.

    Notes
    -----
    A context manager: leaving it removes the file. A row of 29 states takes 10 kB, an IMU
    update 144 bytes; what is in memory besides, once `limit` is reached, does not grow with the
    log but for 17 bytes per row.
    """

    def __init__(
        self, kind: FilterKind, limit: int = DEFAULT_LIMIT, *, outputs: bool = True
    ) -> None:
        self._kind = kind
        self._outputs = outputs
        self._storage = Storage(limit)
        self._empty = True
        self._pushed = 0
        # Numbers and covariances of updates: behind the last row so far, and where they stay
        self._open: list[_Own] = []
        self._alone: list[_Own] = []

    def push(self, block: FilterBlock) -> None:
        """Take the filter's next block.

        Raises
        ------
        ValueError
            If it lacks the outputs or what a smoother needs.
        """
        if block.stored is None or (self._outputs and block.updates is None):
            raise ValueError("Expected a filter that gives outputs and stores epochs.")
        for name in OF_ROWS:
            self._storage.append(name, getattr(block.stored, name))
        for name, values in pack(block.stored, self._kind)._asdict().items():
            self._storage.append(name, values)
        if self._outputs:
            assert block.updates is not None
            for name, values in vars(block.updates).items():
                if name not in COVARIANCES:
                    self._storage.append(f"UpdateColumns.{name}", values)
            self._keep_own(block.updates, block.stored)
        self._empty = False

    def _keep_own(self, updates: UpdateColumns, stored: StoredEpochs) -> None:
        """Keep covariances of the updates between which and the next row nothing is smoothed."""
        own = _Own.of(updates, self._pushed)
        self._pushed += len(updates)
        if not len(stored.update):
            self._open.append(own)
            return
        if stored.restart[0]:
            self._alone += self._open
        row = np.searchsorted(stored.update, own.number, side="right")
        last = row == len(stored.update)
        restarted = ~last & np.append(stored.restart, False)[row]
        self._alone.append(own.rows(restarted))
        self._open = [own.rows(last)]

    def _updates(self) -> dict[str, Any]:
        names = [f.name for f in fields(UpdateColumns) if f.name not in COVARIANCES]
        return {name: self._storage.array(f"UpdateColumns.{name}") for name in names}

    def epochs(self) -> SmoothedEpochs:
        """Smooth; only once, since the stored epochs are overwritten.

        Returns
        -------
        SmoothedEpochs
            Valid until the storage is closed.

        Raises
        ------
        ValueError
            If there is nothing to smooth.
        """
        if self._empty:
            raise ValueError("There is nothing to smooth: the filter gave no block.")
        columns = {name: self._storage.array(name) for name in OF_ROWS}
        if not len(columns["time_ns"]):
            raise ValueError("There is nothing to smooth: the filter stored no row.")
        packed = Packed(*(self._storage.array(name) for name in Packed._fields))
        first = int(self._updates()["time_ns"][0]) if self._outputs else None
        return smooth_columns(columns, packed, self._kind, first, self._storage.release)

    def navigation(self, smoothed: SmoothedEpochs) -> FloatArray:
        """Smoothed navigations at the rows, of a filter with feedback.

        Parameters
        ----------
        smoothed : SmoothedEpochs
            Of :meth:`epochs`.

        Returns
        -------
        ndarray, shape (m, 10)
            As :func:`sinstool.methods.strapdown.navigation.initial_state` has it.
        """
        nav = np.asarray(self._storage.array("nav"))
        return corrected_navigation(nav, smoothed.error)

    def covariance(self, smoothed: SmoothedEpochs, states: IntArray) -> FloatArray:
        """Smoothed covariances of some states at the rows.

        Parameters
        ----------
        smoothed : SmoothedEpochs
            Of :meth:`epochs`.
        states : ndarray of int, shape (k,)
            Of position, velocity and attitude.

        Returns
        -------
        ndarray, shape (m, k, k)
        """
        out = np.array(smoothed.covariance[:, states[:, None], states[None, :]])
        self._storage.release()
        return out

    def blocks(self, smoothed: SmoothedEpochs, rows: int = 16384) -> Iterator[UpdateColumns]:
        """Smoothed outputs in their order.

        Parameters
        ----------
        smoothed : SmoothedEpochs
            Of :meth:`epochs`.
        rows : int, optional
            Updates of a block.
        """
        columns = self._updates()
        own = [*self._alone, *self._open]
        for first in range(0, len(columns["time_ns"]), rows):
            part = {name: np.array(c[first : first + rows]) for name, c in columns.items()}
            for name in COVARIANCES:
                part[name] = np.full((len(part["time_ns"]), 3, 3), np.nan)
            for stored in own:
                begin, end = np.searchsorted(stored.number, (first, first + rows))
                if begin < end:
                    for name, values in zip(COVARIANCES, stored.covariances, strict=True):
                        part[name][stored.number[begin:end] - first] = values[begin:end]
            yield smooth_updates(UpdateColumns(**part), first, smoothed)
            self._storage.release()

    def close(self) -> None:
        """Remove the temporary file."""
        self._storage.close()

    def __enter__(self) -> Smoother:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True)
class _Own:
    """The filter's covariances at some updates, by their numbers from the start of the run."""

    number: IntArray
    covariances: tuple[FloatArray, ...]

    @classmethod
    def of(cls, updates: UpdateColumns, first: int) -> _Own:
        number = first + np.arange(len(updates))
        return cls(number, tuple(getattr(updates, name) for name in COVARIANCES))

    def rows(self, at: np.ndarray) -> _Own:
        return _Own(self.number[at], tuple(values[at] for values in self.covariances))
