"""What `process` says of an INS/GNSS filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sinstool.pipelines.process.summary import FilterUsed, LatencyUsed, WithheldScores


Row = tuple[str, str]


def filter_rows(filter_: FilterUsed | None) -> list[Row]:
    """``filter`` of a result as pairs of what and how."""
    if filter_ is None:
        return []
    smoothed = ", smoothed" if filter_.smoothed else ""
    used, gated = filter_.epochs_used, filter_.epochs_gated
    bias = ", ".join(f"{b:.3e}" for b in filter_.gyro_bias_rad_s)
    accel = ", ".join(f"{b:.3e}" for b in filter_.accel_bias_m_s2)
    rows = [
        (
            "filter",
            f"{filter_.filter}, {filter_.states} states, feedback {filter_.feedback}{smoothed}; IMU"
            f" {filter_.imu_grade.grade} ({filter_.imu_grade.why})",
        ),
        ("start", filter_.start.how),
        ("GNSS", f"{filter_.gnss_noise}; {_latency(filter_.gnss_latency)}"),
        (
            "fixes",
            f"{used} used, {gated} rejected, {filter_.restarts} restarts; innovations squared"
            f" {filter_.mean_nis:.2f} of what was expected",
        ),
        ("biases at end", f"gyro {bias} rad/s; accelerometer {accel} m/s^2 (FRD)"),
    ]
    return rows + _withheld(filter_.withheld)


def _latency(latency: LatencyUsed) -> str:
    """When fixes were valid."""
    position, velocity = 1e3 * latency.position_s, 1e3 * latency.velocity_s
    how = latency.status
    if latency.sigma_s is not None:
        how += f", +- {1e3 * latency.sigma_s:.1f} ms"
    if abs(position - velocity) < 0.05:
        return f"latency {position:.1f} ms ({how})"
    return f"latency of positions {position:.1f} ms, of velocities {velocity:.1f} ms ({how})"


def _withheld(scores: WithheldScores | None) -> list[Row]:
    if scores is None:
        return []
    outages = scores.outages
    most = max(o.largest_in_sigmas for o in outages)
    rms = scores.rms_of_largest_horizontal_m
    text = (
        f"{len(outages)} outages: largest horizontal errors {rms:.3g} m rms, at most {most:.1f}"
        " sigma on an axis"
    )
    if scores.filter is not None:
        text += f"; unsmoothed {scores.filter.rms_of_largest_horizontal_m:.3g} m rms"
    return [("withheld", text)]
