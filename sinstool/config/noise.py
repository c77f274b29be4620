"""The noise file of an IMU: TOML with the unit in each key, written by `allan`.

Each axis of each sensor has a table. Of a visible term it holds the value and its 95 % interval,
of any other a bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from math import isfinite, nan
from pathlib import Path
from typing import Any

from sinstool.config.load import load_toml
from sinstool.core.errors import ConfigurationError
from sinstool.core.suggest import nearest
from sinstool.methods.allan.coefficients import AXES, SENSORS, Coefficient, ImuNoise, Sensor

SCHEMA = "sinstool.imu-noise/1"
_OTHER_FILE = "give a file that sinstool allan wrote with --format sinstool"
# Terms by what they are called for a sensor, with the unit
KEYS: dict[Sensor, dict[str, tuple[str, str]]] = {
    "gyro": {
        "quantisation": ("quantisation", "rad"),
        "white": ("angle_random_walk", "rad_per_sqrt_s"),
        "flicker": ("bias_instability", "rad_per_s"),
        "random_walk": ("rate_random_walk", "rad_per_s_per_sqrt_s"),
        "ramp": ("rate_ramp", "rad_per_s2"),
    },
    "accel": {
        "quantisation": ("quantisation", "m_per_s"),
        "white": ("velocity_random_walk", "m_per_s_per_sqrt_s"),
        "flicker": ("bias_instability", "m_per_s2"),
        "random_walk": ("acceleration_random_walk", "m_per_s2_per_sqrt_s"),
        "ramp": ("acceleration_ramp", "m_per_s3"),
    },
}


def key_of(sensor: Sensor, term: str, what: str = "") -> str:
    """Key of a term in a sensor's table: its name, its quantity, and the unit."""
    name, unit = KEYS[sensor][term]
    return "_".join(filter(None, (name, what, unit)))


def read_noise(path: Path) -> ImuNoise:
    """Read a noise file.

    Raises
    ------
    ConfigurationError
        It cannot be read, is no noise file, or a value in it is missing, mistyped or impossible.
    """
    data = load_toml(path)
    if "schema" not in data:
        raise ConfigurationError(f"{path}: this is no noise file: it has no schema", _OTHER_FILE)
    if data["schema"] != SCHEMA:
        raise ConfigurationError(
            f"{path}: its schema is {data['schema']!r}, this program reads {SCHEMA!r}",
            "write the file again with sinstool allan",
        )
    _only(path, data, ("schema", "source", *SENSORS), "")
    source = _table(path, data, "source", "")
    rate = _number(path, "source.rate_hz", source.get("rate_hz"))
    noise = {
        sensor: _sensor(path, sensor, _table(path, data, sensor, ""))
        for sensor in SENSORS
        if sensor in data
    }
    if not noise:
        raise ConfigurationError(f"{path}: it holds neither gyro nor accel", _OTHER_FILE)
    return ImuNoise(noise.get("gyro", {}), noise.get("accel", {}), rate)


def _sensor(path: Path, sensor: Sensor, table: Mapping[str, Any]) -> dict[str, Any]:
    """Axes of a sensor; one of them at least."""
    _only(path, table, AXES, f"{sensor}.")
    if not table:
        raise ConfigurationError(f"{path}: table {sensor} has no axis", _OTHER_FILE)
    return {
        axis: _axis(path, sensor, f"{sensor}.{axis}.", _table(path, table, axis, f"{sensor}."))
        for axis in table
    }


def _axis(
    path: Path, sensor: Sensor, where: str, table: Mapping[str, Any]
) -> dict[str, Coefficient]:
    names = [key_of(sensor, term, what) for term in KEYS[sensor] for what in ("", "95", "below")]
    _only(path, table, names, where)
    terms: dict[str, Coefficient] = {}
    for term in KEYS[sensor]:
        value, bounds, below = (key_of(sensor, term, what) for what in ("", "95", "below"))
        if value in table and below in table:
            raise ConfigurationError(
                f"{path}: {where}{value} and {where}{below} contradict each other",
                "leave one of them out",
            )
        if below in table:
            terms[term] = Coefficient(None, 0.0, _number(path, where + below, table[below]))
        elif value in table:
            number = _number(path, where + value, table[value])
            low, high = _interval(path, where + bounds, table.get(bounds), number)
            terms[term] = Coefficient(number, low, high)
    if not terms:
        raise ConfigurationError(f"{path}: table {where[:-1]} is empty", _OTHER_FILE)
    return terms


def _interval(path: Path, key: str, value: Any, inside: float) -> tuple[float, float]:
    """Both edges; without any, the value itself."""
    if value is None:
        return inside, inside
    if not isinstance(value, list) or len(value) != 2:
        raise ConfigurationError(f"{path}: {key} = {value!r}: must be a list of two numbers")
    low, high = (_number(path, key, edge) for edge in value)
    if not low <= inside <= high:
        raise ConfigurationError(f"{path}: {key} = {value!r}: does not hold the value {inside!r}")
    return low, high


def _number(path: Path, key: str, value: Any) -> float:
    number = nan
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        with suppress(OverflowError):  # a whole number beyond all floats
            number = float(value)
    if not (isfinite(number) and number > 0.0):
        raise ConfigurationError(f"{path}: {key} = {value!r}: must be a number above 0")
    return number


def _table(path: Path, data: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    value = data.get(name)
    if not isinstance(value, dict):
        said = "is missing" if value is None else "must be a table"
        raise ConfigurationError(f"{path}: {where}{name} {said}", _OTHER_FILE)
    return value


def _only(path: Path, table: Mapping[str, Any], names: Any, where: str) -> None:
    """Refuse keys that mean nothing."""
    for key in table:
        if key not in names:
            near = nearest(key, names)
            raise ConfigurationError(f"{path}: unknown key {where}{key}", near)
