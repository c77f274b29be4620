"""Columns in, columns out: `integrate`, `navigate`, `align` of columns, `simulate`."""

from __future__ import annotations

import tempfile
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sinstool
from sinstool.core.streams import GnssEpochs, Imu


def off(q_nb, true):
    """Angles between attitudes, rad."""
    a = Rotation.from_quat(q_nb, scalar_first=True)
    return (a.inv() * Rotation.from_quat(true, scalar_first=True)).magnitude()


@pytest.mark.parametrize("kind", ["mean-rate", "increment"])
def test_integrate_follows_a_cone(kind):
    cone = sinstool.simulate("coning", duration=3.0, gyro_kind="mean-rate", frequency=5.0)
    imu, true = cone.imu(), cone.truth
    if kind == "increment":
        imu = Imu.of(imu.time_ns, imu.gyro * 0.0025, imu.accel)
    best = sinstool.integrate(imu, true.q_nb[0], coning="lookahead-12", gyro_kind=kind)
    plain = sinstool.integrate(imu, true.q_nb[0], coning="uncompensated", gyro_kind=kind)
    assert np.array_equal(best.time_ns, true.time_ns)
    assert off(best.q_nb, true.q_nb).max() < 1e-8
    assert off(plain.q_nb, true.q_nb).max() > 1e-5


def test_integrate_is_what_process_computes(drive):
    imu = drive[0].imu()
    result = sinstool.process(
        drive[1], mode="attitude", attitude="inertial", align="fixed",
        initial_attitude=(1.0, 2.0, 3.0), gyro_bias=(1e-4, 0.0, -2e-4), latitude=45.0,
    )  # fmt: skip
    from sinstool.core.earth import earth_rate_n

    start = result.solution.q_nb[0]
    solution = sinstool.integrate(
        imu, start, gyro_bias=[1e-4, -0.0, 2e-4], omega_ie_n=earth_rate_n(np.radians(45.0))
    )
    given = Rotation.from_euler("ZYX", [3, 2, 1], True).as_quat(scalar_first=True)
    assert off(start[None], given) < 1e-9
    # the quaternion of the start is normalised once more on this way
    assert np.abs(solution.q_nb - result.solution.q_nb).max() < 1e-14


def test_integrate_holds_the_attitude_over_a_gap():
    times = np.array([0, 10, 20, 30, 1000, 1010]) * 1_000_000
    imu = Imu.of(times, np.tile([0.0, 0.0, 1.0], (6, 1)), np.zeros((6, 3)))
    held = sinstool.integrate(imu).to_pandas().heading_deg
    assert held.iloc[-1] == pytest.approx(np.degrees(0.04))
    across = sinstool.integrate(imu, max_gap_s=2.0).to_pandas().heading_deg
    assert across.iloc[-1] == pytest.approx(np.degrees(1.01))


