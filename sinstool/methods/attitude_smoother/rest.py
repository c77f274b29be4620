"""Rest: two seconds in which the means of epochs stay constant, unless a filter refutes it.

Steady travel and wide turns look like rest. They differ in a rate too large for a gyro bias, in a
specific force that is not vertical, and in the velocity that a filter estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from sinstool.core.earth import EARTH_RATE, SEMI_MAJOR_AXIS
from sinstool.core.order_statistics import median
from sinstool.core.running_median import running_median
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    ACCEL_VARIANCE,
    AT_REST,
    COUNT,
    FORCE_DOUBT,
    GYRO,
    GYRO_VARIANCE,
    MOVING,
    OWN_RATE,
    OWN_VARIANCE,
    QUIET,
    RATE_DOUBT,
    REST,
    STEADY,
    SWAY_FORCE,
    SWAY_RATE,
    TURN_DOUBT,
    Epochs,
)
from sinstool.methods.attitude_smoother.filter_step import DIVERGED, SWAY_LASTS
from sinstool.methods.attitude_smoother.model import (
    EPOCH_S,
    FIRST_VELOCITY,
    GRAVITY,
    POOR_ACCEL_BIAS,
    VEHICLE,
    SensorModel,
)
from sinstool.methods.attitude_smoother.quiet_doubt import WINDOW, noise_of_mean, note_doubt, runs
from sinstool.methods.attitude_smoother.start import filtered
from sinstool.methods.lulls import lulls
from sinstool.methods.sensor_errors import CALIBRATED, LIKELY

AT_ONCE = 4096  # windows
# Largest scatter at rest of the means of epochs, beyond their noise, and of single samples.
GYRO_SCATTER, ACCEL_SCATTER = 0.12 * DEGREE, 0.03  # rad/s, m/s^2
GYRO_NOISE, ACCEL_NOISE = 1.3 * DEGREE, 0.5
# Gyro biases are smaller than this, rad/s.
LARGEST_BIAS = 0.2
# The means of epochs sway if their variance exceeds this many times that of gyro noise, or of the
# quietest rest. What sways may be afloat, in the air or on a smooth road: it does not accelerate,
# but need not stand still.
SWAYS = 3.0**2
# A rest sways as a whole if its median variance exceeds that of its noise by a fifth, by three
# sigma of an estimate from so many epochs, and exceeds QUIET_RATE^2, the correlated noise of
# sensors, rad/s.
SWAYS_SLIGHTLY, QUIET_RATE = 1.2, 2e-4
# The mean rate over this window is compared with the bias: it shows turns slower than the sway.
LONG_WINDOW = 100  # epochs
# The transport rate: what travels turns with the vertical, rad/s.
TRANSPORT_RATE = FIRST_VELOCITY / SEMI_MAJOR_AXIS
# A steady time shorter than this is a lull of the motion, in which a slow acceleration may go on.
LULL = 25  # epochs
# A rest shorter than this share of the longest must have the rate of the longest.
SHORT_SHARE = 1.0 / 3.0
# The share of a quiet time at least as long as LULL that must not be refuted, or none of it is
# rest.
LEAST_SHARE = 0.5
# All rests of a log show the same bias, rad/s, and the same size of gravity, m/s^2, to within this;
# steady turns show others.
SAME_BIAS, SAME_FORCE = 0.02, 0.15
# What swings all the time is quiet where its rate is largest, to one side and to the other. So
# where all quiet times are shorter than a lull, this share of them must show the same rate.
MOST_ALIKE = 2.0 / 3.0
# Uncalibrated accelerometers show another size of gravity in each attitude. So the size does not
# count where the rate agrees with that of the other rests to this, rad/s, beside noise.
EQUAL_BIAS, POOR_FORCE = CALIBRATED, LIKELY * POOR_ACCEL_BIAS
# The columns of an epoch that say whether it is at rest, and how doubtful that is.
MARKS = [REST, RATE_DOUBT, TURN_DOUBT, FORCE_DOUBT]


def with_rest(
    epochs: Epochs,
    moves: Callable[[int, int], bool] | None = None,
    spans: Iterable[tuple[int, int]] = (),
) -> Epochs:
    """Mark the epochs at rest.

    Parameters
    ----------
    epochs : Epochs
        They are marked in place, as a long log's take much memory.
    moves : callable, optional
        Whether something else, as GNSS, shows motion between two times (ns).
    spans : iterable of (int, int), optional
        Times (ns) between which something else shows rest: where an engine idles the means of
        epochs scatter by more than their noise explains.

    Returns
    -------
    Epochs
        The same.
    """
    values = epochs.values
    values[:, REST] = 0.0
    still = _still(epochs)
    for start_ns, end_ns in spans:
        still |= (epochs.time_ns[:-1] >= start_ns) & (epochs.time_ns[1:] <= end_ns) & ~epochs.gap
    for begin, end in runs(still):
        if moves is not None and moves(int(epochs.time_ns[begin]), int(epochs.time_ns[end])):
            still[begin:end] = False
    _note_sway(values, still)
    still &= _of_gravity(values, epochs.gap) & ~_slow_motion(epochs, still)
    still &= _agreeing(values, still) & (not _swings(values, still))
    values[still, REST] = AT_REST
    return epochs


def confirmed(
    epochs: Epochs, sensors: SensorModel, tilt: float | None = None, in_place: bool = False
) -> Epochs:
    """The epochs, without the rests that the states of a filter refute.

    Parameters
    ----------
    epochs : Epochs
        With those marked that look like rest.
    sensors : SensorModel
    tilt : float, optional
        See :func:`~sinstool.methods.attitude_smoother.start.first_state`.
    in_place : bool, optional
        Mark the epochs themselves, as those of a long log take much memory; only `MARKS` change.

    Returns
    -------
    Epochs
        Refuted epochs, and those within two seconds of one, are moving. Epochs that sway by more
        than noise are at most steady; they are quiet where they last less than five seconds, or
        where the tilt leaves room for a steady acceleration. Rest becomes quiet, too, where more
        than half of five seconds or longer is refuted, and where less than a window looked like
        rest.
    """
    still = epochs.rest
    if not still.any():
        return epochs
    rows = epochs.values if in_place else epochs.values.copy()
    looked = rows[:, MARKS].copy()
    sway = rows[:, SWAY_RATE]
    # the median of sway: the last epochs of a rest may sway more as motion begins
    usual = float(median(sway[still]))
    _drop_short_turns(rows, epochs.time_ns, still, sensors, usual)
    quiet = min(median(sway[begin:end]) for begin, end in runs(still))
    own = rows[:, OWN_RATE]
    sways = still & (sway > SWAYS * np.minimum(own, quiet))
    for begin, end in runs(still):
        slightly = max(SWAYS_SLIGHTLY, 1.0 + 3.0 * np.sqrt(2.0 / (3.0 * (end - begin))))
        noise = float(median(own[begin:end]))
        about = float(median(sway[begin:end]))
        sways[begin:end] |= about > max(slightly * noise, QUIET_RATE**2)
    rows[sways & (rows[:, REST] > MOVING), REST] = STEADY
    drop_lulls(rows)
    kinds = np.zeros(len(epochs))
    # In place, as a long log's epochs take much memory
    kept = rows[:, GYRO : GYRO + 3].copy(), rows[:, RATE_DOUBT].copy()
    _set_long_medians(rows, still, usual)
    diverged = filtered(replace(epochs, values=rows), VEHICLE, sensors, tilt, kinds) == DIVERGED
    rows[:, GYRO : GYRO + 3], rows[:, RATE_DOUBT] = kept
    if diverged:
        rows[:, MARKS] = looked
        return epochs
    denied = still & (kinds == MOVING)
    near = np.convolve(denied, np.ones(2 * WINDOW + 1))[WINDOW:-WINDOW] > 0.0
    rows[:, REST] = np.where(near, MOVING, kinds)
    _drop_remains(rows[:, REST], still)
    drop_lulls(rows)
    _drop_pieces(rows, still)
    note_doubt(rows, still, sensors)
    return replace(epochs, values=rows)


def drop_turns(seen: Epochs, removed: np.ndarray, most: float) -> None:
    """Mark apparent rests as moving if their rate exceeds any bias, rad/s."""
    rows = seen.values
    for begin, end in runs(seen.rest):
        rate = rows[begin:end, GYRO : GYRO + 3].mean(axis=0) + removed
        if np.linalg.norm(rate) > most:
            rows[begin:end, REST] = MOVING


def drop_lulls(rows: np.ndarray) -> None:
    """Mark steady epochs as quiet where they last for less than `LULL`."""
    for begin, end in runs(rows[:, REST] == STEADY):
        if end - begin < LULL:
            rows[begin:end, REST] = QUIET


def _drop_remains(kinds: np.ndarray, still: np.ndarray) -> None:
    """Mark as moving what is left of a refuted rest, and is only quiet, where it is too short."""
    for begin, end in runs(kinds > MOVING):
        whole = not still[begin - 1 : begin].any() and not still[end : end + 1].any()
        short = end - begin < WINDOW // 2 and (kinds[begin:end] < AT_REST).all()
        if short and not whole:
            kinds[begin:end] = MOVING


def _drop_pieces(rows: np.ndarray, still: np.ndarray) -> None:
    """Mark rest as quiet where it is too small a part of a quiet time, or of a window."""
    kinds = rows[:, REST]
    pieces = [(begin, end, np.inf) for begin, end in runs(still) if end - begin < WINDOW]
    pieces += [(a, b, LEAST_SHARE) for a, b in runs(kinds > MOVING) if b - a >= LULL]
    for begin, end, least in pieces:
        rest = kinds[begin:end] == AT_REST
        if np.mean(rest) < least:
            kinds[begin:end][rest] = QUIET


def _set_long_medians(rows: np.ndarray, still: np.ndarray, usual: float) -> None:
    """Set the rates of epochs at rest to running medians over a long window, and their doubt.

    Unlike a mean, a median is not moved by a turn that begins where a rest ends.
    """
    for begin, end in runs(still):
        wide = min(LONG_WINDOW, end - begin)
        rate = slice(GYRO, GYRO + 3)
        rows[begin:end, rate] = running_median(rows[begin:end, rate], wide)
        rows[begin:end, RATE_DOUBT] = usual * min(1.0, SWAY_LASTS / wide) + TRANSPORT_RATE**2


def _drop_short_turns(
    rows: np.ndarray, time_ns: np.ndarray, still: np.ndarray, sensors: SensorModel, usual: float
) -> None:
    """Mark short rests as moving whose rate differs from that of the longest: slow turns."""
    first, last = max(runs(still), key=lambda run: run[1] - run[0])
    rate = rows[:, GYRO : GYRO + 3] - median(rows[first:last, GYRO : GYRO + 3], axis=0)
    at = time_ns[:-1]
    apart_s = np.maximum(np.maximum(at[first] - at, at - at[last - 1]), 0) / SECOND
    sway = sensors.zero_rate**2 + usual
    unlike = LIKELY * np.sqrt(sway + (sensors.bias_drift * apart_s) ** 2) + EARTH_RATE
    other = still & (np.linalg.norm(rate, axis=1) > unlike)
    for begin, end in runs(other):
        if end - begin < SHORT_SHARE * (last - first):
            rows[begin:end, REST] = MOVING


def _of_gravity(rows: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Epochs with a specific force of gravity's size, or of its usual one in the log."""
    force = np.linalg.norm(rows[:, ACCEL : ACCEL + 3], axis=1)
    usual = float(median(force[~gap])) if not gap.all() else GRAVITY
    return np.asarray(np.minimum(np.abs(force - GRAVITY), np.abs(force - usual)) < POOR_FORCE)


