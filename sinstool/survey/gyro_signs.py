"""Axes of the gyro whose sign does not belong to the accelerometer's, by gravity.

Over some seconds the mean specific force of a vehicle that speeds up and slows down is that of
gravity, which stays where it is in axes that do not turn. Rates with a wrong sign carry it away, as
a bias does; so the bias that keeps it best is estimated with each choice of signs.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import FloatArray
from sinstool.core.finding import Finding, Severity
from sinstool.methods.alignment.still import WINDOW_NS, Windows

# A piece has so many blocks of so many windows, over which the mean of the specific force is taken.
BLOCKS, BLOCK = 4, 6
# Fewest pieces, and most, those that turn furthest. A window that turns by more than this, rad, is
# not described by its mean rate.
LEAST_PIECES, MOST_PIECES, MOST_TURN = 3, 60, 2.0
# Signs are judged if gravity moves by more than the first, m/s^2 RMS. Other signs are right if it
# then moves by less than the second, and by less than this share of before, in most pieces.
MOVES, STAYS, SHARE, MOST = 1.0, 1.0, 0.4, 0.75
# Other signs with at most so many times the least are as likely; the fewest changes are named.
ALIKE = 1.3
# Iterations for the bias, by Levenberg and Marquardt's method; after how many it shows whether it
# helps; and the step of its derivatives, rad/s.
ROUNDS, ENOUGH, STEP = 8, 3, 1e-3


def gyro_sign_findings(windows: Windows, topic: str) -> Iterator[Finding]:
    """Find a gyro, or an accelerometer, with an axis of the wrong sign.

    Parameters
    ----------
    windows : Windows
        In any right-handed axes, rates in rad/s.
    topic : str
        Of the IMU.
    """
    turns, force = _pieces(windows)
    if len(turns) < LEAST_PIECES:
        return
    # No bias leaves more than this
    most = np.square(_differences(turns[None], force)).sum(axis=3).mean()
    if not most > MOVES**2:
        return
    before = _moved(turns, force, np.ones(3))
    size = float(np.sqrt(before.mean()))
    if not size > MOVES:
        return
    found = {}
    for signs in list(product((1.0, -1.0), repeat=3))[1:]:
        moved = _moved(turns, force, np.array(signs), size**2)
        if float(np.mean(moved < before)) >= MOST:
            found[signs] = float(np.sqrt(moved.mean()))
    least = min(found.values(), default=np.inf)
    if not least < min(STAYS, SHARE * size):
        return
    likely = [signs for signs, moves in found.items() if moves < ALIKE * least]
    fewest = max(sum(signs) for signs in likely)
    ways = [_named(signs) for signs in likely if sum(signs) == fewest]
    yield Finding(
        "gyro-sense",
        f"topic {topic}: turned by the rates, gravity moves by {size:.1f} m/s^2 (RMS, over"
        f" {BLOCKS * BLOCK * WINDOW_NS / 1e9:.0f} s), but by only {least:.2f} if the gyro's sign"
        f" about {' or about '.join(ways)} is changed: gyro and accelerometer do not have the same"
        " axes, so do not trust what is computed from both",
        severity=Severity.LOST,
        answer="correct the driver or convert the log: at rest an accelerometer reads +9.8 m/s^2"
        " along the axis that points up, and turns to the left about that axis are positive rates",
        topic=topic,
        numbers={"moves_m_s2": size, "least_m_s2": least},
    )


def _named(signs: tuple[float, ...]) -> str:
    """Axes whose sign is changed, in words."""
    axes = [axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0.0]
    return axes[0] if len(axes) == 1 else f"{', '.join(axes[:-1])} and {axes[-1]}"


def _pieces(windows: Windows) -> tuple[FloatArray, FloatArray]:
    """Rotation vectors and mean specific force of the windows of pieces, shape (m, n, 3)."""
    n = BLOCKS * BLOCK
    turns = rotation.log(windows.turn[0]) if len(windows) else np.zeros((0, 3))
    breaks = np.flatnonzero(np.diff(windows.start_ns) != WINDOW_NS) + 1
    edges = zip(np.append(0, breaks), np.append(breaks, len(windows)), strict=True)
    first = np.concatenate([np.arange(a, b - n + 1, n // 2) for a, b in edges])
    rows = first[:, None].astype(np.int64) + np.arange(n)
    size = np.linalg.norm(turns, axis=1)[rows]
    rows, size = rows[(size < MOST_TURN).all(axis=1)], size[(size < MOST_TURN).all(axis=1)]
    most = np.sort(np.argsort(-size.sum(axis=1), kind="stable")[:MOST_PIECES])
    return turns[rows[most]], windows.accel[rows[most]]


def _moved(
    turns: FloatArray, force: FloatArray, signs: FloatArray, hopeless: float = np.inf
) -> FloatArray:
    """Mean square of what the blocks' forces differ by, (m/s^2)^2, of each piece.

    With the bias of the gyro, rad/s, that makes it least; roughly, if some rounds leave more than
    `hopeless` on average.
    """
    turns = turns * signs

    def left(bias: FloatArray) -> FloatArray:
        """By any number of biases, shape (k, 3)."""
        return _differences(turns - bias[:, None, None] * (WINDOW_NS / 1e9), force)

    bias = np.zeros(3)
    best = left(bias[None])[0]
    damping = 1e-2
    for number in range(ROUNDS):
        slopes = (left(bias + STEP * np.eye(3)) - best) / STEP
        jacobian = slopes.reshape(3, -1).T
        normal = jacobian.T @ jacobian
        damped = normal + damping * np.diag(np.diag(normal) + 1e-9)
        step = -np.linalg.solve(damped, jacobian.T @ best.ravel())
        other = left((bias + step)[None])[0]
        if np.sum(np.square(other)) < np.sum(np.square(best)):
            bias, best, damping = bias + step, other, damping / 5.0
        else:
            damping *= 10.0
        moved = np.asarray(np.square(best).sum(axis=2).mean(axis=1))
        if np.abs(step).max() < 0.1 * STEP or (number >= ENOUGH and moved.mean() > hopeless):
            break
    return moved


def _differences(turns: FloatArray, force: FloatArray) -> FloatArray:
    """Mean forces of blocks less that of their piece, in axes that do not turn.

    Parameters
    ----------
    turns : ndarray, shape (k, m, n, 3)
    force : ndarray, shape (m, n, 3)

    Returns
    -------
    ndarray, shape (k, m, BLOCKS, 3)
    """
    whole, half = rotation.exp(turns), rotation.exp(0.5 * turns)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (*turns.shape[:2], 1))
    fixed = np.empty_like(turns)
    for k in range(turns.shape[2]):
        fixed[:, :, k] = rotation.rotate(rotation.multiply(q, half[:, :, k]), force[:, k])
        q = rotation.multiply(q, whole[:, :, k])
    blocks = fixed.reshape(*turns.shape[:2], BLOCKS, BLOCK, 3).mean(axis=3)
    return np.asarray(blocks - blocks.mean(axis=2, keepdims=True))
