"""The grade of a log's IMU: set by the user, or from its noise at rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import EARTH_RATE
from sinstool.core.finding import Finding
from sinstool.core.units import (
    DEGREE,
    DEGREE_PER_HOUR,
    DEGREE_PER_ROOT_HOUR,
    STANDARD_GRAVITY,
)
from sinstool.methods.sensor_errors import (
    IMU_GRADES,
    LIKELY,
    LOW_COST,
    Grade,
    grade_by_bias,
    grade_by_noise,
    uncalibrated,
)
from sinstool.survey.noise_at_rest import velocity_walk_of_means, walk_of_means
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source

if TYPE_CHECKING:
    from sinstool.methods.allan.coefficients import ImuNoise

# Steps between values larger than this many times the noise hide it.
COARSE = 2.0
# Means over seconds show less noise than samples if it is less by this factor.
CLEARLY = 0.7
# Noise at rest that exceeds that of a stated grade by this factor contradicts it.
NOISIER = 3.0
REST_S = 30.0  # shortest rest whose mean rate is a bias
BRIEF_REST_S = 10.0  # the same in a log without GNSS, which could show that it is none
CHANCE_SIGMAS = 2.0  # a bias may be larger by so many sigmas of the noise at rest
# A rate about a level axis tilts the specific force: if that changed by less than this share of it,
# the rate is a bias. In a level turn it does not change, as it leans, up to this speed, m/s.
TILTED, FASTEST = 0.5, 300.0
LIKELIER = 0.5  # probability of a bare chip from which on an IMU is taken for one
# Gyros with the noise of tactical or navigation grade may be MEMS, or badly calibrated,
# but no data sheet allows them a bias beyond this, rad/s.
LARGEST_BIAS: dict[Grade, float] = {"tactical": 5e-3, "navigation": 1e-3}


@dataclass(frozen=True)
class ImuGrade:
    """The IMU's grade, and the reason for it.

    Attributes
    ----------
    grade : str
        ``consumer``, ``mems``, ``industrial``, ``tactical`` or ``navigation``.
    why : str
        The reason, as the end of a sentence.
    by_drift : bool
        Whether it was judged by the drift without fixes: its noise at rest is then that of the
        vehicle.
    aligned_as : str or None
        Grade with which the first attitude was found, if it is another: drift says little of
        biases, which an alignment has to allow for.
    uncalibrated : float or None
        Position of a low-cost IMU between a calibrated one, 0, and a bare chip, 1, or beyond, in
        powers of what a calibration takes off; None if it is not judged.
    misaligned : float
        How many times as misaligned as those of the grade its axes are.
    """

    grade: Grade
    why: str
    by_drift: bool = False
    aligned_as: Grade | None = None
    uncalibrated: float | None = None
    misaligned: float = 1.0


def to_align_as(config: ProcessConfig, grade: ImuGrade) -> ProcessConfig:
    """A configuration for an alignment with this grade."""
    aligned_as = grade.aligned_as or grade.grade
    options = config.navigation.model_copy(update={"imu_grade": aligned_as})
    return config.model_copy(update={"navigation": options})


def measured_noise(config: ProcessConfig) -> ImuNoise | None:
    """The noise of the file of ``--imu-noise``, or None.

    Raises
    ------
    ConfigurationError
        It is no noise file.
    """
    file = config.navigation.imu_noise
    if file is None:
        return None
    # The analysis of noise comes with it, which other runs have no need of
    from sinstool.config.noise import read_noise

    return read_noise(Path(file))


def gyro_walk(source: Source, config: ProcessConfig) -> float | None:
    """Angular random walk, rad/sqrt(s), by the noise file where it has it, else at rest."""
    walk = random_walk_of(measured_noise(config))
    return random_walk(source) if walk is None else walk


def random_walk_of(noise: ImuNoise | None) -> float | None:
    """Angular random walk of a noise file, rad/sqrt(s); None where it holds at most a bound."""
    if noise is None:
        return None
    from sinstool.methods.allan.coefficients import over_axes

    white = over_axes(noise.gyro, "white")
    return None if white is None else white.value


def gyro_walk_shown(source: Source, least_s: float = 0.0) -> float | None:
    """Angular random walk, rad/sqrt(s) an axis, that a rest of at least this length, s, shows.

    That of its samples or, if it is clearly less, of means over seconds.
    """
    walk, of_means = random_walk(source, least_s), _walk_of_means(source)
    return of_means if walk and of_means and of_means < CLEARLY * walk else walk


def velocity_walk_shown(source: Source) -> float:
    """Velocity random walk, (m/s)/sqrt(s) an axis, of the longest rest; 0 if none shows it."""
    survey = source.survey
    spans = [*survey.spans, *([] if survey.lead_in is None else [survey.lead_in])]
    if not spans:
        return 0.0
    longest = max(spans, key=lambda s: s.samples)
    return velocity_walk_of_means(survey.windows, longest) or 0.0


def _walk_of_means(source: Source) -> float | None:
    """Angular random walk by means over seconds of the longest rest, if that shows it."""
    spans = source.survey.spans
    longest = max(spans, key=lambda s: s.samples, default=None)
    return None if longest is None else walk_of_means(source.survey.windows, longest)


def random_walks(source: Source, least_s: float = 0.0) -> tuple[float, float] | None:
    """Random walks at rest, of angle, rad/sqrt(s), and of velocity, (m/s)/sqrt(s), of an axis.

    None where the log has no rest of this length, s.
    """
    # a stretch of steady flight will do: it is the scatter that counts, not the mean
    spans = [s for s in source.survey.spans if s.samples > 50 and s.duration_s >= least_s]
    if not spans:
        return None
    longest = max(spans, key=lambda s: s.samples)
    # the mean interval, as the median of stamps that come in bursts says nothing
    axis = np.sqrt(longest.duration_s / longest.samples / 3.0)
    return float(longest.gyro_std * axis), float(longest.accel_std * axis)


def stated_noise_denied(source: Source, config: ProcessConfig) -> list[Finding]:
    """A warning of gyros that are far noisier at rest than the stated grade, or a noise file."""
    stated, shown = config.navigation.imu_grade, gyro_walk_shown(source)
    assumed, option = random_walk_of(measured_noise(config)), "--imu-noise"
    named = f"in {Path(config.navigation.imu_noise or '').name}"
    if assumed is None and stated != "auto":
        assumed, option = IMU_GRADES[stated].angle_random_walk, "--imu-grade"
        named = f"of --imu-grade {stated}"
    if shown is None or assumed is None or shown < NOISIER * assumed:
        return []
    shown, assumed = shown / DEGREE_PER_ROOT_HOUR, assumed / DEGREE_PER_ROOT_HOUR
    return [
        Finding(
            "imu-options",
            f"the gyro's noise at rest is {shown:.2g} deg/sqrt(h), that {named}"
            f" {assumed:.2g}: the attitude is computed as if the gyros were better than they are",
            answer=f"leave {option} out, unless an engine shakes the IMU at rest",
            numbers={"deg_sqrt_h": shown},
        )
    ]


def random_walk(source: Source, least_s: float = 0.0) -> float | None:
    """Angular random walk at rest, rad/sqrt(s) an axis; see :func:`random_walks`."""
    walks = random_walks(source, least_s)
    return None if walks is None else walks[0]


def _hides_noise(source: Source, config: ProcessConfig) -> bool:
    """Whether the resolution of the gyros is too coarse for their noise at rest to show.

    Quantised rates that hardly change have no scatter, however noisy and biased the gyro is. Counts
    of angle, as of laser gyros, are not affected: their sum is the angle.
    """
    if random_walks(source) is None or config.input.sample_kind == "increment":
        return False
    if _walk_of_means(source):
        return False
    longest = max(source.survey.spans, key=lambda s: s.samples)
    return source.survey.gyro_resolution > COARSE * longest.gyro_std / np.sqrt(3.0)


def bias_grade(source: Source, config: ProcessConfig) -> Grade:
    """The grade of the gyros as stated, or by their noise, whatever their rate at rest is."""
    if config.navigation.imu_grade != "auto":
        return config.navigation.imu_grade
    walk = gyro_walk(source, config)
    return "mems" if walk is None or _hides_noise(source, config) else grade_by_noise(walk)


def largest_bias(source: Source, config: ProcessConfig) -> float:
    """Rate, rad/s, beyond which gyros as quiet as these turn; infinite of those that are not."""
    walk = gyro_walk(source, config)
    if walk is None or config.navigation.imu_grade != "auto" or _hides_noise(source, config):
        return np.inf
    grade = grade_by_noise(walk)
    if grade_by_bias(grade, bias_across_gravity(source)) in LOW_COST:
        return np.inf
    return LARGEST_BIAS.get(grade, np.inf)


def bias_at_rest(source: Source) -> float | None:
    """Length of the gyro's bias at rest, rad/s, less the possible part of the Earth's rate.

    From the longest rest of half a minute in which GNSS, if the log has it, does not move; None
    without one. Steady flight, which looks like rest, does not count. In a log without GNSS shorter
    rests count too, and the smallest rate of all, as any of them may be a turn. The uncertainty of
    the mean by the noise at rest, above all of an idling engine, is subtracted.
    """
    still = longest_rest(source.survey.spans, source.aiding.gnss)
    if still is not None and still.duration_s >= REST_S:
        by_chance = CHANCE_SIGMAS * still.gyro_std / np.sqrt(still.samples)
        return max(0.0, float(np.linalg.norm(still.gyro)) - EARTH_RATE - by_chance)
    if source.aiding.gnss is not None:
        return None
    rates = [
        float(np.linalg.norm(span.gyro)) - LIKELY * span.gyro_std / np.sqrt(span.samples)
        for span in source.survey.spans
        if span.duration_s >= BRIEF_REST_S
    ]
    return max(0.0, min(rates) - EARTH_RATE) if rates else None


def bias_across_gravity(source: Source) -> float:
    """The least that the gyros' bias can be, rad/s, by the longest rest of the log, however short.

    Only the vertical part of its rate may be a slow turn. About any other axis a turn would tilt
    the specific force, as the accelerometers would feel; unless it leans itself, as in the turn of
    an aircraft, in proportion to rate and speed. The Earth's rate and noise are subtracted.
    """
    still = longest_rest(source.survey.spans, source.aiding.gnss)
    if still is None:
        return 0.0
    windows = source.survey.windows
    force = windows.accel[(windows.start_ns >= still.start_ns) & (windows.start_ns < still.end_ns)]
    half = len(force) // 2
    if not half:
        return 0.0
    up = still.accel / np.linalg.norm(still.accel)
    across = still.gyro - up * (up @ still.gyro)
    tilted = np.linalg.norm(np.cross(across, still.accel)) * 0.5 * still.duration_s
    seen = np.linalg.norm(force[half:].mean(axis=0) - force[:half].mean(axis=0))
    by_chance = CHANCE_SIGMAS * 2.0 * still.accel_std / np.sqrt(still.samples)
    if seen + by_chance > TILTED * tilted:
        return 0.0
    turns = FASTEST / STANDARD_GRAVITY * float(still.gyro @ still.gyro)
    by_chance = CHANCE_SIGMAS * still.gyro_std / np.sqrt(still.samples)
    return max(0.0, float(np.linalg.norm(across)) - turns - EARTH_RATE - by_chance)


def _small_bias(source: Source) -> bool:
    """Whether any rest shows that the gyros' bias is at most about that of a tactical one."""
    still = longest_rest(source.survey.spans, source.aiding.gnss)
    if still is None:
        return False
    by_chance = CHANCE_SIGMAS * still.gyro_std / np.sqrt(still.samples)
    most = max(0.0, float(np.linalg.norm(still.gyro)) - EARTH_RATE) + by_chance
    return bool(most <= 2.0 * LIKELY * IMU_GRADES["tactical"].gyro_bias)


