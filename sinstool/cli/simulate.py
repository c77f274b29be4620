"""`sinstool simulate`: logs with exact truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import click

from sinstool.cli.choice import Choice, Group
from sinstool.cli.options import Numbers
from sinstool.cli.simulate_many import with_monte_carlo
from sinstool.cli.simulate_motion import drive, launch, manoeuvring_flight, spiral_climb
from sinstool.cli.simulate_options import (
    MAX_DURATION_S,
    MAX_RATE_HZ,
    START_NS,
    check,
    check_outputs,
    common,
    write_log,
)
from sinstool.cli.simulate_rig import command as hse_rig


class Scenarios(Group):
    """The kinds of log."""

    what = "scenario"


@click.group("simulate", cls=Scenarios)
def command() -> None:
    """Write a log with exact truth: /imu/data_raw, and /truth/imu and /truth/odometry beside it."""


@command.command("coning")
@common()
@click.option("--half-angle-deg", type=float, default=1.0, show_default=True, help="of the cone")
@click.option("--frequency", type=float, default=10.0, show_default=True, help="turns/s, Hz")
@click.option("--lead-in", type=float, default=0.0, show_default=True, help="rest before it, s")
def coning(
    half_angle_deg: float,
    frequency: float,
    lead_in: float,
    duration: float,
    rate: float,
    **rest: Any,
) -> dict[str, Any]:
    """Classical coning, exact for any angle, after an optional rest; the Earth does not turn."""
    import numpy as np

    from sinstool.simulation.coning import classical_coning
    from sinstool.simulation.join import after_rest
    from sinstool.simulation.truth import sample_times

    check(duration, rate, rest["seed"])
    if not 0.0 < half_angle_deg < 90.0:
        raise click.UsageError(f"--half-angle-deg is {half_angle_deg}, not between 0 and 90")
    if not abs(frequency) <= MAX_RATE_HZ:
        raise click.UsageError(f"--frequency is {frequency}, not at most {MAX_RATE_HZ:g}")
    if not 0.0 <= lead_in <= MAX_DURATION_S:
        raise click.UsageError(f"--lead-in is {lead_in}, not from 0 to {MAX_DURATION_S:g}")
    times = sample_times(rate, duration + lead_in, START_NS)
    begin = int(np.searchsorted(times, START_NS + round(lead_in * 1e9)))
    if begin >= len(times) - 1:
        raise click.UsageError("--duration holds no sample interval")
    truth = classical_coning(times[begin:], np.radians(half_angle_deg), frequency)
    if begin > 0:
        # A cone without an angle is a rest.
        rest_before = classical_coning(times[: begin + 1], 0.0, frequency, q_nc=truth.q_nb[0])
        truth = after_rest(truth, rest_before)
    scenario = {
        "scenario": "coning",
        "half_angle_deg": half_angle_deg,
        "frequency_hz": frequency,
        "lead_in_s": lead_in,
    }
    return _write(truth, scenario | {"duration_s": duration, "rate_hz": rate}, None, rest)


@command.command("coning-paper")
@common()
@click.option("--noise-frequency", type=float, default=400.0, show_default=True, help="Hz")
@click.option(
    "--noise-deg",
    type=float,
    default=0.01,
    show_default=True,
    help="amplitude of the noise as an angle, before the gyro's filter",
)
@click.option(
    "--phase",
    type=Choice(["consistent", "literal"]),
    default="consistent",
    show_default=True,
    help="the paper's eq. 20 as its motion demands, or to the letter",
)
@click.option(
    "--gyro-response",
    default="cheb:6",
    show_default=True,
    metavar="RESPONSE",
    help="none, cheb:N[,ripple dB,Hz], butter:N[,Hz], or a file with lines of Hz,gain",
)
@click.option("--half-angle-deg", type=float, default=0.1, show_default=True, help="of the cone")
@click.option("--frequency", type=float, default=30.0, show_default=True, help="turns/s, Hz")
def coning_paper(
    noise_frequency: float,
    noise_deg: float,
    phase: Literal["consistent", "literal"],
    gyro_response: str,
    half_angle_deg: float,
    frequency: float,
    duration: float,
    rate: float,
    **rest: Any,
) -> dict[str, Any]:
    """Fu and Luo's experiment: a cone, and noise of one frequency through the gyro's filter.

    The truth is the cone. The gyro has the noise; further errors come with --grade.
    """
    import numpy as np

    from sinstool.simulation.coning_paper import coning_paper as experiment
    from sinstool.simulation.coning_paper import paper_response, response_name
    from sinstool.simulation.truth import sample_times

    check(duration, rate, rest["seed"])
    if not 0.0 < half_angle_deg < 90.0:
        raise click.UsageError(f"--half-angle-deg is {half_angle_deg}, not between 0 and 90")
    if not abs(frequency) <= MAX_RATE_HZ:
        raise click.UsageError(f"--frequency is {frequency}, not at most {MAX_RATE_HZ:g}")
    if not 0.0 <= noise_frequency <= MAX_RATE_HZ:
        raise click.UsageError(
            f"--noise-frequency is {noise_frequency}, not from 0 to {MAX_RATE_HZ:g}"
        )
    if not 0.0 <= noise_deg < 90.0:
        raise click.UsageError(f"--noise-deg is {noise_deg}, not from 0 to 90")
    response = paper_response(gyro_response)
    truth, sensor = experiment(
        sample_times(rate, duration, START_NS),
        noise_frequency,
        phase=phase,
        response=response,
        half_angle=np.radians(half_angle_deg),
        frequency=frequency,
        noise_angle=np.radians(noise_deg),
    )
    scenario = {
        "scenario": "coning-paper",
        "half_angle_deg": half_angle_deg,
        "frequency_hz": frequency,
        "noise_frequency_hz": noise_frequency,
        "noise_deg": noise_deg,
        "phase": phase,
        "gyro_response": response_name(response),
        "duration_s": duration,
        "rate_hz": rate,
    }
    return _write(truth, scenario, None, rest, measured=sensor)


@command.command("static")
@common()
@click.option("--latitude", type=float, default=45.0, show_default=True, help="degrees")
@click.option("--longitude", type=float, default=0.0, show_default=True, help="degrees")
@click.option("--height", type=float, default=0.0, show_default=True, help="metres, ellipsoidal")
@click.option(
    "--attitude",
    type=Numbers(3),
    default="0,0,0",
    show_default=True,
    metavar="ROLL,PITCH,HEADING",
    help="degrees, FRD in NED",
)
def static(
    latitude: float,
    longitude: float,
    height: float,
    attitude: tuple[float, float, float],
    duration: float,
    rate: float,
    **rest: Any,
) -> dict[str, Any]:
    """A body at rest on the turning Earth, with fixes of where it is."""
    import numpy as np

    from sinstool.core.rotation import from_euler
    from sinstool.simulation.static import static as static_truth
    from sinstool.simulation.truth import sample_times

    check(duration, rate, rest["seed"])
    limits = {"latitude": (latitude, 90.0), "longitude": (longitude, 180.0)}
    for name, (value, limit) in limits.items():
        if not -limit <= value <= limit:
            raise click.UsageError(f"--{name} is {value}, not from {-limit:g} to {limit:g}")
    if not np.isfinite([height, *attitude]).all():
        raise click.UsageError("--height and --attitude are not finite numbers")
    times = sample_times(rate, duration, START_NS)
    q_nb = from_euler(np.radians(attitude))
    truth = static_truth(times, q_nb, np.radians(latitude), height)
    scenario = {
        "scenario": "static",
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "height_m": height,
        "attitude_deg": ",".join(map(str, attitude)),
        "duration_s": duration,
        "rate_hz": rate,
    }
    position = (float(np.radians(latitude)), float(np.radians(longitude)), height)
    return _write(truth, scenario, position, rest)


@command.command("two-frequency")
@common()
@click.option(
    "--half-angles-deg", type=Numbers(2), default="0.1,0.1", show_default=True, metavar="A,B"
)
@click.option(
    "--frequencies", type=Numbers(2), default="30,130", show_default=True, metavar="HZ,HZ"
)
def two_frequency(
    half_angles_deg: tuple[float, float],
    frequencies: tuple[float, float],
    duration: float,
    rate: float,
    **rest: Any,
) -> dict[str, Any]:
    """Two conings at once; where their frequencies differ by an update rate, they fold."""
    import numpy as np

    from sinstool.simulation.motions import two_frequency as motion

    check(duration, rate, rest["seed"])
    _positive(half_angles_deg=min(half_angles_deg), frequencies=min(frequencies))
    scenario = {
        "scenario": "two-frequency",
        "half_angles_deg": _listed(half_angles_deg),
        "frequencies_hz": _listed(frequencies),
    }
    a, b = np.radians(half_angles_deg)
    return _write_motion(
        lambda times: motion(times, (a, b), frequencies), scenario, duration, rate, rest
    )


@command.command("broadband")
@common()
@click.option("--angle-deg", type=float, default=0.05, show_default=True, help="rms on x and on y")
@click.option("--band", type=Numbers(2), default="20,150", show_default=True, metavar="HZ,HZ")
def broadband(
    angle_deg: float, band: tuple[float, float], duration: float, rate: float, **rest: Any
) -> dict[str, Any]:
    """Vibration with coning at every frequency of a band, above half the rate too if you like."""
    import numpy as np

    from sinstool.simulation.motions import broadband as motion

    check(duration, rate, rest["seed"])
    _positive(angle_deg=angle_deg, band=min(band))
    scenario = {"scenario": "broadband", "angle_deg": angle_deg, "band_hz": _listed(band)}
    angle = float(np.radians(angle_deg))
    return _write_motion(
        lambda times: motion(times, angle, band, seed=rest["seed"]), scenario, duration, rate, rest
    )


@command.command("manoeuvre")
@common()
@click.option("--rate-rms-deg-s", type=float, default=60.0, show_default=True, help="of the motion")
@click.option("--band", type=Numbers(2), default="0.1,1", show_default=True, metavar="HZ,HZ")
def manoeuvre(
    rate_rms_deg_s: float, band: tuple[float, float], duration: float, rate: float, **rest: Any
) -> dict[str, Any]:
    """Random rotation about all three axes."""
    import numpy as np

    from sinstool.simulation.motions import random_manoeuvre as motion

    check(duration, rate, rest["seed"])
    _positive(rate_rms_deg_s=rate_rms_deg_s, band=min(band))
    scenario = {"scenario": "manoeuvre", "rate_rms_deg_s": rate_rms_deg_s, "band_hz": _listed(band)}
    size = float(np.radians(rate_rms_deg_s))
    return _write_motion(
        lambda times: motion(times, size, band, seed=rest["seed"]), scenario, duration, rate, rest
    )


def _positive(**values: float) -> None:
    """Refuse sizes of which no motion can be made; NaN is none either."""
    for name, value in values.items():
        if not 0.0 < value < float("inf"):
            raise click.UsageError(f"--{name.replace('_', '-')} is {value}, not above 0 and finite")


def _listed(values: tuple[float, ...]) -> str:
    return ",".join(f"{value:g}" for value in values)


def _write_motion(
    motion: Callable[[Any], Any],
    scenario: dict[str, Any],
    duration: float,
    rate: float,
    rest: dict[str, Any],
) -> dict[str, Any]:
    """Sample a motion at the log's instants and write it; impossible motions are refused."""
    from sinstool.simulation.truth import sample_times

    try:
        truth = motion(sample_times(rate, duration, START_NS))
    except ValueError as exc:
        raise click.UsageError(str(exc)) from exc
    return _write(truth, scenario | {"duration_s": duration, "rate_hz": rate}, None, rest)


