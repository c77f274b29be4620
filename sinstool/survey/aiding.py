"""What helps an IMU along: GNSS position and velocity, barometer, of one log, in order.

These streams are slow beside the Imu's, so they are read whole. Every message is either used or
counted, and units that cannot be right are refused with the option that answers them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import DataError, SinstoolError, TopicError
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Baro, BaroHeight, Gnss, GnssEpochs, Stream, Velocity
from sinstool.core.timeline import sorted_stream
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import (
    FIX_TYPE,
    HEIGHT_TYPES,
    PRESSURE_TYPE,
    VELOCITY_TYPES,
)
from sinstool.io.readers.streams import (
    Losses,
    read_fixes,
    read_height,
    read_pressure,
    read_velocity,
)
from sinstool.io.readers.topics import OWN_PREFIXES, choose_optional
from sinstool.methods.height.pressure import suspected_unit

S = TypeVar("S", bound=Stream)
WARNING = Severity.WARNING

# Position and velocity of one epoch may be stamped apart by the time between their messages.
SAME_EPOCH_NS = 20_000_000
PROBE = 100
PASCALS = {"Pa": 1.0, "hPa": 100.0, "kPa": 1000.0, "inHg": 3386.389}
# Faster than this by GNSS, or further by fixes alone, is no rest, however still the Imu seems.
MOVING_M_S = 1.0
MOVING_M = 30.0
# A velocity whose down part is exactly zero, while height moves by this, has none.
FLAT_HEIGHT_M = 5.0
# Beyond what any vehicle with an IMU on Earth does, though not beyond what damaged bytes say.
FASTEST_M_S = 2e4
# A standard deviation above this says "unknown", however much larger it is.
UNKNOWN_SIGMA = 1e6


@dataclass(frozen=True)
class Barometer:
    """A barometer, or heights, of a log.

    Attributes
    ----------
    stream : Baro or BaroHeight or None
        By time; values that no atmosphere has are still in it. None where the log has none.
    topic : str
    findings : tuple of Finding
    problem : SinstoolError or None
        Why it cannot be read, to be raised where it is needed.
    """

    stream: Baro | BaroHeight | None = None
    topic: str = ""
    findings: tuple[Finding, ...] = ()
    problem: SinstoolError | None = None


@dataclass(frozen=True)
class AidingData:
    """GNSS and barometer of a run.

    Attributes
    ----------
    gnss : GnssEpochs or None
        Epochs with a position or a velocity at least, by time.
    fix_topic, velocity_topic : str
        Where they come from; '' where the log has none.
    findings : tuple of Finding
        What was odd about them, or left out.
    barometer : Barometer
    """

    gnss: GnssEpochs | None = None
    fix_topic: str = ""
    velocity_topic: str = ""
    findings: tuple[Finding, ...] = ()
    barometer: Barometer = field(default_factory=Barometer)


def aiding_channels(log: Log) -> list[int]:
    """Channels that GNSS and a barometer may be read from, but for outputs of ours."""
    types = {FIX_TYPE, PRESSURE_TYPE, *VELOCITY_TYPES, *HEIGHT_TYPES}
    return [
        number
        for number, channel in log.channels.items()
        if channel.type in types and not channel.topic.startswith(OWN_PREFIXES)
    ]


def read_gnss(
    log: Log, options: InputOptions, log_time: bool, until_ns: int | None = None
) -> AidingData:
    """Position and velocity of a log, joined by epoch.

    Parameters
    ----------
    log_time : bool
        The run uses the recorder's times instead of stamps.
    until_ns : int, optional
        What comes later is not read; by default all of the log is.

    Raises
    ------
    TopicError, DataError
    """
    fixes, velocity = None, None
    fix_topic, velocity_topic = "", ""
    findings: list[Finding] = []
    channels = choose_optional(log, "--gnss-topic", options.gnss_topic, FIX_TYPE)
    if channels:
        fix_topic = channels[0].topic
        blocks = _until(read_fixes(log, channels, Losses()), until_ns)
        fixes, findings = _in_order(blocks, log_time, fix_topic)
    if fixes is not None:
        problem = ("no-fix", "messages hold no fix", Severity.NOTE)
        fixes, more = _only(fixes, fixes.has_fix, fix_topic, *problem)
        findings += more
        if fixes is None:
            text = f"topic {fix_topic} holds no valid fix"
            findings.append(Finding("no-fixes", text, topic=fix_topic))
    channels = choose_optional(log, "--velocity-topic", options.velocity_topic, *VELOCITY_TYPES)
    if channels:
        velocity_topic = channels[0].topic
        speeds = _until(read_velocity(log, channels, Losses()), until_ns)
        velocity, more = _in_order(speeds, log_time, velocity_topic)
        findings += more
    if velocity is not None:
        what = f"velocities are not finite or beyond {FASTEST_M_S:.0f} m/s; left out"
        good = _of_vehicles(velocity.velocity_n)
        velocity, more = _only(velocity, good, velocity_topic, "no-vehicle-velocity", what)
        findings += more
    if fixes is not None:
        if options.gnss_unit == "rad":
            degrees = {"latitude": fixes.latitude / DEGREE, "longitude": fixes.longitude / DEGREE}
            fixes = replace(fixes, **degrees)
        _check_range(log, fix_topic, fixes)
        # a filter that starts at a damaged one would have to believe it
        what = "fixes are not on Earth; left out"
        fixes, more = _only(fixes, fixes.on_earth, fix_topic, "not-on-earth", what)
        findings += more
    if fixes is not None and options.gnss_unit is None:
        _check_degrees(log, fix_topic, fixes, velocity)
    if fixes is not None and velocity is not None:
        velocity, more = _without_flat(fixes, velocity, velocity_topic)
        findings += more
    return AidingData(join(fixes, velocity), fix_topic, velocity_topic, tuple(findings))


def read_barometer(log: Log, options: InputOptions, log_time: bool) -> Barometer:
    """Pressure or height of a log; what is wrong with it is kept for whoever needs it."""
    try:
        return _barometer(log, options, log_time)
    except (TopicError, DataError) as exc:
        return Barometer(problem=exc)


def _barometer(log: Log, options: InputOptions, log_time: bool) -> Barometer:
    heights = options.baro_kind == "height"
    types = HEIGHT_TYPES if heights else (PRESSURE_TYPE,)
    channels = choose_optional(log, "--baro-topic", options.baro_topic, *types)
    if not channels:
        return Barometer()
    topic = channels[0].topic
    if heights:
        levels = read_height(log, channels, Losses())
        stream, findings = _in_order(levels, log_time, topic, repeats=True)
        return Barometer(stream, topic, tuple(findings))
    pressures = read_pressure(log, channels, Losses())
    baro, findings = _in_order(pressures, log_time, topic, repeats=True)
    if baro is not None and options.baro_unit is None:
        _check_pressure(log, channels[0], baro)
    elif baro is not None and options.baro_unit is not None:
        scale = PASCALS[options.baro_unit]
        baro = replace(baro, pressure=baro.pressure * scale, variance=baro.variance * scale**2)
    return Barometer(baro, topic, tuple(findings))


def _until(blocks: Iterable[S], until_ns: int | None) -> Iterator[S]:
    """Blocks up to the first that lies after a time altogether."""
    for block in blocks:
        if until_ns is not None and len(block) and int(block.time_ns.min()) > until_ns:
            return
        yield block


def moving_at(gnss: GnssEpochs | None, start_ns: int, end_ns: int) -> float | None:
    """Speed that GNSS shows in a span of time, m/s; None where it shows none that is sure.

    Parameters
    ----------
    gnss : GnssEpochs or None
    """
    if gnss is None:
        return None
    inside = gnss.rows((gnss.time_ns >= start_ns) & (gnss.time_ns <= end_ns))
    fast = inside.rows(inside.has_velocity)
    if len(fast):
        speed = float(np.median(np.linalg.norm(fast.velocity_n[:, :2], axis=1)))
        return speed if speed > MOVING_M_S else None
    fixed = inside.rows(inside.has_position)
    if len(fixed) < 2:
        return None
    seconds = float(fixed.time_ns[-1] - fixed.time_ns[0]) * 1e-9
    north, east = horizontal_metres(
        fixed.latitude[-1] - fixed.latitude[0],
        wrapped(fixed.longitude[-1] - fixed.longitude[0]),
        fixed.latitude[0],
    )
    way = float(np.hypot(north, east))
    return way / seconds if way > MOVING_M and way > MOVING_M_S * seconds else None


def _in_order(
    blocks: Iterable[S], log_time: bool, topic: str, repeats: bool = False
) -> tuple[S | None, list[Finding]]:
    """All of a stream by time, and what was out of order or repeated."""
    stream = sorted_stream(blocks, log_time, repeats)
    if stream is None:
        return None, []
    findings = []
    if stream.backward:
        text = f"topic {topic}: {stream.backward} messages came out of order; sorted"
        findings.append(_counted("out-of-order", text, topic, stream.backward))
    if stream.repeated and not repeats:
        text = f"topic {topic}: {stream.repeated} messages repeat a stamp; left out"
        findings.append(_counted("repeated-stamps", text, topic, stream.repeated))
    return stream.stream, findings


def _counted(kind: str, text: str, topic: str, count: int, severity: Severity = WARNING) -> Finding:
    return Finding(kind, text, severity, topic=topic, numbers={"messages": count})


def _only(
    stream: S, good: np.ndarray, topic: str, kind: str, what: str, severity: Severity = WARNING
) -> tuple[S | None, list[Finding]]:
    """The good rows, None where there is none, and how many are not good."""
    bad = int(len(good) - np.count_nonzero(good))
    if not bad:
        return stream, []
    finding = _counted(kind, f"topic {topic}: {bad} {what}", topic, bad, severity)
    return stream.rows(good) if good.any() else None, [finding]


def _of_vehicles(velocity_n: np.ndarray) -> np.ndarray:
    """Which velocities a vehicle can have; those without a vertical part are of use too."""
    level = (np.abs(velocity_n[:, :2]) < FASTEST_M_S).all(axis=1)
    return np.asarray(level & ~(np.abs(velocity_n[:, 2]) >= FASTEST_M_S))


def _check_degrees(log: Log, topic: str, fixes: Gnss, velocity: Velocity | None) -> None:
    """Refuse latitude and longitude that are radians.

    Small numbers alone are no proof: there are places near 0 N, 0 E. Where velocity is known,
    the distance covered decides.
    """
    latitude, longitude = fixes.latitude / DEGREE, fixes.longitude / DEGREE
    if np.abs(latitude).max() > np.pi / 2 or np.abs(longitude).max() > np.pi:
        return
    if velocity is not None and len(velocity) > 1:
        seconds = np.diff(velocity.time_ns) * 1e-9
        speed = np.linalg.norm(velocity.velocity_n[:, :2], axis=1)
        travelled = float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.minimum(seconds, 5.0)))
        north, east = horizontal_metres(
            np.diff(fixes.latitude), wrapped(np.diff(fixes.longitude)), fixes.latitude[1:]
        )
        # the leap of one bad fix is no way that was covered
        way = np.hypot(north, east)
        covered = float(np.sum(np.minimum(way, 10.0 * max(travelled / len(way), 1.0))))
        if travelled > 20.0 and covered > 0.25 * travelled:
            return
    raise DataError(
        log.path,
        f"topic {topic}: latitudes are about {np.median(latitude):.4g} and longitudes"
        f" {np.median(longitude):.4g}, as in radians",
        "add --gnss-unit rad (or --gnss-unit deg if the log is right)",
    )


def _check_range(log: Log, topic: str, fixes: Gnss) -> None:
    """Refuse angles that are on no globe, and heights that no vehicle has."""
    latitude = float(np.median(np.abs(fixes.latitude[:PROBE])) / DEGREE)
    longitude = float(np.median(np.abs(fixes.longitude[:PROBE])) / DEGREE)
    if latitude > 90.0 or longitude > 360.0:
        raise DataError(
            log.path,
            f"topic {topic}: its latitudes are about {latitude:.6g} and longitudes"
            f" {longitude:.6g}, in no unit of NavSatFix",
            "sensor_msgs/NavSatFix holds degrees (some drivers write 1e-7 degrees): convert it,"
            " or name another topic with --gnss-topic",
        )
    heights = fixes.height[np.isfinite(fixes.height)][:PROBE]
    if len(heights) and not -500.0 <= float(np.median(heights)) <= 60000.0:
        raise DataError(
            log.path,
            f"topic {topic}: its altitudes are about {np.median(heights):.6g} m",
            "sensor_msgs/NavSatFix holds metres (some drivers write millimetres): convert it, or"
            " name another topic with --gnss-topic",
        )


def _check_pressure(log: Log, channel: Channel, baro: Baro) -> None:
    """Refuse pressures that are not in pascal."""
    judged = suspected_unit(baro.pressure)
    if judged.unit == "Pa":
        return
    if not judged.samples:
        raise DataError(
            log.path,
            f"topic {channel.topic} holds no pressure that is positive",
            "name another topic with --baro-topic",
        )
    if judged.unit == "unknown":
        raise DataError(
            log.path,
            f"topic {channel.topic}: its pressures are about {judged.median:.5g}, of no atmosphere"
            " in any usual unit",
            "give the unit with --baro-unit, or name another topic with --baro-topic",
        )
    raise DataError(
        log.path,
        f"topic {channel.topic}: its pressures are about {judged.median:.5g}, not pascal but as in"
        f" {judged.unit}",
        f"add --baro-unit {judged.unit} (or --baro-unit Pa if the log is right)",
    )


def _without_flat(fixes: Gnss, velocity: Velocity, topic: str) -> tuple[Velocity, list[Finding]]:
    """Take out down velocities that are all exactly zero although height moves."""
    heights = fixes.height[np.isfinite(fixes.height)]
    down = velocity.velocity_n[:, 2]
    if len(heights) < 2 or np.any(down != 0.0) or np.ptp(heights) <= FLAT_HEIGHT_M:
        return velocity, []
    text = (
        f"topic {topic}: its vertical velocity is always zero while height moves by"
        f" {np.ptp(heights):.0f} m; only the horizontal part is used"
    )
    columns = velocity.velocity_n.copy()
    columns[:, 2] = np.nan
    return replace(velocity, velocity_n=columns), [
        Finding("flat-velocity", text, topic=topic, numbers={"height_m": float(np.ptp(heights))})
    ]


def join(fixes: Gnss | None, velocity: Velocity | None) -> GnssEpochs | None:
    """Fixes and velocities by epoch: those stamped together share a row.

    Parameters
    ----------
    fixes : Gnss or None
    velocity : Velocity or None
        Both by time, without repeated stamps.

    Returns
    -------
    GnssEpochs or None
        By time. A row takes the stamp of the fix.
    """
    first = fixes if fixes is not None else velocity
    if first is None:
        return None
    times, logged, rows = first.time_ns, first.log_time_ns, np.arange(len(first))
    if fixes is not None and velocity is not None:
        partner, together = _partners(fixes.time_ns, velocity.time_ns)
        alone = np.setdiff1d(np.arange(len(velocity)), partner[together])
        times = np.concatenate([times, velocity.time_ns[alone]])
        logged = np.concatenate([logged, velocity.log_time_ns[alone]])
        rows = np.concatenate([rows[together], len(fixes) + np.arange(len(alone))])
        velocity = velocity.rows(np.concatenate([partner[together], alone]))
    position, v, sigma_p, sigma_v = (np.full((len(times), 3), np.nan) for _ in range(4))
    if fixes is not None:
        n = len(fixes)
        position[:n] = np.stack([fixes.latitude, fixes.longitude, fixes.height], axis=1)
        sigma_p[:n] = _sigma(fixes.covariance_n, (fixes.covariance_type > 0)[:, None])
    if velocity is not None:
        v[rows] = velocity.velocity_n
        sigma_v[rows] = _sigma(velocity.covariance_n, True)
    latitude, longitude, height = position.T
    epochs = GnssEpochs(times, logged, latitude, longitude, height, v, sigma_p, sigma_v)
    return epochs.rows(np.argsort(times, kind="stable"))


def _partners(fixes_ns: np.ndarray, velocity_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The velocity nearest to each fix, and whether the two are of one epoch."""
    right = np.searchsorted(velocity_ns, fixes_ns)
    left = np.clip(right - 1, 0, len(velocity_ns) - 1)
    right = np.clip(right, 0, len(velocity_ns) - 1)
    to_left = np.abs(velocity_ns[left] - fixes_ns)
    to_right = np.abs(velocity_ns[right] - fixes_ns)
    partner = np.where(to_left <= to_right, left, right)
    # a velocity belongs to one fix only
    first = np.zeros(len(fixes_ns), np.bool_)
    first[np.unique(partner, return_index=True)[1]] = True
    return partner, first & (np.minimum(to_left, to_right) <= SAME_EPOCH_NS)


def _sigma(covariance: np.ndarray, stated: np.ndarray | bool) -> np.ndarray:
    """Roots of the diagonal; NaN where it says nothing."""
    variance = np.einsum("nii->ni", covariance)
    good = stated & np.isfinite(variance) & (variance > 0.0)
    return np.minimum(np.sqrt(np.where(good, variance, np.nan)), UNKNOWN_SIGMA)
