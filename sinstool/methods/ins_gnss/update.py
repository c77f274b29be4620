"""A measurement: innovation, gain, estimate, covariance in Joseph's form.

A measurement is ``nu = z - H x`` of up to six rows with white noise of variances r. All arrays
are those of :class:`~sinstool.methods.ins_gnss.layout.Memory`.
"""

from __future__ import annotations

from math import sqrt

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.ins_gnss import states
from sinstool.methods.ins_gnss.layout import Memory
from sinstool.methods.products import product

# Tilts less certain than the first, rad (3 deg, 1 sigma), turn gravity by so much that what then
# seems to show a heading of which nothing is known, rad, is the error of the linear model; and so
# until tilts are known to the third (0.1 deg), or for so many seconds.
NOT_LEVEL, NO_HEADING, LEVEL, LEVELLING = 0.05, 1.5, 0.00175, 5.0


@part()
def project(m: Memory, rows: int) -> None:
    """``hp = H P`` and ``s = H P H^T``, without the measurement's own noise."""
    n = m.n
    product(m.h, m.p, rows, n, m.width, m.hp)
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                f = m.h[j, k]
                if f != 0.0:
                    total += m.hp[i, k] * f
            m.s[i, j] = total
            m.s[j, i] = total


@part()
def factor(s: FloatArray, add: FloatArray, rows: int, root: FloatArray) -> bool:
    """Cholesky's root of ``s + diag(add)``; False where it is not positive definite."""
    for i in range(rows):
        for j in range(i + 1):
            total = s[i, j]
            if i == j:
                total += add[i]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                root[i, i] = sqrt(total)
            else:
                root[i, j] = total / root[j, j]
    return True


@part()
def normalised_square(root: FloatArray, nu: FloatArray, rows: int, work: FloatArray) -> float:
    """``nu^T S^-1 nu`` by the root of S."""
    nis = 0.0
    for i in range(rows):
        total = nu[i]
        for k in range(i):
            total -= root[i, k] * work[k]
        total /= root[i, i]
        work[i] = total
        nis += total * total
    return nis


@part()
def apply_measurement(m: Memory, rows: int, epsilon: float) -> bool:
    """Update estimate and covariance with the measurement in `h`, `nu` and `r`.

    After :func:`project`. With `epsilon` the gain is Schmidt's,

        K = P H^T (I + epsilon (H P H^T)^-1 R) S^-1,

    between Kalman's (0) and the one that fits the newest measurement (1). That of heading is 0
    while neither it nor tilts are known, as after a gap: its variance counts, but stays what it is.

    Parameters
    ----------
    m : Memory
        `x`, `dx` and `p` are changed.

    Returns
    -------
    bool
        False, and nothing changed, where S is not positive definite.
    """
    n = m.n
    if not factor(m.s, m.r, rows, m.root):
        return False
    for c in range(rows):
        for i in range(rows):
            m.weight[i, c] = 1.0 if i == c else 0.0
        _solve(m.root, m.weight, c, rows)
    if epsilon > 0.0:
        for i in range(rows):
            m.work[i] = 0.0
        if factor(m.s, m.work, rows, m.root):
            for c in range(rows):
                for i in range(rows):
                    m.pht[i, c] = m.r[i] * m.weight[i, c]
                _solve(m.root, m.pht, c, rows)
                for i in range(rows):
                    m.weight[i, c] += epsilon * m.pht[i, c]
    # Along rows, which the processor takes several at a time, and without the zeros of H
    width = m.width
    for c in range(rows):
        for i in range(width):
            m.gain[c, i] = 0.0
        for k in range(rows):
            f = m.weight[k, c]
            for i in range(width):
                m.gain[c, i] += m.hp[k, i] * f
    if _levelling(m):
        for c in range(rows):
            m.gain[c, states.ATTITUDE + 2] = 0.0
    for i in range(n):
        total = 0.0
        for c in range(rows):
            total += m.gain[c, i] * m.nu[c]
        m.x[i] += total
        m.dx[i] += total
    # ((I - K H) P)^T, then (I - K H) times it, and K R K^T
    for i in range(n):
        for j in range(width):
            m.old[i, j] = m.p[i, j]
    _take_off(m.hp, m.gain, rows, n, width, m.old)
    for c in range(rows):
        for i in range(width):
            m.pht[c, i] = 0.0
        for k in range(n):
            f = m.h[c, k]
            if f != 0.0:
                for i in range(width):
                    m.pht[c, i] += m.old[k, i] * f
        for i in range(width):
            m.pht[c, i] -= m.gain[c, i] * m.r[c]
    _take_off(m.gain, m.pht, rows, n, width, m.old)
    for i in range(n):
        for j in range(i + 1):
            m.p[i, j] = 0.5 * (m.old[i, j] + m.old[j, i])
            m.p[j, i] = m.p[i, j]
    return True


@part()
def _levelling(m: Memory) -> bool:
    """Whether tilts and heading are unknown, or were and tilts are being found."""
    first = states.ATTITUDE
    variance = m.p[first, first] + m.p[first + 1, first + 1]
    heading = m.p[first + 2, first + 2]
    if variance > NOT_LEVEL * NOT_LEVEL and heading > NO_HEADING * NO_HEADING:
        m.level_until = m.now + LEVELLING
    return m.now < m.level_until and variance > LEVEL * LEVEL


@part()
def _take_off(a: FloatArray, b: FloatArray, rows: int, n: int, width: int, out: FloatArray) -> None:
    """``out -= a^T b``; of six rows or three at once, whose places the compiler then knows."""
    if rows == 6:
        for i in range(n):
            f, g, h, p, q, r = a[0, i], a[1, i], a[2, i], a[3, i], a[4, i], a[5, i]
            for j in range(width):
                first = out[i, j] - f * b[0, j] - g * b[1, j] - h * b[2, j]
                out[i, j] = first - p * b[3, j] - q * b[4, j] - r * b[5, j]
    elif rows == 3:
        for i in range(n):
            f, g, h = a[0, i], a[1, i], a[2, i]
            for j in range(width):
                out[i, j] = out[i, j] - f * b[0, j] - g * b[1, j] - h * b[2, j]
    else:
        for i in range(n):
            for c in range(rows):
                f = a[c, i]
                for j in range(width):
                    out[i, j] -= f * b[c, j]


@part()
def _solve(root: FloatArray, columns: FloatArray, c: int, rows: int) -> None:
    """Solve with a root of Cholesky's, column c in place."""
    for i in range(rows):
        total = columns[i, c]
        for k in range(i):
            total -= root[i, k] * columns[k, c]
        columns[i, c] = total / root[i, i]
    for i in range(rows - 1, -1, -1):
        total = columns[i, c]
        for k in range(i + 1, rows):
            total -= root[k, i] * columns[k, c]
        columns[i, c] = total / root[i, i]
