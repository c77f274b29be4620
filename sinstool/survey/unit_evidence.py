"""Evidence in the data for units: gyro in deg/s, accelerometer in g."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import FloatArray
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.still import WINDOW_NS, Windows

# Two readings of the gyro are distinguished where they predict tilts that differ by this much.
TELLING_RAD = 0.1
TELLING_WINDOWS = 10
TELLING_SHARE = 0.6
# Directions within some six degrees of their mean, or eighteen in rough air; sizes that vary by
# more than a road makes them.
HELD = 0.99
NEARLY_HELD = 0.95
VARIES = 0.05
# Vehicles whose specific force is held so stay upright: within a minute they lean by less than the
# first angle from how they mostly stand, and what rates tip beyond the second would have rolled
# over. Sizes that vary by more than AEROBATIC are of vehicles that do.
PIECE, SHORTEST_PIECE = 120, 20  # windows
UPRIGHT = 60.0 * DEGREE
OVER = 75.0 * DEGREE
AEROBATIC = 0.2
# Lift that holds a leaning vehicle up is 1/cos times gravity: its size varies by no less than this
# share of what the largest lean adds.
LEAN_FELT = 0.05
# Gravity turns 57 times what rates in rad/s, taken for deg/s, say: this lies half-way in ratio.
RADIANS_SCALE = 7.5
# No IMU measures 100 rad/s (5 700 deg/s); many reach 100 deg/s.
MAX_RATE_RAD_S = 100.0


@dataclass(frozen=True)
class UnitEvidence:
    """Evidence on the unit of the rates from the rotation of gravity in the body.

    Attributes
    ----------
    scale : float
        How far gravity turned for each unit of what the rates say in deg/s, by least squares:
        1 for deg/s, up to 57.3 for rad/s, 0 where nothing tilts or thrust hides it.
    sigma : float
        Its standard deviation; infinite where nothing is known.
    windows : int
        Telling pairs of windows: the two readings predict clearly different directions.
    share : float
        Of those, the ones that deg/s explains better.
    tipped_rad : float
        Where the specific force stays on one axis of the body all the same: how far rates in
        rad/s tip this axis within a minute while those in deg/s leave it upright; 0 elsewhere.
    """

    scale: float = 0.0
    sigma: float = np.inf
    windows: int = 0
    share: float = 0.0
    tipped_rad: float = 0.0


def unit_evidence(windows: Windows) -> UnitEvidence:
    """Compare the rotation of gravity with the gyro, in rad/s and in deg/s.

    In windows half a second apart the direction of the mean specific force turns by what the
    gyro measured, as far as the vehicle does not accelerate. Where it stays on one axis of the
    body, be it that of a car or of lift, what tells is whether the vehicle would stay upright.

    Parameters
    ----------
    windows : Windows
        With rates read as rad/s.
    """
    size = np.linalg.norm(windows.accel, axis=1)
    nonzero = size > 0
    usable = (np.diff(windows.start_ns) == WINDOW_NS) & nonzero[:-1] & nonzero[1:]
    if not usable.any():
        return UnitEvidence()
    direction = windows.accel / np.where(size > 0, size, 1.0)[:, None]
    turn = 0.5 * (windows.gyro[:-1] + windows.gyro[1:])[usable] * (WINDOW_NS / 1e9)
    before, after = direction[:-1][usable], direction[1:][usable]
    as_radians = _turned(before, turn)
    as_degrees = _turned(before, turn * DEGREE)

    said, done = as_degrees - before, after - before
    power = float(np.sum(said**2))
    scale, sigma = 0.0, np.inf
    if power > 0.0:
        scale = float(np.sum(said * done)) / power
        # a direction moves in two dimensions
        sigma = float(np.sqrt(np.sum((done - scale * said) ** 2) / (2 * len(said)) / power))

    telling = np.linalg.norm(as_radians - as_degrees, axis=1) > TELLING_RAD
    better = np.linalg.norm(after - as_degrees, axis=1) < np.linalg.norm(after - as_radians, axis=1)
    count = int(np.count_nonzero(telling))
    tipped = 0.0
    axis = before[telling].mean(axis=0) if count else np.zeros(3)
    held = float(np.linalg.norm(axis))
    if held > NEARLY_HELD:
        # An aircraft that turns in coordination, a rotor: what turns is the lift. A car: nothing.
        axis /= held
        varies = float(np.std(size[:-1][usable]) / np.median(size[:-1][usable]))
        lean = _tipped(windows, axis, 1.0)
        if lean > OVER and varies < AEROBATIC and _tipped(windows, axis, DEGREE) < UPRIGHT:
            tipped = lean
        elif held > HELD and (
            varies > VARIES if lean > UPRIGHT else varies > LEAN_FELT * (1.0 / np.cos(lean) - 1.0)
        ):
            return UnitEvidence()
    share = float(np.mean(better[telling])) if count else 0.0
    return UnitEvidence(scale, sigma, count, share, tipped)


def _tipped(windows: Windows, axis: FloatArray, unit: float) -> float:
    """How far an axis of the body leans from its mean direction within a minute.

    Parameters
    ----------
    axis : ndarray, shape (3,)
        In the body, of length 1.
    unit : float
        Of the rates, rad/s.

    Returns
    -------
    float
        rad: the most in each minute, and of minutes the upper quartile, as a flip or a rest is no
        habit. By rates less their mean across the axis, which is a bias. Infinite where no part
        of the log is long enough.
    """
    length = min(PIECE, len(windows))
    first = np.arange(0, len(windows) - length + 1, max(length, 1))
    whole = windows.start_ns[first + length - 1] - windows.start_ns[first] == (
        (length - 1) * WINDOW_NS
    )
    first = first[whole]
    if length < SHORTEST_PIECE or not len(first):
        return float(np.inf)
    across = windows.gyro - np.outer(windows.gyro @ axis, axis)
    rates = unit * (windows.gyro - across.mean(axis=0))
    turns = rotation.exp(rates[first[:, None] + np.arange(length)] * (WINDOW_NS / 1e9))
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(first), 1))
    seen = np.empty((length, len(first), 3))
    for k in range(length):
        q = rotation.multiply(q, turns[:, k])
        seen[k] = rotation.rotate(q, np.broadcast_to(axis, (len(first), 3)))
    mean = seen.mean(axis=0)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    cosine = np.einsum("kij,ij->ki", seen, mean).min(axis=0)
    return float(np.quantile(np.arccos(np.clip(cosine, -1.0, 1.0)), 0.75))


def turns_like_degrees(evidence: UnitEvidence) -> bool:
    """Whether gravity turns in the body as rates in deg/s say, or the body rolls over by rad/s.

    The scale alone would be fooled by a spin that is faster than the windows resolve; the share
    alone by a multirotor, whose specific force stays on its own z axis however it tilts.
    """
    e = evidence
    return e.tipped_rad > 0.0 or (
        e.windows >= TELLING_WINDOWS
        and e.share >= TELLING_SHARE
        and e.scale > 2.0 * e.sigma
        and e.scale + 3.0 * e.sigma < RADIANS_SCALE
    )


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
