"""A run of `process` in a few sentences: duration, distance, accuracy, assumptions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sinstool.core.english import counted

if TYPE_CHECKING:
    from sinstool.pipelines.process import filter_used, summary
    from sinstool.pipelines.process.result import ProcessResult
    from sinstool.pipelines.process.travel import Accuracy, Travel

WHAT = {
    "attitude": "Only attitude was computed, from the IMU",
    "turntable": "Attitude on the turntable was computed, and its heading corrected",
    "ins": "Attitude, velocity and position were computed from the IMU alone",
    "ins-gnss": "Attitude, velocity and position were computed from the IMU and GNSS",
}
# Ratios of squared innovations to their expectation beyond which the text gives advice
LOW_NIS, HIGH_NIS = 0.5, 2.0


def account(result: ProcessResult) -> tuple[str, ...]:
    """Paragraphs for the page, above its figures.

    Returns
    -------
    tuple of str
        What was computed, for how long and how far; its accuracy; what was assumed.
    """
    accuracy = [_accuracy(result), _against_truth(result)]
    parts = (
        " ".join(filter(None, (_extent(result), _fixes(result.filter)))),
        " ".join(filter(None, accuracy)),
        _assumptions(result),
    )
    return tuple(part for part in parts if part)


def heading_origin(result: ProcessResult) -> str:
    """The north from which headings count, in words; '' if nothing in the log shows it."""
    smoothing = result.smoothing
    magnetometer = None if smoothing is None else smoothing.magnetometer
    if magnetometer is not None and not magnetometer.refused:
        unverified = "the magnetometer's north, which could not be verified"
        return {"true": "true north", "magnetic": "magnetic north"}.get(
            magnetometer.north, unverified
        )
    return "true north" if result.alignment.north_referenced else ""


def duration(seconds: float) -> str:
    """A length of time in a convenient unit."""
    if seconds < 600.0:
        return f"{seconds:.4g} s"
    return f"{seconds / 60.0:.1f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.2f} h"


def distance(metres: float) -> str:
    """A distance, in m or km."""
    return f"{metres:.3g} m" if metres < 1000.0 else f"{metres / 1000.0:.2f} km"


def _extent(result: ProcessResult) -> str:
    travel, number = result.travel, counted(result.output.attitudes, "attitude")
    text = f"{WHAT[result.plan.mode.value]}: {number} over {duration(travel.duration_s)}"
    return text + _way(travel) + "."


def _way(travel: Travel) -> str:
    if travel.distance_m is None or travel.largest_speed_m_s is None:
        return ""
    mean = travel.mean_speed_m_s or 0.0
    return (
        f" and {distance(travel.distance_m)} over ground, at {mean:.3g} m/s on average and at most"
        f" {travel.largest_speed_m_s:.3g} m/s"
    )


def _fixes(used: filter_used.FilterUsed | None) -> str:
    if used is None:
        return ""
    count = f"{used.epochs_used} GNSS epochs were used"
    if used.epochs_gated:
        count += f" and {used.epochs_gated} rejected"
    out = used.outages
    if not out.count:
        return f"{count}, without an outage."
    if out.count == 1:
        return f"{count}, with one outage of {duration(out.longest_s)}."
    return (
        f"{count}, with {out.count} outages of {duration(out.total_s)} in all, the longest of"
        f" {duration(out.longest_s)}."
    )


def _accuracy(result: ProcessResult) -> str:
    accuracy, north = result.travel.accuracy, heading_origin(result)
    heading = "" if north else " Nothing in the log shows north, so only changes of heading count."
    if accuracy is None:
        if result.hse is not None:
            return ""
        return (
            "From the first attitude on, the gyros alone carry it; this run does not estimate how"
            f" accurate it stays.{heading}"
        )
    drifted = result.smoothing is not None and result.smoothing.heading_lost
    lost = " Heading is not known at the end." if drifted else ""
    return (
        f"By the run's own estimate, {_sigmas(accuracy, result.smoothing)} (one standard deviation,"
        f" median over the log).{lost}{heading}"
    )


def _sigmas(accuracy: Accuracy, smoothing: summary.AttitudeSmoothing | None) -> str:
    parts = [f"roll and pitch are known to {accuracy.tilt_deg.median:.2g} deg"]
    if smoothing is None or not smoothing.heading_lost:
        parts.append(f"heading to {accuracy.heading_deg.median:.2g} deg")
    if accuracy.horizontal_m is not None and accuracy.height_m is not None:
        parts.append(
            f"position to {accuracy.horizontal_m.median:.2g} m north and east and"
            f" {accuracy.height_m.median:.2g} m in height"
        )
    *before, last = parts
    return f"{', '.join(before)} and {last}" if before else last


def _against_truth(result: ProcessResult) -> str:
    truth = result.truth
    kinds = [] if truth is None else truth.kinds()
    if truth is None or not kinds:
        return ""
    parts = []
    for what, unit, error in kinds:
        parts.append(f"{what} {', '.join(f'{v:.2g}' for v in error.rms)} {unit}")
    return (
        f"Against {', '.join(truth.names)} the errors (rms; north, east, down) are:"
        f" {'; '.join(parts)}."
    )


def _assumptions(result: ProcessResult) -> str:
    plan = result.plan
    parts = [
        f"mode {plan.mode.value}, {plan.mode.reason}",
        f"first attitude {plan.first_attitude.value}, {_first(result)}",
        f"gyro samples {plan.gyro_samples.value}, {plan.gyro_samples.reason}",
        f"IMU grade {plan.imu_grade.value}, {plan.imu_grade.reason}",
    ]
    return "Assumed and chosen: " + "; ".join([*parts, *_vehicle(result.filter)]) + "."


def _first(result: ProcessResult) -> str:
    """Reason for the first attitude, without repeating its method."""
    choice = result.plan.first_attitude
    return choice.reason.removeprefix(f"attitude by {choice.value} ")


def _vehicle(used: filter_used.FilterUsed | None) -> list[str]:
    if used is None:
        return []
    vehicle = used.vehicle
    holds = "a vehicle that may slide" if vehicle.land is None else "a vehicle that does not slide"
    return [f"{holds}, {vehicle.reason}"]


def squares(mean_nis: float) -> str:
    """The size of innovations in words.

    Parameters
    ----------
    mean_nis : float
        Squared innovations over their expected size.
    """
    factor = mean_nis**0.5
    if mean_nis < LOW_NIS:
        return (
            f"Fixes agree with navigation {1.0 / factor:.2g} times better than the sigmas allow"
            f" for (squared innovations {mean_nis:.2g} times as large as expected): the sigmas of"
            " the fixes, and those of the solution, are too large. --gnss-noise-scale makes them"
            " smaller."
        )
    if mean_nis > HIGH_NIS:
        return (
            f"Fixes disagree with navigation {factor:.2g} times more than the sigmas allow for"
            f" (squared innovations {mean_nis:.2g} times as large as expected): the sigmas of the"
            " solution are too small. --gnss-noise-scale makes those of the fixes larger."
        )
    return (
        f"Fixes agree with navigation as the sigmas say: squared innovations are {mean_nis:.2g}"
        " times as large as expected."
    )
