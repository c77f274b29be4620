"""The first attitude by the Earth's rotation, at rest; and the Earth's rate at a log's place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import earth_rate_n
from sinstool.core.errors import AlignmentError
from sinstool.methods.alignment import initial
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.sensor_errors import Grade
from sinstool.survey.grade import sensor_grade
from sinstool.survey.source import Source

# Imported where it is used: most logs do not need it, and it takes long to import.
if TYPE_CHECKING:
    from sinstool.methods.alignment.gyrocompass import Gyrocompass


def earth_rate(source: Source) -> np.ndarray | None:
    """Earth rate in NED, rad/s; None without a latitude."""
    if source.latitude is None:
        return None
    return np.asarray(earth_rate_n(source.latitude))


def by_earth_rotation(source: Source, config: ProcessConfig) -> Alignment:
    """Attitude from the Earth's rotation.

    Raises
    ------
    AlignmentError
        The log does not begin still, its latitude is not known, or not even tilt shows.
    """
    path = source.path
    if source.latitude is None:
        raise AlignmentError(
            f"{path}: --align gyrocompass needs the latitude, and the log has no fix",
            "give --latitude",
        )
    if source.survey.lead_in is None:
        raise AlignmentError(
            f"{path}: --align gyrocompass: the log does not begin at rest",
            "choose a beginning at rest with --start, or use --align svd where there is GNSS",
        )
    grade = sensor_grade(source, config).grade
    compassed = compass(source, config, grade)
    if compassed.status == "unobservable":
        raise AlignmentError(
            f"{path}: --align gyrocompass: {'; '.join(compassed.warnings)}",
            "record for longer at rest, or use another --align",
            uncertain=True,
        )
    return from_compass(compassed, source)


def compass(source: Source, config: ProcessConfig, grade: Grade) -> Gyrocompass:
    """Gyrocompass over the still lead-in."""
    still, latitude = source.survey.lead_in, source.latitude
    assert still is not None and latitude is not None
    from sinstool.methods.alignment.gyrocompass import gyrocompass
    from sinstool.methods.alignment.span_reader import MOST_SAMPLES
    from sinstool.pipelines.align.in_motion import increments, sensor_errors

    imu = increments(source, config, np.zeros(3), still.end_ns, most=MOST_SAMPLES)
    errors = sensor_errors(config, grade, False)
    try:
        return gyrocompass(imu, latitude, source.position[2] or 0.0, errors)
    except AlignmentError as exc:
        raise AlignmentError(f"{source.path}: {exc.message}", exc.hint) from exc


def from_compass(answer: Gyrocompass, source: Source) -> Alignment:
    """Attitude at the start of a rest: the same as at its end, as the body did not move."""
    still = source.survey.lead_in
    assert still is not None
    north = answer.status != "level-only"
    sigma = answer.sigma_rad
    return Alignment(
        answer.q_nb,
        "gyrocompass",
        source.survey.first_ns,
        (float(sigma[0]), float(sigma[1]), float(sigma[2]) if north else None),
        answer.status,
        north,
        gyro_bias=initial.still_bias(still, answer.q_nb, earth_rate(source)),
        bias_source="still",
        warnings=answer.warnings,
        covariance_n=answer.cov,
        held_ns=answer.t_ns,
    )
