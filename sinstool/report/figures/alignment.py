"""Figures of an alignment, without how they are drawn."""

from __future__ import annotations

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.rotation import to_euler
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.inflight_answer import InFlightAlignment
from sinstool.methods.alignment.inflight_types import OK_SIGMA, REFUSE_SIGMA, AlignmentSeries
from sinstool.pipelines.align.log import LogAlignment
from sinstool.report.figure import Figure, FloatArray, Series
from sinstool.report.figures.parts import AXES, LOG_TIME, positive

_DYNAMICS = {
    "force": "Norm of each half second's mean. Heading is observable where the horizontal part"
    " changes.",
    "rate": "Norm of each half second's mean: where the vehicle turned.",
}
# What is less than nothing on a logarithmic axis.
_TINY = 1e-9


def figures(alignment: LogAlignment, config: ProcessConfig) -> tuple[Figure, ...]:
    """All figures of an alignment, the main one first.

    Parameters
    ----------
    config : ProcessConfig
        For the limits of the gate.

    Returns
    -------
    tuple of Figure
        Those for which there is something to show; of an alignment at rest only the dynamics.
    """
    made: list[Figure] = []
    answer = alignment.answer
    if isinstance(answer, InFlightAlignment):
        if answer.series is not None and len(answer.series.time_ns):
            made += [*attitude(alignment, answer.series), sigmas(alignment, answer.series)]
            if alignment.error is not None:
                made.append(errors(alignment))
            made.append(singular_values(alignment, answer.series))
        if len(answer.residuals):
            made.append(residuals(alignment, answer))
    return (*made, *dynamics(alignment, config))


def _marks(alignment: LogAlignment) -> tuple[tuple[str, float], ...]:
    """Start and stop of the segment used."""
    result = alignment.result
    named = (("start", result.start_s), ("stop", result.stop_s))
    return tuple((name, float(at)) for name, at in named if at is not None)


def _seconds(alignment: LogAlignment, time_ns: np.ndarray) -> FloatArray:
    return np.asarray((time_ns - alignment.result.imu.first_ns) / SECOND, dtype=np.float64)


def sigmas(alignment: LogAlignment, series: AlignmentSeries) -> Figure:
    """Sigmas of the attitude at each fix, from the data before it."""
    columns = [(f"about {a}", series.sigma[:, k]) for k, a in enumerate(AXES)]
    shown = tuple(Series(n, positive(v / DEGREE, _TINY)) for n, v in columns)
    worst = Series("worst axis", positive(series.sigma_worst / DEGREE, _TINY), style="dashed")
    refined = getattr(alignment.answer, "errors", None) is not None
    notes = ["Of the solver's answer from the fixes up to each time, sensor errors considered."]
    if refined:
        notes.append("The result is the refined attitude at the end, which is more accurate.")
    return Figure(
        "sigma",
        "How well attitude is known",
        _seconds(alignment, series.time_ns),
        (*shown, worst),
        LOG_TIME,
        "sigma, deg",
        log_y=True,
        y_range=_sigma_range(series),
        notes=tuple(notes),
        levels=(("ok", OK_SIGMA / DEGREE), ("no heading above", REFUSE_SIGMA / DEGREE)),
    )


def _sigma_range(series: AlignmentSeries) -> tuple[float, float]:
    """Range of sigmas, from below the best to 200 deg at most, as the first seconds say nothing."""
    values = series.sigma[np.isfinite(series.sigma) & (series.sigma > 0.0)] / DEGREE
    low = 0.5 * float(values.min()) if len(values) else 0.1
    high = 2.0 * float(values.max()) if len(values) else 10.0
    return min(low, 0.5), float(np.clip(high, 10.0, 200.0))


def attitude(alignment: LogAlignment, series: AlignmentSeries) -> list[Figure]:
    """Heading, and roll and pitch, at each fix, where the worst sigma is small enough."""
    euler = to_euler(series.q_nb) / DEGREE
    euler[:, 2] %= 360.0
    too_vague = ~(series.sigma_worst <= REFUSE_SIGMA)
    curves = {}
    for k, name in enumerate(("roll", "pitch", "heading")):
        values = euler[:, k].copy()
        # A jump over the end of the circle is no motion.
        values[1:][np.abs(np.diff(euler[:, k])) > 180.0] = np.nan
        values[too_vague] = np.nan
        curves[name] = Series(name, values)
    note = "The attitude is shown only where the sigma about the worst axis is below 5 deg."
    seconds = _seconds(alignment, series.time_ns)
    both = (curves["roll"], curves["pitch"])
    return [
        Figure("heading", "Heading at each fix", seconds, (curves["heading"],), LOG_TIME,
               "heading, deg", notes=(note,)),
        Figure("attitude", "Roll and pitch at each fix", seconds, both, LOG_TIME, "angle, deg",
               notes=(note,)),
    ]  # fmt: skip


