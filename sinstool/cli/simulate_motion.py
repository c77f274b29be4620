"""`sinstool simulate spiral-climb`, `manoeuvring-flight`, `drive` and `launch`: over the Earth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import click

from sinstool.cli.choice import Choice
from sinstool.cli.options import Numbers
from sinstool.cli.simulate_options import START_NS, check, check_outputs, common, write_log
from sinstool.core.units import DEGREE

F = TypeVar("F", bound=Callable[..., Any])


class Span(click.ParamType):
    """START:END in seconds."""

    name = "span"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        """Parse the text of an option."""
        if not isinstance(value, str):
            return tuple(value)
        try:
            start, end = (float(part) for part in value.split(":"))
        except ValueError:
            self.fail(f"'{value}' is not START:END in seconds", param)
        if not 0.0 <= start < end:
            self.fail(f"'{value}' does not end after it starts", param)
        return start, end


def aids(gnss_model: str, gnss_rate: float, baro_rate: float) -> Callable[[F], F]:
    """Options of the receiver and the barometer, with a scenario's own defaults."""

    def decorate(function: F) -> F:
        span = Span()
        options = [
            click.option("--gnss-rate", type=float, default=gnss_rate, show_default=True,
                         help="fixes/s, Hz; 0 for none"),
            click.option("--gnss-model", type=Choice(["perfect", "launch", "coloured"]),
                         default=gnss_model, show_default=True,
                         help="errors; launch: 0.1 m/s and 1 m white, 4.9 m Markov of 60 s;"
                         " coloured: Markov in position (5/5/8 m, 200 s) and velocity (0.1/0.1/0.15"
                         " m/s, 60 s) beside white noise"),
            click.option("--gnss-latency", type=float, default=0.0, show_default=True,
                         help="by which a fix is older than its stamp, s"),
            click.option("--gnss-offset", type=float, default=0.0, show_default=True,
                         help="of the first fix from the first Imu sample, s"),
            click.option("--lever-arm", type=Numbers(3), default="0,0,0", show_default=True,
                         metavar="X,Y,Z", help="from the Imu to the antenna, m, FRD"),
            click.option("--gnss-outage", type=span, multiple=True, metavar="START:END",
                         help="no fixes there, s from the start; repeatable"),
            click.option("--gnss-flat", type=span, multiple=True, metavar="START:END",
                         help="fixes without height there; repeatable"),
            click.option("--gnss-outliers", type=click.FloatRange(0.0, 1.0), default=0.0,
                         show_default=True, help="share of fixes that are 100 m and 20 m/s off"),
            click.option("--gnss-jump", type=span, multiple=True, metavar="START:END",
                         help="position 100 m off to the north there; repeatable"),
            click.option("--velocity/--no-velocity", default=True, show_default=True,
                         help="write the receiver's velocity too"),
            click.option("--baro-rate", type=float, default=baro_rate, show_default=True,
                         help="pressures/s, Hz; 0 for none"),
            click.option("--baro-sigma", type=float, default=10.0, show_default=True,
                         help="of the barometer's error, first-order Markov, m"),
            click.option("--baro-time", type=float, default=500.0, show_default=True,
                         help="its correlation time, s"),
            click.option("--baro-white", type=float, default=0.0, show_default=True,
                         help="white noise of the barometer, m"),
        ]  # fmt: skip
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def place(latitude: float, longitude: float, height: float, heading: float) -> Callable[[F], F]:
    """Options of where a motion begins, with a scenario's own defaults."""

    def decorate(function: F) -> F:
        options = [
            click.option("--latitude", type=float, default=latitude, show_default=True,
                         help="degrees"),
            click.option("--longitude", type=float, default=longitude, show_default=True,
                         help="degrees"),
            click.option("--height", type=float, default=height, show_default=True,
                         help="metres, ellipsoidal"),
            click.option("--heading", type=float, default=heading, show_default=True,
                         help="at the start, degrees"),
        ]  # fmt: skip
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


@click.command("spiral-climb")
@common(duration=3600.0, rate=128.0)
@place(34.25, 108.9, 400.0, 0.0)
@aids("coloured", 1.0, 50.0)
def spiral_climb(duration: float, rate: float, **told: Any) -> dict[str, Any]:
    """The flight of the height-damping paper: wide circles at 2 degrees of bank, 20 m a turn."""
    from sinstool.simulation.flight import spiral_climb as motion

    check(duration, rate, told["seed"])
    return _write("spiral-climb", motion(duration, rate, **_place(told)), duration, rate, told)


