"""The rows of a result of `process`, shared by the terminal and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sinstool.core.english import counted, heading_text
from sinstool.report.text.numbers import measured

if TYPE_CHECKING:
    from sinstool.pipelines.process import filter_used, height_used, hse_used, summary
    from sinstool.pipelines.process.errors_against_truth import RunErrors
    from sinstool.pipelines.process.result import ProcessResult
    from sinstool.pipelines.process.vehicle_used import VehicleUsed

Row = tuple[str, str]


def summary_rows(result: ProcessResult, verbose: bool = False) -> list[Row]:
    """The summary as pairs of label and text.

    Parameters
    ----------
    verbose : bool, optional
        With sources and hashes.
    """
    imu, align, final = result.imu, result.alignment, result.final
    coning, out = result.coning, result.output
    bias = ", ".join(f"{b:.3e}" for b in align.gyro_bias_rad_s)
    rows = [
        ("log", f"{result.input.path} ({result.input.size / 1e6:.1f} MB)"),
        (
            "IMU",
            f"{imu.topic}: {counted(imu.n, 'sample')} at {imu.rate_hz:.3f} Hz,"
            f" {counted(imu.gaps, 'gap')}, {imu.dropped} dropped",
        ),
        (
            "alignment",
            f"{align.method} ({align.status}): roll {align.roll_deg:z.3f}, pitch"
            f" {align.pitch_deg:z.3f}, heading {heading_text(align.heading_deg, 3)} deg"
            + first_sigma(align)
            + _reference(result),
        ),
        ("gyro bias", _bias(align.gyro_bias_source, bias)),
    ]
    if coning is not None:
        rows.append(
            (
                "coning",
                f"{coning.algorithm}, {counted(coning.samples_per_update, 'sample')} an update,"
                f" gyro read as {coning.gyro_kind}",
            )
        )
    rows += _smoothing(result.smoothing)
    if result.hse is not None:
        rows += _hse(result.hse)
    if result.height is not None:
        rows += _height(result.height)
    rows += _filter(result.filter)
    rows.append(
        (
            "final",
            f"roll {final.roll_deg:z.3f}, pitch {final.pitch_deg:z.3f},"
            f" heading {heading_text(final.heading_deg, 3)} deg" + _place(result),
        )
    )
    rows += _gnss(result.gnss_difference)
    rows += _truth(result.truth)
    rows.append(
        (
            "written",
            f"{out.path}: {counted(out.attitudes, 'attitude')} in frame {out.frame},"
            f" topics {', '.join(out.topics)}",
        )
    )
    if verbose:
        if coning is not None:
            rows.append(("coning source", coning.source))
        rows.append(("input sha256", result.input.sha256))
    return rows


def first_sigma(first: summary.FirstAttitude) -> str:
    """Sigmas of the first attitude, as far as they are known: that of heading may be far larger."""
    known = [sigma for sigma in first.sigma_deg if sigma is not None]
    if len(known) < 2:
        return ""
    if len(known) == 2:
        return f", sigma of tilt {round(max(known), 6):.2g} deg"
    each = ", ".join(f"{round(sigma, 6):.2g}" for sigma in known)
    return f", sigma {each} deg about north, east, down"


def _reference(result: ProcessResult) -> str:
    """What a first heading counts from, where that is not north."""
    if result.alignment.north_referenced:
        return ""
    smoothing = result.smoothing
    magnetometer = None if smoothing is None else smoothing.magnetometer
    if magnetometer is not None and not magnetometer.refused:
        return "; the magnetometer corrects heading"
    return "; heading is not referenced to north"


def _bias(source: str, bias: str) -> str:
    """The gyro bias; one that the user gave in the log's axes may differ in its signs."""
    if source == "given":
        return f"as specified, converted to FRD axes: {bias} rad/s"
    return f"{source}: {bias} rad/s (FRD)"


def _smoothing(s: summary.AttitudeSmoothing | None) -> list[Row]:
    """How the attitude was smoothed, and its sigmas."""
    if s is None:
        return []
    bias = ", ".join(f"{b:.3e}" for b in s.gyro_bias_rad_s)
    heading = "not known" if s.heading_lost else f"to {s.heading_sigma_end_deg:.2g} deg"
    return [
        (
            "smoothed",
            f"motion of a {s.motion}, {s.rest_s:.1f} s at rest; roll and pitch to"
            f" {s.tilt_sigma_deg:.2g} deg (1 sigma; at most {s.tilt_sigma_largest_deg:.2g}),"
            f" heading at the end {heading}",
        ),
        ("bias at end", f"gyro {bias} +- {max(s.gyro_bias_sigma_rad_s):.1e} rad/s (FRD)"),
        *_magnetometer(s.magnetometer),
    ]


