"""`sinstool align` on one log: its attitude with covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, ConfigurationError
from sinstool.core.finding import Finding, Severity
from sinstool.core.progress import Progress, share
from sinstool.core.rotation import conjugate, log, multiply, rotate, to_euler
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.core.whole_file import check_output, write_table
from sinstool.io.readers import open_log
from sinstool.io.readers.truth import at_times, read_truth
from sinstool.methods.alignment.gyrocompass import Gyrocompass
from sinstool.methods.alignment.inflight_answer import InFlightAlignment
from sinstool.methods.ins_gnss.fix_velocity import with_velocities
from sinstool.pipelines.align.earth_rotation import compass
from sinstool.pipelines.align.first_attitude import (
    AGREE_SIGMAS,
    align,
    north_at_rest,
    seconds_from_start,
)
from sinstool.pipelines.align.in_motion import align_moving
from sinstool.pipelines.align.result import (
    HEADING_OBSERVED,
    AlignResult,
    TruthError,
    angles,
    at_rest_values,
    in_motion_values,
    plain_values,
)
from sinstool.pipelines.log_used import ImuTime, LogFile, Lost
from sinstool.pipelines.plan import Choice, Plan
from sinstool.pipelines.planning import NO_INS_GNSS, NO_SOLUTION, fixed_plan, make_plan
from sinstool.survey.grade import sensor_grade
from sinstool.survey.source import Source, lead_in_end, prepare


@dataclass(frozen=True)
class LogAlignment:
    """Result of `align` with the data for its page.

    Attributes
    ----------
    answer : InFlightAlignment or Gyrocompass or None
        With the series, where the method has one.
    windows : tuple of ndarray
        Seconds from the start, specific force (m/s^2) and angular rate (rad/s) in half-second
        means: the dynamics.
    q_nb : ndarray, shape (4,)
        The attitude, its heading arbitrary where it is not known; NaN where there is none.
    error : ErrorCourse or None
        Against a truth, where one was given.
    """

    result: AlignResult
    answer: InFlightAlignment | Gyrocompass | None
    windows: tuple[np.ndarray, np.ndarray, np.ndarray]
    q_nb: np.ndarray
    error: ErrorCourse | None = None


def align_log(
    path: Path, config: ProcessConfig, progress: Progress | None = None, truth: str | None = None
) -> LogAlignment:
    """Align the vehicle of a log.

    Parameters
    ----------
    config : ProcessConfig
        ``auto`` is what the plan of the log says.
    progress : callable, optional
        Called with the fraction done.
    truth : str, optional
        A topic of the log or a CSV file with reference attitudes, to say how wrong the answer is.

    Raises
    ------
    SinstoolError
    """
    with open_log(path, config.input.salvage) as log:
        log.references = frozenset(() if truth is None else (truth,))
        log_choice("log", f"{path}, {log.format}, {log.size / 1e6:.1f} MB")
        source = prepare(log, config, share(progress, log.size, 0.0, 1.0))
        alignment = _align(source, config, _plan(source, config))
        if truth is None:
            return alignment
        times, q_nb = read_truth(log, truth, config.input.body_axes)
        return _with_truth(alignment, source, truth, times, q_nb)


def _plan(source: Source, config: ProcessConfig) -> Plan:
    if config.align.align == "fixed":
        raise ConfigurationError("--align fixed: there is nothing to compute", "choose a method")
    return make_plan(source, config) if config.align.align == "auto" else fixed_plan(source, config)


def _with_truth(
    alignment: LogAlignment, source: Source, name: str, time_ns: np.ndarray, q_nb: np.ndarray
) -> LogAlignment:
    """The same, with its error against a reference."""
    result, answer, aligned = alignment.result, alignment.answer, alignment.q_nb
    findings, error = result.findings, TruthError(name)
    if not time_ns[0] <= result.time_ns <= time_ns[-1]:
        text = f"{name} holds no attitude at the time of the result"
        findings = (*findings, Finding("truth", text))
    elif np.isfinite(aligned).all():
        true = at_times(time_ns, q_nb, np.array([result.time_ns]))
        if result.status in HEADING_OBSERVED:
            psi = errors(aligned[None], true)[0] / DEGREE
            error = TruthError(name, tuple(psi.tolist()), float(np.linalg.norm(psi)))
        else:
            tilt = tilt_errors(aligned[None], true)[0] / DEGREE
            error = TruthError(name, (*tilt.tolist(), None))
    course = None
    if isinstance(answer, InFlightAlignment) and answer.series is not None:
        course = error_course(answer, time_ns, q_nb, source.survey.first_ns)
    result = replace(result, findings=findings, truth=error)
    return replace(alignment, result=result, error=course)


_WITHOUT = {
    "level-only": "the log shows only roll and pitch",
    "level-moving": "the log shows only roll and pitch, and these roughly",
    "unobservable": "the log shows neither it nor roll and pitch",
    "failed": "the alignment failed",
}


def _time_at_rest(source: Source, config: ProcessConfig, method: str, time_ns: int) -> int:
    """The time of an attitude that is not found in motion, by ``--at``."""
    at, first_ns = config.in_flight.at, source.survey.first_ns
    if at in ("end", "start"):
        return time_ns
    asked_ns = first_ns + round(float(at) * SECOND)
    resting = method in ("level", "gyrocompass") and source.survey.lead_in is not None
    end_ns = lead_in_end(source.survey) if resting else first_ns
    if not first_ns <= asked_ns <= end_ns:
        known = f"until {seconds_from_start(end_ns, source):.1f} s" if resting else "at 0 s"
        raise ConfigurationError(
            f"--at {at}: {method} gives the attitude {known} only",
            "give a time in that range, or align in motion with --align svd",
        )
    return asked_ns


def _in_log(source: Source, at: str) -> int:
    """The time of ``--at``, seconds from the first sample, as long as there are samples."""
    first_ns, last_ns = source.survey.first_ns, source.survey.last_ns
    asked_ns = first_ns + round(float(at) * SECOND)
    if not first_ns <= asked_ns <= last_ns:
        span = f"0 to {seconds_from_start(last_ns, source):.1f} s"
        raise ConfigurationError(
            f"--at {at}: the samples of the IMU span {span}", "give a time in that range"
        )
    return asked_ns


def _of_plan(plan: Plan, status: str) -> list[Finding]:
    """Findings of a plan that bear on an alignment alone."""
    findings = []
    for finding in plan.findings:
        if finding.kind != NO_INS_GNSS:
            findings.append(finding)
        elif status not in HEADING_OBSERVED:
            why = finding.text.removeprefix(NO_SOLUTION)
            findings.append(replace(finding, text=f"no heading from GNSS: {why}"))
    return findings


def _align(source: Source, config: ProcessConfig, plan: Plan) -> LogAlignment:
    grade = sensor_grade(source, config)
    method = plan.first_attitude.value
    answer: InFlightAlignment | Gyrocompass | None = None
    span: tuple[int | None, int | None] = (None, None)
    if method in IN_FLIGHT:
        at = config.in_flight.at
        when: str | int = at if at in ("end", "start") else _in_log(source, at)
        gnss = source.aiding.gnss
        if config.align.align == "auto" and gnss is not None and not gnss.has_velocity.any():
            # As the filter finds its start, which the plan has tried
            model = plan.filter_start.settings.gnss
            white = float(max(model.position_white[:2]))
            gnss = with_velocities(gnss, white, model.position_wander)
        # No log shows whether a sample is a mean until its stamp, or a rate at it
        half = 0.0 if plan.gyro_samples.configured else 0.5 * source.survey.interval_ns / SECOND
        moving = align_moving(
            source, config, grade.grade, method, when, gnss, sample_s=half, lasting=True
        )
        answer = moving.result
        name, time_ns, span = answer.method, answer.t_ns, (answer.t_q_ns, answer.t_stop_ns)
        values = in_motion_values(
            answer, moving.settings.grade, moving.settings.gate, moving.gyro_bias
        )
        compassed = north_at_rest(source, config) if config.align.align == "auto" else None
        if compassed is not None and at in ("end", "start") and _better_known(compassed, answer):
            method, answer = "gyrocompass", compassed
            name, time_ns, span = method, answer.t_ns, (answer.t_start_ns, answer.t_ns)
            values = at_rest_values(answer)
            reason = f"as it shows heading better than {plan.first_attitude.value} does"
            plan = replace(plan, first_attitude=Choice(method, reason, "--align"))
    elif method == "gyrocompass":
        if source.survey.lead_in is None or source.latitude is None:
            raise AlignmentError(
                f"{source.path}: gyrocompassing needs a log that begins at rest, and a latitude",
                "choose a beginning at rest with --start, give --latitude, or use --align svd",
            )
        answer = compass(source, config, grade.grade)
        name, time_ns, span = method, answer.t_ns, (answer.t_start_ns, answer.t_ns)
        values = at_rest_values(answer)
    else:
        alignment = align(source, config) if config.align.align != "auto" else plan.alignment
        name, time_ns = alignment.method, alignment.time_ns
        values = plain_values(alignment)
        status = alignment.status if alignment.north_referenced else "level-only"
        q_nb, warnings = alignment.q_nb, alignment.warnings
    if answer is not None:
        status, q_nb, warnings = answer.status, answer.q_nb, answer.warnings
    if method not in IN_FLIGHT:
        time_ns = _time_at_rest(source, config, method, time_ns)
    lost = Lost.of(source)
    findings = [
        *source.findings,
        *_of_plan(plan, status),
        *(Finding("alignment", text) for text in warnings),
        *lost.findings(),
    ]
    if status not in HEADING_OBSERVED:
        why = _WITHOUT["level-moving" if name == "level-moving" else status]
        findings.append(Finding("heading-withheld", f"heading is not known: {why}", Severity.LOST))
    begin, end = span
    result = AlignResult(
        input=LogFile(str(source.path), source.log.size),
        plan=plan,
        imu=ImuTime.of(source),
        imu_grade=grade,
        status=status,
        method=name,
        time_ns=time_ns,
        time_s=seconds_from_start(time_ns, source),
        start_s=None if begin is None else seconds_from_start(begin, source),
        stop_s=None if end is None else seconds_from_start(end, source),
        findings=tuple(findings),
        **angles(q_nb, status),
        **values,
    )
    windows = source.survey.windows
    return LogAlignment(
        result,
        answer,
        (
            (windows.start_ns - source.survey.first_ns) / SECOND,
            np.linalg.norm(windows.accel, axis=1),
            np.linalg.norm(windows.gyro, axis=1),
        ),
        q_nb,
    )


def _better_known(at_rest: Gyrocompass, moving: InFlightAlignment) -> bool:
    """Whether a rest shows heading better than motion, which does not contradict it."""
    if moving.status not in HEADING_OBSERVED:
        return True
    sigma, other = at_rest.sigma_rad[2], moving.sigma_rad[2]
    if sigma >= other:
        return False
    try:
        then = moving.attitude_at(np.array([at_rest.t_ns]))[0]
    except ValueError:  # a gap lies between them
        return False
    turn = log(multiply(at_rest.q_nb, conjugate(then)))
    return bool(abs(turn[2]) < AGREE_SIGMAS * np.hypot(sigma, other))


def write_series(path: Path, alignment: LogAlignment, overwrite: bool) -> None:
    """Write the solution at every fix as a table, angles in degrees.

    Raises
    ------
    ConfigurationError
        The method has none.
    """
    answer = alignment.answer
    if not isinstance(answer, InFlightAlignment) or answer.series is None:
        raise ConfigurationError(
            "--series: only an alignment in motion has a solution at every fix",
            "use --align svd, or leave it out",
        )
    check_output(path, [], overwrite)
    series = answer.series
    euler = to_euler(series.q_nb) / DEGREE
    names = (
        "time_s", "roll_deg", "pitch_deg", "heading_deg", "sigma_north_deg", "sigma_east_deg",
        "sigma_down_deg", "sigma_worst_deg", "observability", "calm",
    )  # fmt: skip
    seconds = (series.time_ns - alignment.result.imu.first_ns) / SECOND
    angles = [series.sigma / DEGREE, series.sigma_worst / DEGREE, series.rho]
    values = np.column_stack([seconds, euler, *angles])
    rows = zip(values, series.calm, strict=True)
    write_table(path, names, ([*(f"{v:.6f}" for v in row), int(calm)] for row, calm in rows))


@dataclass(frozen=True)
class ErrorCourse:
    """Errors at the fixes that the reference covers.

    Attributes
    ----------
    seconds : ndarray, shape (n,)
        Since the log's start.
    series : ndarray, shape (n, 3)
        Of the solution from what came before each fix: about north, east, down, rad.
    final : ndarray, shape (n, 3)
        Of the final answer, carried to each fix; NaN where it cannot be.
    sigma_worst : ndarray, shape (n,)
        Of the series, rad.
    """

    seconds: np.ndarray
    series: np.ndarray
    final: np.ndarray
    sigma_worst: np.ndarray


def errors(answers: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Small rotations in NED by which attitudes are wrong.

    Parameters
    ----------
    answers, true : ndarray, shape (n, 4)
        q_nb.

    Returns
    -------
    ndarray, shape (n, 3)
        psi with ``answer = (I + [psi x]) true``, rad.
    """
    return np.asarray(log(multiply(answers, conjugate(true))))


