"""The third-order network that damps the vertical channel: gains, responses, noise.

The vertical channel of an inertial system is unstable: gravity falls off with height, so a
height error feeds itself. A barometric height h_B holds it:

    e  = h + K4 v - h_B
    h' = v - K1 e
    v' = f_U - a_U - gamma(h) - K2 e - A                                              (1)
    A' = K3 e

with the upward specific force f_U, Coriolis and centripetal terms a_U and gravity gamma. The
integral A absorbs the bias of the accelerometer. The gains put all three roots at
-1/tau, so with N = F + I/tau, N^3 = 0 and exp(F t) = exp(-t/tau) (I + N t + N^2 t^2 / 2):
every response below is exact.

K4 > 0 trades overshoot and noise for a height that lags by K4 v in a climb; K4 = 0 is the
conventional loop; K4 = -T cancels, in a steady climb, a barometer that lags by T.

References
----------
.. [1] Zhang J., Ren S., Tan M., "A study of altitude damping in INS/GNSS integrated navigation
   system", J. Air Force Engineering University 4(6), 2003, 37-39 (in Chinese).
.. [2] W. S. Widnall, P. K. Sinha, "Optimizing the gains of the baro-inertial vertical channel",
   J. Guidance and Control 3(2), 1980, 172-178.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sinstool.core.earth import normal_gravity
from sinstool.core.errors import ConfigurationError
from sinstool.core.parts import part
from sinstool.methods.sensor_errors import Grade

RECOMMENDED_TAU: dict[str, float] = {
    "consumer": 5.0,
    "mems": 5.0,
    "industrial": 10.0,
    "tactical": 30.0,
    "navigation": 100.0,
}
"""Time constant in s for each grade of IMU."""

PAPER_TAU = 2.4
"""s; section 1 of [1]_ of the module."""

PAPER_K4 = 0.5
"""s; section 1 of [1]_ of the module."""

SENSIBLE_TAU = (0.5, 300.0)
"""Range of tau, s: below it the barometer's noise dominates, above it the gravity gradient."""


def gravity_gradient(latitude: float, height: float = 0.0) -> float:
    """Decrease of gravity with height, ``w2 = -d gamma / dh``.

    Parameters
    ----------
    latitude : float
        Geodetic, rad.
    height : float, optional
        Ellipsoidal, m.

    Returns
    -------
    float
        1/s^2, about 3.086e-6; twice the square of the Schuler frequency.
    """
    # normal_gravity is quadratic in the height: a central difference is exact.
    step = 1000.0
    above, below = normal_gravity(latitude, np.array([height + step, height - step]))
    return float(below - above) / (2.0 * step)


@dataclass(frozen=True)
class HeightNetwork:
    """A damping network with all three roots at ``-1/tau``.

    Parameters
    ----------
    tau : float
        Time constant, s.
    k4 : float, optional
        Weight of the vertical velocity in the difference to the barometer, s; its magnitude
        must be less than tau.
    w2 : float, optional
        Gravity's gradient, :func:`gravity_gradient`, 1/s^2.

    Raises
    ------
    ConfigurationError
        If tau is not positive and finite or K4 is not within (-tau, tau).
    """

    tau: float
    k4: float = 0.0
    w2: float = 3.0858e-6

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tau) and self.tau > 0.0):
            raise ConfigurationError(
                f"tau is {self.tau:g} s", "it must be positive; 5 to 100 s are usual"
            )
        if not abs(self.k4) < self.tau:
            raise ConfigurationError(
                f"K4 less the baro lag is {self.k4:g} s with tau {self.tau:g} s",
                "it must be smaller than tau in magnitude",
            )
        if not self.w2 * self.k4 * self.k4 < 1.0:
            raise ConfigurationError(
                f"K4 is {self.k4:g} s", "w2 K4^2 must be less than 1, or no gains exist"
            )

    @property
    def gains(self) -> tuple[float, float, float]:
        """K1 (1/s), K2 (1/s^2), K3 (1/s^3); eq. (3) of [1]_ of the module.

        The paper prints the Earth rate where the Schuler frequency belongs; with the Earth
        rate the three roots spread by -17 to +35 % at tau = 100 s.
        """
        t, k4, w2 = self.tau, self.k4, self.w2
        d = (1.0 - w2 * k4 * k4) * t**3
        k1 = (3.0 * t * t - 3.0 * k4 * t + k4 * k4 - w2 * k4 * t**3) / d
        k2 = (3.0 * t - k4 + w2 * (t**3 - 3.0 * k4 * t * t)) / d
        return k1, k2, 1.0 / t**3


def recommended(grade: Grade, w2: float = 3.0858e-6) -> HeightNetwork:
    """Network with the time constant of :data:`RECOMMENDED_TAU` for a grade, and K4 = 0.

    Parameters
    ----------
    grade : {"consumer", "mems", "industrial", "tactical", "navigation"}
    w2 : float, optional
        Gravity's gradient, 1/s^2.
    """
    return HeightNetwork(RECOMMENDED_TAU[grade], w2=w2)


def paper(w2: float = 3.0858e-6) -> HeightNetwork:
    """Network of section 1 of [1]_ of the module: tau = 2.4 s, K4 = 0.5 s."""
    return HeightNetwork(PAPER_TAU, PAPER_K4, w2)


@part()
def pole_matched_gains(
    interval: float, tau: float, k4: float, w2: float
) -> tuple[float, float, float]:
    """Gains L1, L2 (1/s), L3 (1/s^2) for a sample after any interval.

    Between samples the channel runs free, with the correction A taken off the acceleration. At a
    sample, T after the one before, the difference e moves the state at once:

        h -= L1 e,    v -= L2 e,    A += L3 e.

    L is chosen so that, without gravity's gradient, (I - L c) Phi(T) has the poles r, r, r with
    r = exp(-T/tau), c = (1, K4, 0), for every T: the sampled network is the continuous one seen
    at the samples. Holding K e over T would be unstable from T = 0.676 tau on; these gains are
    stable for every T, also where T changes from sample to sample.

    Parameters
    ----------
    interval : float
        T, time since the accepted sample before, s; positive.
    tau, k4 : float
        Of the network, s.
    w2 : float
        Gravity's gradient, 1/s^2: its share in L2 cancels what gravity adds over T.

    Returns
    -------
    l1, l2, l3 : float
        L/T tends to the continuous gains K as T tends to 0.
    """
    r = math.exp(-interval / tau)
    q = -math.expm1(-interval / tau)
    x = k4 / interval * q  # K4/tau for short intervals
    l1 = q * ((1.0 + r + r * r) - 1.5 * x * (1.0 + r) + x * x)
    l2 = q * q * (3.0 * (1.0 + r) - 2.0 * x) / (2.0 * interval)
    l2 += w2 * interval * (1.0 - 0.5 * l1)
    l3 = q * q * q / (interval * interval)
    return l1, l2, l3
