"""What a filter starts from."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import to_dcm
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.pipelines.process.ins_gnss import initial_state
from sinstool.pipelines.process.ins_gnss.initial_state import in_words
from tests.helpers.filter_logs import first_start_of, start_of
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    CONSUMER,
    GRADES,
    LEVER,
    drive,
    multicopter,
    record,
    straight_flight,
    without_fixes,
    without_samples,
    write,
)
from tests.helpers.unseen_errors import slower


@pytest.mark.parametrize(("held_s", "text"), [(58, "back over 58 s"), (-5, "forward over 5 s")])
def test_which_way_an_attitude_was_carried(held_s, text):
    found = SimpleNamespace(
        method="svd", held_ns=held_s * SECOND, time_ns=0, bias_source="alignment"
    )
    said = in_words(found, np.diag(np.deg2rad([0.1, 0.1, 0.4]) ** 2))
    assert f"carried {text};" in said and said.endswith("heading known to 0.4 deg")


@pytest.mark.parametrize(
    ("uncertain", "rests", "helps"),
    [(True, False, True), (False, False, False), (True, True, False)],
)
def test_a_grade_is_asked_for_where_it_may_help(monkeypatch, uncertain, rests, helps):
    """An attitude that a poor grade leaves too uncertain, whatever the message says of sigmas."""

    def refuse(*_):
        raise AlignmentError("see --gnss-sigma-v", "look", uncertain=uncertain)

    monkeypatch.setattr(initial_state, "_aligned", refuse)
    monkeypatch.setattr(initial_state, "bias_at_rest", lambda _: 0.0 if rests else None)
    with pytest.raises(AlignmentError) as refused:
        initial_state.find_start(SimpleNamespace(path="a.mcap"), ProcessConfig(), None, None)
    assert refused.value.message.startswith("a.mcap: ")
    assert ("--imu-grade" in refused.value.hint) is helps


@pytest.mark.parametrize("seed", [5, 7])
@pytest.mark.slow
def test_an_aircraft_that_flies_straight_for_minutes_is_aligned_by_its_turns(tmp_path, seed):
    """Refused until alignment began later, too: cheap gyros do not last until the first turn."""
    truth = straight_flight(seed)
    data = record(truth, CONSUMER, seed, gnss_rate=5.0, sigma=0.3, sigma_v=0.1)
    log = write(tmp_path / "log.mcap", data)
    arm = {"lever_arm": tuple(LEVER.tolist())}
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=arm)
    assert any("s of motion do not show the attitude" in x for x in start.attitude_warnings)
    row = int(np.argmin(np.abs(truth.seconds - (start.time_ns - T0) / SECOND)))
    true = Rotation.from_matrix(truth.c_nb[row])
    given = Rotation.from_quat(start.start.nav[6:10], scalar_first=True)
    off = (given * true.inv()).as_rotvec()
    sigma = np.sqrt(np.diag(start.start.covariance_attitude_n))
    assert (np.abs(off) < 3.5 * sigma).all()
    assert np.rad2deg(sigma).max() < 12.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 24, 28])
@pytest.mark.parametrize(("rate", "sigma"), [(1.0, 0.02), (5.0, 0.5)])
def test_the_first_velocity_by_positions_is_that_of_the_imu(tmp_path, seed, rate, sigma):
    """Off by up to 2.6 m/s at 0.3 before: in seconds an antenna swings to and fro."""
    truth = multicopter(seed, 100.0)
    data = record(truth, GRADES["tactical"], seed, gnss_rate=rate, sigma=sigma)
    log = write(tmp_path / "log.mcap", data)
    start, _ = first_start_of(
        log,
        navigation={"mode": "ins-gnss"},
        input={"gyro_kind": "mean-rate"},
        gnss={"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0},
    )
    row = int(np.argmin(np.abs(truth.seconds - (start.time_ns - T0) / SECOND)))
    off = start.start.nav[3:6] - truth.velocity_n[row]
    assert (np.abs(off) < 3.5 * np.sqrt(np.diag(start.start.covariance_velocity_n))).all()
    assert np.abs(off).max() < 0.1 + sigma


def part(data, samples_from, fixes_from):
    """The same recording, begun later."""
    return without_fixes(without_samples(data, -1.0, samples_from + 1.0), [(0.0, fixes_from)])


def error_of(start, truth):
    """Position (m), velocity (m/s) and attitude (rad) of a start, NED, shape (9,)."""
    nav, seconds = start.start.nav, np.array([(start.time_ns - T0) * 1e-9])
    return truth.errors_of(seconds, *nav[:3, None], nav[None, 3:6], to_dcm(nav[None, 6:10]))[0]


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 8], ids=["200 Hz", "25 Hz"])
@pytest.mark.parametrize("fixes_from", [145.0, 151.5])
def test_the_attitude_is_that_of_the_sample_at_which_the_filter_starts(tmp_path, every, fixes_from):
    """Not that of the fix before it, up to a sample earlier: a vehicle turns in 40 ms."""
    errors = []
    for seed in (1, 2, 3):
        truth = drive(seed, 400.0, rest=30.0)
        data = record(truth, GRADES["tactical"], seed, gnss_rate=1.0, sigma=0.14, sigma_v=0.076)
        data = part(slower(data, every), 150.0, fixes_from)
        log = write(tmp_path / "log.mcap", data)
        start = start_of(
            log, gnss={"lever_arm": tuple(LEVER.tolist())}, input={"gyro_kind": "mean-rate"}
        )
        errors.append(error_of(start, truth)[6:] / DEGREE)
    worst = np.abs(errors).max(axis=0)
    assert np.all(worst[:2] < 0.04) and worst[2] < 0.2


@pytest.mark.slow
def test_a_log_that_begins_while_a_car_brakes_evenly_does_not_begin_at_rest(tmp_path):
    """To its IMU it stands for a second: tilts were off by up to 5.7 deg, a thousand sigmas."""
    truth = drive(1, 300.0, rest=10.0)
    data = part(record(truth, GRADES["tactical"], 1), 45.2, 40.2)
    log = write(tmp_path / "log.mcap", data)
    start = start_of(
        log, gnss={"lever_arm": tuple(LEVER.tolist())}, input={"gyro_kind": "mean-rate"}
    )
    off = error_of(start, truth)
    assert np.all(np.abs(off[6:]) < 4.0 * np.sqrt(np.diag(start.start.covariance_attitude_n)))
    assert np.all(np.abs(off[3:6]) < 4.0 * np.sqrt(np.diag(start.start.covariance_velocity_n)))


@pytest.mark.slow
def test_gyros_that_lean_in_turns_are_in_the_sigmas_of_a_start_in_motion(tmp_path):
    """Axes as a grade's data sheet has them: tilts were off by one and a half of their sigmas."""
    ratios = []
    for seed in range(1, 7):
        truth = drive(seed, 400.0, rest=30.0)
        data = record(truth, replace(GRADES["tactical"], misalignment=5e-5), seed)
        log = write(tmp_path / "log.mcap", data)
        start = start_of(
            log, gnss={"lever_arm": tuple(LEVER.tolist())}, input={"gyro_kind": "mean-rate"}
        )
        sigma = np.sqrt(np.diag(start.start.covariance_attitude_n))
        ratios.append(error_of(start, truth)[6:8] / sigma[:2])
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.3
