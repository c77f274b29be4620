"""The first attitude of a run, by whatever means its options and its log allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.alignment import initial
from sinstool.alignment.initial import Alignment
from sinstool.config import ProcessConfig
from sinstool.earth import earth_rate_n
from sinstool.errors import AlignmentError
from sinstool.readers.frames import turn_body
from sinstool.source import Source
from sinstool.units import DEGREE


def align(source: Source, config: ProcessConfig) -> Alignment:
    """First attitude and gyro bias.

    Raises
    ------
    AlignmentError
        What was asked for cannot be had from this log.
    """
    options, found = config.align, source.survey
    path = source.log.path
    if options.align == "fixed":
        assert options.initial_attitude is not None
        roll, pitch, heading = (v * DEGREE for v in options.initial_attitude)
        alignment = initial.from_given((roll, pitch, heading), found.first_ns)
    elif options.align == "log":
        if found.orientation is None:
            raise AlignmentError(
                f"{path}: topic {found.topic} holds no orientation",
                "use --align level or --align fixed",
            )
        alignment = initial.from_log(found.orientation, found.orientation_ns)
    elif found.lead_in is not None:
        alignment = initial.from_still(found.lead_in, found.first_ns)
    elif options.align == "level":
        raise AlignmentError(
            f"{path}: the log does not begin still, so its tilt cannot be levelled",
            "choose a still beginning with --start, or use --align log, fixed or auto",
        )
    elif found.orientation is not None and not found.orientation_constant:
        alignment = initial.from_log(found.orientation, found.orientation_ns)
    else:
        alignment = initial.from_motion(found.windows, found.first_ns)
    return _with_bias(alignment, source, config)


def _with_bias(alignment: Alignment, source: Source, config: ProcessConfig) -> Alignment:
    wanted = config.align.gyro_bias
    if wanted == "none":
        return alignment
    if not isinstance(wanted, str):
        bias = turn_body(np.array(wanted), config.input.body_axes)
        return replace(alignment, gyro_bias=bias, bias_source="given")
    still = source.survey.lead_in
    if still is None:
        note = "the log does not begin still, so no gyro bias is removed"
        return replace(alignment, warnings=(*alignment.warnings, note))
    bias = initial.still_bias(still, alignment.q_nb, earth_rate(source))
    return replace(alignment, gyro_bias=bias, bias_source="still")


def earth_rate(source: Source) -> np.ndarray | None:
    """Earth rate in NED, rad/s; None where the latitude is not known."""
    if source.latitude is None:
        return None
    return np.asarray(earth_rate_n(source.latitude))
