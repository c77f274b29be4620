"""Evidence in the data for units: gyro in deg/s, accelerometer in g."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core import rotation
from sinstool.core.order_statistics import median
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.alignment.still import UNITS, WINDOW_NS, StillSpan, Windows

# Readings of the gyro in rad/s and deg/s are distinguished if the tilts that they predict differ by
# this.
TELLING_RAD = 0.1
TELLING_WINDOWS = 10
TELLING_SHARE = 0.6
# Number of windows in a piece over which velocity changes little compared with gravity times its
# length.
PIECE, SHORTEST_PIECE = 40, 20
# Limits for the mean specific force of pieces, rotated by the rates: with the wrong unit its size
# differs from gravity by more than this share, and by so many times the difference with the right
# unit, which is below a share. With a saturated gyro, or in a rocket, neither unit gives gravity.
LEAST_MISFIT = 0.06
WORSE, KEPT = 3.0, 0.15
# Both units are possible if their misfits differ by less than this, which a bias of the
# accelerometer explains.
ALIKE = 1.5
# If rates in rad/s are converted from deg/s by mistake, gravity turns 57 times as far as they say:
# the limit is the geometric mean.
RADIANS_SCALE = 7.5
# RMS of half-second means of rates of a vehicle that turns about. If such rates are in deg/s, the
# vehicle hardly turns.
LIVELY_RAD_S = 0.7
# RMS of half-second means, rad/s, of a spin that few vehicles have: 290 deg/s.
SPINNING_RAD_S = 5.0
# Usual range of the mean specific force of half a second, m/s^2.
GRAVITY_SIZES = 7.0, 13.0
# Number of the most even windows whose mean shows a bias, if the vehicle rests in them.
QUIETEST = 4
# No IMU measures 100 rad/s (5 700 deg/s); many reach 100 deg/s.
MAX_RATE_RAD_S = 100.0


@dataclass(frozen=True)
class UnitEvidence:
    """Evidence on the unit of the rates from the rotation of gravity in the body.

    Attributes
    ----------
    scale : float
        Turn of gravity over that of rates in deg/s, by least squares: 1 for deg/s, up to 57.3 for
        rad/s, 0 if nothing tilts or thrust hides it.
    sigma : float
        Its standard deviation; infinite without evidence.
    windows : int
        Pairs of windows for which both readings predict clearly different directions.
    share : float
        Share of these that deg/s explains better.
    misfit_radians, misfit_degrees : float
        Difference of the mean specific force of twenty seconds, in axes that do not turn, from
        gravity, as a share of gravity, RMS over all pieces, with rates in rad/s and in deg/s;
        NaN if the log is too short.
    rate : float
        RMS of the windows' mean rates as read, rad/s.
    """

    scale: float = 0.0
    sigma: float = np.inf
    windows: int = 0
    share: float = 0.0
    misfit_radians: float = np.nan
    misfit_degrees: float = np.nan
    rate: float = np.inf

    @property
    def surely_degrees(self) -> bool:
        """Whether rates that look like deg/s are too large for rad/s of most vehicles, too.

        A multicopter's thrust stays on its own axis whatever its rates, so that all that is left to
        judge by are small accelerations.
        """
        return self.rate > LIVELY_RAD_S


def unit_evidence(windows: Windows) -> UnitEvidence:
    """Compare the rotation of gravity with the gyro, in rad/s and in deg/s.

    From one half second to the next the direction of the mean specific force turns as the gyro
    measures, if the vehicle does not accelerate. Even if it does, for minutes as a circling
    aircraft, its velocity changes little in twenty seconds: the mean specific force, rotated sample
    by sample with the right rates, is then gravity.

    Parameters
    ----------
    windows : Windows
        With rates read as rad/s.
    """
    follows = np.diff(windows.start_ns) == WINDOW_NS
    direction, force = _direction(windows.accel), _direction(windows.force)
    nonzero = np.logical_and.reduce([direction.any(axis=1), np.abs(force).max(axis=(0, 2)) > 0.0])
    usable = follows & nonzero[:-1] & nonzero[1:]
    if not usable.any():
        return UnitEvidence()
    turn = 0.5 * (windows.gyro[:-1] + windows.gyro[1:])[usable] * (WINDOW_NS / 1e9)
    before, after = direction[:-1][usable], direction[1:][usable]
    as_degrees = _turned(before, turn * DEGREE)

    said, done = as_degrees - before, after - before
    power = float(np.sum(said**2))
    scale, sigma = 0.0, np.inf
    if power > 0.0:
        scale = float(np.sum(said * done)) / power
        # a direction moves in two dimensions
        sigma = float(np.sqrt(np.sum((done - scale * said) ** 2) / (2 * len(said)) / power))

    telling = np.linalg.norm(_turned(before, turn) - as_degrees, axis=1) > TELLING_RAD
    # By every sample, as a body may turn far within a window
    back = rotation.conjugate(windows.turn[:, :-1][:, usable])
    left = rotation.rotate(back, force[:, :-1][:, usable]) - force[:, 1:][:, usable]
    by_radians, by_degrees = np.linalg.norm(left, axis=2)
    better = by_degrees < by_radians
    count = int(np.count_nonzero(telling))
    share = float(np.mean(better[telling])) if count else 0.0
    rate = float(np.sqrt(np.mean(np.sum(windows.gyro**2, axis=1))))
    radians, degrees = _misfits(windows)
    return UnitEvidence(scale, sigma, count, share, radians, degrees, rate)


def _direction(force: np.ndarray) -> np.ndarray:
    """Unit vectors; 0 where there is no force."""
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    return force / np.where(size > 0.0, size, 1.0)


def _misfits(windows: Windows) -> list[float]:
    """How far the size of the mean specific force of pieces of a log is from that of gravity.

    Returns
    -------
    list of float
        Share of gravity, RMS of the pieces, for rates in rad/s and in deg/s; NaN where no piece is
        long enough. Of that with the rates as they are, less those of the quietest windows, less
        their mean, and less that across the specific force: without a bias, with one that a rest
        shows, with one, and with one of a vehicle that turns.
    """
    length = min(PIECE, len(windows))
    first = np.arange(0, len(windows) - length + 1, max(length, 1))
    last = first + length - 1
    first = first[windows.start_ns[last] - windows.start_ns[first] == (length - 1) * WINDOW_NS]
    if length < SHORTEST_PIECE or not len(first):
        return [np.nan, np.nan]
    axis = windows.accel.mean(axis=0)
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    mean = windows.gyro.mean(axis=0)
    usual = float(median(np.linalg.norm(windows.accel, axis=1)))
    gravity = usual if accel_looks_like_g(usual) else STANDARD_GRAVITY
    rows = first[:, None] + np.arange(length)
    quiet = np.argsort(windows.gyro_std)[: max(QUIETEST, len(windows) // 50)]
    rest = windows.gyro[quiet].mean(axis=0)
    biases = np.array([np.zeros(3), rest, mean, mean - axis * (mean @ axis)])
    # By unit and bias: what is computed for all of them at once is called for once
    back = rotation.exp(np.array(UNITS)[:, None, None] * biases * (-WINDOW_NS / 1e9))
    turns = rotation.multiply(windows.turn[:, None, rows], back[:, :, None, None])
    forces = np.broadcast_to(windows.force[:, None, rows], (*turns.shape[:-1], 3))
    q = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (2, len(biases), len(first), 4))
    force = np.zeros((2, len(biases), len(first), 3))
    for k in range(length):
        force += rotation.rotate(q, forces[..., k, :]) / length
        q = rotation.multiply(q, turns[..., k, :])
    size = np.linalg.norm(force, axis=-1)
    misfits = np.sqrt(np.mean((size / gravity - 1.0) ** 2, axis=-1))
    return [float(least) for least in misfits.min(axis=-1)]


def turns_like_degrees(evidence: UnitEvidence) -> bool:
    """Whether gravity turns as rates in deg/s say, or rates in rad/s do not explain gravity.

    The scale alone would be wrong in a spin too fast for the windows; both tests would be in a
    vehicle that circles or leans in coordination, whose specific force stays on its own axis: there
    rates in rad/s must also fail to explain gravity although they turn far, or explain it hardly
    worse.
    """
    e = evidence
    if e.windows < TELLING_WINDOWS:
        return False
    if e.misfit_radians > max(LEAST_MISFIT, WORSE * e.misfit_degrees):
        return e.misfit_degrees < KEPT
    far = e.windows > PIECE
    alike = e.misfit_radians < min(LEAST_MISFIT, ALIKE * e.misfit_degrees)
    if e.misfit_radians < e.misfit_degrees or alike or (far and e.misfit_radians < LEAST_MISFIT):
        return False
    return (
        e.share >= TELLING_SHARE
        and e.scale > 2.0 * e.sigma
        and e.scale + 3.0 * e.sigma < RADIANS_SCALE
    )


def may_spin_fast(evidence: UnitEvidence) -> bool:
    """Whether rates in rad/s would be those of a fast spin, and gravity shows nothing of it.

    A spin about the vertical leaves gravity where it is in the body, however fast it is.
    """
    e = evidence
    return SPINNING_RAD_S < e.rate < np.inf and not e.misfit_degrees > WORSE * e.misfit_radians


def gyro_looks_like_degrees(evidence: UnitEvidence, gyro_max: np.ndarray) -> bool:
    """Whether rates read as rad/s must be deg/s.

    Parameters
    ----------
    gyro_max : ndarray, shape (3,)
        Largest magnitudes.
    """
    surely_radians = evidence.scale - 3.0 * evidence.sigma > RADIANS_SCALE
    too_fast = bool(gyro_max.max() > MAX_RATE_RAD_S)
    return turns_like_degrees(evidence) or (too_fast and not surely_radians)


def degrees_look_like_radians(evidence: UnitEvidence) -> bool:
    """Whether rates that were converted from deg/s must have been rad/s already.

    Parameters
    ----------
    evidence : UnitEvidence
        Of the converted rates: gravity then turns up to 57 times what they say in deg/s where the
        conversion is right, and 57 times that where it is not.
    """
    e = evidence
    return e.scale > 5.0 * e.sigma and e.scale - 3.0 * e.sigma > RADIANS_SCALE / DEGREE


def _turned(direction: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A direction fixed in space, seen from a body that has turned: Rodrigues by -turn."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    axis = turn / np.where(angle > 0, angle, 1.0)
    along = np.einsum("ij,ij->i", axis, direction)[:, None] * axis
    return along + (direction - along) * np.cos(angle) - np.cross(axis, direction) * np.sin(angle)


def accel_looks_like_g(specific_force_median: float) -> bool:
    """Whether a specific force read as m/s^2 must be in g: its usual size is about one."""
    return 0.8 < specific_force_median < 1.25


def force_at_rest(lead_in: StillSpan | None, spans: Sequence[StillSpan]) -> float:
    """Size of the specific force, m/s^2, in the rest at the beginning, or else in the longest one.

    NaN without a rest.
    """
    rest = lead_in or max(spans, key=lambda span: span.duration_s, default=None)
    return np.nan if rest is None else float(np.linalg.norm(rest.accel))


def rests_under_gravity(lead_in: StillSpan | None, spans: Sequence[StillSpan]) -> bool:
    """Whether the rest at the beginning, or else the longest one, feels gravity in m/s^2.

    Then that is the unit, however little a log feels that mostly falls, as a rocket's does, or how
    much one feels that burns most of the time.
    """
    low, high = GRAVITY_SIZES
    return low < force_at_rest(lead_in, spans) < high
