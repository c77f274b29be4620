"""A start with the antenna where the log's transforms have it, unless the motion denies this."""

from __future__ import annotations

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding, Severity
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.start import earliest_start, timed_start
from sinstool.survey.source import Source


def start_by_antenna(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart | None,
) -> tuple[ProcessConfig, FilterStart, list[Finding]]:
    """A start, timed, and the configuration it was made with.

    Transforms are often written before the antenna is mounted. Where the fixes show that it is
    elsewhere, the start is made once more as if they said nothing.

    Parameters
    ----------
    first, start : FilterStart
        See :func:`~sinstool.pipelines.process.ins_gnss.start.timed_start`.
    """
    begun = timed_start(source, config, algorithm, first, start)
    stated = source.antenna_b
    if stated is None:
        return config, begun, []
    forward, right, down = stated
    place = f"{forward:.2f} m forward, {right:.2f} m right and {down:.2f} m down of the IMU"
    numbers = {"forward_m": forward, "right_m": right, "down_m": down}

    def found(text: str, severity: Severity, answer: str) -> list[Finding]:
        return [Finding("lever-arm-transform", text, severity, answer, numbers=numbers)]

    used = f"the antenna is {place}, by /tf_static"
    if begun.offsets is None or not begun.offsets.arm_contradicts:
        log_choice("lever arm", f"{used} (--lever-arm)")
        return config, begun, found(used, Severity.NOTE, "--lever-arm overrides this")
    shown = ", ".join(f"{value:.2f}" for value in begun.offsets.arm_b)
    text = (
        f"/tf_static has the antenna {place}, but fixes move with the vehicle's turns as if it were"
        f" at {shown} m"
    )
    answer = "correct the transform, or give --lever-arm"
    gnss = config.gnss.model_copy(update={"lever_arm": None})
    freed = config.model_copy(update={"gnss": gnss})
    try:
        first = earliest_start(source, freed, algorithm)
        begun = timed_start(source, freed, algorithm, first)
    except AlignmentError:
        return config, begun, found(text, Severity.WARNING, answer)
    text += "; its place is estimated from the motion instead"
    return freed, begun, found(text, Severity.WARNING, answer)
