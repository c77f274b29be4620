"""Result of `align`: the values of ``--json``, the terminal and the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sinstool.core.finding import Finding
from sinstool.core.result import Result, compass
from sinstool.core.rotation import to_euler
from sinstool.core.units import DEGREE, DEGREE_PER_HOUR
from sinstool.methods.alignment.gyrocompass import Gyrocompass
from sinstool.methods.alignment.inflight_answer import InFlightAlignment
from sinstool.methods.alignment.inflight_types import UNIFORM_SIGMA, SensorGrade
from sinstool.methods.alignment.initial import Alignment
from sinstool.pipelines.log_used import ImuTime, LogFile
from sinstool.pipelines.plan import Plan
from sinstool.survey.grade import ImuGrade

# Statuses whose heading is known.
HEADING_OBSERVED = ("ok", "degraded")

# What the vectors are that an alignment in motion compares, by the value of ``--vectors``.
VECTORS = {
    "win": "velocity integrated over a sliding window",
    "cen": "velocity integrated over a sliding window, less its mean",
    "int": "velocity integrated from the start",
    "diff": "accelerations by backward differences",
    "diffc": "accelerations by central differences",
    "pos": "positions",
}

Vector = tuple[float | None, ...]


@dataclass(frozen=True)
class AssumedErrors:
    """Errors of the sensors that an alignment in motion assumed, one sigma.

    Attributes
    ----------
    gyro_bias_deg_h, accel_bias_m_s2 : float
        Biases.
    gyro_scale, accel_scale : float
        Scale factors, as fractions.
    angle_random_walk_deg_sqrt_h, velocity_random_walk_m_s_sqrt_s : float
        White noise.
    bias_time_s : float
        Correlation time of biases that wander.
    """

    gyro_bias_deg_h: float
    accel_bias_m_s2: float
    gyro_scale: float
    accel_scale: float
    angle_random_walk_deg_sqrt_h: float
    velocity_random_walk_m_s_sqrt_s: float
    bias_time_s: float

    @classmethod
    def of(cls, grade: SensorGrade) -> AssumedErrors:
        """Errors of a grade, in the units of data sheets."""
        return cls(
            gyro_bias_deg_h=grade.gyro_bias / DEGREE_PER_HOUR,
            accel_bias_m_s2=grade.accel_bias,
            gyro_scale=grade.gyro_scale,
            accel_scale=grade.accel_scale,
            angle_random_walk_deg_sqrt_h=grade.angle_random_walk / DEGREE * 60.0,
            velocity_random_walk_m_s_sqrt_s=grade.velocity_random_walk,
            bias_time_s=grade.bias_time_s,
        )


@dataclass(frozen=True)
class TruthError:
    """Error of the attitude against a reference.

    Attributes
    ----------
    name : str
        Topic or file of ``--truth``.
    error_deg : tuple of float or None
        About north, east, down.
    total_deg : float or None
        The whole angle.
    """

    name: str
    error_deg: Vector | None = None
    total_deg: float | None = None


@dataclass(frozen=True)
class AlignResult(Result):
    """An attitude with its covariance; fields that a method does not provide are None.

    Attributes
    ----------
    input : LogFile
        The log.
    plan : Plan
        Choices, each with its reason.
    imu : ImuTime
        Samples of the IMU.
    imu_grade : ImuGrade
        With the reason.
    status : str
        ``ok``, ``degraded``, ``level-only``, ``unobservable`` or ``failed``.
    method : str
        As in ``plan.first_attitude``.
    time_ns, time_s : int, float
        When the attitude holds; seconds from the first sample.
    start_s, stop_s : float or None
        Span of the data used, from the first sample.
    q_nb_wxyz : tuple of float or None
        Scalar first, from Forward-Right-Down to North-East-Down; None also if heading is not known.
    roll_deg, pitch_deg, heading_deg : float or None
        None if not known.
    sigma_deg : tuple
        Of small rotations about north, east, down.
    findings : tuple of Finding
        About the log and the alignment.
    vectors : str or None
        Which vectors were compared.
    sigma_worst_deg : float or None
        About the least certain axis.
    cov_deg2 : ndarray, shape (3, 3), or None
        Covariance about north, east, down; None if heading is not known.
    observability : float or None
        Geometry of the vectors: 0, one direction only, to 1.
    singular_values : tuple of float or None
        Of the attitude profile matrix.
    n_pairs, n_rejected : int or None
        Pairs of vectors used, and fixes rejected as outliers.
    residual_rms : float or None
        Of the pairs, in the unit of the vectors.
    chi2, refined_chi2 : float or None
        Squared residuals of the pairs, and innovations of the refinement, over what is expected.
    time_to_align_s : float or None
        Until the solver alone was within 1 deg about every axis.
    gate : str or None
        ``paper``, ``mask`` or ``off``.
    assumed : AssumedErrors or None
        Errors of the sensors.
    gyro_bias_removed_deg_h : tuple of float or None
        Gyro bias removed before the alignment, FRD.
    gyro_bias_deg_h, accel_bias_m_s2 : tuple of float or None
        Estimated biases, FRD; of the gyros beside what was removed.
    latency_s : float or None
        Estimated latency of the fixes beside ``--gnss-latency``.
    truth : TruthError or None
        Left out without ``--truth``.
    """

    SCHEMA: ClassVar[str] = "sinstool.align/1"
    OPTIONAL: ClassVar[tuple[str, ...]] = ("truth",)
    input: LogFile
    plan: Plan
    imu: ImuTime
    imu_grade: ImuGrade
    status: str
    method: str
    time_ns: int
    time_s: float
    start_s: float | None
    stop_s: float | None
    q_nb_wxyz: Vector | None
    roll_deg: float | None
    pitch_deg: float | None
    heading_deg: float | None
    sigma_deg: Vector
    findings: tuple[Finding, ...]
    vectors: str | None = None
    sigma_worst_deg: float | None = None
    cov_deg2: np.ndarray | None = None
    observability: float | None = None
    singular_values: Vector | None = None
    n_pairs: int | None = None
    n_rejected: int | None = None
    residual_rms: float | None = None
    chi2: float | None = None
    refined_chi2: float | None = None
    time_to_align_s: float | None = None
    gate: str | None = None
    assumed: AssumedErrors | None = None
    gyro_bias_removed_deg_h: Vector | None = None
    gyro_bias_deg_h: Vector | None = None
    accel_bias_m_s2: Vector | None = None
    latency_s: float | None = None
    truth: TruthError | None = None

    @property
    def method_text(self) -> str:
        """The method in words, with the vectors that it compares."""
        if self.vectors is None:
            return self.method
        return f"{self.method}, on {VECTORS[self.vectors]} (--vectors {self.vectors})"


def angles(q_nb: np.ndarray, status: str) -> dict[str, Any]:
    """Quaternion and Euler angles of an answer; heading only where it is observable."""
    if not np.isfinite(q_nb).all():
        return dict.fromkeys(("q_nb_wxyz", "roll_deg", "pitch_deg", "heading_deg"))
    north = status in HEADING_OBSERVED
    roll, pitch, heading = (float(v) for v in to_euler(q_nb) / DEGREE)
    return {
        "q_nb_wxyz": tuple(q_nb.tolist()) if north else None,
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": compass(heading) if north else None,
    }


def sigmas(answer: InFlightAlignment | Gyrocompass) -> Vector:
    """Sigmas in degrees; None for a heading that is not observable."""
    values: list[float | None] = [finite(s / DEGREE) for s in answer.sigma_rad]
    if answer.status == "level-only":
        values[2] = None
    return tuple(values)


def covariance(answer: InFlightAlignment | Gyrocompass) -> np.ndarray | None:
    """Covariance in deg^2, where heading is observable."""
    return np.asarray(answer.cov / DEGREE**2) if answer.status in HEADING_OBSERVED else None


def finite(value: float | None) -> float | None:
    """A number, or None where it is none."""
    return float(value) if value is not None and np.isfinite(value) else None


def in_motion_values(
    answer: InFlightAlignment, errors: SensorGrade, gate: str, gyro_bias: np.ndarray
) -> dict[str, Any]:
    """Values of an alignment in motion beside its attitude."""
    refined = answer.errors
    return {
        "vectors": answer.vectors,
        "sigma_deg": sigmas(answer),
        "sigma_worst_deg": finite(min(answer.sigma_worst, UNIFORM_SIGMA) / DEGREE),
        "cov_deg2": covariance(answer),
        "observability": finite(answer.rho),
        "singular_values": tuple(finite(s) for s in answer.singular_values),
        "n_pairs": answer.n_pairs,
        "n_rejected": answer.n_rejected,
        "residual_rms": finite(answer.residual_rms),
        "chi2": finite(answer.chi2),
        "refined_chi2": None if refined is None else refined.chi2,
        "time_to_align_s": finite(answer.time_to_align_s),
        "gate": gate,
        "assumed": AssumedErrors.of(errors),
        "gyro_bias_removed_deg_h": tuple((gyro_bias / DEGREE_PER_HOUR).tolist()),
        "gyro_bias_deg_h": None
        if refined is None
        else tuple((refined.gyro_bias / DEGREE_PER_HOUR).tolist()),
        "accel_bias_m_s2": None if refined is None else tuple(refined.accel_bias.tolist()),
        "latency_s": None if refined is None else refined.latency_s,
    }


def at_rest_values(answer: Gyrocompass) -> dict[str, Any]:
    """Values of a gyrocompass beside its attitude."""
    return {
        "sigma_deg": sigmas(answer),
        "sigma_worst_deg": finite(answer.sigma_heading / DEGREE),
        "cov_deg2": covariance(answer),
        "chi2": finite(answer.chi2),
        "gyro_bias_deg_h": tuple((answer.gyro_bias / DEGREE_PER_HOUR).tolist()),
        "accel_bias_m_s2": tuple(answer.accel_bias.tolist()),
    }


def plain_values(alignment: Alignment) -> dict[str, Any]:
    """Values of levelling, or of the log's own orientation, beside the attitude."""
    return {
        "sigma_deg": tuple(None if s is None else s / DEGREE for s in alignment.sigma_rad),
        "gyro_bias_deg_h": tuple((alignment.gyro_bias / DEGREE_PER_HOUR).tolist()),
    }
