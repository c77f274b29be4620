"""Logs as columns, and columns as tables."""

from __future__ import annotations

import gc
import os
import sys

import numpy as np
import pytest

import sinstool
from sinstool.core.streams import (
    Baro,
    BaroHeight,
    Encoder,
    Gnss,
    GnssEpochs,
    Imu,
    Magnetometer,
    Solution,
    Velocity,
)
from sinstool.core.table import table_of
from tests.helpers.paths import ROOT

STATIC = ROOT / "sample_data" / "static.mcap"
TO_FRD = np.array([1.0, -1.0, -1.0])


def test_imu_is_what_was_simulated_in_frd(drive):
    simulated, path = drive
    with sinstool.open_log(str(path)) as log:
        imu = log.imu()
        named = log.imu("/truth/imu")
    true = simulated.truth
    assert np.array_equal(imu.time_ns, true.time_ns) and len(imu) == 9001
    assert np.array_equal(named.gyro, true.omega_ib_b)
    assert np.abs(imu.gyro - true.omega_ib_b).max() < 0.01  # errors of the sensor
    assert np.abs(imu.accel - true.specific_force_b).max() < 0.5
    assert np.array_equal(simulated.imu().gyro, imu.gyro)


def test_arrays_are_contiguous_and_cannot_be_written_to(drive):
    imu = sinstool.open_log(drive[1]).imu()
    for array in (imu.time_ns, imu.gyro, imu.accel):
        assert array.flags.c_contiguous and not array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_gnss_and_barometer(drive):
    simulated, path = drive
    with sinstool.open_log(path) as log:
        gnss, baro = log.gnss(), log.barometer()
    true = simulated.truth
    at = np.searchsorted(true.time_ns, gnss.time_ns)
    assert gnss.has_position.all() and gnss.has_velocity.all()
    assert np.abs(gnss.height - true.position[at, 2]).max() < 15.0
    assert np.abs(gnss.velocity_n - true.velocity_n[at]).max() < 1.0
    assert baro.pressure.min() > 9e4 and baro.pressure.max() < 1.1e5


def test_options_of_the_log_turn_axes_and_units(tmp_path):
    frd = sinstool.simulate("static", duration=2.0, body_axes="frd", attitude=[0, 0, 90])
    path = frd.write(tmp_path / "frd.mcap")
    right = sinstool.open_log(path, body_axes="frd").imu()
    wrong = sinstool.open_log(path).imu()
    assert np.array_equal(right.accel, wrong.accel * TO_FRD)
    assert right.accel[:, 2].max() < -9.7
    assert np.array_equal(frd.imu().accel, right.accel)


def test_increments_are_given_as_mean_rates():
    parts = {
        kind: sinstool.simulate("coning", duration=1.0, gyro_kind=kind).imu()
        for kind in ("mean-rate", "increment")
    }
    assert parts["increment"].gyro == pytest.approx(parts["mean-rate"].gyro, abs=1e-9)


def test_the_magnetometer_of_an_imu(tmp_path):
    from tests.survey.test_magnetometer import FIELD, field_messages, log_of

    path = log_of(tmp_path / "m.mcap", field_messages("/mag"))
    with sinstool.open_log(path) as log:
        measured = log.magnetometer()
        assert measured.field == pytest.approx(np.broadcast_to(FIELD * TO_FRD, (len(measured), 3)))
        assert list(measured.to_pandas().columns[2:]) == ["field_x_T", "field_y_T", "field_z_T"]
    path = log_of(tmp_path / "n.mcap", field_messages("/a", ""), field_messages("/b", ""))
    with sinstool.open_log(path) as log:
        with pytest.raises(sinstool.SinstoolError, match="which is meant of /a, /b"):
            log.magnetometer()
        assert log.magnetometer("/b").field[0] == pytest.approx(FIELD * TO_FRD)


