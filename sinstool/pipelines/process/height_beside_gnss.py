"""Heights held to a barometer beside those of GNSS, which such a run uses for its start only."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.streams import GnssEpochs, Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.height.reference import HeightReference

# Differences are medians over so long, s, of so many fixes at least.
BLOCK_S, LEAST_FIXES = 15.0, 5
# Differences that count are larger than this, m, as the weather makes some metres in an hour, and
# than so many sigmas of a GNSS height, for which this is taken, m, if none is stated.
LARGE_M, SIGMAS, UNSTATED_M = 15.0, 3.0, 8.6


class HeightBesideGnss:
    """Compares the heights of a run with GNSS heights that it does not use.

    Parameters
    ----------
    reference : HeightReference
        Of the run.
    gnss : GnssEpochs or None
        Of the log.
    """

    def __init__(self, reference: HeightReference, gnss: GnssEpochs | None) -> None:
        baro = reference.baro
        # Heights of a topic and those by an altimeter setting may be above mean sea level
        self._level_known = baro is not None and baro.mode != "qnh"
        self._gnss: GnssEpochs | None = None
        if gnss is not None and reference.kind == "baro":
            self._gnss = gnss.rows(np.isfinite(gnss.height))
        self._first_ns: int | None = None
        self._last: tuple[int, float] | None = None
        self._seconds: list[FloatArray] = []
        self._off: list[FloatArray] = []

    def push(self, solution: Solution) -> None:
        """Take the next solutions, with their vertical columns."""
        if self._gnss is None or not len(solution):
            return
        assert solution.vertical is not None
        times, heights = solution.time_ns, solution.vertical[:, 0]
        if self._first_ns is None:
            self._first_ns = int(times[0])
        if self._last is not None:
            times = np.concatenate([[self._last[0]], times])
            heights = np.concatenate([[self._last[1]], heights])
        self._last = int(times[-1]), float(heights[-1])
        begin, end = np.searchsorted(self._gnss.time_ns, [times[0], times[-1]])
        at = self._gnss.time_ns[begin:end]
        ours = np.interp((at - times[0]) / SECOND, (times - times[0]) / SECOND, heights)
        self._seconds.append((at - self._first_ns) / SECOND)
        self._off.append(ours - self._gnss.height[begin:end])

    def warnings(self) -> list[str]:
        """That the heights are not those of GNSS, if so."""
        if self._gnss is None or not self._off:
            return []
        seconds, off = np.concatenate(self._seconds), np.concatenate(self._off)
        known = np.isfinite(off)
        seconds, off = seconds[known], off[known]
        block = np.floor(seconds / BLOCK_S).astype(int)
        all_blocks, many = np.unique(block, return_counts=True)
        blocks = all_blocks[many >= LEAST_FIXES]
        if not len(blocks):
            return []
        differences = np.array([float(median(off[block == k])) for k in blocks])
        if not self._level_known:
            differences -= float(median(differences))
        stated = self._gnss.sigma_position_n[:, 2]
        stated = stated[np.isfinite(stated)]
        sigma = float(median(stated)) if len(stated) else UNSTATED_M
        worst = int(np.argmax(np.abs(differences)))
        if abs(differences[worst]) < max(LARGE_M, SIGMAS * sigma):
            return []
        at = (blocks[worst] + 0.5) * BLOCK_S
        return [
            f"height differs from that of GNSS by up to {differences[worst]:+.0f} m, at {at:.0f} s:"
            " the barometer drifts, hangs, or its stamps are off; --height-damping gnss or --mode"
            " ins-gnss holds the height to the fixes"
        ]