def sensor_grade(source: Source, config: ProcessConfig) -> ImuGrade:
    """Grade of the IMU, and the reason.

    Without a rest the sensors count as MEMS: sigmas that are too large cost accuracy, sigmas that
    are too small are wrong. MEMS whose bias at rest is more likely that of a bare chip are of the
    grade ``consumer``.
    """
    if config.navigation.imu_grade != "auto":
        return ImuGrade(config.navigation.imu_grade, "as configured")
    judged, rest = (
        _by_noise_and_bias(source, config),
        longest_rest(source.survey.spans, source.aiding.gnss),
    )
    if judged.grade != "mems" or rest is None or uncalibrated(rest.gyro) < LIKELIER:
        return judged
    bias = float(np.linalg.norm(rest.gyro)) / DEGREE
    return ImuGrade("consumer", f"{judged.why}; not calibrated, by a bias of {bias:.2g} deg/s")


def _by_noise_and_bias(source: Source, config: ProcessConfig) -> ImuGrade:
    """A grade by the noise, and a worse one if the bias is too large for it."""
    file = config.navigation.imu_noise
    measured = random_walk_of(measured_noise(config))
    walk = gyro_walk_shown(source) if measured is None else measured
    if walk is None:
        return ImuGrade("mems", "assumed, as the log shows no rest")
    if measured is None and _hides_noise(source, config):
        return ImuGrade("mems", "as the resolution of its gyros hides their noise at rest")
    where = f"in {Path(file).name}" if file is not None and measured is not None else "at rest"
    moving = (
        walks_in_motion(source) if measured is None and source.aiding.gnss is not None else None
    )
    if (
        moving is not None
        and moving[0] < walk
        and grade_by_noise(moving[0]) != grade_by_noise(walk)
    ):
        # What shakes the vehicle where it stands, an engine or people, is no noise of the IMU
        walk, where = moving[0], "in motion, less than at rest"
    shown = walk / DEGREE_PER_ROOT_HOUR
    grade, why = grade_by_noise(walk), f"by its gyro noise {where}, {shown:.2g} deg/sqrt(h)"
    bias = bias_at_rest(source)
    if grade_by_bias(grade, across := bias_across_gravity(source)) != grade:
        bias = max(bias or 0.0, across)
    if not bias and measured is None and grade == "tactical" and not _small_bias(source):
        # Calibrated MEMS have its noise, and biases tens of times those of a tactical gyro
        return ImuGrade("industrial", f"{why}, as no rest shows its bias to be small")
    lower = grade if bias is None else grade_by_bias(grade, bias)
    if bias is None or lower == grade:
        return ImuGrade(grade, why)
    return ImuGrade(lower, f"{why}, and its bias there, {bias / DEGREE_PER_HOUR:.2g} deg/h")
