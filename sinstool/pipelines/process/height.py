"""Height damping of a run: barometer or GNSS heights, and the network."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.choices import log_choice
from sinstool.core.errors import DataError, TopicError
from sinstool.core.order_statistics import median
from sinstool.core.rotation import rotate
from sinstool.core.streams import Baro, BaroHeight, GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.height.hangs import hung_rows
from sinstool.methods.height.layout import ACCEPTED, FROZEN, REASONS, ChannelSummary, Event
from sinstool.methods.height.network import (
    SENSIBLE_TAU,
    HeightNetwork,
    gravity_gradient,
    paper,
    recommended,
)
from sinstool.methods.height.pressure import frozen_spans, pressure_reason
from sinstool.methods.height.reference import (
    SCALE_BOUNDS,
    BaroReference,
    HeightReference,
    ScaleFit,
    fit_scale,
    reference_from_gnss,
    reference_from_setting,
    reference_from_start,
)
from sinstool.methods.height.standard_atmosphere import STANDARD_PRESSURE
from sinstool.methods.sensor_errors import Grade
from sinstool.pipelines.process.height_used import (
    BarometerSetting,
    FinalHeight,
    HeightDamping,
    HeightEvent,
)
from sinstool.pipelines.process.summary import Sink
from sinstool.survey.grade import ImuGrade, sensor_grade
from sinstool.survey.source import Source

# Time over which samples are averaged for the height at the start, s.
START_S = 1.0
# Pressures further apart than this are not interpolated.
NEAR_NS = 2_000_000_000
# Least gate of the vertical channel, m: a larger change of height is not noise.
MOVED_M = 8.0
# Rows before and after a jump whose medians show it, and the ratio to the usual change.
JUMP_ROWS = 5
JUMP_RATIO = 10.0
# Times of a sensor that hangs that are listed.
SHOWN_HANGS = 3


def network(
    config: ProcessConfig, grade: Grade, latitude: float
) -> tuple[HeightNetwork, list[str]]:
    """The damping network of a run.

    Parameters
    ----------
    grade : str
        Of the IMU.
    latitude : float
        rad.

    Returns
    -------
    HeightNetwork
        The barometer's lag is taken off its K4.
    warnings : list of str
    """
    options = config.vertical
    w2 = gravity_gradient(latitude)
    chosen = recommended(grade, w2) if options.height_preset == "recommended" else paper(w2)
    tau = chosen.tau if options.tau is None else options.tau
    k4 = chosen.k4 if options.k4 is None else options.k4
    warnings = []
    if not SENSIBLE_TAU[0] <= tau <= SENSIBLE_TAU[1]:
        warnings.append(
            f"--tau {tau:g} s is outside the sensible {SENSIBLE_TAU[0]:g} to {SENSIBLE_TAU[1]:g} s"
        )
    if k4 != 0.0 and options.baro_lag == 0.0:
        warnings.append(
            f"K4 = {k4:g} s: in a steady climb the height is off by {-k4:+g} s times the vertical"
            " velocity; --k4 0 has no such error"
        )
    log_choice(
        "height",
        f"network of tau {tau:g} s, K4 {k4 - options.baro_lag:g} s, by"
        + (
            " --tau"
            if options.tau is not None
            else f" preset {options.height_preset} of grade {grade}"
        ),
    )
    return HeightNetwork(tau, k4 - options.baro_lag, w2), warnings


def height_reference(
    source: Source, config: ProcessConfig, start_height: float
) -> tuple[HeightReference, list[str]]:
    """Heights that damp the vertical channel of a run.

    Parameters
    ----------
    config : ProcessConfig
        With damping.
    start_height : float
        Of the run, m.

    Raises
    ------
    TopicError, DataError
        The log has no such heights, or none that can be used.
    """
    barometer = source.aiding.barometer
    if config.vertical.height_damping == "gnss":
        return _from_gnss(source), []
    if barometer.problem is not None:
        raise barometer.problem
    baro = barometer.stream
    if baro is None:
        absent = "the log has no barometer (sensor_msgs/FluidPressure)"
        why = barometer.findings[0].text if barometer.findings else absent
        raise TopicError(
            source.path,
            f"--height-damping baro: {why}",
            "name a topic with --baro-topic (--baro-kind height for heights), use --height-damping"
            " gnss, or off: height then runs away, its error doubling every 400 s",
        )
    if not isinstance(baro, Baro):
        return _from_heights(source, baro)
    reason = pressure_reason(baro.pressure)
    hung, hangs = _hung(source, baro.time_ns, baro.pressure, reason == ACCEPTED)
    reference, warnings = _baro_reference(source, baro.rows(~hung), config, start_height)
    height = reference.height(baro.pressure)
    reason[hung] = FROZEN
    good = reason == ACCEPTED
    variance = baro.variance[good]
    variance = np.where(variance < STANDARD_PRESSURE**2, variance, 0.0)  # NaN is not smaller either
    sigma = reference.sigma(baro.pressure[good], variance)
    positive = sigma[sigma > 0.0]
    return (
        HeightReference(
            "baro",
            barometer.topic,
            baro.time_ns,
            height,
            reason,
            float(median(positive)) if len(positive) else 0.0,
            reference,
        ),
        [*hangs, *warnings],
    )


def _hung(
    source: Source, time_ns: IntArray, values: FloatArray, good: BoolArray
) -> tuple[BoolArray, list[str]]:
    """Samples of a sensor that hangs, and a warning about them."""
    rests = [(span.start_ns, span.end_ns) for span in source.survey.spans]
    hung = hung_rows(time_ns, np.where(good, values, np.nan), rests)
    if not hung.any():
        return hung, []
    edges = np.diff(hung.astype(np.int8), prepend=0, append=0)
    # The sample before is the one that is repeated
    begins, ends = time_ns[np.flatnonzero(edges > 0) - 1], time_ns[np.flatnonzero(edges < 0) - 1]
    seconds = (np.stack([begins, ends], axis=1) - source.survey.first_ns) / SECOND
    shown = [f"{begin:.1f} to {end:.1f} s" for begin, end in seconds[:SHOWN_HANGS].tolist()]
    if len(seconds) > SHOWN_HANGS:
        shown.append(f"{len(seconds) - SHOWN_HANGS} more times")
    text = f"topic {source.aiding.barometer.topic} hangs, repeating one value, from"
    return hung, [f"{text} {', '.join(shown)}: these samples are left out"]


def _baro_reference(
    source: Source, baro: Baro, config: ProcessConfig, start_height: float
) -> tuple[BaroReference, list[str]]:
    options = config.vertical
    warnings: list[str] = []
    if options.qnh is not None:
        if options.undulation == 0.0:
            warnings.append(
                "heights by --qnh are above mean sea level; give --undulation for the ellipsoid"
            )
        return reference_from_setting(options.qnh, options.undulation), warnings
    _require_pressures(source, baro, config)
    gnss = source.aiding.gnss
    if options.baro_ref != "init" and gnss is not None and np.isfinite(gnss.height).any():
        usable = heights_for_calibration(baro, gnss)
        reference = reference_from_gnss(
            baro.time_ns, baro.pressure, gnss.time_ns[usable], gnss.height[usable]
        )
        if reference is not None:
            fit = reference.fit
            if fit is not None and fit.applied and _shows(fit):
                warnings.append(
                    f"over {fit.height_range:.0f} m of GNSS heights the barometer's scale is"
                    f" {reference.scale:.4f} (a warm or cold day), which is applied"
                )
            return reference, warnings
    if options.baro_ref == "gnss":
        raise DataError(
            source.path,
            "--baro-ref gnss: the log has no GNSS heights at the times of the pressures",
            "use --baro-ref init or --qnh",
        )
    early = baro.time_ns - baro.time_ns[0] <= int(START_S * 1e9)
    if not (pressure_reason(baro.pressure[early]) == ACCEPTED).any():
        raise DataError(
            source.path,
            f"topic {source.aiding.barometer.topic}: no pressure of the first {START_S:g} s can be"
            " used",
            "use --qnh, or choose another span with --start and --end",
        )
    return reference_from_start(baro.pressure[early], start_height), warnings


def _require_pressures(source: Source, baro: Baro, config: ProcessConfig) -> None:
    """Refuse a barometer without a single plausible pressure."""
    if (pressure_reason(baro.pressure) == ACCEPTED).any():
        return
    unit = config.input.baro_unit
    read = "" if unit is None else f", read in {unit} as configured"
    raise DataError(
        source.path,
        f"topic {source.aiding.barometer.topic}: its pressures are about"
        f" {np.nanmedian(baro.pressure):.5g} Pa{read}, which no atmosphere has",
        "correct --baro-unit, or leave the barometer out with --baro-topic none",
    )


def _shows(fit: ScaleFit) -> bool:
    """Whether a scale changes heights by more than 1 m."""
    return abs(fit.scale - 1.0) * fit.height_range > 1.0


def heights_for_calibration(baro: Baro, gnss: GnssEpochs) -> np.ndarray:
    """GNSS heights from which offset and scale of a barometer can be estimated.

    Heights while the barometer has a gap or hangs are left out, and all after a jump of its
    reference, or of the receiver's height: a jump would be taken for the scale of a warm or cold
    day.

    Returns
    -------
    ndarray of bool, shape (n,)
        Rows of `gnss`.
    """
    good = pressure_reason(baro.pressure) == ACCEPTED
    times, pressure = baro.time_ns[good], baro.pressure[good]
    usable = np.isfinite(gnss.height)
    if len(times) < 2 or not usable.any():
        return usable
    after = np.clip(np.searchsorted(times, gnss.time_ns), 1, len(times) - 1)
    usable &= times[after] - times[after - 1] <= NEAR_NS
    for start, end in frozen_spans(times, pressure):
        inside = usable & (gnss.time_ns >= start) & (gnss.time_ns <= end)
        if np.count_nonzero(inside) > JUMP_ROWS and np.ptp(_medians(gnss.height[inside])) > MOVED_M:
            usable &= ~inside
    if not usable.any():  # a coarse sensor at rest under a receiver that wanders
        return np.isfinite(gnss.height)
    rows = np.flatnonzero(usable)
    heights = gnss.height[rows]
    standard = BaroReference("gnss", 0.0).height(pressure)
    origin = times[0]
    at = (gnss.time_ns[rows] - origin) * 1e-9
    standard = np.interp(at, (times - origin) * 1e-9, standard)
    # A fast climb on a warm day, or one through a gap, is no jump
    scale = np.clip(fit_scale(standard, heights).scale, *SCALE_BOUNDS)
    usable[rows[_first_jump(heights - scale * standard) :]] = False
    return usable


def _first_jump(values: np.ndarray) -> int:
    """First row after a jump of the values; their number where there is none."""
    if len(values) < 2 * JUMP_ROWS:
        return len(values)
    medians = _medians(values)
    steps = np.abs(medians[JUMP_ROWS:] - medians[:-JUMP_ROWS])
    usual = float(median(steps))
    jumps = np.flatnonzero(steps > max(MOVED_M, JUMP_RATIO * usual))
    # most of the later rows are beyond the jump when it shows
    return int(jumps[0]) + JUMP_ROWS + JUMP_ROWS // 2 if len(jumps) else len(values)


def _medians(values: np.ndarray) -> np.ndarray:
    """Running medians, which noise and single outliers hardly change."""
    windows = np.lib.stride_tricks.sliding_window_view(values, JUMP_ROWS)
    return np.asarray(median(windows, axis=1))


def _from_heights(source: Source, stream: BaroHeight) -> tuple[HeightReference, list[str]]:
    """A topic that holds heights, not pressures."""
    topic = source.aiding.barometer.topic
    finite = np.isfinite(stream.height)
    if not finite.any():
        raise DataError(source.path, f"topic {topic} holds no finite height")
    hung, hangs = _hung(source, stream.time_ns, stream.height, finite)
    reason = np.where(finite, ACCEPTED, REASONS.index("not_finite")).astype(np.int64)
    reason[hung] = FROZEN
    reference = HeightReference("baro", topic, stream.time_ns, stream.height, reason, 0.0, None)
    return reference, hangs


def _from_gnss(source: Source) -> HeightReference:
    gnss = source.aiding.gnss
    good = None if gnss is None else np.isfinite(gnss.height)
    if gnss is None or good is None or not good.any():
        raise TopicError(
            source.path,
            "--height-damping gnss: the log has no GNSS heights",
            "use --height-damping baro, or off",
        )
    rows = gnss.rows(good)
    sigma = rows.sigma_position_n[:, 2]
    stated = sigma[np.isfinite(sigma)]
    return HeightReference(
        "gnss",
        source.aiding.fix_topic,
        rows.time_ns,
        rows.height,
        np.zeros(len(rows), np.int64),
        float(median(stated)) if len(stated) else 0.0,
        None,
    )


@dataclass(frozen=True)
class Damping:
    """Reference heights and settings of the vertical channel of a run."""

    reference: HeightReference
    network: HeightNetwork
    grade: ImuGrade

    def show(self, sink: Sink) -> None:
        """Give a sink the usable reference heights."""
        reference = self.reference
        good = reference.reason == ACCEPTED
        sink.refer_height(reference.topic, reference.time_ns[good], reference.height[good])

    def result(
        self, channel: ChannelSummary, events: list[Event], first_ns: int, final: np.ndarray
    ) -> HeightDamping:
        """How the height was damped, and the events of the vertical channel.

        Parameters
        ----------
        events : list of Event
            Times in s since ``first_ns``.
        final : ndarray, shape (3,)
            Height (m), vertical velocity (m/s) and correction (m/s^2) at the end.
        """
        baro = self.reference.baro
        return HeightDamping(
            damping=self.reference.kind,
            topic=self.reference.topic,
            tau_s=self.network.tau,
            k4_s=self.network.k4,
            gains=tuple(self.network.gains),
            reference=None
            if baro is None
            else BarometerSetting(baro.mode, baro.offset, baro.scale),
            samples=channel.samples,
            seconds=channel.seconds,
            phase=channel.phase,
            difference_rms_m=channel.difference_rms,
            offset_m=channel.offset,
            final=FinalHeight(*final.tolist()),
            events=tuple(
                HeightEvent(e.kind, first_ns + round(e.time * 1e9), e.size, e.duration)
                for e in events
            ),
            imu_grade=self.grade,
        )


def with_heights_of_imu(source: Source, config: ProcessConfig, q_nb: FloatArray) -> Source:
    """The same, with GNSS heights that are those of the IMU, at the times when they were so.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
        First attitude, from which that of a vehicle differs by little more than its heading.
    """
    gnss, position, height = source.aiding.gnss, source.position, source.position[2]
    if gnss is None:
        return source
    down = float(rotate(q_nb, np.array(config.gnss.lever_arm or (0.0, 0.0, 0.0)))[2])
    late_ns = round((config.gnss.gnss_latency or 0.0) * SECOND)
    gnss = replace(gnss, time_ns=gnss.time_ns - late_ns, height=gnss.height + down)
    if height is not None and config.align.latitude is None:
        position = (*position[:2], height + down)
    return replace(source, aiding=replace(source.aiding, gnss=gnss), position=position)


def damping(
    source: Source, config: ProcessConfig, latitude: float, start_height: float
) -> tuple[Damping, list[str]]:
    """Damping of the height of a run without a filter, and warnings about it.

    Parameters
    ----------
    latitude : float
        rad.
    start_height : float
        m.
    """
    grade = sensor_grade(source, config)
    reference, notes = height_reference(source, config, start_height)
    heights, more = network(config, grade.grade, latitude)
    return Damping(reference, heights, grade), [*notes, *more]