def _slow_motion(epochs: Epochs, still: np.ndarray) -> np.ndarray:
    """Epochs of apparent rests that may be part of a slow motion."""
    rows, found = epochs.values, runs(still)
    squares = [rows[:, at : at + 3].sum(axis=1) for at in (GYRO_VARIANCE, ACCEL_VARIANCE)]
    joined = ~(epochs.gap | np.concatenate(([True], epochs.gap[:-1])))
    moving = np.zeros(len(rows), np.bool_)
    marked = lulls(
        rows[:, GYRO : GYRO + 3],
        noise_of_mean(rows),
        np.column_stack(squares),
        joined,
        found,
        EPOCH_S,
    )
    for (begin, end), lull in zip(found, marked, strict=True):
        moving[begin:end] = lull
    return moving


def _note_sway(rows: np.ndarray, still: np.ndarray) -> None:
    """Set the variances of the means of epochs within their windows, and those due to noise.

    Samples that a sensor filters are alike, so that their mean is less certain than that of others.
    Parts of an epoch show that, each poorly, but it is the same throughout the log.
    """
    times = []
    for begin, end in runs(still):
        part = rows[begin:end]
        wide = min(WINDOW, len(part))
        for mean, sway in ((GYRO, SWAY_RATE), (ACCEL, SWAY_FORCE)):
            about = part[:, mean : mean + 3] - part[:, mean : mean + 3].mean(axis=0)
            square = _over_windows((about**2).mean(axis=1), wide)
            for axis in about.T:
                square -= _over_windows(axis, wide) ** 2 / 3.0
            part[:, sway] = _of_windows(square * wide / max(wide - 1, 1), len(part))
        white = part[:, GYRO_VARIANCE : GYRO_VARIANCE + 3].mean(axis=1)
        part[:, OWN_RATE] = mean_over(white / np.maximum(part[:, COUNT], 1.0), wide)
        noisy = part[:, OWN_RATE] > 0.0
        own = mean_over(part[:, OWN_VARIANCE], wide)
        times.append(own[noisy] / part[noisy, OWN_RATE])
    if still.any():
        together = np.concatenate(times)
        # The median, as means of parts differ by more where motion begins or ends
        rows[still, OWN_RATE] *= max(1.0, float(median(together))) if len(together) else 1.0


