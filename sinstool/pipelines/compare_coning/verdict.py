"""Which algorithm to use on a log, in words that the log supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sinstool.pipelines.compare_coning.divergence import DEG_H, DriftStatistics, Row

# What the reference is good to is itself known to a factor of two at best.
MARGIN = 2.0
# Costs within this factor are one: timing is little better, and all are far below reading the log.
SAME_COST = 4.0


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
    rows: Sequence[Row], reference: str, resolution: float | None, tolerance: float
) -> Verdict:
    """Judge the candidates that were fed with the log as it is.

    Parameters
    ----------
    reference : str
        Name of the algorithm, ``truth`` or ``none``.
    resolution : float or None
        What the reference is good to, rad/s; None for a truth, and where nobody can say.
    tolerance : float
        Drift that does not matter, rad/s.

    Returns
    -------
    Verdict
        Drift is judged by its slope in each window: the same as the drift to the window's end
        where it grows evenly, without what only swings to and fro.
    """
    native = [(r, r.drift) for r in rows if r.candidate.decimate == 1 and r.drift is not None]
    if reference == "none":
        return Verdict(None, "without a reference there is nothing to choose by", False)
    if not native:
        return Verdict(None, "the log is too short to choose by", False)
    if reference == "truth":
        judged = _against_truth(native, tolerance)
    else:
        judged = _against_reference(native, reference, resolution, tolerance)
    if native[0][1].windows > 1:
        return judged
    return replace(judged, text=f"{judged.text} (of one window: nothing is known of the spread)")


def _against_reference(
    native: list[tuple[Row, DriftStatistics]],
    reference: str,
    resolution: float | None,
    tolerance: float,
) -> Verdict:
    largest = max(d.slope_rms for _, d in native)
    others = [one for one in native if one[0].candidate.name != reference] or native
    if resolution is None:
        return Verdict(None, "the log is too short to judge the reference, so to choose by", False)
    limit = max(tolerance, MARGIN * resolution) * DEG_H
    if largest <= tolerance * DEG_H and resolution <= tolerance:
        best = _preferred(native)
        text = (
            f"all agree to {tolerance * DEG_H:g} deg/h: on this log the choice does not matter;"
            f" {best} is as good as any"
        )
        return Verdict(best, text, True, limit)
    good = [r for r, d in others if d.slope_rms <= limit]
    far = [(r.candidate.name, d) for r, d in others if d.slope_rms > limit]
    if not far:
        text = (
            f"the log cannot tell them apart: none parts from {reference} by more than"
            f" {_short(largest)} deg/h, and that is good to about"
            f" {_short(resolution * DEG_H)} deg/h only"
        )
        return Verdict(None, text, False, limit)
    apart = ", ".join(f"{name} by {_short(d.slope_rms)}" for name, d in _by_size(far))
    if not good:
        text = f"none comes within {_short(limit)} deg/h of {reference}: {apart} deg/h part from it"
        return Verdict(reference, text, False, limit)
    best = _preferred([(r, d) for r, d in others if r in good])
    same = [r.candidate.name for r in good if r.candidate.name != best]
    equal = f" (as {'does' if len(same) == 1 else 'do'} {', '.join(same)})"
    text = (
        f"{best}: cheap, and within {_short(limit)} deg/h of {reference}"
        f"{equal if same else ''}; these part from it: {apart} deg/h"
    )
    return Verdict(best, text, False, limit)


def _against_truth(native: list[tuple[Row, DriftStatistics]], tolerance: float) -> Verdict:
    """What the closest still lacks may point any way, and an algorithm's error may even it out.

    So only what is further off than that twice over is further off for sure.
    """
    least = min(d.slope_rms for _, d in native)
    limit = max(least + tolerance * DEG_H, 2.0 * least)
    good = [(r, d) for r, d in native if d.slope_rms <= limit]
    far = [(r.candidate.name, d) for r, d in native if d.slope_rms > limit]
    best = _preferred(good)
    if not far and max(d.slope_rms for _, d in native) <= tolerance * DEG_H:
        text = f"all agree with the truth to {tolerance * DEG_H:g} deg/h: any will do"
        return Verdict(best, text, True, limit)
    rest = (
        f". The {_short(least)} deg/h in all of them are errors of the sensor (its bias, above all)"
        " and of the truth, or what no algorithm here takes out"
        if least > tolerance * DEG_H
        else ""
    )
    if not far:
        text = (
            "the truth cannot tell them apart: all are between"
            f" {_short(least)} and {_short(max(d.slope_rms for _, d in native))} deg/h from it"
        )
        return Verdict(None, f"{text}{rest}", False)
    same = [r.candidate.name for r, _ in good if r.candidate.name != best]
    text = f"{best}: cheap, and within {_short(limit)} deg/h of the truth"
    text += f" (as {'does' if len(same) == 1 else 'do'} {', '.join(same)})" if same else ""
    apart = ", ".join(f"{name} by {_short(d.slope_rms)}" for name, d in _by_size(far))
    return Verdict(best, f"{text}; these part from it: {apart} deg/h{rest}", False, limit)


def _preferred(rows: Sequence[tuple[Row, DriftStatistics]]) -> str:
    """Cheap, then with the most attitudes, then close."""
    cheap = SAME_COST * min(r.ns_per_sample for r, _ in rows)
    some = [(r, d) for r, d in rows if r.ns_per_sample <= cheap]
    best, _ = min(some, key=lambda one: (-one[0].update_hz, one[1].slope_rms))
    return best.candidate.name


def _short(value: float) -> str:
    """Two digits, without an exponent where there is no need."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def _by_size(rows: list[tuple[str, DriftStatistics]]) -> list[tuple[str, DriftStatistics]]:
    return sorted(rows, key=lambda one: -one[1].slope_rms)
