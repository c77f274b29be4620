"""White noise of fixes from their innovations: for adaptive filters and the gate.

A ratio for each row multiplies the nominal variance. ``sage-husa`` and ``innovation`` adapt it at
every epoch [1]_ [2]_. Otherwise the gate measures it before it rejects a fix: if the nominal noise
is too small it would reject nearly all fixes and use those few that happen to be near, which is
worse than no gate. What tells noise from a bad fix, a jump of the fixes or a filter that has
diverged is how innovations change from one epoch to the next [3]_: a bad fix makes two changes
large, a jump one and a diverged filter none, while noise makes most of them large. The ratio is a
low quantile of the squared changes, which many bad fixes leave small, over its value with nominal
noise. A fix is rejected if it is beyond the gate with both the nominal and the measured noise.

References
----------
.. [1] A. P. Sage, G. W. Husa, "Adaptive filtering with unknown prior statistics", Joint Automatic
   Control Conference, 1969, 760-769.
.. [2] A. H. Mohamed, K. P. Schwarz, "Adaptive Kalman filtering for INS/GPS", Journal of Geodesy
   73, 1999, 193-203.
.. [3] J. von Neumann et al., "The mean square successive difference", Annals of Mathematical
   Statistics 12, 1941, 153-162.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.ins_gnss import layout
from sinstool.methods.ins_gnss.layout import Memory, Model

# A share p of bad fixes makes 1 - (1 - p)^2 of the changes large, so that the quantile q is still
# one of the others up to p = 1 - sqrt(q): 41 % here, 29 % for the median. Lower quantiles scatter
# more.
QUANTILE = 0.35
# This quantile of chi-square with one degree of freedom, (Phi^-1(0.675))^2, is that of half the
# square of the difference of two independent unit normals.
OF_NORMAL = 0.2059
SORTED = layout.ROWS  # a column to sort in
# Number of changes that show noise that has begun just now. The third smallest is taken, whose mean
# rank, 3 in 9, is near the quantile; two bad fixes make four changes large and leave it alone. With
# the nominal noise 90 % of the resulting ratios are between 0.09 and 3.9, hence NOISY.
SHORT: Any = np.int64(8)
# If the changes of all epochs kept (60) show this many times the nominal variance, they alone are
# used: with nominal noise two in a thousand are beyond that, and the larger of their ratio and that
# of the few changes, which scatters, would mostly be too large.
NOISY = 3.0
# Time constant, in epochs, of the fading mean of the share beyond the gate: three in a row give
# 0.14, four 0.19.
FAR_EPOCHS = 20.0
# With NOISY times the nominal variance this share of epochs with six rows is beyond the gate of
# 99.99 %: the probability of chi-square above 27.86 / 3 is 0.158. With nominal noise it is 0.0001.
FAR_SHARE = 0.15


@part()
def row_of(m: Memory, k: int) -> int:
    """Component of row k of a fix among position and velocity, N E D."""
    i = 0
    while m.h[k, i] != 1.0:
        i += 1
    return i


@part()
def adapt(m: Memory, model: Model, window: FloatArray, rows: int) -> None:
    """Measurement variances from innovations; see DivergenceControl."""
    slot = int(m.window_seen) % window.shape[0]
    # 1, 1/2, 1/3, ... to 1 - b: the first epochs count as much as those after them
    b = model.fading
    share = (1.0 - b) / (1.0 - b ** (m.window_seen + 1.0))
    for i in range(layout.ROWS):
        window[slot, i] = -1.0
    for k in range(rows):
        i = row_of(m, k)
        nominal = m.r[k] / m.ratio[i]
        square = m.nu[k] * m.nu[k]
        window[slot, i] = square
        if model.adaptive == 1.0:
            ratio = (square - m.s[k, k]) / nominal
            if ratio > model.most:
                m.ratio[i] = model.most
            else:
                m.ratio[i] += share * (max(ratio, model.least) - m.ratio[i])
        elif m.window_seen + 1.0 >= window.shape[0]:
            total = 0.0
            many = 0
            for j in range(window.shape[0]):
                if window[j, i] >= 0.0:
                    total += window[j, i]
                    many += 1
            ratio = (total / many - m.s[k, k]) / nominal
            m.ratio[i] = min(max(ratio, model.least), model.most)
        m.r[k] = nominal * m.ratio[i]
    m.window_seen += 1.0


@part()
def note_changes(m: Memory, changes: FloatArray, rows: int) -> None:
    """Record changes of the innovations since the last epoch, over their nominal sigma.

    After :func:`~sinstool.methods.ins_gnss.update.project`, of every epoch, used or rejected.
    Squared and halved, changes are 1 in the mean where the noise is nominal.
    """
    length = changes.shape[0]
    for k in range(rows):
        i = row_of(m, k)
        now = m.nu[k] / sqrt(m.s[k, k] + m.r[k])
        before = m.latest[i]
        m.latest[i] = now
        if before == before:
            changes[int(m.changes_seen[i]) % length, i] = 0.5 * (now - before) ** 2
            m.changes_seen[i] += 1.0


@part()
def often_far(m: Memory, far: bool) -> bool:
    """Whether to use the measured noise: for an epoch that is beyond the gate with nominal noise.

    It is used, too, for epochs between many such ones, which are as noisy though they happen to be
    near. Epochs with velocity only are counted separately, as their noise differs.
    """
    alone = 0 if row_of(m, 0) < 3 else 1
    m.far_share[alone] += ((1.0 if far else 0.0) - m.far_share[alone]) / FAR_EPOCHS
    return far or m.far_share[alone] > FAR_SHARE


@part()
def use_measured(m: Memory, changes: FloatArray, rows: int) -> None:
    """Set measurement variances from changes of the innovations where above the nominal ones."""
    for k in range(rows):
        i = row_of(m, k)
        times = _low_change(m, changes, i, changes.shape[0])
        if times < NOISY:
            # Noise that has begun just now
            times = max(times, _low_change(m, changes, i, SHORT))
        if times > 1.0:
            more = (times - 1.0) * (m.s[k, k] + m.r[k])
            m.ratio[i] = 1.0 + more / m.r[k]
            m.r[k] += more


@part()
def _low_change(m: Memory, changes: FloatArray, i: int, many: int) -> float:
    """Low quantile of a row's latest changes over its nominal value; 1 if there are too few."""
    length = changes.shape[0]
    seen = int(m.changes_seen[i])
    if seen < many or many > length:
        return 1.0
    for j in range(many):
        value = changes[(seen - 1 - j) % length, i]
        k = j
        # NaN goes to the end
        while k > 0 and (value < changes[k - 1, SORTED] or np.isnan(changes[k - 1, SORTED])):
            changes[k, SORTED] = changes[k - 1, SORTED]
            k -= 1
        changes[k, SORTED] = value
    return changes[int(QUANTILE * many), SORTED] / OF_NORMAL