def _write(
    truth: Any,
    scenario: dict[str, Any],
    position: tuple[float, float, float] | None,
    rest: Any,
    measured: Any = None,
) -> dict[str, Any]:
    """Write the log; `measured` is the truth with errors of the scenario's own, if it has any."""
    from sinstool.simulation.log import Axes, imu_topic, resting_fixes, truth_topics
    from sinstool.simulation.sensors import GRADES, with_errors

    check_outputs(rest)
    sensor = with_errors(
        truth if measured is None else measured, GRADES[rest["grade"]], rest["seed"]
    )
    kept = {k: rest[k] for k in ("gyro_kind", "body_axes", "grade", "seed")}
    settings = {k: str(v) for k, v in (scenario | kept).items()}
    axes = Axes(rest["body_axes"])
    topics = [imu_topic(sensor, rest["gyro_kind"], axes)]
    if rest["truth"]:
        topics += truth_topics(truth, axes)
    if position is not None:
        topics.append(resting_fixes(truth.time_ns, position))

    def write_page(params: Mapping[str, Any]) -> None:
        from sinstool.report.pages.simulate import write_motion

        write_motion(params, truth, sensor, topics)

    return write_log(rest, topics, settings, write_page)


for _scenario in (spiral_climb, manoeuvring_flight, drive, launch, hse_rig):
    command.add_command(_scenario)
for _scenario in command.commands.values():
    with_monte_carlo(_scenario)
