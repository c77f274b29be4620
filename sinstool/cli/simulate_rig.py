"""`sinstool simulate hse-rig`: a rate-biased laser-gyro system on its turntable."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from sinstool.cli.choice import Choice
from sinstool.cli.options import Numbers, Words
from sinstool.cli.simulate_options import check_outputs, write_log
from sinstool.cli.verbose import verbose_option
from sinstool.core.errors import OutputError
from sinstool.core.units import ARCSEC, DEGREE

JOINT = "table"
NOISE = ("arw", "gyro_bias", "gyro_drift", "gyro_quantum", "accel_bias", "vrw", "encoder_lsb")
LARGEST_LEAN = 0.5
SILENT = ("report", "overwrite", "as_json", "verbose")


@click.command("hse-rig")
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="MCAP")
@click.option(
    "--rig-out",
    type=click.Path(path_type=Path),
    metavar="RIG.toml",
    help="also write the rig as its user believes it to be, for --config",
)
@click.option("--rates", type=Words(), default="20,40,60", show_default=True, metavar="DEG/S,...",
              help="of the table, one after the other")  # fmt: skip
@click.option("--plateau", type=float, default=604.0, show_default=True, help="at each rate, s")
@click.option("--rate", type=float, default=500.0, show_default=True, help="Imu samples/s, Hz")
@click.option("--encoder-rate", type=float, default=500.0, show_default=True, help="readings/s, Hz")
@click.option("--latitude", type=float, default=28.07, show_default=True, help="degrees")
@click.option("--heading", type=float, default=40.0, show_default=True, help="of the base, degrees")
@click.option("--tilt-east", type=float, default=8e-4, show_default=True,
              help="by which the axis leans to the east, rad")  # fmt: skip
@click.option("--tilt-north", type=float, default=0.0, show_default=True,
              help="by which the axis leans to the north, rad")  # fmt: skip
@click.option("--epsilon", type=Numbers(3), default="2.2,0.8,1.2", show_default=True,
              metavar="E1,E2,E3", help="misalignments of the believed K_g, arcsec")  # fmt: skip
@click.option("--kappa", type=Numbers(3), default="0,0,0", show_default=True,
              metavar="K1,K2,K3", help="scale errors of the believed K_g, ppm")  # fmt: skip
@click.option("--xi", type=Numbers(3), default="0,0,0", show_default=True,
              metavar="X,Y,Z", help="errors of the believed C_s_to_b, arcsec")  # fmt: skip
@click.option("--arw", type=float, default=0.0, show_default=True,
              help="angular random walk, deg/sqrt(h)")  # fmt: skip
@click.option("--gyro-bias", type=float, default=0.0, show_default=True,
              help="standard deviation of each gyro's bias, deg/h")  # fmt: skip
@click.option("--gyro-drift", type=float, default=0.0, show_default=True,
              help="of the part of it that wanders, deg/h")  # fmt: skip
@click.option("--gyro-quantum", type=float, default=0.0, show_default=True,
              help="angle of one count, arcsec")  # fmt: skip
@click.option("--accel-bias", type=float, default=0.0, show_default=True,
              help="standard deviation of each accelerometer's bias, micro-g")  # fmt: skip
@click.option("--vrw", type=float, default=0.0, show_default=True,
              help="noise of the accelerometers, micro-g/sqrt(Hz)")  # fmt: skip
@click.option("--encoder-lsb", type=float, default=0.0, show_default=True, help="arcsec")
@click.option("--encoder-delay", type=float, default=0.0, show_default=True,
              help="by which readings are older than their stamps, microseconds")  # fmt: skip
@click.option("--encoder-sign", type=Choice(["1", "-1"]), default="1", show_default=True)
@click.option("--ripple", type=float, default=0.0, show_default=True,
              help="of the table's rate, relative, once a turn")  # fmt: skip
@click.option("--base-drift", type=Numbers(3), default="0,0,0", show_default=True,
              metavar="N,E,D", help="turn of the base over the log, arcsec")  # fmt: skip
@click.option("--truth/--no-truth", default=True, show_default=True, help="write /truth/imu")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="of the errors")  # fmt: skip
@click.option("--report", type=click.Path(path_type=Path), metavar="FILE.html",
              help="also write a page of figures, or its first one (.png, .pdf, .svg)")  # fmt: skip
@click.option("--overwrite", is_flag=True, help="replace existing outputs")
@click.option("--json", "as_json", is_flag=True, help="one JSON object on stdout")
@verbose_option()
def command(output: Path, rig_out: Path | None, **told: Any) -> dict[str, Any]:
    """Raw gyros, accelerometers and encoder of a skewed triad that turns at constant rates.

    The Imu topic holds the raw triad (mean rates over the interval that ends at the stamp), the
    JointState topic the table's angle, /truth/imu the true attitude of the turning body.
    """
    check_outputs({"output": output, **told})
    if rig_out is not None:
        from sinstool.core.whole_file import check_output

        if rig_out.resolve() == output.resolve():
            raise OutputError(f"{output} is named twice", "choose another --rig-out")
        check_output(rig_out, [], told["overwrite"])
    log, settings = _simulate(told)
    topics = _topics(log, told["truth"])

    def write_page(options: Mapping[str, Any]) -> None:
        from sinstool.report.pages.simulate import write_rig

        write_rig(options, log, topics)

    def write_rig_file() -> None:
        if rig_out is not None:
            import tomli_w

            from sinstool.core.whole_file import write_whole

            write_whole(rig_out, tomli_w.dumps({"rig": _rig(log, told)}))

    return write_log({"output": output, **told}, topics, settings, write_page, write_rig_file)


def _simulate(told: dict[str, Any]) -> tuple[Any, dict[str, str]]:
    import numpy as np

    from sinstool.simulation.hse_rig import HseRigErrors, HseRigSetup, hse_rig

    try:
        rates = [float(word) * DEGREE for word in told["rates"]]
    except ValueError:
        raise click.UsageError(f"--rates: {','.join(told['rates'])} are not numbers") from None
    _check(told, rates)
    random = np.random.default_rng([told["seed"], 1])
    micro_g = 9.80665e-6
    degree_per_hour = DEGREE / 3600.0
    heading = told["heading"] * DEGREE
    theta, gamma = lean(heading, told["tilt_north"], told["tilt_east"])
    setup = HseRigSetup(
        latitude=told["latitude"] * DEGREE,
        heading=heading,
        theta=theta,
        gamma=gamma,
        epsilon=tuple(v * ARCSEC for v in told["epsilon"]),
        kappa=tuple(v * 1e-6 for v in told["kappa"]),
        xi=tuple(v * ARCSEC for v in told["xi"]),
        imu_rate=told["rate"],
        encoder_rate=told["encoder_rate"],
    )
    ramps = float(np.abs(np.diff(rates)).sum()) / (5.0 * DEGREE)
    length = told["plateau"] * len(rates) + ramps
    errors = HseRigErrors(
        angle_random_walk=told["arw"] * DEGREE / 60.0,
        gyro_bias=tuple(told["gyro_bias"] * degree_per_hour * random.standard_normal(3)),
        gyro_drift=told["gyro_drift"] * degree_per_hour,
        gyro_quantum=told["gyro_quantum"] * ARCSEC,
        velocity_random_walk=told["vrw"] * micro_g,
        accel_bias=tuple(told["accel_bias"] * micro_g * random.standard_normal(3)),
        encoder_lsb=told["encoder_lsb"] * ARCSEC,
        encoder_delay=told["encoder_delay"] * 1e-6,
        encoder_sign=int(told["encoder_sign"]),
        ripple=told["ripple"],
        base_drift_n=tuple(v * ARCSEC / length for v in told["base_drift"]),
    )
    try:
        log = hse_rig([(r, told["plateau"]) for r in rates], setup, errors, seed=told["seed"])
    except ValueError as exc:
        raise click.UsageError(str(exc)) from exc
    kept = {k: v for k, v in told.items() if k not in SILENT}
    settings = {"scenario": "hse-rig", **{k: str(v) for k, v in kept.items()}}
    settings["lambda2_arcsec"] = repr(log.truth.lambda2 / ARCSEC)
    return log, settings


def _check(told: dict[str, Any], rates: list[float]) -> None:
    """Refuse what no rig can be, before anything is computed."""
    import numpy as np

    def flag(name: str) -> str:
        return f"--{name.replace('_', '-')} is {told[name]}"

    if not rates or not np.isfinite(rates).all():
        raise click.UsageError(f"--rates: {','.join(told['rates'])} are not numbers")
    for name, value in told.items():
        if isinstance(value, float | tuple) and name != "rates" and not np.isfinite(value).all():
            raise click.UsageError(f"{flag(name)}, not a finite number")
    for name in ("plateau", "rate", "encoder_rate"):
        if not 0.0 < told[name] <= 1e6:
            raise click.UsageError(f"{flag(name)}, not above 0")
    for name in NOISE:
        if told[name] < 0.0:
            raise click.UsageError(f"{flag(name)}, below 0")
    if not abs(told["latitude"]) <= 90.0:
        raise click.UsageError(f"{flag('latitude')}, not from -90 to 90")
    if not np.hypot(told["tilt_north"], told["tilt_east"]) < LARGEST_LEAN:
        raise click.UsageError(f"the axis leans by more than {LARGEST_LEAN} rad")


def lean(heading: float, north: float, east: float) -> tuple[float, float]:
    """Pitch and roll of the base whose (down) axis leans by these components.

    The third column of C_b0^n is (C13, C23, C33) = (north, east, ...): rotate it by minus the
    heading, and read sin(theta) cos(gamma) and -sin(gamma) from it.

    Parameters
    ----------
    heading : float
        rad.
    north, east : float
        Components of the axis.

    Returns
    -------
    theta, gamma : float
        rad.
    """
    import numpy as np

    along = north * np.cos(heading) + east * np.sin(heading)
    across = -north * np.sin(heading) + east * np.cos(heading)
    gamma = -np.arcsin(across)
    return float(np.arcsin(along / np.cos(gamma))), float(gamma)


def _topics(log: Any, truth: bool) -> list[Any]:
    from sinstool.simulation.log import (
        IMU_TOPIC,
        Axes,
        SimulatedTopic,
        joint_topic,
        raw_imu_columns,
    )

    axes = Axes("frd")

    def imu(rows: slice) -> dict[str, Any]:
        return raw_imu_columns(log.gyro[rows], log.accel[rows])

    def true(rows: slice) -> dict[str, Any]:
        return {"orientation.x": axes.xyzw(log.truth.q_nb[rows])}

    name = "sensor_msgs/msg/Imu"
    topics = [
        SimulatedTopic(IMU_TOPIC, name, log.time_ns, imu, {"header.frame_id": "gyro_triad"}),
        joint_topic(log.encoder_time_ns, log.encoder_position, JOINT),
    ]
    if truth:
        frame = {"header.frame_id": axes.body}
        topics.append(SimulatedTopic("/truth/imu", name, log.time_ns, true, frame))
    return topics


def _rig(log: Any, told: dict[str, Any]) -> dict[str, Any]:
    return {
        "K_g": log.believed_K_g.tolist(),
        "C_s_to_b": log.believed_C_s_to_b.tolist(),
        "gyro_frame": "g",
        "accel_frame": "s",
        "latitude_deg": told["latitude"],
        "imu_stamp": "end",
        "encoder": {"joint": JOINT, "sign": int(told["encoder_sign"])},
    }