@click.command("manoeuvring-flight")
@common(duration=1800.0, rate=100.0)
@place(34.25, 108.9, 1500.0, 0.0)
@click.option("--turbulence", type=click.FloatRange(min=0.0), default=1.0, show_default=True,
              help="factor of its angles")  # fmt: skip
@aids("coloured", 1.0, 10.0)
def manoeuvring_flight(
    duration: float, rate: float, turbulence: float, **told: Any
) -> dict[str, Any]:
    """Turns of 35 degrees of bank to either side, climbs and dives, in turbulence."""
    from sinstool.simulation.flight import manoeuvring_flight as motion

    check(duration, rate, told["seed"])
    trajectory = motion(duration, rate, turbulence=turbulence, seed=told["seed"], **_place(told))
    return _write(
        "manoeuvring-flight", trajectory, duration, rate, told | {"turbulence": turbulence}
    )


@click.command("drive")
@common(duration=600.0, rate=100.0)
@place(48.1, 11.6, 560.0, 40.0)
@click.option("--still", type=click.FloatRange(min=0.0), default=60.0, show_default=True,
              help="at rest before the drive, s")  # fmt: skip
@aids("coloured", 4.0, 10.0)
def drive(duration: float, rate: float, still: float, **told: Any) -> dict[str, Any]:
    """Stand, then drive through a town on hills, with stops and turns."""
    from sinstool.simulation.drive import road_drive as motion

    check(duration, rate, told["seed"])
    trajectory = motion(duration, rate, still_s=still, seed=told["seed"], **_place(told))
    return _write("drive", trajectory, duration, rate, told | {"still": still})


@click.command("launch")
@common(duration=260.0, rate=200.0, kind="increment")
@place(41.25, 100.3, 1000.0, 63.0)
@click.option("--dynamics", type=click.FloatRange(min=0.0), default=1.0, show_default=True,
              help="factor of the manoeuvres after the boost")  # fmt: skip
@click.option("--straight", is_flag=True, help="straight and level after the boost")
@click.option("--pad", type=click.FloatRange(min=0.0), default=0.0, show_default=True,
              help="at rest before lift-off, s")  # fmt: skip
@click.option("--launch-grade", type=Choice(["0.01", "1", "10"]), metavar="DEG/H",
              help="sensors of the alignment paper instead of --grade")  # fmt: skip
@click.option("--accel-unit-reading", type=Choice(["m/s^2", "g"]), default="g",
              show_default=True, help="how the paper's accelerometer biases are read")  # fmt: skip
@click.option("--gyro-range", type=click.FloatRange(min=0.0, min_open=True), metavar="DEG/S",
              help="the gyro clips there")  # fmt: skip
@aids("launch", 10.0, 0.0)
def launch(
    duration: float,
    rate: float,
    dynamics: float,
    straight: bool,
    pad: float,
    launch_grade: str | None,
    accel_unit_reading: Any,
    gyro_range: float | None,
    **told: Any,
) -> dict[str, Any]:
    """The flight of the alignment paper: boost, calm, glide with turns; 260 s."""
    from sinstool.simulation import launch_sensors
    from sinstool.simulation.launch import launch as motion

    check(duration, rate, told["seed"])
    where = _place(told)
    azimuth = where.pop("heading")
    trajectory = motion(
        rate, duration, azimuth=azimuth, dynamics=dynamics, straight=straight, pad_s=pad, **where
    )
    grade = None
    if launch_grade is not None:
        grade = launch_sensors.launch_grade(launch_grade, accel_unit_reading)
    settings = {
        "dynamics": dynamics,
        "straight": straight,
        "pad": pad,
        "launch_grade": launch_grade,
        "accel_unit_reading": accel_unit_reading,
        "gyro_range": gyro_range,
    }
    limit = None if gyro_range is None else gyro_range * DEGREE
    return _write("launch", trajectory, duration, rate, told | settings, grade, limit)


