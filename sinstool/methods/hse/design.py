"""Predicted accuracy of a calibration of heading-sensitive error.

White noise of the gyro (angular random walk) is all that is assumed; the covariance is that of
the fits in :mod:`sinstool.methods.hse.fit` and :mod:`sinstool.methods.hse.axial`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import ConfigurationError
from sinstool.core.units import ARCSEC
from sinstool.methods.hse.fit import MIN_RATE_SPAN
from sinstool.methods.hse.model import DISTINCT_LEAN, MIN_C23
from sinstool.methods.hse.run import MAX_LATITUDE
from sinstool.methods.hse.status import SIGNIFICANT

# A lean of the axis that is easy to set up and small enough for the linear model
GOOD_LEAN = 8e-3
FEW_TURNS = 10
# Far beyond any table, campaign and gyro: numbers that only a slip of the keyboard makes
MAX_RATE = np.radians(10_000.0)
MAX_REPEATS = 1000
MAX_RANDOM_WALK = np.radians(100.0) / 60.0


@dataclass(frozen=True)
class Design:
    """Runs to be made.

    Attributes
    ----------
    rates : tuple of float
        Rates of the table, signed, rad/s.
    repeats : int
        Runs at each rate and position.
    duration_s : float
        Duration of each run, s; its whole turns are used.
    C23 : tuple of float
        Lean of the axis to the east at each position: the east component of its unit vector.
    angle_random_walk : float
        Angular random walk of the gyros, rad/sqrt(s).
    latitude : float
        rad.
    """

    rates: tuple[float, ...]
    repeats: int
    duration_s: float
    C23: tuple[float, ...]
    angle_random_walk: float
    latitude: float


@dataclass(frozen=True)
class Prediction:
    """Expected accuracy of a design.

    Attributes
    ----------
    total_s : float
        Turning time, s.
    sigma_run : tuple of float
        Of one heading at each rate, rad.
    sigma_K : float
        Of the slope of heading against rate at one position, s.
    sigma_lambda2_heading : float or None
        rad; None where the axis leans too little.
    sigma_lambda2_joint, sigma_delay : float or None
        rad and s; None where the positions lean alike.
    sigma_lambda2_axial : float
        rad, with the gyro's bias estimated.
    order : tuple of float
        Rates in the order to run them at each position: up and down in turn, so that a drift
        with time is not taken for a slope.
    """

    n_runs: int
    total_s: float
    sigma_run: tuple[float, ...]
    sigma_K: float
    sigma_lambda2_heading: float | None
    sigma_lambda2_joint: float | None
    sigma_delay: float | None
    sigma_lambda2_axial: float
    order: tuple[float, ...]
    advice: tuple[str, ...]


def run_order(rates: ArrayLike, repeats: int) -> tuple[float, ...]:
    """Rates in the order to run them: ascending and descending in turn."""
    up = sorted(float(r) for r in np.asarray(rates, dtype=np.float64))
    return tuple(r for k in range(repeats) for r in (up if k % 2 == 0 else up[::-1]))


def _validate(design: Design) -> None:
    rates = np.asarray(design.rates, dtype=np.float64)
    problems = {
        "no rate is given": len(rates) == 0,
        "a rate is beyond 10000 deg/s": bool(np.any(np.abs(rates) > MAX_RATE)),
        "there are no repeats": design.repeats < 1,
        f"there are more than {MAX_REPEATS} repeats": design.repeats > MAX_REPEATS,
        "no position is given": len(design.C23) == 0,
        "the axis leans by more than 1 rad": any(abs(lean) > 1.0 for lean in design.C23),
        "the random walk of the gyro is not positive": not design.angle_random_walk > 0.0,
        "the random walk of the gyro is beyond 100 deg/sqrt(h)": (
            design.angle_random_walk > MAX_RANDOM_WALK
        ),
        "the latitude is beyond 85 deg": abs(design.latitude) > MAX_LATITUDE,
    }
    for message, wrong in problems.items():
        if wrong:
            raise ConfigurationError(message, "see `sinstool calibrate-hse --help`")
    for rate in rates:
        if abs(rate) * design.duration_s < 2.0 * np.pi * (1.0 - 1e-9):
            raise ConfigurationError(
                f"{design.duration_s:g} s at {np.degrees(rate):g} deg/s is less than a whole turn",
                "make the runs longer",
            )
    if np.ptp(rates) < MIN_RATE_SPAN:
        raise ConfigurationError(
            "the rates differ by less than 10 deg/s, too little to determine a slope",
            "take 20, 40 and 60 deg/s, preferably in both directions",
        )


def predict(design: Design, advise: bool = True) -> Prediction:
    """Predict the standard deviations that a design leads to.

    Parameters
    ----------
    advise : bool
        Compare with what a little more effort would give.

    Raises
    ------
    ConfigurationError
        If the design cannot give a slope.
    """
    _validate(design)
    each = np.asarray(design.rates, dtype=np.float64)
    # 540 s at 20 deg/s are thirty turns, whatever rounding makes of it
    turns = np.floor(np.abs(each) * design.duration_s / (2.0 * np.pi) + 1e-9)
    used = 2.0 * np.pi * turns / np.abs(each)
    noise = design.angle_random_walk / np.sqrt(used)  # of a mean rate, rad/s
    horizontal = EARTH_RATE * np.cos(design.latitude)
    rate = np.repeat(each, design.repeats)
    sigma = np.repeat(noise, design.repeats)
    lean = np.asarray(design.C23, dtype=np.float64)
    k, n = len(lean), len(rate)
    rates, sigmas = np.tile(rate, k), np.tile(sigma, k)
    offsets = np.kron(np.eye(k), np.ones((n, 1)))
    lambda1 = rates - EARTH_RATE * np.sin(design.latitude)
    x = lambda1 * np.repeat(lean, n) / (3.0 * horizontal)

    one = _deviations(np.stack([np.ones(n), rate], axis=1), sigma / horizontal)
    by_heading = by_joint = delay = None
    if np.max(np.abs(lean)) >= MIN_C23:
        columns = np.column_stack([offsets, x])
        by_heading = float(_deviations(columns, sigmas / horizontal)[k])
    if np.ptp(lean) > max(MIN_C23, DISTINCT_LEAN * np.max(np.abs(lean))):
        both = _deviations(np.column_stack([offsets, x, rates]), sigmas / horizontal)
        by_joint, delay = float(both[k]), float(both[k + 1])
    axial = _deviations(np.column_stack([lambda1, np.ones_like(lambda1)]), sigmas)
    result = Prediction(
        n_runs=n * k,
        total_s=float(n * k * design.duration_s),
        sigma_run=tuple(float(s) for s in noise / horizontal),
        sigma_K=float(one[1]),
        sigma_lambda2_heading=by_heading,
        sigma_lambda2_joint=by_joint,
        sigma_delay=delay,
        sigma_lambda2_axial=3.0 * float(axial[0]),
        order=run_order(each, design.repeats),
        advice=(),
    )
    return replace(result, advice=_advice(design, result)) if advise else result


def _deviations(columns: FloatArray, sigma: FloatArray) -> FloatArray:
    rows = columns / sigma[:, None]
    length = np.linalg.norm(rows, axis=0)
    root = np.linalg.pinv(rows / length)
    return np.asarray(np.sqrt(np.sum(root * root, axis=1)) / length)


def _arcsec(value: float | None) -> str:
    return "not observable" if value is None else f"{value / ARCSEC:.3g} arcsec"


def _advice(design: Design, now: Prediction) -> tuple[str, ...]:
    advice = []
    heading = now.sigma_lambda2_heading
    if heading is None:
        advice.append(
            "the axis leans too little: headings do not show lambda2; tilt the base to the"
            f" east or west by {GOOD_LEAN:g} rad"
        )
    else:
        advice.append(
            f"lambda2 from headings is significant if it is {_arcsec(SIGNIFICANT * heading)} or"
            " more"
        )
    rates = np.asarray(design.rates, dtype=np.float64)
    if np.all(rates > 0.0) or np.all(rates < 0.0):
        turned = replace(
            design,
            rates=tuple(design.rates) + tuple(-r for r in design.rates),
            repeats=max(1, design.repeats // 2),
        )
        other = predict(turned, advise=False)
        advice.append(
            f"both directions, {other.n_runs} runs: {_arcsec(other.sigma_lambda2_heading)} instead"
            f" of {_arcsec(heading)}"
        )
    lean = float(np.max(np.abs(design.C23)))
    if 0.0 < lean < 0.5 * GOOD_LEAN:
        tilted = replace(design, C23=tuple(c * GOOD_LEAN / lean for c in design.C23))
        other = predict(tilted, advise=False)
        advice.append(
            f"a lean of {GOOD_LEAN:g} rad: {_arcsec(other.sigma_lambda2_heading)} instead of"
            f" {_arcsec(heading)}"
        )
    if now.sigma_lambda2_joint is None and lean > 0.0:
        turned = replace(design, C23=(lean, -lean), repeats=max(1, design.repeats // 2))
        other = predict(turned, advise=False)
        advice.append(
            "with the base also turned by 180 deg, a delay of the encoder is known to"
            f" {(other.sigma_delay or np.nan) * 1e6:.0f} us and no longer looks like lambda2"
            f" ({_arcsec(other.sigma_lambda2_joint)}, {other.n_runs} runs)"
        )
    advice.append(f"from the rate along the axis: {_arcsec(now.sigma_lambda2_axial)}")
    few = [r for r in design.rates if abs(r) * design.duration_s < FEW_TURNS * 2.0 * np.pi - 1e-9]
    if few:
        advice.append(
            f"{design.duration_s:g} s at {np.degrees(few[0]):g} deg/s is fewer than {FEW_TURNS}"
            " turns: such runs are left out unless --min-turns is lowered"
        )
    return tuple(advice)