def test_topics_and_repr():
    with sinstool.open_log(STATIC) as log:
        assert [one.topic for one in log.topics] == [
            "/gnss/fix", "/imu/data_raw", "/truth/imu", "/truth/odometry",
        ]  # fmt: skip
        assert log.topics[1].type == "sensor_msgs/msg/Imu" and log.topics[1].messages == 2001
        assert "4 topics" in repr(log)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda log: log.imu("/imu/dataraw"), "/imu/data_raw"),
        (
            lambda log: log.barometer(),
            "no barometer .no FluidPressure topic.: its topics",
        ),
        (lambda log: log.barometer("/baro"), "/baro"),
        (lambda log: log.magnetometer(), "no magnetic field"),
        (lambda log: log.gnss("/fix"), "/fix"),
    ],
)
def test_a_topic_that_is_not_there(call, said):
    with (
        sinstool.open_log(STATIC) as log,
        pytest.raises(sinstool.SinstoolError, match=said) as info,
    ):
        call(log)
    assert str(STATIC) in str(info.value)


def test_a_barometer_that_measures_nothing_is_no_missing_topic(tmp_path):
    from tests.helpers.imulogs import Message, header, store, write_log

    kind = "sensor_msgs/msg/FluidPressure"
    nothing = store(2).types[kind](header(10**9, "baro"), float("nan"), 0.0)
    path = write_log(tmp_path / "a.mcap", [Message("/baro", kind, 10**9, nothing)])
    said = pytest.raises(sinstool.SinstoolError, match="/baro holds no pressure")
    with sinstool.open_log(path) as log, said:
        log.barometer()


def test_a_log_without_imu_gives_gnss(tmp_path, drive):
    from sinstool.simulation.log import write_simulated
    from sinstool.simulation.recorded import recorded_topics

    path = tmp_path / "gnss.mcap"
    topics = recorded_topics(drive[0].imu(), drive[0].gnss())
    write_simulated(path, [one for one in topics if "gnss" in one.topic], {"scenario": "x"})
    with sinstool.open_log(path) as log:
        same = log.gnss()
        with pytest.raises(sinstool.SinstoolError, match="Imu"):
            log.imu()
    assert np.array_equal(same.time_ns, drive[0].gnss().time_ns)


def test_columns_written_as_topics_are_read_as_they_were(tmp_path, drive):
    from sinstool.api.arrays import as_log

    imu, gnss, baro = drive[0].imu(), drive[0].gnss(), drive[0].barometer()
    only_height = gnss.sigma_position_n.copy()
    only_height[::2] = np.nan  # unknown in every second epoch
    gnss = GnssEpochs(**{**vars(gnss), "sigma_position_n": only_height})
    with as_log(imu, gnss, baro) as path, sinstool.open_log(path) as log:
        again = log.imu(), log.gnss(), log.barometer()
    assert not path.exists()
    for one, other in zip((imu, gnss, baro), again, strict=True):
        for name, column in vars(one).items():
            if column is not None:
                same = np.testing.assert_allclose
                same(vars(other)[name], column, rtol=1e-14, atol=0.0, err_msg=name)


def test_a_closed_log_says_so():
    log = sinstool.open_log(STATIC)
    log.close()
    log.close()
    with pytest.raises(sinstool.SinstoolError, match="the log is closed: open it again"):
        log.imu()
    assert len(log.topics) == 4


def test_a_closed_log_says_so_though_it_was_read_before():
    log = sinstool.open_log(STATIC)
    log.imu()
    log.close()
    with pytest.raises(sinstool.SinstoolError, match="the log is closed: open it again"):
        log.imu()


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="needs /proc")
def test_a_forgotten_log_leaves_no_open_file():
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        sinstool.open_log(STATIC).imu()
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("no.mcap", "there is no such file"),
        (ROOT / "README.md", "not a log"),
        (5, "the log is of type int: give a path"),
    ],
)
def test_what_is_no_log_is_refused(path, said):
    with pytest.raises(sinstool.SinstoolError, match=said):
        sinstool.open_log(path)


def test_unknown_options_are_refused():
    with pytest.raises(sinstool.SinstoolError, match="no option imutopic: did you mean imu_topic"):
        sinstool.open_log(STATIC, imutopic="/imu")
    with pytest.raises(sinstool.SinstoolError, match="--gyro-unit"):
        sinstool.open_log(STATIC, gyro_unit="rpm")


# Tables