def _magnetometer(m: summary.MagnetometerUsed | None) -> list[Row]:
    """Heading by a magnetometer."""
    if m is None:
        return []
    field = f"field {1e6 * m.field_T:.1f} uT, dip {m.dip_deg:.1f} deg" if m.field_T else ""
    if m.refused:
        return [("magnetometer", f"{m.topic} is not used ({m.refused})" + (field and f"; {field}"))]
    north = {"true": "true north", "magnetic": "magnetic north"}.get(m.north, "north, unverified")
    declination = "" if m.declination_deg is None else f", declination {m.declination_deg:+.2f} deg"
    iron = ""
    if m.hard_iron_removed and m.hard_iron_T is not None:
        offset = ", ".join(f"{1e6 * v:.1f}" for v in m.hard_iron_T)
        iron = f"; hard iron {offset} uT taken off (FRD)"
    return [
        (
            "magnetometer",
            f"{m.topic}: heading from {north}{declination}, to {m.heading_sigma_deg:.2g} deg (1"
            f" sigma); {field}, undisturbed {100.0 * m.trusted:.0f} % of the time{iron}",
        )
    ]


def _place(result: ProcessResult) -> str:
    """Last position of the run, if it computed any."""
    final = result.final
    if "/sinstool/fix" not in result.output.topics:
        return ""
    return (
        f"; {final.lat_deg:.7f}, {final.lon_deg:.7f} deg,"
        f" {final.height_m:.3f} m above the ellipsoid"
    )


def _height(height: height_used.HeightDamping) -> list[Row]:
    samples, final = height.samples, height.final
    k4 = f", K4 {height.k4_s:g} s" if height.k4_s else ""
    used = f"{samples['accepted']} of {sum(samples.values())} samples used"
    out = height.seconds["coast"]
    coast = f", {out:.1f} s without" if out else ""
    return [
        (
            "height",
            f"held to {height.topic} ({height.damping}), tau {height.tau_s:g} s{k4};"
            f" {used}{coast}; latest difference {height.difference_rms_m:.3g} m rms",
        ),
        (
            "height at end",
            f"{final.height_m:.3f} m, {final.velocity_up_m_s:+.3f} m/s up;"
            f" {final.accelerometer_correction_m_s2:+.2e} m/s^2 taken off the accelerometer",
        ),
    ]


def _filter(filter_: filter_used.FilterUsed | None) -> list[Row]:
    """The filter as pairs of label and text."""
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
            "GNSS epochs",
            f"{used} used, {gated} rejected, {filter_.restarts} restarts; squared innovations"
            f" {filter_.mean_nis:.2f} times as large as expected",
        ),
        ("biases at end", f"gyro {bias} rad/s; accelerometer {accel} m/s^2 (FRD)"),
    ]
    return rows + _vehicle(filter_.vehicle) + _withheld(filter_.withheld)


def _vehicle(vehicle: VehicleUsed) -> list[Row]:
    """Constraints of a vehicle that were used."""
    rest = f"held at rest for {vehicle.rest_s:.1f} s" if vehicle.rest_s else "never held at rest"
    rest += f" (threshold: {vehicle.rest_reason})" if vehicle.rest_reason else ""
    land = vehicle.land
    if land is None:
        return [("vehicle", f"may slide, {vehicle.reason}; {rest}")]
    roll, pitch, yaw = land.mount_deg
    wheels = land.wheels
    turned = []
    if wheels is not None:
        turned.append(
            (
                "wheels",
                f"{wheels.topic}: {wheels.metres_per_unit:.4f} m for each"
                f" {'m' if wheels.unit == 'm/s' else 'rad'}, latency"
                f" {1e3 * wheels.latency_s:.0f} +- {1e3 * wheels.latency_sigma_s:.0f} ms; used"
                f" {counted(wheels.used, 'time')}, {wheels.slipped} left out",
            )
        )
    return [
        ("vehicle", f"its axle does not slide, {vehicle.reason}; {rest}"),
        (
            "mount",
            f"roll {roll:.2f}, pitch {pitch:.2f}, yaw {yaw:.2f} deg, sigma of pitch and yaw"
            f" {land.mount_sigma_deg[0]:.2f}, {land.mount_sigma_deg[1]:.2f} deg; the IMU is"
            f" {land.axle_m:.2f} +- {land.axle_sigma_m:.2f} m ahead of the axle",
        ),
        *turned,
    ]


