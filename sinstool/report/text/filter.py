"""What `process` says of an INS/GNSS filter."""

from __future__ import annotations

from typing import Any

Row = tuple[str, str]


def filter_rows(told: dict[str, Any] | None) -> list[Row]:
    """``filter`` of a summary as pairs of what and how.

    Parameters
    ----------
    told : dict or None
    """
    if told is None:
        return []
    smoothed = ", smoothed" if told["smoothed"] else ""
    used, gated = told["epochs_used"], told["epochs_gated"]
    bias = ", ".join(f"{b:.3e}" for b in told["gyro_bias_rad_s"])
    accel = ", ".join(f"{b:.3e}" for b in told["accel_bias_m_s2"])
    rows = [
        (
            "filter",
            f"{told['filter']}, {told['states']} states, feedback {told['feedback']}{smoothed}; IMU"
            f" {told['imu_grade']['grade']} ({told['imu_grade']['why']})",
        ),
        ("start", told["start"]["how"]),
        ("GNSS", f"{told['gnss_noise']}; {_latency(told['gnss_latency'])}"),
        (
            "fixes",
            f"{used} used, {gated} rejected, {told['restarts']} restarts; innovations squared"
            f" {told['mean_nis']:.2f} of what was expected",
        ),
        ("biases at end", f"gyro {bias} rad/s; accelerometer {accel} m/s^2 (FRD)"),
    ]
    return rows + _withheld(told["withheld"])


def _latency(told: dict[str, Any]) -> str:
    """When fixes were valid."""
    position, velocity = 1e3 * told["position_s"], 1e3 * told["velocity_s"]
    how = told["status"]
    if told["sigma_s"] is not None:
        how += f", +- {1e3 * told['sigma_s']:.1f} ms"
    if abs(position - velocity) < 0.05:
        return f"latency {position:.1f} ms ({how})"
    return f"latency of positions {position:.1f} ms, of velocities {velocity:.1f} ms ({how})"


def _withheld(told: dict[str, Any] | None) -> list[Row]:
    if told is None:
        return []
    outages = told["outages"]
    most = max(o["largest_in_sigmas"] for o in outages)
    rms = told["rms_of_largest_horizontal_m"]
    text = (
        f"{len(outages)} outages: largest horizontal errors {rms:.3g} m rms, at most {most:.1f}"
        " sigma on an axis"
    )
    if "filter" in told and told["filter"] is not None:
        text += f"; unsmoothed {told['filter']['rms_of_largest_horizontal_m']:.3g} m rms"
    return [("withheld", text)]