def test_pandas_has_a_column_with_its_unit_for_each_component(navigated):
    frame = navigated.solution.to_pandas()
    solution = navigated.solution
    assert list(frame.columns[:9]) == [
        "time_ns", "log_time_ns", "q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z",
        "roll_deg", "pitch_deg", "heading_deg",
    ]  # fmt: skip
    assert frame.time_ns.dtype == np.int64 and len(frame) == len(solution)
    assert frame.heading_deg.between(0, 360, inclusive="left").all()
    degrees = np.degrees(solution.position[:, 0])
    assert frame.latitude_deg.to_numpy() == pytest.approx(degrees, rel=1e-15)
    sigma = np.degrees(np.sqrt(solution.covariance_attitude_n[:, 2, 2]))
    assert frame.sigma_attitude_down_deg.to_numpy() == pytest.approx(sigma)
    assert np.array_equal(frame.velocity_east_m_s, solution.velocity_n[:, 1])
    assert frame.notna().all(axis=None)


def test_polars_and_arrow_hold_the_same(drive):
    import polars
    import pyarrow

    imu = drive[0].imu()
    frame, other, arrow = imu.to_pandas(), imu.to_polars(), pyarrow.table(imu)
    assert other.columns == arrow.column_names == list(frame.columns)
    assert other.equals(polars.DataFrame(imu))
    for name in frame.columns:
        assert np.array_equal(frame[name], other[name].to_numpy())
        assert np.array_equal(frame[name], arrow[name].to_numpy())


@pytest.mark.parametrize(
    ("library", "call"),
    [
        ("pandas", lambda imu: imu.to_pandas()),
        ("polars", lambda imu: imu.to_polars()),
        ("pyarrow", lambda imu: imu.__arrow_c_stream__()),
    ],
)
def test_a_library_that_is_missing_is_named(monkeypatch, library, call):
    imu = Imu.of([0, 1], np.zeros((2, 3)), np.zeros((2, 3)))
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(
        sinstool.SinstoolError, match=f"{library}, which is not .*pip install {library}"
    ):
        call(imu)


N = 2
SCALAR, VECTOR, MATRIX = (N,), (N, 3), (N, 3, 3)
SHAPES = {
    Imu: {"gyro": VECTOR, "accel": VECTOR, "orientation": (N, 4)},
    Gnss: {"covariance_n": MATRIX},
    Velocity: {"velocity_n": VECTOR, "covariance_n": MATRIX},
    GnssEpochs: dict.fromkeys(("velocity_n", "sigma_position_n", "sigma_velocity_n"), VECTOR),
    Baro: {},
    BaroHeight: {},
    Encoder: {},
    Magnetometer: {"field": VECTOR},
    Solution: {
        **dict.fromkeys(("omega_ib_b", "specific_force_b", "position"), VECTOR),
        **dict.fromkeys(("velocity_n", "vertical"), VECTOR),
        **{f"covariance_{what}_n": MATRIX for what in ("position", "velocity", "attitude")},
        "q_nb": (N, 4),
    },
}
UNITS = ("_deg", "_rad", "_m", "_m_s", "_m_s2", "_rad_s", "_Pa", "_Pa2", "_T", "_ns")


@pytest.mark.parametrize("kind", SHAPES)
def test_every_component_has_a_column_with_its_unit(kind):
    whole = ("time_ns", "log_time_ns", "covariance_type", "status")
    fields = {
        name: np.zeros(SHAPES[kind].get(name, SCALAR), np.int64 if name in whole else float)
        for name in kind.__dataclass_fields__
    }
    for name in ("q_nb", "orientation"):
        if name in fields:
            fields[name][:, 0] = 1.0
    table = table_of(kind(**fields))
    fields.pop("q_vb", None)  # the mount, which has none
    assert {column.shape for column in table.values()} == {SCALAR}
    for name in table:
        assert name.endswith(UNITS) or name.startswith("q_nb_") or name in whole, name
    # nothing stands in the place of another
    size = {SCALAR: 1, VECTOR: 3, MATRIX: 3, (N, 4): 4 + 3}
    assert len(table) == sum(size[column.shape] for column in fields.values())
