"""Units and axes that no navigation can be made of: refused, with the option that answers them."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.earth import gravity_n
from sinstool.core.errors import DataError
from sinstool.core.rotation import conjugate, rotate
from tests.pipelines.process.flights import flight_log, run

DAMPED = {"height_damping": "baro"}


@pytest.mark.parametrize(
    ("unit", "scale", "median"), [("hPa", 100.0, 880), ("kPa", 1e3, 88.0), ("inHg", 3386.389, 26.0)]
)
@pytest.mark.parametrize("mode", ["ins", "attitude"])
def test_pressures_in_other_units(tmp_path, unit, scale, median, mode):
    f = flight_log(30.0)
    f.pressure = f.pressure / scale
    log = f.write(tmp_path / "log.mcap")
    options = f.options(navigation={"mode": mode}, vertical=DAMPED)
    with pytest.raises(DataError) as refused:
        run(log, tmp_path / "out.mcap", options)
    text = str(refused.value)
    said = float(text.split("pressures are about ")[1].split(",")[0])
    assert said == pytest.approx(median, rel=0.05)
    assert "/baro" in text and f"--baro-unit {unit}" in text
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]
    options["input"]["baro_unit"] = unit
    summary, collected = run(log, tmp_path / "out.mcap", options)
    assert summary["height"]["samples"]["accepted"] == len(f.pressure) - 1
    if mode == "ins":
        assert np.abs(collected.column("vertical")[:, 0] - f.flight.height).max() < 1.0


def test_radians_for_degrees(tmp_path):
    f = flight_log(30.0, longitude=np.radians(-71.2))
    flight = f.flight
    degree = np.pi / 180.0
    f.flight = replace(
        flight, latitude=flight.latitude * degree, longitude=flight.longitude * degree
    )
    log = f.write(tmp_path / "log.mcap", imu=flight.imu)
    options = f.options()
    with pytest.raises(DataError) as refused:
        run(log, tmp_path / "out.mcap", options)
    assert "/gnss/fix" in str(refused.value) and "-0.7592" in str(refused.value)
    assert "--gnss-unit rad" in str(refused.value)
    options["input"]["gnss_unit"] = "rad"
    _, collected = run(log, tmp_path / "out.mcap", options)
    assert np.degrees(collected.column("position")[0, 0]) == pytest.approx(-43.5, abs=1e-6)


def scaled(f, factor, gravity_removed=False):
    imu = f.flight.imu
    force, mean = imu.specific_force, imu.mean_specific_force
    if gravity_removed:
        pull = rotate(conjugate(imu.q_nb), gravity_n(f.flight.latitude, f.flight.height))
        force, mean = 0.05 * (force + pull), 0.05 * (mean + pull)
    return replace(imu, specific_force=force * factor, mean_specific_force=mean * factor)


@pytest.mark.parametrize(
    ("mode", "vertical", "refused"),
    [
        ("ins", {}, True),
        ("ins", DAMPED, True),
        ("attitude", DAMPED, True),
        ("attitude", {}, False),
    ],
)
def test_gravity_taken_out(tmp_path, mode, vertical, refused):
    f = flight_log(30.0)
    log = f.write(tmp_path / "log.mcap", imu=scaled(f, 1.0, gravity_removed=True))
    options = f.options(navigation={"mode": mode}, vertical=vertical)
    if refused:
        with pytest.raises(DataError) as said:
            run(log, tmp_path / "out.mcap", options)
        text = str(said.value)
        assert "/imu/data_raw" in text and "gravity has been removed" in text
        assert "--imu-topic" in text
        return
    summary, _ = run(log, tmp_path / "out.mcap", options)
    assert any("gravity" in w for w in summary["warnings"])


@pytest.mark.parametrize(
    ("factor", "words"), [(1.0 / 9.80665, "--accel-unit g"), (100.0, "units of mg or cm/s^2")]
)
def test_specific_force_in_other_units(tmp_path, factor, words):
    f = flight_log(30.0)
    log = f.write(tmp_path / "log.mcap", imu=scaled(f, factor))
    options = f.options()
    with pytest.raises(DataError) as refused:
        run(log, tmp_path / "out.mcap", options)
    assert words in str(refused.value) and "/imu/data_raw" in str(refused.value)
    if "g" in words.split():
        options["input"]["accel_unit"] = "g"
        _, collected = run(log, tmp_path / "out.mcap", options)
        assert np.abs(collected.column("position")[-1, 2] - f.flight.height[-1]) < 1e-3
