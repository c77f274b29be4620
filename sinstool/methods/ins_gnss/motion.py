"""The motion that an INS/GNSS filter remembers from update to update.

Rates and specific force of the latest update and of the time before it bridge a gap of the IMU;
rates that swing the antenna carry a fix to its own time.
"""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.core.quaternion_kernels import cross
from sinstool.methods.ins_gnss.layout import Memory
from sinstool.methods.strapdown.followed_rates import FOLLOWED_S

BRIDGE = 0.05  # s, longest step within an IMU gap
BESIDE = 0.5  # s, of the motion beside a gap that is longer than such a step


@part()
def begin(m: Memory, dt: float, phi: FloatArray, dv: FloatArray, followed: FloatArray) -> None:
    """Know no motion but that of an update, the first or the first after a long gap."""
    for i in range(3):
        m.rate[i] = phi[i] / dt
        m.swing[i] = followed[i]
        m.force[i] = dv[i] / dt
        m.recent[i] = m.rate[i]
        m.recent[3 + i] = m.force[i]


@part(inline="always")
def go_on(m: Memory, dt: float, phi: FloatArray, dv: FloatArray, followed: FloatArray) -> None:
    """Remember the motion of an update."""
    for i in range(3):
        m.rate[i] = phi[i] / dt
        m.swing[i] = followed[i]
        m.force[i] = dv[i] / dt
        m.recent[i] += dt / (dt + BESIDE) * (m.rate[i] - m.recent[i])
        m.recent[3 + i] += dt / (dt + BESIDE) * (m.force[i] - m.recent[3 + i])


@part()
def swing_over(
    m: Memory,
    d: float,
    dt: float,
    phi: FloatArray,
    followed: FloatArray,
    px: float,
    py: float,
    pz: float,
    bridged: bool,
    last: bool,
) -> None:
    """Change over an update of the rate that swings the antenna, and that rate at its end.

    In long updates it is that of their mean rates, from the middle of the one before.

    Parameters
    ----------
    d, dt : float
        Of a step, which may be one of several in a gap, and of the update, s.
    px, py, pz : float
        Rotation vector of the step without errors of the gyro.
    bridged, last : bool
        Whether a gap was before the update, and whether the step is the update itself.
    """
    smooth = dt > FOLLOWED_S
    for i in range(3):
        before = m.rate[i] if smooth else m.swing[i]
        after = phi[i] / dt if smooth else followed[i]
        m.moved[6 + i] = 0.0 if bridged else (after - before) / dt
    inverse = 1.0 / d
    m.rate[0], m.rate[1], m.rate[2] = px * inverse, py * inverse, pz * inverse
    if last:
        for i in range(3):
            own = 0.5 * d * m.moved[6 + i] if smooth else followed[i] - phi[i] / dt
            m.rate[i] += own


@part()
def bridge_gap(
    m: Memory,
    gap: float,
    time: FloatArray,
    interval: FloatArray,
    phi: FloatArray,
    dv: FloatArray,
    k: int,
) -> None:
    """Rate and specific force with which the gap before update `k` is bridged.

    The mean of the motion before and after. Beside a gap that is longer than vibration these are
    means over some time, as far as the block extends: one sample may have any value.
    """
    last, seconds = k + 1, interval[k]
    if gap > BRIDGE:
        while last < len(time) and seconds < BESIDE:
            if time[last] - interval[last] - time[last - 1] > 0.5 * interval[last]:
                break
            seconds += interval[last]
            last += 1
    for i in range(3):
        turned, gained = 0.0, 0.0
        for j in range(k, last):
            turned += phi[j, i]
            gained += dv[j, i]
        rate, force = m.rate[i], m.force[i]
        if gap > BRIDGE:
            rate, force = m.recent[i], m.recent[3 + i]
            # The mean from before the gap is no longer recent
            m.recent[i], m.recent[3 + i] = turned / seconds, gained / seconds
        m.bridge[i] = 0.5 * (rate + turned / seconds)
        m.bridge[3 + i] = 0.5 * (force + gained / seconds)


@part()
def in_gap(m: Memory, d: float, dt: float) -> tuple[float, float, float, float, float, float]:
    """Rotation vector and velocity increment of a step in a gap, by what bridges it."""
    px, py, pz = d * m.bridge[0], d * m.bridge[1], d * m.bridge[2]
    ux, uy, uz = d * m.bridge[3], d * m.bridge[4], d * m.bridge[5]
    # An increment is in the axes of its start: those of samples hold half their turn
    half = 0.5 * (1.0 - dt / d)
    ax, ay, az = cross(px, py, pz, ux, uy, uz)
    return px, py, pz, ux + half * ax, uy + half * ay, uz + half * az
