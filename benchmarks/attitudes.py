"""Attitudes of the same samples by other packages, and their errors against a reference."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from benchmarks.common import FloatArray, G
from sinstool.core.rotation import conjugate, log, multiply, tilt_and_heading
from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import q_nb_from_log, turn_body
from sinstool.io.readers.truth import at_times


@dataclass(frozen=True)
class Attitudes:
    """Attitude at instants: q_nb, and its covariance in NED where there is one."""

    time_ns: np.ndarray
    q_nb: FloatArray
    covariance_n: FloatArray | None = None

    def rows(self, which: np.ndarray) -> Attitudes:
        """Some of them, without covariances."""
        return Attitudes(self.time_ns[which], self.q_nb[which])

    def at(self, times: np.ndarray) -> FloatArray:
        """q_nb at instants within."""
        return at_times(self.time_ns, self.q_nb, times)


# --- other packages ---------------------------------------------------------------------------


def vqf(imu: Imu, offline: bool, field: FloatArray | None = None) -> Attitudes:
    """VQF or its offline variant, on samples at their median interval.

    Parameters
    ----------
    field : ndarray, shape (n, 3), optional
        Of a magnetometer at each sample, FRD; without it heading is free.
    """
    from vqf import VQF, offlineVQF

    gyro, accel = _flu(imu.gyro), _flu(imu.accel)
    name = "quat6D" if field is None else "quat9D"
    others = () if field is None else (_flu(field),)
    if offline:
        q = offlineVQF(gyro, accel, *(others or (None,)), _interval(imu))[name]
    else:
        q = VQF(_interval(imu)).updateBatch(gyro, accel, *others)[name]
    return Attitudes(imu.time_ns, q_nb_from_log(q, "flu"))


def imufusion(imu: Imu) -> Attitudes:
    """imufusion as its documentation sets it up, without a magnetometer."""
    import imufusion as fusion

    ahrs = fusion.Ahrs()
    ahrs.set_sample_period(_interval(imu))
    q = np.empty((len(imu), 4))
    for k, (rate, force) in enumerate(
        zip(_flu(imu.gyro) / DEGREE, _flu(imu.accel) / G, strict=True)
    ):
        ahrs.update_no_magnetometer(rate, force)
        q[k] = ahrs.get_quaternion()
    return Attitudes(imu.time_ns, q_nb_from_log(q, "flu"))


def _flu(vectors: FloatArray) -> FloatArray:
    return np.ascontiguousarray(turn_body(vectors, "flu"))


def _interval(imu: Imu) -> float:
    return float(np.median(np.diff(imu.time_ns))) / SECOND


# --- references -------------------------------------------------------------------------------


def read_reference(
    path: Path, world: str = "flu", settle_s: float = 0.0, late_s: float = 0.0
) -> Attitudes:
    """Rows of a CSV file with `time_s` and `qw,qx,qy,qz` that count: those that move, if it says.

    Parameters
    ----------
    world : {'flu', 'frd'}
        FLU in a world with z up, or FRD in NED.
    settle_s : float
        Left out at the begin.
    late_s : float
        By which the attitudes belong to a later time than their stamps say.
    """
    with path.open(newline="", encoding="utf-8") as stream:
        rows = [r for r in csv.DictReader(line for line in stream if line[0] != "#") if r["qw"]]
    times = np.array([int(Decimal(r["time_s"]) * SECOND) for r in rows])
    q = np.array([[float(r[c]) for c in ("qw", "qx", "qy", "qz")] for r in rows])
    good = np.isfinite(q).all(axis=1) & (times >= times[0] + settle_s * SECOND)
    if "movement" in rows[0]:
        good &= np.array([float(r["movement"]) > 0.0 for r in rows])
    if settle_s:
        good &= np.abs(q[:, 0]) < 1.0  # no attitude yet
    return Attitudes(times[good] + round(late_s * SECOND), q_nb_from_log(q[good], world))


# --- errors -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Errors:
    """Errors of an attitude at the instants of a reference.

    Attributes
    ----------
    tilt : ndarray, shape (n, 2)
        About north and east, rad.
    heading : ndarray, shape (n,)
        rad, -pi to pi.
    total : ndarray, shape (n,)
        Of the whole angle, rad.
    sigma : ndarray, shape (n, 3), or None
        Of tilt and heading.
    """

    tilt: FloatArray
    heading: FloatArray
    total: FloatArray
    sigma: FloatArray | None

    @property
    def inclination(self) -> FloatArray:
        """Angle between the verticals, rad."""
        return np.asarray(np.linalg.norm(self.tilt, axis=1))

    @property
    def heading_about_median(self) -> FloatArray:
        """What is left of the error of heading without its median, rad."""
        middle = np.angle(np.mean(np.exp(1j * self.heading)))
        off = np.angle(np.exp(1j * (self.heading - middle)))
        return np.asarray(off - np.median(off))

    def tilt_over_sigma(self) -> FloatArray | None:
        """Both axes' errors of tilt over what the attitude says of them."""
        return None if self.sigma is None else np.abs(self.tilt) / self.sigma[:, :2]


def errors(found: Attitudes, true: Attitudes) -> Errors:
    """Errors at those instants of a reference that lie within what was found."""
    within = (true.time_ns >= found.time_ns[0]) & (true.time_ns <= found.time_ns[-1])
    times = true.time_ns[within]
    off = multiply(true.q_nb[within], conjugate(found.at(times)))
    sigma = None
    if found.covariance_n is not None:
        row = np.searchsorted(found.time_ns, times)
        sigma = np.sqrt(np.einsum("nii->ni", found.covariance_n[row]))
    return Errors(*tilt_and_heading(off), np.linalg.norm(log(off), axis=1), sigma)


def rms_deg(angles: FloatArray) -> float:
    """Root mean square of angles in rad, deg."""
    return float(np.sqrt(np.mean(np.square(angles))) / DEGREE)


def shares(over_sigma: FloatArray, limits: tuple[float, ...]) -> list[float]:
    """Of errors over their sigmas, those within limits."""
    return [float(np.mean(np.abs(over_sigma) < limit)) for limit in limits]
