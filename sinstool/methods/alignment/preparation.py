"""Both streams prepared for alignment: repeats, gaps, missing values, breaks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.english import counted
from sinstool.core.errors import AlignmentError
from sinstool.core.order_statistics import median
from sinstool.core.running_median import running_median
from sinstool.core.timeline import GAP_INTERVALS, SECOND
from sinstool.methods.alignment.gate import dynamics, saturated
from sinstool.methods.alignment.inflight_types import AlignmentSettings, GnssFixes, ImuIncrements
from sinstool.methods.strapdown.lost_samples import LostSamples

MISSING = 1.5
"""Of the usual interval: beyond, samples may be missing."""

BRIDGED_SAMPLES = 3
BRIDGED_NS = 100_000_000
"""Longest gap that is integrated across in any motion, where whole stretches are too short."""

MIN_SPAN_S = 10.0
MIN_POSITION_SPAN_S = 60.0
SILENT_GAP_S = 10.0
BROKEN_GAP_S = 60.0
MANY_MISSING = 0.2
ROUGH_FIX = 2.0
LEVEL_S = 5.0


@dataclass(frozen=True)
class Stretch:
    """Samples over which the chain of attitude holds.

    Attributes
    ----------
    after : str
        What broke the chain before it; empty at the start of the log.
    """

    imu: ImuIncrements
    after: str


def stretches(
    imu: ImuIncrements, settings: AlignmentSettings, bridged_ns: int = 0
) -> tuple[list[Stretch], list[str]]:
    """Split at gaps and at saturated samples.

    Parameters
    ----------
    bridged_ns : int, optional
        Gaps up to this are integrated across, whatever the motion.

    Returns
    -------
    parts : list of Stretch
        Those with at least two samples.
    warnings : list of str

    Notes
    -----
    Intervals up to `settings.max_gap_ns` are integrated across, as everywhere, and so are up to
    three missing samples in calm flight. Increments that cover only their usual interval gain the
    mean of the motion before and after for the rest, the mean of f telling whether they do.
    """
    warnings = []
    new = np.diff(imu.time_ns, prepend=imu.time_ns[:1] - 1) > 0
    if not new.all():
        warnings.append(f"{int((~new).sum())} IMU samples with repeated times are left out")
        imu = imu.rows(new)
    if settings.start_ns is not None or settings.end_ns is not None:
        first = imu.time_ns[0] if settings.start_ns is None else settings.start_ns
        last = imu.time_ns[-1] if settings.end_ns is None else settings.end_ns
        imu = imu.rows((imu.time_ns >= first) & (imu.time_ns <= last))
    if len(imu) < 2:
        raise AlignmentError("there are no IMU samples to align with", "widen start and end")
    step = np.diff(imu.time_ns)
    usual = float(median(step))
    missing = np.rint(step / usual) - 1
    longest = settings.max_gap_ns or GAP_INTERVALS * usual
    gaps = np.flatnonzero(step > min(MISSING * usual, longest))
    within = dynamics(imu, settings.limits.smooth).within(settings.limits)
    calm = within[0] & within[2]
    broken = np.zeros(len(imu), dtype=bool)
    reason = {}
    bridged, longest_bridged = 0, 0
    theta, velocity = imu.delta_theta, imu.delta_velocity
    for k in gaps:  # of which a log has few
        gap = step[k] > longest
        short = missing[k] <= BRIDGED_SAMPLES and calm[k] and calm[min(k + 2, len(calm) - 1)]
        if short or not gap or step[k] <= bridged_ns:
            if gap:
                bridged, longest_bridged = bridged + 1, max(longest_bridged, int(step[k]))
            length = step[k - 1] if k else usual
            before = np.linalg.norm(velocity[k]) / length
            if np.linalg.norm(velocity[k + 1]) < 0.5 * before * (step[k] + usual):
                if theta is imu.delta_theta:
                    theta, velocity = theta.copy(), velocity.copy()
                for of in (theta, velocity):
                    rate = 0.5 * (of[k] / length + of[k + 1] / usual)
                    of[k + 1] += (step[k] - usual) * rate
        else:
            broken[k + 1] = True
            reason[int(k + 1)] = f"a gap of {step[k] * 1e-9:.3f} s in the IMU"
    if bridged:
        most = f"of up to {longest_bridged * 1e-9:.3f} s"
        warnings.append(f"{counted(bridged, 'gap')} {most} in the IMU integrated across")
    if broken.any():
        many = f"{int(broken.sum())} gaps in the IMU interrupt the alignment; the longest is"
        one = "a gap in the IMU interrupts the alignment; it is"
        longest = step[np.flatnonzero(broken) - 1].max() * 1e-9
        warnings.append(f"{one if broken.sum() == 1 else many} {longest:.3f} s long")
    imu = ImuIncrements(imu.time_ns, theta, velocity)
    lost = saturated(imu, settings.gyro_limit, settings.accel_limit)
    if lost.any():
        last_s = (imu.time_ns[np.flatnonzero(lost)[-1]] - imu.time_ns[0]) * 1e-9
        warnings.append(
            f"{int(lost.sum())} saturated IMU samples, the last {last_s:.2f} s after the first"
            " sample: alignment starts after them"
        )
    edges = np.flatnonzero(broken | (np.diff(lost, prepend=lost[:1]) != 0))
    begins = np.concatenate([[0], edges])
    ends = np.concatenate([edges, [len(imu)]])
    parts = []
    for begin, end in zip(begins, ends, strict=True):
        if end - begin >= 2 and not lost[begin]:
            why = reason.get(int(begin), "saturated samples" if begin else "")
            parts.append(Stretch(imu.rows(slice(int(begin), int(end))), why))
    return parts, warnings


def walk_of_lost(imu: ImuIncrements) -> float:
    """Angle random walk of attitudes integrated across lost samples, rad/sqrt(s).

    Parameters
    ----------
    imu : ImuIncrements
        Of consecutive samples; their usual interval is the median.

    Returns
    -------
    float
        About the axis about which it is the largest; 0 where none was lost.
    """
    dt = np.diff(imu.time_ns) / SECOND
    usual = float(median(dt)) if len(dt) else 0.0
    if not (dt > MISSING * usual).any():
        return 0.0
    lost = LostSamples(usual, usual).push(dt, imu.delta_theta[1:], imu.delta_velocity[1:])
    return float(np.sqrt(lost[:, :3].sum(axis=0).max() / dt.sum()))


def prepare_fixes(
    gnss: GnssFixes, settings: AlignmentSettings
) -> tuple[GnssFixes, AlignmentSettings, list[str]]:
    """Fixes that can be used, stamped when they were valid, with a noise each.

    Returns
    -------
    gnss : GnssFixes
    settings : AlignmentSettings
        With ``vectors='pos'`` where there is no velocity. As two positions make no pair of vectors,
        ``triad`` then becomes ``svd``; where there is, it needs other vectors.
    warnings : list of str

    Raises
    ------
    AlignmentError
        If there is neither velocity nor position for a minute.
    """
    warnings = []
    if settings.method == "triad" and settings.vectors == "pos":
        settings = replace(settings, vectors="int")
    new = np.diff(gnss.time_ns, prepend=gnss.time_ns[:1] - 1) > 0
    if not new.all():
        warnings.append(f"{counted(int((~new).sum()), 'fix')} with repeated times left out")
    placed = np.isfinite(gnss.latitude) & np.isfinite(gnss.longitude) & np.isfinite(gnss.height)
    gnss = gnss.rows(new & placed)
    sigma = np.full(len(gnss), settings.gnss_sigma_v)
    if gnss.sigma_v is not None:
        own = np.isfinite(gnss.sigma_v) & (gnss.sigma_v > 0.0)
        sigma = np.where(own, gnss.sigma_v, sigma)
    latency = round(settings.gnss_latency_s * 1e9)
    gnss = replace(gnss, time_ns=gnss.time_ns - latency, sigma_v=sigma)
    good = np.ones(len(gnss), dtype=bool)
    if settings.start_ns is not None:
        good &= gnss.time_ns >= settings.start_ns
    if settings.end_ns is not None:
        good &= gnss.time_ns <= settings.end_ns
    gnss = gnss.rows(good)
    rough = rough_fixes(gnss.time_ns, np.asarray(gnss.sigma_v))
    if rough.any() and settings.vectors != "pos":
        warnings.append(
            f"{int(rough.sum())} of {len(rough)} fixes are not used, as velocities there are much"
            " less certain than those of their neighbours"
        )
        gnss = gnss.rows(~rough)
    if settings.vectors == "pos":
        return gnss, settings, warnings
    moving = np.isfinite(gnss.velocity_n).all(axis=1)
    if _span_s(gnss.time_ns[moving]) >= MIN_SPAN_S - 2.0 * _usual_s(gnss.time_ns):
        missing = 1.0 - moving.mean()
        if missing >= MANY_MISSING:
            warnings.append(f"{missing:.0%} of the fixes have no velocity and are not used")
        return gnss.rows(moving), settings, warnings
    span = _span_s(gnss.time_ns)
    if span < MIN_POSITION_SPAN_S:
        raise AlignmentError(
            f"alignment in flight needs GNSS velocity for {MIN_SPAN_S:g} s, or positions for"
            f" {MIN_POSITION_SPAN_S:g} s, and{_where(settings)} there are velocities for"
            f" {_span_s(gnss.time_ns[moving]):.1f} s and positions for {span:.1f} s",
            "choose a longer span, or use --align level or log",
        )
    text = "the fixes have no velocity: aligned by positions, which takes a minute"
    if settings.method == "triad":
        text += ", and by svd, as triad needs velocity"
        settings = replace(settings, method="svd")
    warnings.append(text)
    return gnss, replace(settings, vectors="pos"), warnings


def _where(settings: AlignmentSettings) -> str:
    """Which fixes count, where not all of a log do."""
    if settings.start_ns is None and settings.end_ns is None:
        return ""
    return " in the span to align with"


def rough_fixes(time_ns: IntArray, sigma_v: FloatArray) -> BoolArray:
    """Which fixes are much noisier than their neighbours, shape (n,).

    Parameters
    ----------
    sigma_v : ndarray, shape (n,)
        Of a velocity, m/s.
    """
    return np.asarray(sigma_v > ROUGH_FIX * noise_level(sigma_v, _usual_s(time_ns)))


def noise_level(sigma: FloatArray, interval_s: float) -> FloatArray:
    """Running median of the noise of fixes over 5 s to each side, shape (n,).

    In differences over a window the noise of a fix nearly cancels with that of the next window,
    unless their weights differ: weights therefore follow the level of the noise, not the noise
    of each fix, and single rough fixes are left out altogether.
    """
    if not len(sigma) or not interval_s > 0.0 or np.all(sigma == sigma[0]):
        return sigma.copy()
    width = 2 * max(round(LEVEL_S / interval_s), 1) + 1
    return running_median(sigma, width)


def _span_s(time_ns: IntArray) -> float:
    return float(time_ns[-1] - time_ns[0]) * 1e-9 if len(time_ns) else 0.0


def _usual_s(time_ns: IntArray) -> float:
    return float(median(np.diff(time_ns))) * 1e-9 if len(time_ns) > 1 else 0.0


def gap_edges(time_s: FloatArray) -> tuple[IntArray, float]:
    """Rows of the fixes after gaps that are too long to integrate across.

    Parameters
    ----------
    time_s : ndarray, shape (n,)

    Returns
    -------
    edges : ndarray of int64
        Rows after a gap of more than 60 s.
    longest : float
        Longest of the other gaps, s.
    """
    step = np.diff(time_s)
    broken = step > BROKEN_GAP_S
    longest = float(step[~broken].max()) if (~broken).any() else 0.0
    return np.flatnonzero(broken) + 1, longest
