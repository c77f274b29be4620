"""Measured noise in the files of other programs, with units in words.

=================  ================================================  ==============================
format             white noise N, bias random walk K                 said by
=================  ================================================  ==============================
kalibr, openvins   N and K themselves, of continuous time            Kalibr wiki, IMU Noise Model
vins-fusion        N sqrt(f) and K sqrt(f), of samples at f Hz       its propagation: noise times dt
fast-lio           N^2 f and K^2 f, variances of samples             its propagation: noise times dt
robot-localization N^2 f, covariances of messages                    sensor_msgs/Imu, REP 103
kf-gins            N in deg/sqrt(h) and (m/s)/sqrt(h); B             its configuration file
=================  ================================================  ==============================
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import get_args

from sinstool.config.export import NoiseFormat
from sinstool.config.noise import SCHEMA, key_of
from sinstool.core.english import in_seconds
from sinstool.core.errors import ConfigurationError, one_line
from sinstool.core.suggest import nearest
from sinstool.core.units import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR
from sinstool.core.version import VERSION
from sinstool.core.whole_file import write_whole
from sinstool.methods.allan.coefficients import (
    AXES,
    MARKOV_OF_FLICKER,
    SENSORS,
    Sensor,
    over_axes,
)
from sinstool.pipelines.allan.result import AllanResult, Axis

NAMES: tuple[NoiseFormat, ...] = get_args(NoiseFormat)
SUFFIXES = {name: ".toml" if name == "sinstool" else ".yaml" for name in NAMES}
MILLIGAL = 1e-5  # m/s^2
# Correlation time of the biases in the files that come with KF-GINS, hours
KF_GINS_HOURS = 1.0
WORDS = {
    "white": "white noise",
    "flicker": "bias instability",
    "random_walk": "random walk of the bias",
}
SENSOR_WORDS = {"gyro": "gyro", "accel": "accelerometer"}


@dataclass(frozen=True)
class Entry:
    """One key of a file.

    Attributes
    ----------
    value : float or None
        What stands there; None where no axis of the sensor could be measured.
    visible : bool
        Else the value is an upper bound.
    interval : tuple of float
        Of 95 %.
    what : str
        What it is, in words.
    """

    key: str
    value: float | None
    visible: bool
    interval: tuple[float, float]
    unit: str
    what: str

    @property
    def note(self) -> str:
        """Remark on the value for a reader of the file."""
        if not self.visible:
            return f"NOT VISIBLE in this log: at most this, {self.what}, {self.unit}"
        low, high = self.interval
        return f"{self.what}, {self.unit}; 95 %: {low:.4g} to {high:.4g}"

    def line(self, form: Callable[[str], str] = str) -> str:
        """The line of YAML.

        Parameters
        ----------
        form : callable, optional
            Makes what stands there of the number.
        """
        if self.value is None:
            return f"# {self.key}: not measured, as no axis of the {self.what.split()[0]} could be"
        return f"{self.key}: {form(_number(self.value))}  # {self.note}"


def write_noise(result: AllanResult, path: Path, kind: NoiseFormat) -> AllanResult:
    """Write the file of a format.

    Returns
    -------
    AllanResult
        With the name of the file.

    Raises
    ------
    ConfigurationError
        There is no such format.
    OutputError
        It cannot be written.
    """
    if kind not in SUFFIXES:
        near = nearest(kind, SUFFIXES)
        raise ConfigurationError(f"'{kind}' is not one of {', '.join(SUFFIXES)}", near)
    write_whole(path, text_of(result, kind))
    return replace(result, output=str(path))


def text_of(result: AllanResult, kind: NoiseFormat) -> str:
    """The file of a format, as text."""
    if kind == "sinstool":
        return _sinstool(result)
    if kind == "robot-localization":
        return _robot_localization(result)
    about, above, wrap = _FRAMES[kind]
    lines = [f"# {about}", f"# by {sources(result)}", *above]
    body = [entry.line(_triple if kind == "kf-gins" else str) for entry in entries(result, kind)]
    if kind in ("kalibr", "openvins"):
        rate = f"update_rate: {_rate(result):.6g}  # Hz"
        body = [f"rostopic: {json.dumps(result.imu.topic)}", rate, *body]
    if kind == "kf-gins":
        body.append(f"corrtime: {KF_GINS_HOURS:.1f}  # hr, of the biases; not measured")
    if wrap:
        body = [wrap, *(f"  {line}" for line in body)]
    return "\n".join([*lines, *body]) + "\n"


def entries(result: AllanResult, kind: NoiseFormat) -> list[Entry]:
    """The keys of a file that are one figure for a sensor; none of sinstool's, which has axes."""
    return [_entry(result, *key) for key in _KEYS.get(kind, lambda _: [])(_rate(result))]