def _over_windows(column: np.ndarray, wide: int) -> np.ndarray:
    """Means over all windows of so many epochs."""
    return np.convolve(column, np.full(wide, 1.0 / wide), "valid")


def mean_over(column: np.ndarray, wide: int) -> np.ndarray:
    """Mean over the means of all windows of so many epochs that contain each epoch."""
    return _of_windows(_over_windows(column, wide), len(column))


def _of_windows(windows: np.ndarray, count: int) -> np.ndarray:
    """Mean over the windows that contain each epoch."""
    ones = np.ones(count - len(windows) + 1)
    return np.convolve(windows, ones) / np.convolve(np.ones(len(windows)), ones)


def _still(epochs: Epochs) -> np.ndarray:
    """Epochs of windows in which nothing seems to move."""
    rows, gap = epochs.values, epochs.gap
    still = np.zeros(len(rows), np.bool_)
    for begin, end in runs(~gap):
        # so many windows at a time, as each of their epochs is in memory once for every window
        for first in range(begin, end - WINDOW + 1, AT_ONCE):
            last = min(first + AT_ONCE + WINDOW - 1, end)
            quiet = _quiet(rows[first:last])
            still[first:last] |= np.convolve(quiet, np.ones(WINDOW)) > 0.0
    return still


def _quiet(part: np.ndarray) -> np.ndarray:
    """Whether nothing seems to move in each window, shape (n - WINDOW + 1,)."""
    count = np.maximum(part[:, COUNT], 1.0)[:, None]
    quiet = np.ones(len(part) - WINDOW + 1, np.bool_)
    for mean, square, least, most in (
        (GYRO, GYRO_VARIANCE, GYRO_SCATTER, GYRO_NOISE),
        (ACCEL, ACCEL_VARIANCE, ACCEL_SCATTER, ACCEL_NOISE),
    ):
        variance = _window_mean(part[:, square : square + 3])
        own = _window_mean(part[:, square : square + 3] / count)
        scatter = _window_variance(part[:, mean : mean + 3])
        quiet &= (scatter < least**2 + own).all(axis=1)
        quiet &= (variance < most**2).all(axis=1)
    rate = _window_mean(part[:, GYRO : GYRO + 3])
    quiet &= np.linalg.norm(rate, axis=1) < LARGEST_BIAS
    return quiet


