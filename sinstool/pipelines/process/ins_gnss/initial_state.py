"""Start of a filter: an instant, the attitude there, and the accuracy of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.arrays import IntArray
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import GnssEpochs, Imu
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.alignment.preparation import rough_fixes
from sinstool.methods.ins_gnss.fix_velocity import with_velocities
from sinstool.methods.ins_gnss.settings import GnssModel, Settings, Start
from sinstool.methods.ins_gnss.start import TWICE_USED, start_at
from sinstool.methods.strapdown.followed_rates import FOLLOWED_S
from sinstool.pipelines.align.first_attitude import align, seconds_from_start
from sinstool.pipelines.align.first_in_motion import in_flight, with_bias_in_motion
from sinstool.pipelines.process.ins_gnss.start_velocity import velocity_around
from sinstool.survey.grade import bias_at_rest
from sinstool.survey.source import Source, rate_blocks

# A start leaves out fixes before it that span at most so many seconds, if there is an earlier one.
LEFT_OUT_S = 30.0


@dataclass(frozen=True)
class StartFixes:
    """Fixes to start a filter from.

    Attributes
    ----------
    gnss : GnssEpochs
        All fixes, with velocities derived from positions if the receiver gives none.
    shown : GnssEpochs
        Fixes that an alignment in motion may use.
    derived : bool
        Whether the velocities are derived from positions.
    """

    gnss: GnssEpochs
    shown: GnssEpochs
    derived: bool = False

    @classmethod
    def of(cls, gnss: GnssEpochs, model: GnssModel) -> StartFixes:
        """From the fixes that the filter may use, and their noise."""
        if gnss.has_velocity.any():
            return cls(gnss, gnss)
        white = float(max(model.position_white[:2]))
        shown = with_velocities(gnss, white, model.position_wander)
        gnss = with_velocities(gnss, white, ends=True)
        # Where speed changes quickly these velocities are rough, although the fixes are good
        sigma = np.sqrt(np.mean(np.square(shown.sigma_velocity_n), axis=1))
        return cls(gnss, shown.rows(~rough_fixes(shown.time_ns, sigma)), True)


@dataclass(frozen=True)
class FoundStart:
    """A start of a filter, and its first attitude.

    Attributes
    ----------
    time_ns : int
        Of a sample.
    how : str
        Source of the attitude, in words.
    """

    start: Start
    time_ns: int
    how: str
    alignment: Alignment


def find_start(
    source: Source,
    config: ProcessConfig,
    settings: Settings,
    fixes: StartFixes,
    aligned: Alignment | None = None,
    near: Alignment | None = None,
) -> FoundStart:
    """Start of the filter: by the alignment of the options, else by motion.

    Parameters
    ----------
    fixes : StartFixes
        Valid `settings.gnss_latency` before their stamps.
    aligned : Alignment, optional
        The first attitude, where it is known.
    near : Alignment, optional
        One with fixes that differ little, or are of a slightly different time.

    Raises
    ------
    AlignmentError
    """
    path = source.path
    try:
        alignment = aligned or _aligned(source, config, settings, fixes, near)
        covariance, bias_sigma = _covariance(alignment), alignment.gyro_bias_sigma
        if bias_sigma is None and alignment.bias_source != "none":
            bias_sigma = settings.imu.gyro_instability
        sample = _sample(source, config, alignment.time_ns)
        time_ns = int(sample.time_ns[0])
        of_imu = None
        if fixes.derived:
            of_imu = velocity_around(
                source, config, settings, fixes.gnss, alignment, covariance, time_ns
            )
        start = start_at(
            time_ns,
            alignment.q_nb,
            covariance,
            fixes.gnss,
            settings,
            omega_eb_b=_followed(source, config, time_ns) - alignment.gyro_bias,
            of_imu=of_imu,
            gyro_bias=alignment.gyro_bias,
            gyro_bias_sigma=bias_sigma,
        )
    except AlignmentError as exc:
        message = exc.message if str(path) in exc.message else f"{path}: {exc.message}"
        hint = exc.hint
        unsure = exc.uncertain and config.navigation.imu_grade == "auto"
        if unsure and bias_at_rest(source) is None:
            hint = (
                f"{hint or 'give an initial attitude'}, or set the grade of the IMU with"
                " --imu-grade"
            )
        raise AlignmentError(message, hint, exc.uncertain, exc.consistent) from exc
    return FoundStart(start, time_ns, in_words(alignment, covariance), alignment)


def _aligned(
    source: Source,
    config: ProcessConfig,
    settings: Settings,
    fixes: StartFixes,
    near: Alignment | None,
) -> Alignment:
    """First attitude with heading."""
    options: dict[str, Any] = {
        "gnss": config.gnss.model_copy(
            update={"gnss_latency": settings.gnss_latency, "lever_arm": settings.lever_arm_b}
        )
    }
    if config.align.align == "auto" and config.in_flight.gate == "auto":
        # The filter starts as early as possible, not when a launched vehicle flies calmly
        options["in_flight"] = config.in_flight.model_copy(update={"gate": "off"})
    config = config.model_copy(update=options)
    gnss, shown = fixes.gnss, fixes.shown
    method: str = "svd" if config.align.align == "auto" else config.align.align
    if method in IN_FLIGHT:
        late = round(settings.gnss_latency * SECOND)
        # Only fixes with good velocities: those of the start are the velocities of a fix
        valid = shown.time_ns[shown.has_position] - late
        first = _sample(source, config, int(valid[0]) if len(valid) else 0)
        whole = shown.time_ns[shown.has_position & shown.has_velocity] - late
        begin_ns = int(first.time_ns[0])
        alignment = in_flight(source, config, method, shown, begin_ns, whole, near)
        while config.in_flight.align_end is None:
            earlier = _before(alignment, source, config, method, shown, begin_ns, whole)
            if earlier is None:
                break
            alignment = earlier
    else:
        alignment = align(source, config)
        if alignment.bias_source == "none" and config.align.gyro_bias == "still":
            alignment = with_bias_in_motion(alignment, source, config, gnss)
    if alignment.north_referenced:
        return alignment
    if config.align.align == "auto":
        raise AlignmentError(
            "motion and GNSS do not show the heading, and the filter needs it",
            "give it with --align fixed --initial-attitude ROLL,PITCH,HEADING, or use --align"
            " gyrocompass if the gyros can measure the Earth's rotation at rest",
        )
    raise AlignmentError(
        f"--align {alignment.method} gives no heading, and the filter needs one",
        "leave --align out, or use svd, gyrocompass, log or fixed",
    )


def _before(
    alignment: Alignment,
    source: Source,
    config: ProcessConfig,
    method: str,
    shown: GnssEpochs,
    begin_ns: int,
    fixes_ns: IntArray,
) -> Alignment | None:
    """First attitude by the fixes before an outage, if the one after it cannot be carried there.

    Of the parts between outages the alignment uses the one that shows the attitude best; but a
    filter that starts there leaves out all fixes before.

    Parameters
    ----------
    begin_ns, fixes_ns
        As :func:`in_flight` takes them.

    Returns
    -------
    Alignment or None
        None if hardly any fixes are left out, or if they show no heading.
    """
    before = fixes_ns[fixes_ns < alignment.time_ns]
    if not len(before) or before[-1] - before[0] < LEFT_OUT_S * SECOND:
        return None
    end = seconds_from_start(int(before[-1]), source)
    options = {"in_flight": config.in_flight.model_copy(update={"align_end": end})}
    config = config.model_copy(update=options)
    try:
        earlier = in_flight(source, config, method, shown, begin_ns, fixes_ns)
    except AlignmentError:
        return None
    return earlier if earlier.north_referenced and earlier.time_ns < alignment.time_ns else None


def _sample(source: Source, config: ProcessConfig, time_ns: int) -> Imu:
    """The first sample from a time on."""
    for block in rate_blocks(source, config, time_ns):
        return block.rows(slice(0, 1))
    raise AlignmentError("GNSS begins after the last IMU sample", "check the clocks")


def _followed(source: Source, config: ProcessConfig, time_ns: int) -> np.ndarray:
    """Mean rate of the samples about one, shape (3,), rad/s, in the bandwidth of a receiver."""
    reach = round(FOLLOWED_S * SECOND)
    rates = []
    for block in rate_blocks(source, config, max(source.survey.first_ns, time_ns - reach)):
        rates.append(block.gyro[np.abs(block.time_ns - time_ns) <= reach])
        if block.time_ns[-1] > time_ns + reach:
            break
    return np.asarray(np.concatenate(rates).mean(axis=0))


def _covariance(alignment: Alignment) -> np.ndarray:
    """Covariance of the attitude, in NED, rad^2."""
    if alignment.covariance_n is not None:
        twice = TWICE_USED if alignment.method in IN_FLIGHT else 1.0
        return twice**2 * alignment.covariance_n
    tilt = [s if s is not None else 2.0 * DEGREE for s in alignment.sigma_rad[:2]]
    heading = alignment.sigma_rad[2]
    return np.diag(np.square([*tilt, 2.0 * DEGREE if heading is None else heading]))


_BIAS = {
    "alignment": "by the alignment",
    "rest": "by a rest",
    "still": "by the rest at the beginning",
    "given": "as configured",
    "none": "not known",
}


def in_words(alignment: Alignment, covariance: np.ndarray) -> str:
    """Source of the attitude in words."""
    if alignment.method not in IN_FLIGHT or alignment.held_ns is None:
        shown = "; gyro bias from motion" if alignment.bias_source == "alignment" else ""
        return f"attitude by {alignment.method}{shown}"
    later = (alignment.held_ns - alignment.time_ns) / SECOND
    carried = f"carried {'back' if later >= 0.0 else 'forward'} over {abs(later):.0f} s"
    return (
        f"attitude by {alignment.method} from velocity changes, {carried};"
        f" gyro bias {_BIAS[alignment.bias_source]}; heading known to"
        f" {np.sqrt(covariance[2, 2]) / DEGREE:.1f} deg"
    )