Key = tuple[str, Sensor, str, str, Callable[[float], float]]


def _entry(
    result: AllanResult,
    key: str,
    sensor: Sensor,
    term: str,
    unit: str,
    of: Callable[[float], float],
) -> Entry:
    """A key with the figure for all axes of a sensor; ``of`` turns SI into what it holds."""
    coefficient = over_axes(result.noise.of(sensor), term)
    what = f"{SENSOR_WORDS[sensor]} {WORDS[term]}"
    if coefficient is None:
        return Entry(key, None, True, (0.0, 0.0), unit, what)
    value = coefficient.high if coefficient.value is None else coefficient.value
    interval = of(coefficient.low), of(coefficient.high)
    return Entry(key, of(value), coefficient.value is not None, interval, unit, what)


def _continuous(rate: float) -> list[Key]:
    """Keys of Kalibr's file, which OpenVINS reads too: both in continuous time."""

    def same(value: float) -> float:
        return value

    return [
        ("accelerometer_noise_density", "accel", "white", "m/s^2/sqrt(Hz)", same),
        ("accelerometer_random_walk", "accel", "random_walk", "m/s^3/sqrt(Hz)", same),
        ("gyroscope_noise_density", "gyro", "white", "rad/s/sqrt(Hz)", same),
        ("gyroscope_random_walk", "gyro", "random_walk", "rad/s^2/sqrt(Hz)", same),
    ]


def _vins_fusion(rate: float) -> list[Key]:
    per = f"at {rate:.6g} Hz"

    def sampled(value: float) -> float:
        return value * sqrt(rate)

    return [
        ("acc_n", "accel", "white", f"m/s^2 {per}", sampled),
        ("gyr_n", "gyro", "white", f"rad/s {per}", sampled),
        ("acc_w", "accel", "random_walk", f"m/s^3 {per}", sampled),
        ("gyr_w", "gyro", "random_walk", f"rad/s^2 {per}", sampled),
    ]


def _fast_lio(rate: float) -> list[Key]:
    per = f"at {rate:.6g} Hz"

    def variance(value: float) -> float:
        return value * value * rate

    return [
        ("acc_cov", "accel", "white", f"(m/s^2)^2 {per}", variance),
        ("gyr_cov", "gyro", "white", f"(rad/s)^2 {per}", variance),
        ("b_acc_cov", "accel", "random_walk", f"(m/s^3)^2 {per}", variance),
        ("b_gyr_cov", "gyro", "random_walk", f"(rad/s^2)^2 {per}", variance),
    ]


def kf_gins_keys(rate: float) -> list[Key]:
    """Keys of KF-GINS, whose biases are Markov processes; it has no use for the rate, Hz."""

    def scaled(unit: float) -> Callable[[float], float]:
        return lambda value: value / unit

    return [
        ("arw", "gyro", "white", "deg/sqrt(hr)", scaled(DEGREE_PER_ROOT_HOUR)),
        ("vrw", "accel", "white", "m/s/sqrt(hr)", scaled(1.0 / 60.0)),
        ("gbstd", "gyro", "flicker", "deg/hr", scaled(DEGREE_PER_HOUR / MARKOV_OF_FLICKER)),
        ("abstd", "accel", "flicker", "mGal", scaled(MILLIGAL / MARKOV_OF_FLICKER)),
    ]


