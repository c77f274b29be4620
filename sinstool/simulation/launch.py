"""The flight of a launched vehicle: boost, calm glide with gentle weaving, rolls and turns.

The flight of Qu, Li, Zhu and Wang's in-flight alignment experiment is known only by its
dynamics: up to 196 m/s^2, 980 m/s^3, 220 deg/s and 1000 deg/s^2 within 30 s of lift-off, a roll
above 40 deg/s for 8 s near 80 s, rolls of 60 deg/s at 110 to 130 s, calm in between. This one has
them. Its course in the calm part is not published: amplitudes and phases of the weave were fitted
so that errors of alignment grow and shrink with time as an earlier simulation of that experiment
has them, so agreement with those figures says less about the alignment than about the fit.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.units import DEGREE
from sinstool.simulation.profile import Profile, Ramp, Step, Term, Wave, fly
from sinstool.simulation.truth import Trajectory, sample_times

# When the weave that makes heading visible in the calm glide begins to come in.
_CALM_S = 36.0
_CONING_HZ = 17.0
_CONING_HALF_ANGLE = 0.02 * DEGREE
_VIBRATION_HZ = 43.0
_VIBRATION = 5.0  # m/s^2


def launch_profile(dynamics: float = 1.0, straight: bool = False) -> Profile:
    """The default flight.

    Parameters
    ----------
    dynamics : float, optional
        Factor on the weaving and the turns after the boost, not on boost and rolls.
    straight : bool, optional
        After the boost fly straight and level at constant speed, without any roll.
    """
    boost = (Step(0.05, 0.2, 1.0), Step(24.0, 4.0, -1.0))
    coning = 2.0 * np.pi * _CONING_HZ
    vibration = 2.0 * np.pi * _VIBRATION_HZ
    speed: tuple[Term, ...] = (
        Ramp(0.0, 0.35, 186.0),
        Ramp(2.5, 0.35, -168.0),
        Wave(_VIBRATION / vibration, vibration, 0.0, boost),
    )
    climb: tuple[Term, ...] = (Step(-1e4, 1.0, 48.0 * DEGREE), Step(2.0, 34.0, -40.0 * DEGREE))
    pitch: tuple[Term, ...] = (
        Wave(_CONING_HALF_ANGLE, coning, np.pi / 2.0, boost),
        Step(5.0, 20.0, 3.0 * DEGREE),
    )
    yaw: tuple[Term, ...] = (Wave(1.3 * _CONING_HALF_ANGLE, coning, 0.0, boost),)
    roll: tuple[Term, ...] = (Ramp(3.0, 0.4, 220.0 * DEGREE), Ramp(11.0, 0.4, -220.0 * DEGREE))
    if straight:
        return Profile(
            (*speed, Ramp(28.0, 1.0, -18.0)),
            (*climb, Step(30.0, 8.0, -8.0 * DEGREE)),
            (),
            pitch,
            yaw,
            roll,
        )
    return _with_glide(Profile(speed, climb, (), pitch, yaw, roll), dynamics)


def _with_glide(boost: Profile, dynamics: float) -> Profile:
    """The boost, then glide, weave, rolls and turns.

    The weave is strong for half a minute and gentle after. Its two frequencies and phases make
    the horizontal force turn mostly one way, so that heading shows from the first seconds, and
    more slowly as time goes on.
    """
    fade = (Step(_CALM_S, 4.0, 1.0), Step(66.0, 15.0, -0.8), Step(150.0, 20.0, -0.2))
    ahead, aside = 0.12, 0.0555  # rad/s
    return Profile(
        speed=(
            *boost.speed,
            Ramp(28.0, 1.0, -20.0),
            Ramp(140.0, 10.0, -4.7),
            Ramp(203.0, 10.0, 8.4),
            Wave(17.8 * dynamics, ahead, 1.4 - ahead * 40.0, fade),
        ),
        climb=(
            *boost.climb,
            Step(44.0, 90.0, -4.8 * DEGREE),
            Step(145.0, 40.0, -3.2 * DEGREE),
            Step(195.0, 50.0, -5.0 * DEGREE),
        ),
        course=(
            Wave(-2.55 * DEGREE * dynamics, aside, 1.87 - aside * 40.0, fade),
            Step(150.0, 50.0, -9.0 * DEGREE * dynamics),
            Step(205.0, 50.0, 12.0 * DEGREE * dynamics),
        ),
        pitch=(*boost.pitch, Wave(2.0 * DEGREE * dynamics, 0.17, 0.0, fade)),
        yaw=boost.yaw,
        roll=(
            *boost.roll,
            Wave(5.0 * DEGREE * dynamics, 0.11, 0.0, fade),
            Ramp(76.0, 1.0, 46.0 * DEGREE),
            Ramp(85.0, 1.0, -46.0 * DEGREE),
            Ramp(110.5, 0.8, 62.0 * DEGREE),
            Ramp(114.4, 1.6, -124.0 * DEGREE),
            Ramp(121.4, 0.8, 62.0 * DEGREE),
        ),
    )


def launch(
    rate_hz: float = 200.0,
    duration_s: float = 260.0,
    *,
    latitude: float = 0.72,
    longitude: float = 1.75,
    height: float = 1000.0,
    azimuth: float = 1.1,
    dynamics: float = 1.0,
    straight: bool = False,
    pad_s: float = 0.0,
    start_ns: int = 0,
) -> Trajectory:
    """Simulate the flight.

    Parameters
    ----------
    rate_hz : float, optional
        IMU samples per second.
    duration_s : float, optional
        Time from lift-off to the end, s; the profile ends at 260 s.
    latitude, longitude, height : float, optional
        Position of the site, rad and m, anywhere but at a pole.
    azimuth : float, optional
        Azimuth of the launch, from north, rad.
    dynamics, straight : optional
        See :func:`launch_profile`.
    pad_s : float, optional
        Seconds at rest before lift-off.
    start_ns : int, optional
        First instant.

    Returns
    -------
    Trajectory
        Increments are integrals by Gauss-Legendre quadrature with four nodes in each 5 ms.

    Raises
    ------
    ValueError
        If the rate or the duration are not positive.
    """
    return fly(
        launch_profile(dynamics, straight),
        sample_times(rate_hz, pad_s + duration_s, start_ns),
        start_ns + round(pad_s * 1e9),
        (latitude, longitude, height),
        azimuth,
    )
