"""The verdict of a comparison: the algorithm that a log needs, or that it cannot tell.

An algorithm is named only where the log shows that it is accurate to the tolerance, for which the
reference itself must be that accurate. Otherwise only differences larger than the uncertainty of
the reference are stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sinstool.config.coning import DEFAULT_CONING
from sinstool.pipelines.compare_coning.divergence import IN_DEG_H, DriftStatistics, Row

# The uncertainty of the reference is itself known to a factor of two at best.
MARGIN = 2.0
# Costs within this factor are one: timing is little better, and all are far below reading the log.
SAME_COST = 4.0

Judged = tuple[Row, DriftStatistics]


@dataclass(frozen=True)
class Verdict:
    """Which algorithm to use on this log.

    Attributes
    ----------
    algorithm : str or None
        None where the log cannot tell.
    agree : bool
        All candidates agree to the tolerance: it does not matter.
    limit_dph : float or None
        Drift below which a candidate counts as the same as the reference, deg/h.
    """

    algorithm: str | None
    text: str
    agree: bool
    limit_dph: float | None = None


def verdict(
    rows: Sequence[Row],
    reference: str,
    resolution: float | None,
    tolerance: float,
    short: bool = False,
) -> Verdict:
    """Judge the candidates that were fed with the log as it is.

    Parameters
    ----------
    reference : str
        Name of the algorithm, ``truth`` or ``none``.
    resolution : float or None
        What the reference is good to, rad/s; None for a truth, and where it is unknown.
    tolerance : float
        Drift that does not matter, rad/s.
    short : bool
        The log is shorter than a window: what an algorithm lacks where it begins counts as drift
        then, and so little motion says nothing of other motion.

    Returns
    -------
    Verdict
        Drift is judged by its slope in each window: the same as the drift to the window's end
        where it grows evenly, without what only swings to and fro.
    """
    native = [
        (r, r.drift_dph) for r in rows if r.candidate.decimate == 1 and r.drift_dph is not None
    ]
    if reference == "none":
        return Verdict(None, "Without a reference no algorithm can be chosen", False)
    if not native:
        return Verdict(None, "The log is too short to choose by", False)
    if reference == "truth":
        judged = _against_truth(native, tolerance * IN_DEG_H)
    elif resolution is None:
        text = "The log is too short to judge the reference, so to choose by"
        return Verdict(None, text, False)
    else:
        judged = _against_reference(native, reference, resolution * IN_DEG_H, tolerance * IN_DEG_H)
    if short and judged.limit_dph is not None:
        text = (
            "The log is shorter than one window, too short to choose by."
            f" {_larger_differences(native, judged.limit_dph)}"
        )
        judged = Verdict(None, text, False, judged.limit_dph)
    if native[0][1].windows > 1:
        return judged
    return replace(judged, text=f"{judged.text} (one window only, so the spread is unknown)")


def _against_reference(
    native: list[Judged], reference: str, resolution: float, tolerance: float
) -> Verdict:
    """Judge by an algorithm; drifts in deg/h."""
    uncertainty = MARGIN * resolution
    limit = max(tolerance, uncertainty)
    others = [one for one in native if one[0].candidate.name != reference] or native
    if uncertainty <= tolerance:
        if max(d.slope_rms for _, d in native) <= tolerance:
            best = _preferred(native)
            text = (
                f"All algorithms agree to {tolerance:g} deg/h, so on this log the choice does not"
                f" matter; {best} is as good as any"
            )
            return Verdict(best, text, True, limit)
        return _named(others, reference, tolerance, fallback=reference)
    text = (
        f"This log cannot tell which algorithm is accurate to {tolerance:g} deg/h, as the"
        f" reference, {reference}, is itself uncertain by about {_short(uncertainty)} deg/h. "
    )
    return Verdict(None, text + _larger_differences(others, limit), False, limit)


def _against_truth(native: list[Judged], tolerance: float) -> Verdict:
    """Judge by a truth; drifts in deg/h.

    What the closest still lacks may point any way, and an algorithm's error may even it out. So
    only what is further off than that twice over is further off for sure.
    """
    least = min(d.slope_rms for _, d in native)
    if least <= tolerance:
        if max(d.slope_rms for _, d in native) <= tolerance:
            best = _preferred(native)
            text = f"All algorithms agree with the truth to {tolerance:g} deg/h, so any will do"
            return Verdict(best, text, True, tolerance)
        return _named(native, "the truth", tolerance, fallback=None)
    limit = max(least + tolerance, MARGIN * least)
    text = (
        f"The truth cannot tell which algorithm is accurate to {tolerance:g} deg/h, as even the"
        f" closest drifts from it by {_short(least)} deg/h. That is the sensor's error (its bias,"
        " above all), the Earth's rotation, the truth's own error, or what no algorithm here"
        " removes, such as coning beyond half the sampling rate. "
    )
    return Verdict(None, text + _larger_differences(native, limit), False, limit)


def _named(rows: list[Judged], reference: str, tolerance: float, fallback: str | None) -> Verdict:
    """Name the algorithm to use, and those that are further off than the tolerance."""
    good = [(r, d) for r, d in rows if d.slope_rms <= tolerance]
    far = _listed([(r, d) for r, d in rows if d.slope_rms > tolerance])
    if not good:
        text = f"None of the others is within {tolerance:g} deg/h of {reference}: {far}"
        return Verdict(fallback, text, False, tolerance)
    best = _preferred(good)
    same = [r.candidate.name for r, _ in good if r.candidate.name != best]
    equal = f"; so {'is' if len(same) == 1 else 'are'} {', '.join(same)}" if same else ""
    text = (
        f"{best} is cheap and within {tolerance:g} deg/h of {reference}{equal}. Larger drift: {far}"
    )
    return Verdict(best, text, False, tolerance)


def _larger_differences(rows: list[Judged], limit: float) -> str:
    """State which algorithms differ by more than the uncertainty, and which remain."""
    far = [(r, d) for r, d in rows if d.slope_rms > limit]
    close = [r.candidate.name for r, d in rows if d.slope_rms <= limit]
    default = f", and {DEFAULT_CONING}, the default, is among them" * (DEFAULT_CONING in close)
    if not far:
        return f"No two of them differ by more than that{default}"
    text = f"Only larger differences show: {_listed(far)}"
    if not close:
        return text
    if len(close) == 1:
        is_default = ", the default," if close[0] == DEFAULT_CONING else ""
        return f"{text}. Only {close[0]}{is_default} is within that uncertainty"
    return f"{text}. The others cannot be told apart{default}"


def _preferred(rows: Sequence[Judged]) -> str:
    """Cheap, then with the most attitudes, then close."""
    cheap = SAME_COST * min(r.ns_per_sample for r, _ in rows)
    some = [(r, d) for r, d in rows if r.ns_per_sample <= cheap]
    best, _ = min(some, key=lambda one: (-one[0].update_hz, one[1].slope_rms))
    return best.candidate.name


def _listed(rows: list[Judged]) -> str:
    """Names with their drifts, the largest first."""
    ordered = sorted(rows, key=lambda one: -one[1].slope_rms)
    names = [f"{r.candidate.name} {_short(d.slope_rms)}" for r, d in ordered]
    return f"{', '.join(names)} deg/h"


def _short(value: float) -> str:
    """Two digits, without an exponent where there is no need."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"