def _window_mean(columns: np.ndarray) -> np.ndarray:
    # Column by column of the windows, as NumPy takes its time over so short an axis
    return np.asarray(sum(_in_windows(columns)) / WINDOW)


def _window_variance(columns: np.ndarray) -> np.ndarray:
    mean = _window_mean(columns)
    return np.asarray(sum((each - mean) ** 2 for each in _in_windows(columns)) / WINDOW)


def _in_windows(columns: np.ndarray) -> list[np.ndarray]:
    """The first rows of all windows, the second rows, and so on."""
    count = len(columns) - WINDOW + 1
    return [columns[k : k + count] for k in range(WINDOW)]


def _agreeing(rows: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Epochs whose rate and specific force are about those of most of the rests."""
    if not still.any():
        return still
    rate = rows[:, GYRO : GYRO + 3] - median(rows[still, GYRO : GYRO + 3], axis=0)
    force = np.linalg.norm(rows[:, ACCEL : ACCEL + 3], axis=1)
    own = np.linalg.norm(np.sqrt(rows[:, GYRO_VARIANCE : GYRO_VARIANCE + 3]), axis=1)
    unlike, off = np.linalg.norm(rate, axis=1), np.abs(force - median(force[still]))
    near = unlike < SAME_BIAS + own
    return np.asarray(near & (off < np.where(_same_rate(rows, still), POOR_FORCE, SAME_FORCE)))


def _swings(rows: np.ndarray, still: np.ndarray) -> bool:
    """Whether there are only short quiet times, and these are those of a swing."""
    found = runs(still)
    if not found or max(end - begin for begin, end in found) >= LULL:
        return False
    usual = median(rows[still, GYRO : GYRO + 3], axis=0)
    noise, alike = noise_of_mean(rows), 0
    for begin, end in found:
        off = rows[begin:end, GYRO : GYRO + 3].mean(axis=0) - usual
        own = LIKELY * np.sqrt(3.0 * noise[begin:end].mean() / (end - begin))
        alike += (end - begin) * int(np.linalg.norm(off) < EQUAL_BIAS + own)
    return alike < MOST_ALIKE * int(np.count_nonzero(still))


def _same_rate(rows: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Epochs whose rate is that of most of the rests, beside noise."""
    off = rows[:, GYRO : GYRO + 3] - median(rows[still, GYRO : GYRO + 3], axis=0)
    own = np.linalg.norm(np.sqrt(rows[:, GYRO_VARIANCE : GYRO_VARIANCE + 3]), axis=1)
    noise = LIKELY * own / np.sqrt(np.maximum(rows[:, COUNT], 1.0))
    return np.asarray(np.linalg.norm(off, axis=1) < EQUAL_BIAS + noise)
