"""Rest of accelerometers whose own noise is as loud as motion, as of those for shocks.

Noise is white: what differs from sample to sample explains both the scatter of samples in a window
and that of the windows' means, and it stays the same. Motion and vibration are not.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.alignment.still import MAX_GYRO_STD, WINDOW_NS, StillSpan, Windows, span_of

# Windows in a row that are judged together, and samples of each at least.
TOGETHER, LEAST_COUNT = 20, 10
# Means over a piece, and its noise, may differ from those of the piece before by this many sigmas.
SIGMAS = 4.0
# Beside noise, a bias that wanders: rad/s and m/s^2.
WANDER = (5e-4, 5e-3)


def noisy_rests(windows: Windows) -> list[StillSpan]:
    """Spans of ten seconds or longer in which all that changes is white noise.

    No gyro that works is noisier than the limit for any rest.

    Returns
    -------
    list of StillSpan
        In order of time.
    """
    spans: list[StillSpan] = []
    begin = 0
    count = len(windows) // TOGETHER
    still = [_white(windows, slice(k * TOGETHER, (k + 1) * TOGETHER)) for k in range(count)]
    for k in range(count + 1):
        goes_on = k < count and still[k]
        joins = goes_on and k > begin and _alike(windows, begin * TOGETHER, k * TOGETHER)
        if joins:
            continue
        if k > begin and still[begin]:
            spans.append(span_of(windows, begin * TOGETHER, k * TOGETHER))
        begin = k
    return spans


def _white(windows: Windows, rows: slice) -> bool:
    """Whether samples and means of windows scatter as white noise does."""
    size = windows.count[rows].astype(np.float64)
    apart = np.diff(windows.start_ns[rows])
    if size.min() < LEAST_COUNT or (apart != WINDOW_NS).any():
        return False
    if float(np.mean(windows.gyro_std[rows] ** 2)) > MAX_GYRO_STD**2:
        return False
    freedom = 3.0 * (len(size) - 1)
    for mean, std, fast, wander in _kinds(windows, rows):
        noise = float(np.mean(fast**2))
        spread = float(mean.var(axis=0, ddof=1).sum())
        white = noise * float(np.mean(1.0 / size))
        most = 1.0 + SIGMAS * np.sqrt(2.0 / freedom)
        # Differences have the scatter of their samples, to within that of so few
        off = SIGMAS * np.sqrt(3.0 / (3.0 * size.sum()))
        if not (noise > 0.0 and float(np.mean(std**2)) < (1.0 + off) * noise + wander**2):
            return False
        if spread > most * white + 3.0 * wander**2:
            return False
    return True


def _alike(windows: Windows, begin: int, at: int) -> bool:
    """Whether the piece at a window goes on as those since another one."""
    before, rows = slice(begin, at), slice(at, at + TOGETHER)
    if windows.start_ns[at] - windows.start_ns[at - 1] != WINDOW_NS:
        return False
    samples = float(windows.count[rows].sum())
    pieces = zip(_kinds(windows, before), _kinds(windows, rows), strict=True)
    for (mean, _, fast, wander), (other, _, now, _) in pieces:
        noise, new = float(np.mean(fast**2)), float(np.mean(now**2))
        step = float(np.linalg.norm(other.mean(axis=0) - mean.mean(axis=0)))
        if step > SIGMAS * np.sqrt(2.0 * noise / samples) + wander * SIGMAS:
            return False
        if abs(new / noise - 1.0) > SIGMAS * np.sqrt(6.0 / samples):
            return False
    return True


def _kinds(windows: Windows, rows: slice) -> tuple[tuple[FloatArray, ...], ...]:
    """Of gyro and accelerometer: means, scatter, white noise, and how far a bias may wander."""
    return (
        (windows.gyro[rows], windows.gyro_std[rows], windows.gyro_fast[rows], np.array(WANDER[0])),
        (
            windows.accel[rows],
            windows.accel_std[rows],
            windows.accel_fast[rows],
            np.array(WANDER[1]),
        ),
    )
