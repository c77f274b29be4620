"""Errors of a data sheet in simulated logs: which are there, and that the log says which."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from sinstool.cli.main import cli
from sinstool.core.units import DEGREE_PER_HOUR
from tests.pipelines.process.flights import read

GYRO = [f"angular_velocity.{axis}" for axis in "xyz"]
ACCEL = [f"linear_acceleration.{axis}" for axis in "xyz"]
OFF = ("--no-scale-errors", "--no-misalignment", "--no-bias-drift")


def simulate(folder, *words):
    log = folder / "log.mcap"
    ran = CliRunner().invoke(cli, ["simulate", *words, "-o", str(log), "--json", "--overwrite"])
    assert ran.exit_code == 0, ran.output
    return log, json.loads(ran.stdout)


def settings_of(log):
    with log.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    return record.metadata


@pytest.mark.parametrize("axes", ["flu", "frd"])
def test_a_log_tells_the_errors_of_its_sensors(tmp_path, axes):
    log, _ = simulate(tmp_path, "drive", "--grade", "tactical", "--seed", "4", "--still", "20",
                      "--duration", "80", "--body-axes", axes, "--gyro-kind", "rate")  # fmt: skip
    settings = settings_of(log)
    for sensor, fields, noise in (("gyro", GYRO, 3e-4), ("accel", ACCEL, 1e-2)):
        _, read_out = read(log, "/imu/data_raw", fields)
        _, truth = read(log, "/truth/imu", fields)
        seconds, bias = read(log, "/truth/bias", fields)
        matrix = 1e-6 * np.array([float(x) for x in settings[f"{sensor}_matrix_ppm"].split(",")])
        said = truth @ matrix.reshape(3, 3).T + np.repeat(bias, 100, axis=0)[: len(truth)]
        left = read_out - truth - said
        assert len(seconds) == 81 and np.ptp(bias, axis=0).min() > 0.0
        # white noise is left, and no more: not of the truth's sizes, and without a mean
        assert np.std(left) < noise
        assert np.abs(left.mean(axis=0)).max() < 4.0 * noise / np.sqrt(len(left))
        assert np.abs(said).max() > 4.0 * noise / np.sqrt(len(left))
        for column in truth.T:
            assert np.abs(np.corrcoef(left.T, column)[:3, 3]).max() < 0.06


def test_each_error_is_switched_off_by_itself(tmp_path):
    words = ("drive", "--grade", "mems", "--duration", "20")
    for k, (flag, what) in enumerate(zip(OFF, ("diagonal", "beside", "wander"), strict=True)):
        log, _ = simulate(tmp_path, *words, flag)
        settings, (_, bias) = settings_of(log), read(log, "/truth/bias", GYRO)
        matrix = np.array([float(x) for x in settings["gyro_matrix_ppm"].split(",")]).reshape(3, 3)
        there = {
            "diagonal": bool(np.all(np.diag(matrix))),
            "beside": bool(np.all(matrix[~np.eye(3, dtype=bool)])),
            "wander": bool(np.ptp(bias, axis=0).all()),
        }
        assert [name for name, on in there.items() if not on] == [what], k
    log, _ = simulate(tmp_path, *words, *OFF)
    assert not [name for name in settings_of(log) if name.endswith("_ppm")]


def test_noise_and_biases_do_not_depend_on_the_other_errors(tmp_path):
    words = ("drive", "--grade", "mems", "--duration", "20", "--still", "20")
    log, _ = simulate(tmp_path, *words, *OFF)
    _, plain = read(log, "/imu/data_raw", GYRO)
    log, _ = simulate(tmp_path, *words, "--no-bias-drift")
    _, whole = read(log, "/imu/data_raw", GYRO)
    # at rest a gyro reads nothing that a scale factor of a per mille or a millirad would move
    np.testing.assert_allclose(whole, plain, atol=1e-6)
    assert not np.array_equal(whole, plain)


@pytest.mark.parametrize("scenario", ["coning", "static", "broadband", "manoeuvre"])
def test_a_motion_about_a_point_has_them_on_demand_only(tmp_path, scenario):
    log, written = simulate(tmp_path, scenario, "--grade", "tactical", "--duration", "5")
    assert not [name for name in settings_of(log) if name.endswith("_ppm")]
    _, bias = read(log, "/truth/bias", GYRO)
    assert np.ptp(bias, axis=0).max() == 0.0 and np.abs(bias).max() < 4.0 * DEGREE_PER_HOUR
    log, _ = simulate(
        tmp_path, scenario, "--grade", "tactical", "--duration", "5", "--misalignment"
    )
    assert "gyro_matrix_ppm" in settings_of(log)
    log, written = simulate(tmp_path, scenario, "--duration", "5", "--misalignment")
    assert "/truth/bias" not in written["topics"] and "gyro_matrix_ppm" not in settings_of(log)


def test_a_log_without_truth_has_no_word_of_it(tmp_path):
    log, written = simulate(tmp_path, "drive", "--grade", "mems", "--duration", "20", "--no-truth")
    assert not [topic for topic in written["topics"] if topic.startswith("/truth")]
    assert not [name for name in settings_of(log) if name.endswith("_ppm")]
