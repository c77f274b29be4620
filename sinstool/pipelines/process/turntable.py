"""`process --hse`: attitude of a system on its turntable, corrected for its error.

Every stretch at constant rate is aligned on its whole turns, its heading corrected by the
calibration. The base does not move, so that between stretches the attitude is that of the
nearest one in time, turned by the encoder: no gyro is integrated.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import special

from sinstool.config import ProcessConfig
from sinstool.core.english import counted
from sinstool.core.errors import AlignmentError, ConfigurationError
from sinstool.core.finding import Finding, Severity
from sinstool.core.result import compass
from sinstool.core.small_file import read_text
from sinstool.core.streams import Solution
from sinstool.core.units import ARCSEC, DEGREE
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import frame_id
from sinstool.io.readers.topics import choose_imu
from sinstool.io.writers.solution_topics import Frames
from sinstool.methods.hse.agreement import StampedAngle
from sinstool.methods.hse.calibration import (
    CorrectedHeading,
    HseCalibration,
    require_applicable,
    require_config,
)
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.site import wrong_latitude
from sinstool.methods.hse.statistics import drifts
from sinstool.methods.hse.whole_turn import (
    SIGNIFICANT_TILT_DRIFT,
    WholeTurnAlignment,
    align_whole_turns,
)
from sinstool.pipelines.calibrate_hse.calibration_file import loads
from sinstool.pipelines.calibrate_hse.run import correct_runs, rig_of, segment_rules
from sinstool.pipelines.log_used import ImuTime, Lost
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.planning import turntable_plan
from sinstool.pipelines.process.hse_used import HseCorrection, TurntableStretch, UnusedStretch
from sinstool.pipelines.process.mode import warned
from sinstool.pipelines.process.output import Output
from sinstool.pipelines.process.result import ProcessResult
from sinstool.pipelines.process.summary import FinalState, FirstAttitude
from sinstool.survey.grade import measured_noise
from sinstool.survey.rig import (
    RigLog,
    RigTurns,
    angles_at_stamps,
    denied_angles,
    find_turns,
    nothing_to_use,
    read_rig_log,
)

BLOCK = 65536
# Tilts smaller than this, rad, are rounding.
SMALLEST_TILT = 1e-4 * ARCSEC


def process_turntable(
    log: Log, config: ProcessConfig, written: Output, progress: Callable[[int], None] | None
) -> ProcessResult:
    """Process a rig's log.

    Parameters
    ----------
    config : ProcessConfig
        With a rig and a calibration.
    progress : callable, optional
        Called with the bytes read.

    Raises
    ------
    SinstoolError
    """
    rig, calibration, warnings = _files(config)
    rules = segment_rules(config.calibration)
    samples = read_rig_log(log, rig, config.input, progress)
    turns = find_turns(samples, rig, rules)
    if not turns.turns:
        error = nothing_to_use(turns, log.path, rules)
        raise AlignmentError(error.message, error.hint)
    alignments = _align(turns, rig, config)
    corrected = correct_runs(alignments, calibration)
    body = frame_id(log, samples.topic.channels, samples.topic.path) or "imu_link"
    # b has its z axis down, whatever the axes of the triad
    frames = Frames(config.output.world, "map", body, "frd")
    encoding = samples.topic.channels[0].message_encoding
    left_out = written.open(encoding, ("imu", "attitude"), frames)
    angles = angles_at_stamps(samples, rig, turns)
    attitudes = _write(written, samples, turns, rig, alignments, corrected, angles)
    written.complete()
    hse = _hse(config, calibration, turns, alignments, corrected)
    lost = _lost(log, samples)
    warnings += [*rig.remarks(), *_remarks(turns, alignments, corrected)]
    without = len(samples.imu) - int(np.count_nonzero(samples.made)) - attitudes
    denied = denied_angles(samples, turns, angles, withheld=True)
    without -= sum(int(finding.numbers["samples"]) for finding in denied)
    if without:
        warnings.append(
            f"{counted(without, 'sample')} without attitude, where the encoder or the gyro has a"
            " gap"
        )
    plan = turntable_plan(samples.topic.topic, config)
    findings = (
        *plan.findings,
        *left_out,
        *warned("turntable", warnings),
        *denied,
        *_findings(samples, hse, lost),
    )
    input_file, output_file = written.finish(findings)
    assert written.last is not None and rig.latitude is not None
    return ProcessResult(
        input=input_file,
        output=output_file,
        plan=plan,
        imu=_imu(samples),
        alignment=_first_attitude(turns, alignments[-1], corrected, len(alignments) - 1),
        hse=hse,
        travel=written.odometer.travel(),
        final=FinalState.of(written.last, navigates=False),
        lost=lost,
        findings=findings,
    )


def _findings(samples: RigLog, hse: HseCorrection, lost: Lost) -> list[Finding]:
    """Findings about stretches left out, and about a calibration without effect."""
    findings = list(samples.findings)
    if hse.status != "ok":
        text = f"the calibration is {hse.status}"
        findings.append(Finding("calibration", text, Severity.LOST))
    return [*findings, *lost.findings()]


def plan_turntable(log: Log, config: ProcessConfig) -> Plan:
    """The plan for a log with ``--hse``: there is nothing to choose.

    Raises
    ------
    SinstoolError
        The log has not one IMU topic, or `process` would refuse the options.
    """
    _files(config)
    return turntable_plan(choose_imu(log, config.input.imu_topic).topic, config)


def _files(config: ProcessConfig) -> tuple[Rig, HseCalibration, list[str]]:
    """The rig, its calibration and warnings about that, of options that go with them.

    Raises
    ------
    SinstoolError
        They do not, or a file cannot be read, be it one that has no effect.
    """
    if config.navigation.mode not in ("auto", "attitude"):
        raise ConfigurationError(
            f"--mode {config.navigation.mode} does not go with --hse",
            "a system that turns on its table gets only its attitude; leave out one of them",
        )
    measured_noise(config)
    rig = rig_of(config)
    return rig, *load_calibration(Path(config.hse.hse or ""), rig, config.hse.force)


def load_calibration(path: Path, rig: Rig, force: bool) -> tuple[HseCalibration, list[str]]:
    """A calibration file, if it belongs to a rig and may be applied.

    Raises
    ------
    ConfigurationError
        It cannot be read, is of another rig or is not significant, and was not forced.
    """
    text = read_text(path, "--hse", "give the file that calibrate-hse wrote")
    try:
        calibration = loads(text)
        forced = (
            require_config(calibration, rig.sha256(), force),
            require_applicable(calibration, force),
        )
    except ConfigurationError as exc:
        raise ConfigurationError(f"--hse {path}: {exc.message}", exc.hint) from exc
    return calibration, [f"--force: {text}" for text in forced if text is not None]


def _align(turns: RigTurns, rig: Rig, config: ProcessConfig) -> list[WholeTurnAlignment]:
    options = config.calibration
    try:
        return [
            align_whole_turns(t, rig, options.level_rate, options.gyro_bias_sigma * DEGREE / 3600.0)
            for t in turns.turns
        ]
    except (AlignmentError, ConfigurationError) as exc:
        raise type(exc)(f"{turns.source}: {exc.message}", exc.hint) from exc


def _write(
    written: Output,
    samples: RigLog,
    turns: RigTurns,
    rig: Rig,
    alignments: list[WholeTurnAlignment],
    corrected: CorrectedHeading,
    angles: list[StampedAngle],
) -> int:
    """Write the attitude at every sample with an encoder angle; returns their number."""
    imu = samples.imu
    count = 0
    for piece, angle in zip(turns.pieces, angles, strict=True):
        for begin in range(0, len(piece), BLOCK):
            end = min(begin + BLOCK, len(piece))
            made = samples.made[piece.first + begin : piece.first + end]
            given = np.flatnonzero(~made & ~angle.denied[begin:end])
            if not len(given):
                continue
            rows = piece.first + begin + given
            q_nb = np.empty((end - begin, 4))
            for k in np.unique(angle.nearest[begin:end]).tolist():
                mine = angle.nearest[begin:end] == k
                alpha = angle.alpha[begin:end][mine]
                q_nb[mine] = alignments[k].q_nb(alpha, float(corrected.dpsi[k]))
            written.push(
                Solution(
                    imu.time_ns[rows],
                    imu.log_time_ns[rows],
                    q_nb[given],
                    (imu.gyro[rows] - rig.gyro_bias) @ rig.gyro_to_b.T,
                    (imu.accel[rows] - rig.accel_bias) @ rig.accel_to_b.T,
                )
            )
            count += len(given)
    return count


def _remarks(
    turns: RigTurns, alignments: list[WholeTurnAlignment], corrected: CorrectedHeading
) -> list[str]:
    """Findings about the site and about single stretches."""
    elsewhere = wrong_latitude(alignments)
    notes = [f"{elsewhere}: check latitude_deg"] if elsewhere else []
    for number, (segment, a) in enumerate(zip(turns.segments, alignments, strict=True)):
        where = f"stretch {number + 1} (from {segment.start_s:.1f} s)"
        if corrected.outside_rate[number]:
            notes.append(
                f"{where}: its rate, {a.rate / DEGREE:.2f} deg/s, is outside the calibrated range"
            )
        if corrected.outside_C23[number]:
            notes.append(
                f"{where}: its axis leans to the east by {a.C23:.2e} rad, more than in the"
                " calibration"
            )
        if drifts(a.per_turn_heading):
            notes.append(
                f"{where}: heading drifts over its turns (t = {a.quality['heading_trend_t']:.1f}):"
                " warm-up, or the base moved"
            )
        drift = float(np.hypot(a.quality["tilt_drift_north"], a.quality["tilt_drift_east"]))
        if drift > max(_sigmas(a) * a.quality["tilt_drift_sigma"], SMALLEST_TILT):
            notes.append(f"{where}: the base tilted by {drift / ARCSEC:.2f} arcsec meanwhile")
    return notes


def _sigmas(a: WholeTurnAlignment) -> float:
    """Sigmas of a drift that are as rare with these turns as the usual ones with many."""
    turns = len(a.per_turn_heading)
    if turns < 3:
        return float("inf")
    return float(special.stdtrit(turns - 2, special.ndtr(SIGNIFICANT_TILT_DRIFT)))


def _imu(samples: RigLog) -> ImuTime:
    recorded = samples.imu.time_ns[~samples.made]
    steps = np.diff(recorded)
    interval = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps[steps > 3.0 * interval]
    counts = samples.imu_counts
    return ImuTime(
        topic=counts.topic,
        n=len(recorded),
        rate_hz=1e9 / interval if interval else 0.0,
        first_ns=samples.start_ns,
        last_ns=int(recorded[-1]),
        time_source="stamp",
        gaps=len(gaps),
        gap_total_s=float(gaps.sum()) * 1e-9,
        duplicates=counts.repeated,
        backward=counts.backward,
        dropped=counts.repeated + counts.malformed + counts.not_finite,
    )


def _first_attitude(
    turns: RigTurns, a: WholeTurnAlignment, corrected: CorrectedHeading, k: int
) -> FirstAttitude:
    sigma = float(corrected.sigma[k])
    return FirstAttitude(
        method="whole-turn",
        how="over whole turns of the table",
        time_ns=turns.start_ns + round(turns.turns[k].start_s * 1e9),
        roll_deg=a.gamma / DEGREE,
        pitch_deg=a.theta / DEGREE,
        heading_deg=compass(float(corrected.heading[k]) / DEGREE),
        sigma_deg=(None, None, sigma / DEGREE if np.isfinite(sigma) else None),
        status="ok",
        north_referenced=True,
        gyro_bias_rad_s=(0.0, 0.0, 0.0),
        gyro_bias_source="rig",
    )


def _hse(
    config: ProcessConfig,
    calibration: HseCalibration,
    turns: RigTurns,
    alignments: list[WholeTurnAlignment],
    corrected: CorrectedHeading,
) -> HseCorrection:
    return HseCorrection(
        file=config.hse.hse,
        status=calibration.status,
        lambda2_arcsec=_arcsec(calibration.lambda2_rad),
        sigma_lambda2_arcsec=_arcsec(calibration.sigma_lambda2_rad),
        segments=tuple(
            TurntableStretch(
                start_ns=turns.start_ns + round(t.start_s * 1e9),
                duration_s=float(t.duration.sum()),
                turns=len(t),
                rate_deg_s=a.rate / DEGREE,
                C23_rad=a.C23,
                heading_raw_deg=a.heading / DEGREE,
                correction_arcsec=float(corrected.dpsi[k]) / ARCSEC,
                sigma_correction_arcsec=_arcsec(corrected.sigma_dpsi[k]),
                heading_deg=float(corrected.heading[k]) / DEGREE,
                sigma_heading_arcsec=_arcsec(corrected.sigma[k]),
                outside_rate=bool(corrected.outside_rate[k]),
                outside_C23=bool(corrected.outside_C23[k]),
            )
            for k, (t, a) in enumerate(zip(turns.turns, alignments, strict=True))
        ),
        not_used=tuple(
            UnusedStretch(s.start_s, s.duration_s, s.rate / DEGREE, s.reason)
            for s in turns.segmentation.rejected
        ),
    )


def _arcsec(angle: float | None) -> float | None:
    """An angle in arc seconds; None if unknown."""
    return None if angle is None or not np.isfinite(angle) else float(angle) / ARCSEC


def _lost(log: Log, samples: RigLog) -> Lost:
    counts = samples.imu_counts
    return Lost(
        **vars(log.account()), malformed=counts.malformed, not_finite=counts.not_finite, late=0
    )
