"""The published pseudo-coning experiment: a cone, and a tone of noise through the gyro's filter.

The motion is section 4 of [1]_, eq. 19: the rotation vector of the body against a frame ``c``

    phi(t) = theta [sin W t, cos W t, 0],   W = 2 pi f,

is a cone whose exact rate is ``W [sin(theta) cos W t, -sin(theta) sin W t, 2 sin(theta/2)**2]``.
What the gyro measures has two readings:

``consistent``
    That rate with its x and y, which oscillate, times the gyro's gain ``G(f)``, its z, which is
    constant, times ``G(0) = 1``; and noise ``G(f_n) theta_n W_n [cos W_n t, -sin W_n t, 0]``.
    The noise is no motion, so no rate about z belongs to it.
``literal``
    Eq. 20 as printed: sine and cosine change places, which puts the measured rate a quarter
    of a turn behind the motion, both z terms are ``G**2 theta**2 W / 2``, and the noise has one.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.methods.coning.gyro_response import GyroResponse, chebyshev, gyro_response
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.truth import ImuTruth, check_times

Phase = Literal["consistent", "literal"]

PHASES: tuple[Phase, ...] = ("consistent", "literal")
HALF_ANGLE = float(np.radians(0.1))
FREQUENCY_HZ = 30.0
NOISE_ANGLE = float(np.radians(0.01))
RATE_HZ = 400.0
DURATION_S = 10.0
RIPPLE_DB = 0.2
BANDWIDTH_HZ = 200.0
DEFAULT_RESPONSE = chebyshev(6, RIPPLE_DB, BANDWIDTH_HZ)
_WIDTH = f",{BANDWIDTH_HZ:g}"
_SHAPE = f",{RIPPLE_DB:g}{_WIDTH}"


@dataclass(frozen=True)
class Tone:
    """Cosine and sine of one frequency, at instants and as means over the intervals before them.

    Attributes
    ----------
    frequency : float
        Hz.
    cos, sin : ndarray, shape (n,)
        At the instants.
    mean_cos, mean_sin : ndarray, shape (n,)
        Over the interval that ends at each instant.
    """

    frequency: float
    cos: FloatArray
    sin: FloatArray
    mean_cos: FloatArray
    mean_sin: FloatArray


def paper_response(text: str) -> GyroResponse:
    """Gyro response from the command line, with the paper's figures where it gives none.

    Parameters
    ----------
    text : str
        As :func:`~sinstool.methods.coning.gyro_response.gyro_response` takes it; also ``cheb:N``
        and ``butter:N``, which have the 0.2 dB and 200 Hz of the paper's figure 1.

    Raises
    ------
    ConfigurationError
        If it cannot be understood.
    """
    if re.fullmatch(r"cheb:\d+", text):
        text = f"{text}{_SHAPE}"
    elif re.fullmatch(r"butter:\d+", text):
        text = f"{text}{_WIDTH}"
    return gyro_response(text)


def response_name(response: GyroResponse) -> str:
    """Short name of a gyro response: without the paper's own figures.

    Returns
    -------
    str
        :func:`paper_response` takes it.
    """
    if response.name.startswith("cheb:"):
        return response.name.removesuffix(_SHAPE)
    return response.name.removesuffix(_WIDTH)


def tone(time_ns: IntArray, interval: FloatArray, frequency: float) -> Tone:
    """Sample a tone that has phase 0 at the first instant.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
    interval : ndarray, shape (n,)
        s; see :func:`~sinstool.simulation.truth.check_times`.
    frequency : float
        Hz, of any size: beyond half the sample rate too.
    """
    # Whole turns are taken off before the product could lose digits.
    seconds, rest = np.divmod(time_ns - time_ns[0], 1_000_000_000)
    turns = np.mod(np.mod(frequency * seconds, 1.0) + frequency * (rest * 1e-9), 1.0)
    phase = 2.0 * np.pi * turns
    middle = phase - np.pi * frequency * interval
    gain = np.sinc(frequency * interval)
    return Tone(
        frequency, np.cos(phase), np.sin(phase), gain * np.cos(middle), gain * np.sin(middle)
    )


def measured_rate(
    motion: Tone,
    noise: Tone,
    *,
    mean: bool = False,
    phase: Phase = "consistent",
    response: GyroResponse = DEFAULT_RESPONSE,
    half_angle: float = HALF_ANGLE,
    noise_angle: float = NOISE_ANGLE,
    out: FloatArray | None = None,
) -> FloatArray:
    """Rate that the experiment's gyro measures.

    Parameters
    ----------
    motion, noise : Tone
        Of the two frequencies, at the same instants.
    mean : bool, optional
        The mean over each interval instead of the value at each instant.
    phase : {"consistent", "literal"}, optional
        See the module.
    response : GyroResponse, optional
        Gain of the gyro.
    half_angle : float, optional
        Of the cone, rad.
    noise_angle : float, optional
        Amplitude of the noise as an angle before the filter, rad.
    out : ndarray, shape (n, 3), optional
        Where to write it.

    Returns
    -------
    ndarray, shape (n, 3)
        rad/s; `out` if that is given.
    """
    turn = 2.0 * np.pi * motion.frequency
    noise_turn = 2.0 * np.pi * noise.frequency
    g, g_noise = response([motion.frequency, noise.frequency]).tolist()
    b = g_noise * noise_angle * noise_turn
    mc, ms = (motion.mean_cos, motion.mean_sin) if mean else (motion.cos, motion.sin)
    nc, ns = (noise.mean_cos, noise.mean_sin) if mean else (noise.cos, noise.sin)
    if out is None:
        out = np.empty((len(mc), 3))
    if phase == "literal":
        a = g * half_angle * turn
        out[:, 0] = a * ms + b * ns
        out[:, 1] = a * mc + b * nc
        out[:, 2] = 0.5 * (g * g * half_angle**2 * turn + b * g_noise * noise_angle)
    else:
        a = g * np.sin(half_angle) * turn
        out[:, 0] = a * mc + b * nc
        out[:, 1] = -a * ms - b * ns
        out[:, 2] = 2.0 * turn * np.sin(0.5 * half_angle) ** 2
    return out


def cone(
    time_ns: ArrayLike, half_angle: float = HALF_ANGLE, frequency: float = FREQUENCY_HZ
) -> ImuTruth:
    """Exact samples of the motion of eq. 19.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants; the cone has phase 0 at the first.
    half_angle : float, optional
        rad.
    frequency : float, optional
        Hz.

    Returns
    -------
    ImuTruth
        The frame ``c`` is NED, which does not rotate.
    """
    # Classical coning starts on the x axis and turns the other way; on axes a quarter of a
    # turn further it is this cone.
    base = classical_coning(time_ns, half_angle, -frequency)
    quarter = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])

    def turned(v: FloatArray) -> FloatArray:
        return np.stack([-v[:, 1], v[:, 0], v[:, 2]], axis=-1)

    q_cb = rotation.multiply(quarter, rotation.multiply(base.q_nb, rotation.conjugate(quarter)))
    return replace(
        base,
        gyro_rate=turned(base.gyro_rate),
        gyro_mean_rate=turned(base.gyro_mean_rate),
        gyro_increment=turned(base.gyro_increment),
        specific_force=turned(base.specific_force),
        mean_specific_force=turned(base.mean_specific_force),
        q_nb=q_cb,
    )


def coning_paper(
    time_ns: ArrayLike,
    noise_frequency: float,
    *,
    phase: Phase = "consistent",
    response: GyroResponse = DEFAULT_RESPONSE,
    half_angle: float = HALF_ANGLE,
    frequency: float = FREQUENCY_HZ,
    noise_angle: float = NOISE_ANGLE,
) -> tuple[ImuTruth, ImuTruth]:
    """Samples of the experiment at one frequency of noise.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least.
    noise_frequency : float
        Hz.
    phase, response, half_angle, noise_angle
        See :func:`measured_rate`.
    frequency : float, optional
        Of the cone, Hz.

    Returns
    -------
    truth, sensor : ImuTruth
        The motion, and the same with what the gyro measures of it; the accelerometer measures
        the truth.

    Raises
    ------
    ValueError
        If time does not increase or `phase` is unknown.
    """
    if phase not in PHASES:
        raise ValueError(f"Expected `phase` to be one of {PHASES}, got {phase!r}.")
    times, interval = check_times(time_ns)
    truth = cone(times, half_angle, frequency)
    tones = (tone(times, interval, frequency), tone(times, interval, noise_frequency))

    def measure(mean: bool) -> FloatArray:
        return measured_rate(
            *tones,
            mean=mean,
            phase=phase,
            response=response,
            half_angle=half_angle,
            noise_angle=noise_angle,
        )

    mean_rate = measure(True)
    sensor = replace(
        truth,
        gyro_rate=measure(False),
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * interval[:, np.newaxis],
    )
    return truth, sensor