def _place(told: dict[str, Any]) -> dict[str, Any]:
    """Where the motion begins, in radians."""
    import math

    limits = {"latitude": 90.0, "longitude": 180.0}
    for name, limit in limits.items():
        if not -limit <= told[name] <= limit:
            raise click.UsageError(f"--{name} is {told[name]}, not from {-limit:g} to {limit:g}")
    if not (math.isfinite(told["height"]) and math.isfinite(told["heading"])):
        raise click.UsageError("--height and --heading are not finite numbers")
    angles = {name: told[name] * DEGREE for name in ("latitude", "longitude", "heading")}
    return {**angles, "height": told["height"], "start_ns": START_NS}


def _write(
    scenario: str,
    trajectory: Any,
    duration: float,
    rate: float,
    told: dict[str, Any],
    grade: Any = None,
    gyro_range: float | None = None,
) -> dict[str, Any]:
    from sinstool.simulation.launch_sensors import saturated
    from sinstool.simulation.log import Axes, imu_topic, truth_topics
    from sinstool.simulation.sensors import GRADES, with_errors

    check_outputs(told)
    sensor = with_errors(trajectory.imu, grade or GRADES[told["grade"]], told["seed"])
    if gyro_range is not None:
        sensor = saturated(sensor, gyro_range, float("inf"))
    axes = Axes(told["body_axes"])
    topics = [imu_topic(sensor, told["gyro_kind"], axes)]
    if told["truth"]:
        topics += truth_topics(trajectory.imu, axes, trajectory)
    topics += _gnss(trajectory, told) + _baro(trajectory, told)
    hidden = ("output", "report", "overwrite", "as_json", "verbose")
    settings = {
        "scenario": scenario,
        "duration_s": str(duration),
        "rate_hz": str(rate),
        **{k: str(v) for k, v in told.items() if k not in hidden},
    }

    def write_page(params: Mapping[str, Any]) -> None:
        from sinstool.report.pages.simulate import write_motion

        write_motion(params, trajectory.imu, sensor, topics, trajectory)

    return write_log(told, topics, settings, write_page)


def _gnss(trajectory: Any, told: dict[str, Any]) -> list[Any]:
    if told["gnss_rate"] == 0.0:
        return []
    from sinstool.simulation.gnss import MODELS, GnssFaults, Jump, Receiver, gnss_samples
    from sinstool.simulation.log import gnss_topics

    faults = GnssFaults(
        outages=tuple(told["gnss_outage"]),
        jumps=tuple(Jump(a, b, (100.0, 0.0, 0.0)) for a, b in told["gnss_jump"]),
        outlier_fraction=told["gnss_outliers"],
        outlier_position=100.0,
        outlier_velocity=20.0,
        flat=tuple(told["gnss_flat"]),
    )
    receiver = Receiver(
        rate_hz=told["gnss_rate"],
        offset_s=told["gnss_offset"],
        latency_s=told["gnss_latency"],
        lever_arm_b=told["lever_arm"],
        errors=MODELS[told["gnss_model"]],
        faults=faults,
    )
    try:
        samples = gnss_samples(trajectory, receiver, told["seed"] + 1000)
    except ValueError as exc:
        raise click.UsageError(str(exc)) from exc
    return gnss_topics(samples, told["velocity"])


def _baro(trajectory: Any, told: dict[str, Any]) -> list[Any]:
    if told["baro_rate"] == 0.0:
        return []
    if not told["baro_rate"] > 0.0 or not told["baro_time"] > 0.0:
        raise click.UsageError("--baro-rate and --baro-time must be above 0")
    import numpy as np

    from sinstool.methods.height.pressure import geopotential, height_per_pascal, pressure_at
    from sinstool.simulation.barometer import barometer
    from sinstool.simulation.log import baro_topic

    first, last = (int(trajectory.time_ns[k]) for k in (0, -1))
    count = int((last - first) * 1e-9 * told["baro_rate"]) + 1
    times = first + np.round(np.arange(count) * 1e9 / told["baro_rate"]).astype(np.int64)
    seconds = (trajectory.time_ns - first) * 1e-9
    truth = np.interp((times - first) * 1e-9, seconds, trajectory.height)
    measured, _ = barometer(
        times,
        truth,
        sigma=told["baro_sigma"],
        correlation_time=told["baro_time"],
        white=told["baro_white"],
        seed=told["seed"] + 2000,
    )
    pressure = pressure_at(geopotential(measured))
    slope = float(np.median(np.abs(height_per_pascal(pressure))))
    return [baro_topic(times, pressure, (told["baro_white"] / slope) ** 2)]
