"""What a run of `process` tells: the values of ``--json``."""

from __future__ import annotations

from typing import Any

from sinstool.core.rotation import to_euler
from sinstool.core.streams import Solution
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.coning.algorithm import ConingAlgorithm, of_rates
from sinstool.methods.strapdown.attitude_run import AttitudeRun
from sinstool.survey.source import Source


def imu(source: Source) -> dict[str, Any]:
    """The Imu topic and what was found of its time."""
    s = source.survey
    return {
        "topic": s.topic,
        "n": s.count,
        "rate_hz": s.rate_hz,
        "first_ns": str(s.first_ns),
        "last_ns": str(s.last_ns),
        "time_source": s.time_source,
        "gaps": s.gap_count,
        "gap_total_s": s.gap_total_s,
        "duplicates": s.order.duplicates,
        "backward": s.order.backward,
        "dropped": s.order.duplicates + s.order.late + s.losses.malformed + s.losses.nonfinite,
    }


def alignment(a: Alignment) -> dict[str, Any]:
    """The first attitude and the gyro bias."""
    roll, pitch, heading = to_euler(a.q_nb) / DEGREE
    return {
        "method": a.method,
        "time_ns": str(a.time_ns),
        "roll_deg": float(roll),
        "pitch_deg": float(pitch),
        "heading_deg": float(heading),
        "sigma_deg": [None if s is None else s / DEGREE for s in a.sigma_rad],
        "status": a.status,
        "north_referenced": a.north_referenced,
        "gyro_bias_rad_s": a.gyro_bias.tolist(),
        "gyro_bias_source": a.bias_source,
    }


def coning(algorithm: ConingAlgorithm, gyro_kind: str, updates: int) -> dict[str, Any]:
    """The algorithm, in the form for the kind of sample that the log has."""
    chosen = algorithm.for_kind(of_rates(gyro_kind))
    return {
        "algorithm": chosen.name,
        "summary": chosen.summary,
        "samples_per_update": chosen.samples,
        "gyro_kind": gyro_kind,
        "takes": chosen.takes,
        "updates": updates,
        "source": chosen.source,
    }


def final(last: Solution, source: Source) -> dict[str, Any]:
    """The last attitude."""
    roll, pitch, heading = to_euler(last.q_nb[-1]) / DEGREE
    latitude, longitude, height = source.position
    if last.position is not None:
        latitude, longitude = (float(v) for v in last.position[-1, :2] / DEGREE)
        height = float(last.position[-1, 2])
    return {
        "time_ns": str(int(last.time_ns[-1])),
        "q_wxyz_ned_frd": last.q_nb[-1].tolist(),
        "roll_deg": float(roll),
        "pitch_deg": float(pitch),
        "heading_deg": float(heading),
        "lat_deg": latitude,
        "lon_deg": longitude,
        "height_m": height,
    }


def lost(source: Source) -> dict[str, Any]:
    """What of the log could not be used."""
    s = source.survey
    return {
        **source.log.account(),
        "malformed": s.losses.malformed,
        "not_finite": s.losses.nonfinite,
        "late": s.order.late,
    }


def run_warnings(source: Source, run: AttitudeRun) -> list[str]:
    """What a user has to be told that only the run could show."""
    notes = [f"lost: {part}" for part in source.log.lost]
    if run.settings.algorithm.caveat:
        notes.append(run.settings.algorithm.caveat)
    if run.missed_rotation:
        notes.append(
            "attitude is held across gaps: at the rates on either side the vehicle turned by"
            f" {run.missed_rotation / DEGREE:.3g} deg during them"
        )
    if source.latitude is None:
        notes.append("no latitude is known, so the Earth's rate is not removed; give --latitude")
    return notes


def something_lost(summary: dict[str, Any]) -> bool:
    """Whether a summary tells of lost data: exit status 3."""
    if summary["hse"] is not None and summary["hse"]["status"] != "ok":
        return True
    return incomplete(summary["lost"])


def incomplete(lost: dict[str, Any]) -> bool:
    """Whether something of a log could not be used; of the values of `lost`."""
    return bool(lost["parts"] or lost["malformed"] or lost["not_finite"] or lost["late"])
