"""What an INS/GNSS filter writes of an update."""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.height.channel import smooth_height
from sinstool.methods.height.layout import S_CORRECTION
from sinstool.methods.ins_gnss import instants, layout
from sinstool.methods.ins_gnss.layout import Memory, Model
from sinstool.methods.ins_gnss.states import VELOCITY
from sinstool.methods.strapdown.navigation import HEIGHT
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE


@part()
def write_line(
    m: Memory,
    model: Model,
    line: FloatArray,
    now: float,
    inverse: float,
    px: float,
    py: float,
    pz: float,
    ux: float,
    uy: float,
    uz: float,
) -> None:
    """Write navigation, motion and covariances at the end of an update.

    Parameters
    ----------
    line : ndarray, shape (OUTPUT,)
        Set.
    now, inverse : float
        Time, s, and 1 / duration of the update.
    px, py, pz, ux, uy, uz : float
        Rotation vector and velocity increment without sensor errors.
    """
    if model.closed == 0.0 or model.k4 != 0.0:
        instants.corrected(m.nav, m.x, line)
    else:
        for i in range(NAV_SIZE):
            line[i] = m.nav[i]
    fades = 0.0
    if model.has_network > 0.0 and not m.keep:  # a smoother makes no step
        fades = smooth_height(m.channel, now, 0.0)
        line[HEIGHT] += fades
    line[layout.O_RATE] = px * inverse
    line[layout.O_RATE + 1] = py * inverse
    line[layout.O_RATE + 2] = pz * inverse
    # The increment is in the axes of the update's start: half a turn on, to its middle
    line[layout.O_FORCE] = inverse * (ux - 0.5 * (py * uz - pz * uy))
    line[layout.O_FORCE + 1] = inverse * (uy - 0.5 * (pz * ux - px * uz))
    line[layout.O_FORCE + 2] = inverse * (uz - 0.5 * (px * uy - py * ux))
    line[layout.O_CORRECTION] = m.channel[S_CORRECTION]
    at = layout.O_COVARIANCE
    doubt = m.doubt
    # The covariance is that of the latest substep or measurement. Right after a fix positions are
    # far better known than velocities, which carry them on from there
    since = now - m.from_time
    for block in range(3):
        b = 3 * block
        for i in range(3):
            for j in range(3):
                value = m.p[b + i, b + j]
                if block == 0:
                    both = m.p[i, VELOCITY + j] + m.p[VELOCITY + i, j]
                    value += since * (both + since * m.p[VELOCITY + i, VELOCITY + j])
                line[at + 3 * i + j] = doubt * value
            if block < 2 and m.streak[0] > 1.0:
                # Consecutive fixes differ by that much, and either they or the navigation may be
                # wrong
                line[at + 4 * i] += m.rejected[b + i] ** 2
        at += 9
    line[layout.O_COVARIANCE + 8] += fades * fades
