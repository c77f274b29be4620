"""Classical coning, exact for any cone angle: the test motion of coning algorithms.

The body's z axis stays on a cone about the z axis of a frame ``c``:

    q_cb(t) = [cos(a/2), sin(a/2) cos p, sin(a/2) sin p, 0],   p = 2 pi f t,

which makes ``omega_ib_b = W [-sin a sin p, sin a cos p, -2 sin(a/2)**2]``, ``W = 2 pi f``.
Nothing here is for small angles.

References
----------
.. [1] L. E. Goodman, A. R. Robinson, "Effect of finite rotations on gyroscopic sensing
   devices", J. Applied Mechanics 25, 1958, 210-213.
"""

from __future__ import annotations

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.simulation.truth import STANDARD_GRAVITY_N, ImuTruth, check_times


def classical_coning(
    time_ns: ArrayLike,
    half_angle: float,
    frequency: float,
    *,
    q_nc: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    gravity_n: ArrayLike = STANDARD_GRAVITY_N,
) -> ImuTruth:
    """Exact samples of a body in classical coning that goes nowhere.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least; see
        :func:`~sinstool.simulation.truth.sample_times`. The coning starts at phase 0 at the
        first.
    half_angle : float
        Half of the cone's angle, rad.
    frequency : float
        Turns per second, Hz; negative turns the other way round.
    q_nc : array_like, shape (4,), optional
        Attitude of the cone's frame in NED; ``q_nb = q_nc q_cb``.
    gravity_n : array_like, shape (3,), optional
        Gravity in NED, m/s^2; standard gravity by default.

    Returns
    -------
    ImuTruth
        NED is taken as not rotating: the gyro sees the coning alone.

    Raises
    ------
    ValueError
        If a shape is wrong or time does not increase.
    """
    times, interval = check_times(time_ns)
    cone = rotation.normalise(q_nc)
    gravity = np.asarray(gravity_n, dtype=np.float64)
    if cone.shape != (4,) or gravity.shape != (3,):
        raise ValueError(f"Expected shapes (4,) and (3,), got {cone.shape} and {gravity.shape}.")
    turn = 2.0 * np.pi * frequency
    sin_a, cos_a = np.sin(half_angle), np.cos(half_angle)
    z_rate = -2.0 * turn * np.sin(0.5 * half_angle) ** 2

    phase = _phase(times - times[0], frequency)
    middle = phase - 0.5 * turn * interval
    # Mean of a sinusoid over an interval: its value in the middle times sin(u)/u.
    once = np.sinc(frequency * interval)
    twice = np.sinc(2.0 * frequency * interval)

    def body_rate(at: FloatArray, gain: FloatArray | float) -> FloatArray:
        x_y = turn * sin_a * gain
        return np.stack([-x_y * np.sin(at), x_y * np.cos(at), np.full(at.shape, z_rate)], axis=-1)

    def specific_force(
        at: FloatArray, gain: FloatArray | float, gain_twice: FloatArray | float
    ) -> FloatArray:
        # C_bc v = cos a v + (1 - cos a) u (u v) - sin a u x v, u the axis in the x-y plane;
        # its elements are of order 1, cos p, sin p, cos 2p and sin 2p, and so are the means.
        vx, vy, vz = rotation.rotate(rotation.conjugate(cone), -gravity)
        cos1, sin1 = gain * np.cos(at), gain * np.sin(at)
        cos2, sin2 = gain_twice * np.cos(2.0 * at), gain_twice * np.sin(2.0 * at)
        versine = 2.0 * np.sin(0.5 * half_angle) ** 2
        return np.stack(
            [
                cos_a * vx + 0.5 * versine * ((1.0 + cos2) * vx + sin2 * vy) - sin_a * sin1 * vz,
                cos_a * vy + 0.5 * versine * (sin2 * vx + (1.0 - cos2) * vy) + sin_a * cos1 * vz,
                cos_a * vz - sin_a * (cos1 * vy - sin1 * vx),
            ],
            axis=-1,
        )

    q_cb = np.stack(
        [
            np.full(phase.shape, np.cos(0.5 * half_angle)),
            np.sin(0.5 * half_angle) * np.cos(phase),
            np.sin(0.5 * half_angle) * np.sin(phase),
            np.zeros(phase.shape),
        ],
        axis=-1,
    )
    mean_rate = body_rate(middle, once)
    return ImuTruth(
        time_ns=times,
        interval=interval,
        gyro_rate=body_rate(phase, 1.0),
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * interval[:, np.newaxis],
        specific_force=specific_force(phase, 1.0, 1.0),
        mean_specific_force=specific_force(middle, once, twice),
        q_nb=rotation.multiply(cone, q_cb),
    )


def _phase(elapsed_ns: IntArray, frequency: float) -> FloatArray:
    """Return 2 pi f t less whole turns, without the digits that a large product would lose."""
    seconds, rest = np.divmod(elapsed_ns, 1_000_000_000)
    turns = np.mod(frequency * seconds, 1.0) + frequency * (rest * 1e-9)
    return 2.0 * np.pi * np.mod(turns, 1.0)