def _latency(latency: filter_used.LatencyUsed) -> str:
    """Latency of the fixes."""
    position, velocity = 1e3 * latency.position_s, 1e3 * latency.velocity_s
    how = "estimated" if latency.status == "found" else latency.status
    if latency.estimate_s is not None and latency.sigma_s is not None:
        how += "" if latency.status == "found" else "; estimated"
        how += f": {1e3 * latency.estimate_s:.1f} +- {1e3 * latency.sigma_s:.1f} ms"
    elif how == "not observable":
        how += " in this log"
    if abs(position - velocity) < 0.05:
        return f"latency {position:.1f} ms ({how})"
    return f"latency of positions {position:.1f} ms, of velocities {velocity:.1f} ms ({how})"


def _withheld(scores: filter_used.WithheldScores | None) -> list[Row]:
    if scores is None:
        return []
    outages = scores.outages
    most = max(o.largest_in_sigmas for o in outages)
    squares = sum(o.epochs * o.rms_in_sigmas**2 for o in outages)
    in_sigmas = (squares / sum(o.epochs for o in outages)) ** 0.5
    rms = scores.rms_of_largest_horizontal_m
    text = (
        f"{len(outages)} outage{'s' * (len(outages) != 1)}: largest horizontal errors {rms:.3g} m"
        f" rms; errors over sigma {in_sigmas:.2f} rms, at most {most:.1f} on an axis"
    )
    if scores.filter is not None:
        text += f"; unsmoothed {scores.filter.rms_of_largest_horizontal_m:.3g} m rms"
    return [("withheld", text)]


def _gnss(off: summary.GnssDifference | None) -> list[Row]:
    """Distance of inertial navigation from GNSS, which it does not use."""
    if off is None:
        return []
    up = "" if off.up_m is None else f", {off.up_m:+.1f} m up"
    north, east = f"{off.north_m:+.1f} m north", f"{off.east_m:+.1f} m east"
    return [("off last fix", f"{north}, {east}{up}")]


def _truth(truth: RunErrors | None) -> list[Row]:
    """Root mean square errors, north, east, down."""
    if truth is None:
        return []
    rows = []
    for what, unit, error in truth.kinds():
        rms = ", ".join(f"{v:.3g}" for v in error.rms)
        most = ", ".join(f"{v:.3g}" for v in error.largest)
        rows.append((f"{what} error", f"rms {rms} {unit} (N, E, D); at most {most}"))
        if what == "attitude" and truth.vertical_deg is not None:
            v = truth.vertical_deg
            rows.append(
                (
                    "inclination error",
                    f"rms {v.inclination_rms:.3g} deg; at most {v.inclination_largest:.3g}",
                )
            )
            free = v.heading_aligned is not None
            note = " (aligned at first: heading is not referenced to north)" if free else ""
            rows.append(
                (
                    "heading error",
                    f"rms {v.heading_rms:.3g} deg, {v.heading_drift:+.3g} deg from first to"
                    f" last{note}",
                )
            )
    if not rows:
        rows.append(("errors", f"nothing to compare with {', '.join(truth.names)}"))
    return rows


def _hse(hse: hse_used.HseCorrection) -> list[Row]:
    """Heading before and after, stretch by stretch."""
    return [
        (
            "heading" if k == 0 else "",
            f"at {s.rate_deg_s:+.3f} deg/s, {counted(s.turns, 'turn')}:"
            f" {s.heading_raw_deg:.4f} deg, corrected by"
            f" {measured(-s.correction_arcsec, s.sigma_correction_arcsec, 'arcsec')}"
            f" to {_heading(s.heading_deg, s.sigma_heading_arcsec)}",
        )
        for k, s in enumerate(hse.segments)
    ]


def _heading(heading_deg: float, sigma_arcsec: float | None) -> str:
    sigma_deg = None if sigma_arcsec is None else sigma_arcsec / 3600.0
    return measured(heading_deg, sigma_deg, "deg")