_KEYS: dict[NoiseFormat, Callable[[float], list[Key]]] = {
    "kalibr": _continuous,
    "openvins": _continuous,
    "vins-fusion": _vins_fusion,
    "fast-lio": _fast_lio,
    "kf-gins": kf_gins_keys,
}
# Of each file the first line, lines below it, and the key that holds the others
_FRAMES: dict[NoiseFormat, tuple[str, tuple[str, ...], str]] = {
    "kalibr": ("Kalibr, imu.yaml: noise of continuous time", (), ""),
    "openvins": ("OpenVINS, kalibr_imu_chain.yaml: noise of continuous time", (), "imu0:"),
    "vins-fusion": ("VINS-Fusion: standard deviations of single samples", (), ""),
    "fast-lio": ("FAST-LIO: variances of single samples", (), "mapping:"),
    "kf-gins": (
        "KF-GINS: the same figures on each axis",
        ("# gsstd and asstd, the scale factors, do not show at rest: take the data sheet's",),
        "imunoise:",
    ),
}


def sources(result: AllanResult) -> str:
    """Source of the figures, in a line."""
    rest = result.rest
    return one_line(
        f"sinstool {VERSION} from {Path(result.input.path).name}, {result.imu.topic}:"
        f" {in_seconds(rest.total_s)} at rest, {_rate(result):.6g} Hz"
    )


def _sinstool(result: AllanResult) -> str:
    lines = [
        f"# Noise of an IMU at rest, by {sources(result)}",
        "# Of each visible term the value and its 95 % interval; of any other a bound (below).",
        f'schema = "{SCHEMA}"',
        "",
        "[source]",
        f"log = {_quoted(Path(result.input.path).name)}",
        f"topic = {_quoted(result.imu.topic)}",
        f"rate_hz = {_rate(result):.9g}",
        f"rest_s = {result.rest.total_s:.6g}",
        f"longest_rest_s = {result.rest.longest_s:.6g}",
    ]
    for axis in result.axes:
        lines += ["", *_axis_lines(axis)]
    return "\n".join(lines) + "\n"


def _axis_lines(axis: Axis) -> Iterator[str]:
    """The table of an axis."""
    if axis.status != "measured":
        yield f"# [{axis.sensor}.{axis.axis}] was not measured: {axis.status}"
        return
    yield f"[{axis.sensor}.{axis.axis}]"
    for term, c in axis.coefficients.items():
        if c.value is None:
            yield f"{key_of(axis.sensor, term, 'below')} = {c.high:.4g}"
        else:
            yield f"{key_of(axis.sensor, term)} = {c.value:.6g}"
            yield f"{key_of(axis.sensor, term, '95')} = [{c.low:.6g}, {c.high:.6g}]"


def _quoted(text: str) -> str:
    """A string of TOML."""
    import tomli_w

    return tomli_w.dumps({"x": text}).removeprefix("x = ").rstrip("\n")


def _robot_localization(result: AllanResult) -> str:
    about = "robot_localization: covariances, for the driver that publishes sensor_msgs/Imu"
    lines = [f"# {about}", f"# by {sources(result)}"]
    keys = {"gyro": "angular_velocity_covariance", "accel": "linear_acceleration_covariance"}
    units = {"gyro": "(rad/s)^2", "accel": "(m/s^2)^2"}
    for sensor in SENSORS:
        measured = result.noise.of(sensor)
        mean = over_axes(measured, "white")
        if mean is None or mean.value is None:
            lines.append(f"# {keys[sensor]}: not measured, as no axis of the sensor could be")
            continue
        cells = ["0.0"] * 9
        for k, axis in enumerate(AXES):
            white = measured[axis]["white"].value if axis in measured else None
            cells[4 * k] = _number((mean.value if white is None else white) ** 2 * _rate(result))
        note = f"{units[sensor]} of a single sample at {_rate(result):.6g} Hz, by rows"
        lines.append(f"{keys[sensor]}: [{', '.join(cells)}]  # {note}")
        missing = [axis for axis in AXES if axis not in measured]
        if missing:
            said = f"{', '.join(missing)} was not measured and has the mean of the others"
            lines.append(f"# {keys[sensor]}: {said}")
    return "\n".join(lines) + "\n"


def _rate(result: AllanResult) -> float:
    """Rate of the samples, Hz."""
    return 1.0 / result.rest.interval_s


def _number(value: float) -> str:
    """A number that every YAML reader takes for one: with a point and a signed exponent."""
    return f"{value:.6e}"


def _triple(text: str) -> str:
    """The same figure on each of three axes."""
    return f"[{text}, {text}, {text}]"