def errors(alignment: LogAlignment) -> Figure:
    """Errors against the reference."""
    course = alignment.error
    assert course is not None
    usable = course.sigma_worst <= OK_SIGMA
    curves = []
    for k, name in enumerate(AXES):
        final = course.final[:, k] / DEGREE
        curves.append(Series(f"final answer, {name}", np.where(np.isfinite(final), final, np.nan)))
    for k, name in enumerate(AXES):
        step = np.where(usable, course.series[:, k] / DEGREE, np.nan)
        curves.append(Series(f"so far, {name}", step, style="dashed", shown=k == 2))
    return Figure(
        "error",
        "Error against the reference",
        course.seconds,
        tuple(curves),
        LOG_TIME,
        "error, deg",
        notes=(
            "Final answer: carried from the end of the segment to each fix. So far: the solver's"
            " answer from the fixes up to each time, where it is known to 1 deg.",
            "If the reference belongs to another body than the IMU's, this shows the mounting"
            " between them.",
        ),
    )


def singular_values(alignment: LogAlignment, series: AlignmentSeries) -> Figure:
    """Singular values of the attitude profile matrix; the second and third show attitude."""
    s = series.singular_values
    curves = tuple(Series(f"s{k + 1}", positive(np.abs(s[:, k]), _TINY)) for k in range(3))
    return Figure(
        "singular-values",
        "Singular values of the attitude profile matrix",
        _seconds(alignment, series.time_ns),
        curves,
        LOG_TIME,
        "singular value, (m/s)²",
        log_y=True,
        notes=(
            "If all vectors have one direction, s2 and s3 stay small and the rotation about it is"
            " unknown. Units are those of the vectors squared.",
        ),
    )


def residuals(alignment: LogAlignment, answer: InFlightAlignment) -> Figure:
    """Residuals of the solver's pairs."""
    unit = {"diff": "m/s²", "diffc": "m/s²", "pos": "m"}.get(answer.vectors, "m/s")
    return Figure(
        "residuals",
        "Residuals of the vectors",
        _seconds(alignment, answer.residual_ns),
        tuple(Series(n, answer.residuals[:, k]) for k, n in enumerate(("x", "y", "z"))),
        LOG_TIME,
        f"residual, {unit}",
        notes=(
            "In the body axes at the start. They grow with specific force"
            " where fixes are late, with angular rate where the lever arm is wrong, and with time"
            " where a gyro drifts, which only the refinement estimates.",
        ),
    )


def dynamics(alignment: LogAlignment, config: ProcessConfig) -> tuple[Figure, Figure]:
    """Specific force and angular rate of the whole log, and where the gate held it calm."""
    seconds, force, rate = alignment.windows
    options = config.in_flight
    gated = alignment.result.gate in ("paper", "mask")
    calm_at, calm = None, None
    answer = alignment.answer
    if isinstance(answer, InFlightAlignment) and answer.series is not None:
        calm_at, calm = _seconds(alignment, answer.series.time_ns), answer.series.calm
    made = []
    for key, title, values, unit, limit in (
        ("force", "Specific force", force, "m/s²", options.f_set),
        ("rate", "Angular rate", rate / DEGREE, "deg/s", options.w_set),
    ):
        curves = [Series("half-second means", values)]
        if calm_at is not None and calm is not None and calm.any():
            at = np.interp(calm_at, seconds, values)
            curves.append(Series("calm fixes used", np.where(calm, at, np.nan), calm_at))
        made.append(
            Figure(
                key,
                title,
                seconds,
                tuple(curves),
                LOG_TIME,
                f"{title.lower()}, {unit}",
                notes=(_DYNAMICS[key],),
                levels=((f"limit, {limit:g} {unit}", limit),) if gated else (),
                marks=_marks(alignment),
            )
        )
    return made[0], made[1]
