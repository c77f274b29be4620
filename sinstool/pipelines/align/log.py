"""`sinstool align`: one log in, its attitude with covariance out."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, ConfigurationError
from sinstool.core.rotation import to_euler
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.core.whole_file import check_output, write_whole
from sinstool.io.readers import open_log
from sinstool.io.readers.truth import at_times, read_truth
from sinstool.methods.alignment.gyrocompass import Gyrocompass
from sinstool.methods.alignment.in_motion import MotionAlignment
from sinstool.methods.alignment.inflight import InFlightAlignment
from sinstool.pipelines import summary
from sinstool.pipelines.align.errors_against_truth import (
    ErrorCourse,
    error_course,
    errors,
    tilt_errors,
)
from sinstool.pipelines.align.first_attitude import align, compass, seconds_from_start
from sinstool.pipelines.align.in_motion import align_moving
from sinstool.survey.grade import sensor_grade
from sinstool.survey.source import Source, prepare

Progress = Callable[[float], None]


@dataclass(frozen=True)
class LogAlignment:
    """What `align` found.

    Attributes
    ----------
    summary : dict
        The values of ``--json``.
    answer : InFlightAlignment or Gyrocompass or None
        With the series, where the method has one.
    first_ns : int
        Time of the first sample.
    windows : tuple of ndarray
        Seconds from the start, specific force (m/s^2) and angular rate (rad/s) in half-second
        means: the dynamics.
    q_nb : ndarray, shape (4,)
        The attitude, its heading arbitrary where it is not known; NaN where there is none.
    error : ErrorCourse or None
        Against a truth, where one was given.
    """

    summary: dict[str, Any]
    answer: InFlightAlignment | Gyrocompass | None
    first_ns: int
    windows: tuple[np.ndarray, np.ndarray, np.ndarray]
    q_nb: np.ndarray
    error: ErrorCourse | None = None


def align_log(
    path: Path,
    config: ProcessConfig,
    progress: Progress | None = None,
    truth: str | None = None,
) -> LogAlignment:
    """Align the vehicle of a log.

    Parameters
    ----------
    config : ProcessConfig
        ``auto`` is svd where the log has GNSS velocity, else gyrocompass where it begins still
        and its latitude is known, else level.
    progress : callable, optional
        Called with the fraction done.
    truth : str, optional
        A topic of the log or a CSV file with reference attitudes, to say how wrong the answer is.

    Raises
    ------
    SinstoolError
    """
    with open_log(path, config.input.salvage) as log:
        report = None
        if progress is not None:
            size = max(log.size, 1)
            told = progress
            report = lambda position: told(min(1.0, position / size))  # noqa: E731
        log_choice("log", f"{path}, {log.format}, {log.size / 1e6:.1f} MB")
        source = prepare(log, config, report, whole_gnss=True)
        found = _align(source, config)
        if truth is None:
            return found
        return _with_truth(found, source, read_truth(log, truth, config.input.body_axes))


def _with_truth(
    found: LogAlignment, source: Source, truth: tuple[np.ndarray, np.ndarray, str]
) -> LogAlignment:
    """The same, with its error against a reference."""
    time_ns, q_nb, name = truth
    told: dict[str, Any] = {"name": name, "error_deg": None, "total_deg": None}
    answer = found.answer
    t_ns, q_found = int(found.summary["t_ns"]), found.q_nb
    warnings = list(found.summary["warnings"])
    if not time_ns[0] <= t_ns <= time_ns[-1]:
        warnings.append(f"{name} holds no attitude at the time of the answer")
    elif np.isfinite(q_found).all():
        true = at_times(time_ns, q_nb, np.array([t_ns]))
        if found.summary["status"] in ("ok", "degraded"):
            psi = errors(q_found[None], true)[0] / DEGREE
            told["error_deg"] = psi.tolist()
            told["total_deg"] = float(np.linalg.norm(psi))
        else:
            told["error_deg"] = [*(tilt_errors(q_found[None], true)[0] / DEGREE).tolist(), None]
    course = None
    if isinstance(answer, InFlightAlignment) and answer.series is not None:
        course = error_course(answer, time_ns, q_nb, source.survey.first_ns)
    return replace(
        found, summary={**found.summary, "truth": told, "warnings": warnings}, error=course
    )


def _align(source: Source, config: ProcessConfig) -> LogAlignment:
    grade, why = sensor_grade(source, config)
    method: str = config.align.align
    told_so = method != "auto"
    if not told_so:
        method = _method(source)
    log_choice("method", f"{method}, {'as told' if told_so else _METHOD_WHY[method]}")
    answer: InFlightAlignment | Gyrocompass | None = None
    if method in IN_FLIGHT:
        at = config.in_flight.at
        when: str | int = at
        if at not in ("end", "start"):
            when = source.survey.first_ns + round(float(at) * SECOND)
        moving = align_moving(source, config, grade, method, when)
        answer = moving.result
        told = _in_flight(moving, source)
    elif method == "gyrocompass":
        if source.survey.lead_in is None or source.latitude is None:
            raise AlignmentError(
                f"{source.log.path}: gyrocompassing needs a log that begins still, and a latitude",
                "choose a still beginning with --start, give --latitude, or use --method svd",
            )
        answer = compass(source, config, grade)
        told = _at_rest(answer, source)
    elif method in ("level", "log"):
        told = _plain(source, config)
    else:
        raise ConfigurationError("--align fixed: there is nothing to find", "choose a method")
    q_nb = told.pop("q_nb")
    windows = source.survey.windows
    since = (windows.start_ns - source.survey.first_ns) / SECOND
    return LogAlignment(
        {
            "input": str(source.log.path),
            "imu": summary.imu(source),
            "imu_grade": {"grade": grade, "why": why},
            **told,
            "warnings": [*source.warnings, *told["warnings"]],
        },
        answer,
        source.survey.first_ns,
        (
            since,
            np.linalg.norm(windows.accel, axis=1),
            np.linalg.norm(windows.gyro, axis=1),
        ),
        q_nb,
    )


_METHOD_WHY = {
    "svd": "as the log has GNSS position and velocity",
    "gyrocompass": "as the log begins at rest, its latitude is known, and there is no velocity",
    "level": "as there is neither GNSS velocity nor a rest at a known latitude",
}


def _method(source: Source) -> str:
    gnss = source.aiding.gnss
    if gnss is not None and gnss.has_velocity.any() and gnss.has_position.any():
        return "svd"
    if source.survey.lead_in is not None and source.latitude is not None:
        return "gyrocompass"
    return "level"


def _attitude(q_nb: np.ndarray, heading: bool) -> dict[str, Any]:
    if not np.isfinite(q_nb).all():
        return {"q_nb": q_nb, "q_nb_wxyz": None, "euler_deg": None}
    roll, pitch, yaw = (float(v) for v in to_euler(q_nb) / DEGREE)
    return {
        "q_nb": q_nb,
        "q_nb_wxyz": q_nb.tolist() if heading else None,
        "euler_deg": {"roll": roll, "pitch": pitch, "heading": yaw % 360.0 if heading else None},
    }


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _in_flight(moving: MotionAlignment, source: Source) -> dict[str, Any]:
    answer, assumed = moving.result, moving.settings.grade
    heading = answer.status in ("ok", "degraded")
    sigma = [_number(s / DEGREE) for s in answer.sigma_rad]
    if answer.status == "level-only":
        sigma[2] = None
    refined = answer.errors
    return {
        "status": answer.status,
        "method": answer.method,
        "vectors": answer.vectors,
        "t_ns": str(answer.t_ns),
        "t_s": seconds_from_start(answer.t_ns, source),
        "start_s": seconds_from_start(answer.t_q_ns, source),
        "stop_s": seconds_from_start(answer.t_stop_ns, source),
        **_attitude(answer.q_nb, heading),
        "sigma_deg": sigma,
        "sigma_worst_deg": _number(answer.sigma_worst / DEGREE),
        "cov_deg2": (answer.cov / DEGREE**2).tolist() if heading else None,
        "observability": _number(answer.rho),
        "singular_values": [_number(s) for s in answer.singular_values],
        "n_pairs": answer.n_pairs,
        "n_rejected": answer.n_rejected,
        "residual_rms": _number(answer.residual_rms),
        "chi2": _number(answer.chi2),
        "refined_chi2": None if refined is None else refined.chi2,
        "time_to_align_s": _number(answer.time_to_align_s),
        "gate": moving.settings.gate,
        "assumed": {
            "gyro_bias_deg_h": assumed.gyro_bias / DEGREE * 3600.0,
            "accel_bias_m_s2": assumed.accel_bias,
            "gyro_scale": assumed.gyro_scale,
            "accel_scale": assumed.accel_scale,
            "angle_random_walk_deg_sqrt_h": assumed.angle_random_walk / DEGREE * 60.0,
            "velocity_random_walk_m_s_sqrt_s": assumed.velocity_random_walk,
            "bias_time_s": assumed.bias_time_s,
        },
        "gyro_bias_removed_deg_h": (moving.gyro_bias / DEGREE * 3600.0).tolist(),
        "gyro_bias_deg_h": None
        if refined is None
        else (refined.gyro_bias / DEGREE * 3600.0).tolist(),
        "accel_bias_m_s2": None if refined is None else refined.accel_bias.tolist(),
        "latency_s": None if refined is None else refined.latency_s,
        "warnings": list(answer.warnings),
    }


def _at_rest(answer: Gyrocompass, source: Source) -> dict[str, Any]:
    heading = answer.status in ("ok", "degraded")
    sigma = [_number(s / DEGREE) for s in answer.sigma_rad]
    if answer.status == "level-only":
        sigma[2] = None
    return {
        "status": answer.status,
        "method": "gyrocompass",
        "vectors": None,
        "t_ns": str(answer.t_ns),
        "t_s": seconds_from_start(answer.t_ns, source),
        "start_s": seconds_from_start(answer.t_start_ns, source),
        "stop_s": seconds_from_start(answer.t_ns, source),
        **_attitude(answer.q_nb, heading),
        "sigma_deg": sigma,
        "sigma_worst_deg": _number(answer.sigma_heading / DEGREE),
        "cov_deg2": (answer.cov / DEGREE**2).tolist() if heading else None,
        "observability": None,
        "singular_values": None,
        "n_pairs": None,
        "n_rejected": None,
        "residual_rms": None,
        "chi2": _number(answer.chi2),
        "refined_chi2": None,
        "time_to_align_s": None,
        "gate": None,
        "assumed": None,
        "gyro_bias_removed_deg_h": None,
        "gyro_bias_deg_h": (answer.gyro_bias / DEGREE * 3600.0).tolist(),
        "accel_bias_m_s2": answer.accel_bias.tolist(),
        "latency_s": None,
        "warnings": list(answer.warnings),
    }


def _plain(source: Source, config: ProcessConfig) -> dict[str, Any]:
    """Tilt alone, or what the log says."""
    found = align(source, config)
    heading = found.north_referenced
    return {
        "status": found.status if heading else "level-only",
        "method": found.method,
        "vectors": None,
        "t_ns": str(found.time_ns),
        "t_s": seconds_from_start(found.time_ns, source),
        "start_s": None,
        "stop_s": None,
        **_attitude(found.q_nb, heading),
        "sigma_deg": [None if s is None else s / DEGREE for s in found.sigma_rad],
        "sigma_worst_deg": None,
        "cov_deg2": None,
        "observability": None,
        "singular_values": None,
        "n_pairs": None,
        "n_rejected": None,
        "residual_rms": None,
        "chi2": None,
        "refined_chi2": None,
        "time_to_align_s": None,
        "gate": None,
        "assumed": None,
        "gyro_bias_removed_deg_h": None,
        "gyro_bias_deg_h": (found.gyro_bias / DEGREE * 3600.0).tolist(),
        "accel_bias_m_s2": None,
        "latency_s": None,
        "warnings": list(found.warnings),
    }


def write_series(path: Path, found: LogAlignment, overwrite: bool) -> None:
    """Write the solution at every fix as a table, angles in degrees.

    Raises
    ------
    ConfigurationError
        The method has none.
    """
    answer = found.answer
    if not isinstance(answer, InFlightAlignment) or answer.series is None:
        raise ConfigurationError(
            "--series: only an alignment in motion has a solution at every fix",
            "use --method svd, or leave it out",
        )
    check_output(path, [], overwrite)
    series = answer.series
    euler = to_euler(series.q_nb) / DEGREE
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(
        ["time_s", "roll_deg", "pitch_deg", "heading_deg", "sigma_north_deg", "sigma_east_deg",
         "sigma_down_deg", "sigma_worst_deg", "observability", "calm"]
    )  # fmt: skip
    for k in range(len(series.time_ns)):
        writer.writerow(
            [
                f"{(int(series.time_ns[k]) - found.first_ns) / SECOND:.6f}",
                *(f"{v:.6f}" for v in euler[k]),
                *(f"{v:.6f}" for v in series.sigma[k] / DEGREE),
                f"{series.sigma_worst[k] / DEGREE:.6f}",
                f"{series.rho[k]:.6f}",
                int(series.calm[k]),
            ]
        )
    write_whole(path, buffer.getvalue())
