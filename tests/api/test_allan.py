"""`sinstool.allan`: the command's numbers, of logs and of columns, and its file."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

import sinstool
from tests.helpers.resting_logs import GYRO, RATE, T0, noise, write

WALK = GYRO[1] / np.sqrt(RATE)


@pytest.fixture(scope="module")
def samples():
    return noise(4000)


def test_columns_give_what_a_log_gives(samples, tmp_path):
    rates, forces = samples
    time_ns = T0 + np.arange(len(rates)) * 10_000_000
    of_log = sinstool.allan(write(tmp_path / "rest.mcap", rates, forces, time_ns))
    of_columns = sinstool.allan(sinstool.Imu(time_ns, time_ns, rates, forces))
    for one, other in zip(of_log.axes, of_columns.axes, strict=True):
        assert one.coefficients == other.coefficients
        np.testing.assert_array_equal(one.deviation, other.deviation)
    white = of_log.noise.gyro["x"]["white"]
    assert white.low < WALK < white.high
    assert of_log.to_json()["schema"] == "sinstool.allan/1"


def test_file_for_process(samples, tmp_path):
    log, file = write(tmp_path / "rest.mcap", *samples), tmp_path / "noise.toml"
    assert sinstool.allan(log, file).output == str(file)
    result = sinstool.process(log, imu_noise=file)
    assert result.plan.imu_noise.value == "noise.toml"
    with pytest.raises(sinstool.SinstoolError, match="exists"):
        sinstool.allan(log, file)
    sinstool.allan(log, file, format="kalibr", overwrite=True)
    read = yaml.safe_load(file.read_text())
    assert read["gyroscope_noise_density"] == pytest.approx(WALK, rel=0.1)
    with pytest.raises(sinstool.SinstoolError, match="kalibr"):
        sinstool.allan(log, tmp_path / "k.yaml", format="kaliber")
    assert not (tmp_path / "k.yaml").exists()