def tilt_errors(answers: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Errors about north and east alone, whatever the headings are.

    Parameters
    ----------
    answers, true : ndarray, shape (n, 4)
        q_nb.

    Returns
    -------
    ndarray, shape (n, 2)
        rad.
    """
    down = np.broadcast_to([0.0, 0.0, 1.0], (len(answers), 3))
    seen = rotate(answers, rotate(conjugate(true), down))
    return np.stack([-seen[:, 1], seen[:, 0]], axis=1)


def error_course(
    answer: InFlightAlignment, time_ns: np.ndarray, q_nb: np.ndarray, first_ns: int
) -> ErrorCourse | None:
    """Errors of the series and of the final answer; None where the reference covers no fix.

    Parameters
    ----------
    answer : InFlightAlignment
        With its series.
    time_ns : ndarray of int64, shape (k,)
        Of the reference, increasing.
    q_nb : ndarray, shape (k, 4)
    first_ns : int
        Time of the log's first sample.
    """
    series = answer.series
    assert series is not None
    times = series.time_ns
    inside = (times >= time_ns[0]) & (times <= time_ns[-1]) & np.isfinite(series.sigma_worst)
    if not inside.any():
        return None
    true = at_times(time_ns, q_nb, times[inside])
    final = np.full((int(inside.sum()), 3), np.nan)
    if answer.status not in ("failed", "unobservable"):
        final = errors(answer.attitude_at(times[inside]), true)
    return ErrorCourse(
        (times[inside] - first_ns) / SECOND,
        errors(series.q_nb[inside], true),
        final,
        series.sigma_worst[inside],
    )