def test_navigate_is_process_of_the_same_samples(drive, navigated, tmp_path, monkeypatch):
    simulated, _ = drive
    # a place of its own, as other tests make temporary files too
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result = sinstool.navigate(
        simulated.imu(), simulated.gnss(), simulated.barometer(), imu_grade="tactical"
    )
    assert list(tmp_path.iterdir()) == []
    assert result.plan.mode.value == "ins-gnss"
    ours, theirs = result.solution, navigated.solution
    assert np.array_equal(ours.time_ns, theirs.time_ns)
    # rad and degrees are turned once more on this way
    assert off(ours.q_nb, theirs.q_nb).max() < 1e-9
    assert np.abs(ours.velocity_n - theirs.velocity_n).max() < 1e-7
    true = simulated.truth
    late = slice(len(ours) // 2, None)
    assert np.degrees(off(ours.q_nb, true.q_nb)[late]).max() < 2.0
    assert np.abs(ours.velocity_n - true.velocity_n)[late].max() < 0.5


def test_navigate_writes_an_output_and_takes_options(tmp_path, drive):
    simulated, _ = drive
    out = tmp_path / "out.mcap"
    result = sinstool.navigate(
        simulated.imu(), simulated.gnss(), output=out, smooth=True, imu_grade="tactical"
    )
    assert out.exists() and result.summary.output.path == str(out)
    assert result.summary.filter is not None
    with pytest.raises(sinstool.SinstoolError, match="navigate has no option body_axes"):
        sinstool.navigate(simulated.imu(), simulated.gnss(), body_axes="frd")


def test_align_of_columns_is_align_of_their_log(tmp_path):
    rest = sinstool.simulate(
        "static", duration=60.0, grade="navigation", attitude=(2.0, -3.0, 40.0), latitude=50.0
    )
    path = rest.write(tmp_path / "rest.mcap")
    options = {"align": "gyrocompass", "imu_grade": "navigation"}
    by_log = sinstool.align(path, **options)
    by_columns = sinstool.align(rest.imu(), rest.gnss(), **options)
    assert by_log.status in ("ok", "degraded")
    assert abs(by_log.heading_deg - 40.0) < 1.0
    assert by_columns.heading_deg == pytest.approx(by_log.heading_deg, abs=1e-9)
    assert by_columns.sigma_deg == pytest.approx(by_log.sigma_deg, rel=1e-9)


TIMES = np.arange(5) * 10_000_000
ZEROS = np.zeros((5, 3))
GOOD = Imu.of(TIMES, ZEROS, ZEROS)
EPOCHS = GnssEpochs(TIMES, TIMES, *ZEROS.T, ZEROS, ZEROS, ZEROS)


def cut_short(epochs):
    return replace(epochs, latitude=epochs.latitude[:-1])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: sinstool.integrate(3), "imu is of type int: give columns"),
        (lambda: sinstool.integrate(GOOD, [0, 0, 0, 0]), "q_nb is zero"),
        (lambda: sinstool.integrate(GOOD, [1, 0, 0]), "q_nb has the shape"),
        (lambda: sinstool.integrate(GOOD, gyro_kind="mean"), "gyro_kind is 'mean'"),
        (lambda: sinstool.integrate(GOOD, coning="previous-0"), "unknown coning algorithm"),
        (lambda: sinstool.integrate(GOOD, gyro_bias="still"), "gyro_bias is not made of numbers"),
        (lambda: sinstool.integrate(GOOD.rows(slice(0, 1))), "imu has 1 sample: give at least two"),
        (lambda: sinstool.integrate(GOOD.rows(slice(None, None, -1))), "in time order"),
        (lambda: sinstool.integrate(GOOD, coning=3), "unknown coning algorithm '3'"),
        (lambda: sinstool.integrate(GOOD, max_gap_s="long"), "max_gap_s is not made of numbers"),
        (lambda: sinstool.integrate(GOOD, max_gap_s=np.nan), "not finite: give a number"),
        (lambda: sinstool.integrate(GOOD, max_gap_s=0.005), "samples are 0.01 s apart"),
        (lambda: sinstool.integrate(GOOD, max_gap_s=-1.0), "give a longer one"),
        (lambda: sinstool.navigate(GOOD, None), "no GNSS is given"),
        (lambda: sinstool.navigate(GOOD, cut_short(EPOCHS)), "has 4 rows, and gnss.time_ns 5"),
        (lambda: sinstool.navigate(GOOD, EPOCHS, config=3), "the config is of type int"),
        (lambda: sinstool.process(""), "the log is an empty text"),
        (lambda: sinstool.navigate(GOOD, GOOD), "gnss is of type Imu: give columns: log.gnss"),
        (lambda: Imu.of(TIMES, ZEROS[1:], ZEROS), r"gyro has the shape \(4, 3\)"),
        (lambda: Imu.of(TIMES, ZEROS, ZEROS * np.nan), "accel has the shape .* not finite"),
        (lambda: Imu.of(TIMES * 1.0, ZEROS, ZEROS), "time_ns is not a column of integers"),
        (lambda: Imu.of(TIMES * 0, ZEROS, ZEROS), "ascending order"),
        (lambda: sinstool.simulate("drvie"), "no scenario 'drvie': did you mean drive"),
        (lambda: sinstool.simulate("drive", durtion=1), "did you mean duration"),
        (lambda: sinstool.simulate("drive", xyz=1), "`sinstool simulate drive --help-all` lists"),
        (lambda: sinstool.simulate("drive", duration=-1), "--duration -1: must be greater"),
        (lambda: sinstool.simulate("static", duration=2.0).barometer(), "no barometer"),
        (lambda: sinstool.simulate("hse-rig", rate=50).truth, "turntable"),
    ],
)
def test_impossible_columns_are_refused_in_one_line(call, said):
    with pytest.raises(sinstool.SinstoolError, match=said) as info:
        call()
    assert "\n" not in str(info.value)


def test_a_simulated_log_is_that_of_the_command(tmp_path, monkeypatch):
    from sinstool.cli import main

    by_command, by_call = tmp_path / "a.mcap", tmp_path / "b.mcap"
    monkeypatch.setattr(
        "sys.argv",
        ["sinstool", "simulate", "static", "-o", str(by_command), "--duration", "3", "-q"],
    )
    with pytest.raises(SystemExit):
        main.main()
    sinstool.simulate("static", by_call, duration=3)
    assert by_command.read_bytes() == by_call.read_bytes()
    with pytest.raises(sinstool.SinstoolError, match="exists already"):
        sinstool.simulate("static", by_call, duration=3)
