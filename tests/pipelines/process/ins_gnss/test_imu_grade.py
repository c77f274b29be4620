"""A quiet IMU whose biases are not those of the grade that its noise at rest looks like."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from benchmarks.trusted_navigation import process
from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Severity
from sinstool.core.units import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR
from sinstool.io.readers import open_log
from sinstool.methods.sensor_errors import IMU_GRADES, SIMULATED_GRADES, partly_calibrated
from sinstool.pipelines.process.ins_gnss import (
    filter_settings,
    first_start,
    initial_state,
    likelier_grade,
    start,
)
from sinstool.pipelines.process.ins_gnss.contradictions import contradictions
from sinstool.pipelines.process.ins_gnss.imu_fit import Fit
from sinstool.pipelines.process.ins_gnss.likelier_grade import (
    clearly_likelier,
    likeliest_times,
    uncalibrated_share,
)
from sinstool.pipelines.process.ins_gnss.noise_factors import NoiseFactors
from sinstool.survey.grade import ImuGrade, sensor_grade
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import run, simulated, start_of
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    PHONE,
    drive,
    flight,
    record,
    sensor_errors,
    with_outliers,
    without_fixes,
    write,
)
from tests.helpers.unseen_errors import crossed


@pytest.mark.slow
@pytest.mark.parametrize(("grade", "expected"), [("industrial", "industrial"), ("tactical", None)])
def test_what_drifts_as_a_worse_grade_is_taken_for_one(tmp_path, grade, expected):
    data = record(drive(9, 260.0, 20.0), GRADES[grade], 32, gnss_rate=10.0, sigma=0.9)
    if expected is None:  # bad fixes refute no IMU
        data = with_outliers(data, 31)
    log = write(tmp_path / "log.mcap", data)
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    begun = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss)
    assert (begun.grade.grade == "industrial") == (expected == "industrial"), begun.grade
    bias = np.rad2deg(begun.settings.imu.gyro_bias) * 3600.0
    # Of 0.027 deg/h, which the noise of a navigation grade does not exclude
    assert bias > 20.0 if expected else 0.027 < bias < 2.0
    assert ("its bias" in begun.grade.why) == (expected is not None)
    # Its slow drift is none of the fixes'
    assert begun.slow_errors == (1.0, 1.0)
    # 0.0064 deg/sqrt(h) at rest
    assert expected or begun.settings.imu.angle_random_walk < 0.007 * DEGREE_PER_ROOT_HOUR


@pytest.mark.slow
def test_innovations_refute_the_grade_of_a_rest(tmp_path):
    """Gyros as quiet and unbiased as tactical ones, with poor scale factors."""
    sensors = sensor_errors(0.1, 1.0, 0.1, 200.0, 5000.0, 1.0)
    log = write(
        tmp_path / "log.mcap",
        record(drive(9, 260.0, 40.0), sensors, 33, gnss_rate=10.0, sigma=0.1),
    )
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss)
    assert start.grade.grade == "industrial"
    assert "clearly better than tactical" in start.grade.why


@pytest.mark.parametrize(
    ("square", "costs", "grade"),
    [
        # From navigation grade on, as an aircraft showed it
        (1.6, (-6642.0, -6644.0, -10427.0, -10211.0, -10078.0), "industrial"),
        (1.6, (-6642.0, -6600.0, -6500.0, -10211.0, -10230.0), "consumer"),
        (1.6, (-6642.0, None, -6640.0, -6644.0, -6647.0), "navigation"),
        # With fixes that a receiver smooths, and with a wrong lever arm: nothing diverges
        (0.1, (-16380.0, -16363.0, -16319.0, -16487.0, -16500.0), "navigation"),
        (1.1, (-1573.0, -1716.0, -1649.0, -1805.0, -1805.0), "tactical"),
    ],
)
def test_grades_beyond_one_that_fits_as_badly_are_tried(monkeypatch, square, costs, grade):
    """The search ended at tactical grade, and the fixes seemed to wander by 128 times as much."""
    names = ("navigation", "tactical", "industrial", "mems", "consumer")
    fits = {
        name: cost and Fit(square, cost / 1000, 1000)
        for name, cost in zip(names, costs, strict=True)
    }

    def begun(source, config, first, grade, lag):
        return SimpleNamespace(grade=grade, lag=lag, slow_errors=(128.0, 32.0))

    def timed(source, config, algorithm, begun):
        if fits[begun.grade.grade] is None:
            raise AlignmentError("no start")
        return SimpleNamespace(**vars(begun), by_the_fixes=begun.grade.grade)

    monkeypatch.setattr(start, "begun_as", begun)
    monkeypatch.setattr(start, "timed", timed)
    monkeypatch.setattr(start, "fit", lambda source, config, algorithm, name: fits[name])
    first = begun(None, None, None, ImuGrade("navigation", ""), 0.0)
    found = start.with_fitting_grade(None, None, None, first, timed(None, None, None, first))
    assert [one.grade.grade for one in found] == [grade, grade]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 5])
def test_gyros_that_are_quiet_but_badly_calibrated_in_flight(tmp_path, seed):
    """They were taken for navigation grade: 10 to 32 m and 2 to 5 deg of heading off, status 3."""
    truth = flight(seed, 300.0)
    sensors = sensor_errors(0.003, 100.0, 0.01, 3000.0, 2000.0, 1.0)
    data = record(truth, sensors, seed, gnss_rate=2.0, sigma=0.3, sigma_v=0.05)
    answer, status, _ = process(write(tmp_path / "log.mcap", data), truth, [])
    assert answer is not None and status == 0
    late = answer.seconds > 60.0
    metres = np.linalg.norm(answer.error[late, :3], axis=1)
    assert np.sqrt(np.mean(np.square(metres))) < 1.0
    ratio = answer.error[late] / answer.sigma[late]
    assert np.sqrt(np.mean(np.square(ratio), axis=0)).max() < 2.0


def idling(path, grade, seed):
    """Drive in a car whose engine shakes sensors at each rest, which have noise and biases."""
    return simulated(
        path, "drive", "--duration", "600", "--still", "30", "--grade", grade, "--rate", "50",
        "--seed", str(seed), "--idle", "0.3,0.01", "--gnss-model", "coloured",
        "--no-scale-errors", "--no-misalignment", "--no-bias-drift",
    )  # fmt: skip


@pytest.mark.slow
def test_sensors_that_an_idling_engine_shakes_are_known_by_their_noise_in_motion(tmp_path):
    """Heading was known to 0.37 deg where it is known to 0.07."""
    log = idling(tmp_path / "log.mcap", "tactical", 3)
    start = start_of(log, gnss={"gnss_latency": 0.0})
    imu, truth = start.settings.imu, SIMULATED_GRADES["tactical"]
    assert start.grade.grade in ("industrial", "tactical")
    assert "in motion, less than at rest" in start.grade.why
    assert 0.7 < imu.angle_random_walk / truth.angle_random_walk < 1.3
    # 15 times at rest, a grade's six times
    assert 0.7 < imu.velocity_random_walk / truth.velocity_random_walk < 7.0
    noise = start_of(log, gnss={"gnss_latency": 0.0}, navigation={"imu_grade": "mems"})
    assert noise.settings.imu == IMU_GRADES["mems"] and not noise.grade.by_drift


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_sensors_that_an_idling_engine_shakes_are_known_by_their_drift(tmp_path, seed):
    start = start_of(idling(tmp_path / "log.mcap", "mems", seed), gnss={"gnss_latency": 0.0})
    imu, truth = start.settings.imu, SIMULATED_GRADES["mems"]
    assert "by its drift without fixes" in start.grade.why
    # The rest, at which it shakes, bounds no noise, but motion does; of biases drift says little
    assert 0.3 < imu.angle_random_walk / truth.angle_random_walk < 1.3
    assert imu.accel_bias >= IMU_GRADES["industrial"].accel_bias
    # and noise alone does not make a better grade of it
    assert start.grade.grade in ("mems", "industrial")


@pytest.mark.slow
def test_a_grade_is_fitted_once(tmp_path, monkeypatch):
    fitted, fit = [], likelier_grade.fit

    def counted(source, config, algorithm, start):
        fitted.append(start.settings.imu)
        return fit(source, config, algorithm, start)

    monkeypatch.setattr(likelier_grade, "fit", counted)
    start_of(idling(tmp_path / "log.mcap", "mems", 3), gnss={"gnss_latency": 0.0})
    assert len(fitted) == len(set(fitted)) > 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_an_engine_that_idles_is_no_fault_of_a_navigation_grade_nor_of_the_fixes(tmp_path, seed):
    """Its noise at rest passed for a bias, and for fixes that wander by twice what they say."""
    start = start_of(idling(tmp_path / "log.mcap", "navigation", seed), gnss={"gnss_latency": 0.0})
    assert start.grade.grade == "navigation"
    assert start.slow_errors == (1.0, 1.0)


@pytest.mark.parametrize(
    ("gains", "expected"),
    [
        ((9.0, 9.5, 9.9), None),
        ((30.3, 31.7, 38.5), "industrial"),
        ((30.0, 41.0, 45.0), "tactical"),
        ((5.0, 30.0, 41.0), "navigation"),
        ((8.2, 10.1, -2.5), "industrial"),
        ((30.0, 20.0, -np.inf), "industrial"),
    ],
)
def test_a_drift_makes_an_imu_no_better_than_it_clearly_shows(gains, expected):
    """The likeliest was taken: 2 of 12 simulated MEMS for navigation grade, at 1.6 sigmas.

    And a better grade than the worst that is nearly as likely.
    """
    better = ("industrial", "tactical", "navigation")
    assert clearly_likelier(dict(zip(better, gains, strict=True))) == expected


@pytest.mark.parametrize(("grade", "worse"), [("industrial", "mems"), ("navigation", "tactical")])
def test_a_drift_does_not_show_biases_nor_how_axes_lie_in_the_case(monkeypatch, grade, worse):
    for name in ("_walks_at_rest", "walks_in_motion"):
        monkeypatch.setattr(filter_settings, name, lambda _: None)
    imu = filter_settings.imu_noise_of(None, ProcessConfig(), ImuGrade(grade, "by its drift", True))
    for name in ("gyro_bias", "accel_bias", "gyro_misalignment", "accel_misalignment"):
        assert getattr(imu, name) == getattr(IMU_GRADES[worse], name)
        assert getattr(imu, name) > getattr(IMU_GRADES[grade], name)
    assert imu.gyro_scale == IMU_GRADES[grade].gyro_scale


def test_a_filter_expects_axes_as_misaligned_as_they_are_judged(monkeypatch):
    for name in ("_walks_at_rest", "walks_in_motion"):
        monkeypatch.setattr(filter_settings, name, lambda _: None)
    grade = IMU_GRADES["tactical"]
    imu = filter_settings.imu_noise_of(
        None, ProcessConfig(), ImuGrade("tactical", "", misaligned=4.0)
    )
    assert imu.gyro_misalignment == imu.accel_misalignment == 4.0 * grade.gyro_misalignment
    assert imu.accel_bias == grade.accel_bias and imu.gyro_scale == grade.gyro_scale


@pytest.mark.parametrize(("grade", "expected"), [("consumer", "consumer"), ("mems", "mems")])
def test_a_rest_shows_a_bare_chip_by_its_bias(tmp_path, grade, expected):
    log = simulated(
        tmp_path / "log.mcap", "drive", "--grade", grade, "--duration", "120", "--rate", "50",
        "--seed", "2", "--still", "20",
    )  # fmt: skip
    with open_log(log) as opened:
        config = ProcessConfig()
        judged = sensor_grade(prepare(opened, config), config)
    assert judged.grade == expected
    assert ("not calibrated" in judged.why) == (expected == "consumer")


@pytest.mark.parametrize(
    ("bias_deg_s", "gain", "expected"),
    [
        (None, 0.0, "consumer"),
        (None, 40.0, "mems"),
        # A small bias speaks for a calibration, a large one against it
        (0.0, 15.0, "mems"),
        (0.0, -20.0, "consumer"),
        (1.0, 11.0, "consumer"),
    ],
)
def test_a_low_cost_imu_is_calibrated_by_innovations_and_bias_together(
    monkeypatch, bias_deg_s, gain, expected
):
    costs = {0.0: 5.0 - gain / 100, 0.5: 5.0, 1.0: 5.0, 1.5: 5.0}
    shown = {share: Fit(1.0, cost, 100) for share, cost in costs.items()}
    monkeypatch.setattr(likelier_grade.GradeFits, "uncalibrated_by", lambda _, s: shown[s])
    monkeypatch.setattr(likelier_grade.GradeFits, "of", lambda *_: Fit(1.0, 9.0, 100))
    rest = None if bias_deg_s is None else SimpleNamespace(gyro=np.deg2rad([bias_deg_s, 0.0, 0.0]))
    monkeypatch.setattr(likelier_grade, "longest_rest", lambda *_: rest)
    source = SimpleNamespace(survey=SimpleNamespace(spans=()), aiding=SimpleNamespace(gnss=None))
    before = SimpleNamespace(grade=ImuGrade("mems", "by its noise"))
    fits = likelier_grade.GradeFits(source, ProcessConfig(), None, before, None)
    judged = likelier_grade.likelier_low_cost(fits)
    assert judged is not None and judged.grade == expected


@given(
    st.lists(st.floats(-1e4, 1e4), min_size=4, max_size=4), st.floats(-50.0, 50.0), st.floats(0, 50)
)
def test_a_share_is_within_what_is_tried_and_follows_what_is_likelier(cost, log_odds, less):
    cost = np.array(cost)
    share = uncalibrated_share(cost, log_odds)
    assert 0.0 <= share <= likelier_grade.SHARES[-1] + 1e-12
    assert uncalibrated_share(cost, log_odds + less) >= share - 1e-9
    assert uncalibrated_share(cost + less, log_odds) == pytest.approx(share, abs=1e-6)
    assert uncalibrated_share(cost - [less, 0.0, 0.0, 0.0], log_odds) <= share + 1e-9


def test_a_share_is_that_of_the_mean_square():
    """A tenth of the odds for angles of ten times make 3.3 times of them."""
    cost = np.array([0.0, np.inf, 2.0 * likelier_grade.DOUBT * np.log(9.0), np.inf])
    assert uncalibrated_share(cost, 0.0) == pytest.approx(np.log10(np.sqrt(0.9 + 0.1 * 100.0)))


def test_axes_worse_than_those_of_a_bare_chip_are_what_innovations_show():
    """Not what the gyros' bias at rest says, nor nothing: few lie so."""
    clearly = np.array([900.0, 300.0, 60.0, 0.0])
    assert uncalibrated_share(clearly, 0.0) == pytest.approx(1.5, abs=0.01)
    assert uncalibrated_share(np.array([300.0, 60.0, 0.0, 60.0]), 0.0) == pytest.approx(
        1.0, abs=0.01
    )
    unknown = uncalibrated_share(np.zeros(4), 0.0)
    assert 0.75 < unknown < 0.9
    assert uncalibrated_share(np.zeros(4), 50.0) < 1.1


@given(st.floats(0.0, 1.5))
def test_a_calibration_in_part_lies_between(share):
    mems, chip = IMU_GRADES["mems"], IMU_GRADES["consumer"]
    imu = partly_calibrated(mems, chip, share)
    for name in ("accel_bias", "accel_scale", "gyro_scale", "gyro_misalignment"):
        between = (1.0 - share) * np.log(getattr(mems, name)) + share * np.log(getattr(chip, name))
        assert np.log(getattr(imu, name)) == pytest.approx(between)
    assert imu.angle_random_walk == mems.angle_random_walk
    used = filter_settings.of_grade(ProcessConfig(), ImuGrade("mems", "", uncalibrated=share))
    assert used == imu


@pytest.mark.slow
@pytest.mark.parametrize("across", [1e-3, 3e-3, 1e-2])
def test_sigmas_hold_however_well_axes_are_calibrated(tmp_path, across):
    """Tilts of level cars are off by as much as gyros feel turns across: no fixes show it."""
    off = []
    for seed in range(1, 5):
        truth = drive(seed, 260.0, 20.0)
        imu = sensor_errors(0.4, 200.0, 0.12, 8000.0, 1e6 * across, 0.5)
        data = crossed(record(truth, imu, seed, gnss_rate=5.0, sigma=0.3), seed, across)
        log = write(tmp_path / f"{seed}.mcap", data)
        answer, status, _ = process(log, truth, [])
        assert status == 0
        off.append(np.mean(np.square(answer.error[:, 6:8] / answer.sigma[:, 6:8])))
    assert 0.4 < np.sqrt(np.mean(off)) < 2.0


@pytest.mark.slow
def test_axes_worse_than_those_of_a_bare_chip_are_in_the_sigmas(tmp_path):
    """By 30 mrad, as a gyro and an accelerometer that are soldered apart: 2.75 sigmas before."""
    off = []
    for seed in (2, 4):
        truth = drive(seed, 260.0, 20.0)
        imu = sensor_errors(0.4, 200.0, 0.12, 8000.0, 3e4, 0.5)
        data = crossed(record(truth, imu, seed, gnss_rate=5.0, sigma=0.3), seed, 3e-2)
        answer, status, _ = process(write(tmp_path / f"{seed}.mcap", data), truth, [])
        assert status == 0
        off.append(np.mean(np.square(answer.error[:, 6:8] / answer.sigma[:, 6:8])))
    assert 0.4 < np.sqrt(np.mean(off)) < 2.0


@pytest.mark.slow
def test_axes_that_turns_show_to_be_misaligned_are_in_the_sigmas(tmp_path):
    """Of quiet gyros, whose grade has axes fourteen times as good: 3.8 and 8.6 sigmas before.

    Of a level car no fix shows the angles that the axes of gyros and accelerometers share.
    """
    for make, last, most in ((flight, False, 2.3), (drive, 30.0, 4.5)):
        off = []
        for seed in range(1, 7):
            truth = make(seed, 300.0, last)
            data = record(truth, GRADES["tactical"], seed, gnss_rate=2.0, sigma=1.0)
            log = write(tmp_path / f"{seed}.mcap", crossed(data, seed, 7e-4))
            answer, status, _ = process(log, truth, [])
            assert status == 0
            off.append(np.mean(np.square(answer.error[:, 6:8] / answer.sigma[:, 6:8])))
        assert 0.4 < np.sqrt(np.mean(off)) < most, off


def test_misalignments_are_those_that_the_fixes_make_likely():
    unknown = likeliest_times(np.zeros(3))
    assert 1.0 < unknown < likelier_grade.LEAST_TIMES
    assert likeliest_times(np.array([100.0, 0.0, 100.0])) == pytest.approx(4.0, rel=1e-3)
    assert likeliest_times(np.array([0.0, 50.0, 50.0])) == pytest.approx(1.0, rel=1e-3)
    # Of odds of 20 to 1 before there are fixes, their likelihood makes even ones
    even = -2.0 * likelier_grade.DOUBT * likelier_grade.LOG_ODDS_TIMES
    assert likeliest_times(np.array([even, 0.0, 1e3])) == pytest.approx(np.sqrt(8.5))


@given(st.lists(st.floats(0.0, 1e4), min_size=3, max_size=3), st.floats(0.0, 50.0))
def test_misalignments_are_within_what_is_tried_and_follow_what_is_likelier(cost, less):
    cost = np.array(cost)
    times = likeliest_times(cost)
    assert 1.0 <= times <= max(likelier_grade.TIMES)
    assert likeliest_times(cost - [less, 0.0, 0.0]) <= times * (1.0 + 1e-9)
    assert likeliest_times(cost - [0.0, 0.0, less]) >= times * (1.0 - 1e-9)


@pytest.mark.parametrize("option", [None, 0.05])
def test_misalignments_that_an_option_gives_are_used(option):
    """And a grade's are so many times as large as the log shows them."""
    config = ProcessConfig.model_validate({"filter": {"sigma_misalignment": option}})
    shown = SimpleNamespace(misaligned=lambda times: Fit(1.0, 9.0 - 0.1 * times, 1000))
    begun = SimpleNamespace(
        grade=ImuGrade("tactical", "by its noise"),
        settings=SimpleNamespace(imu=IMU_GRADES["tactical"]),
    )
    judged = likelier_grade.likelier_calibration(
        SimpleNamespace(config=config, start=begun, misaligned=shown.misaligned)
    )
    if option is not None:
        assert judged is None
        return
    assert judged is not None and judged.misaligned == pytest.approx(16.0)
    assert "aligned as innovations show, to about 3.2 mrad" in judged.why


@dataclass(frozen=True)
class Begun:
    start: "Begun | None" = None
    covariance_attitude_n: np.ndarray | None = None


def test_a_start_that_was_aligned_as_a_better_imu_is_less_level():
    mems, chip = IMU_GRADES["mems"], IMU_GRADES["consumer"]
    begun = Begun(Begun(covariance_attitude_n=np.diag([1e-4, 1e-4, 1e-2])))
    tilt = start.less_level(begun, mems, chip).start.covariance_attitude_n
    felt = (chip.accel_bias**2 - mems.accel_bias**2) / 9.80665**2
    felt += chip.accel_misalignment**2 - mems.accel_misalignment**2
    assert np.allclose(np.diag(tilt), [1e-4 + felt, 1e-4 + felt, 1e-2])
    same = start.less_level(begun, chip, mems).start.covariance_attitude_n
    assert np.array_equal(same, begun.start.covariance_attitude_n)


@pytest.mark.parametrize("starts", [("consumer",), ()])
def test_where_no_start_fits_a_calibrated_imu_a_bare_chip_is_tried(tmp_path, monkeypatch, starts):
    """And where none fits that either, what is said is about the first."""
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "60", "--still", "20", "--grade", "mems",
        "--rate", "50",
    )  # fmt: skip
    tried = []

    def start_as(grade, *_):
        tried.append(grade.grade)
        if grade.grade not in starts:
            raise AlignmentError(f"no start as {grade.grade}")
        return grade

    monkeypatch.setattr(first_start, "_start_as", start_as)
    with open_log(log) as opened:
        config = ProcessConfig()
        source = prepare(opened, config)
        if starts:
            assert first_start.first_start(source, config).grade == "consumer"
        else:
            with pytest.raises(AlignmentError, match="no start as mems"):
                first_start.first_start(source, config)
    assert tried == ["mems", "consumer"]


@pytest.mark.parametrize(
    ("latency", "begun"), [(0.0, "anew"), (0.15, "as before"), (None, "as before")]
)
def test_another_grade_is_aligned_as_before_rather_than_at_another_time(
    monkeypatch, latency, begun
):
    """A flight of a chip began with a latency of 0.15 s that was none: tilts 21 deg off."""

    def anew(*_):
        if latency is None:
            raise AlignmentError("no start")
        return SimpleNamespace(settings=SimpleNamespace(gnss_latency=latency), how="anew")

    settings = SimpleNamespace(gnss_latency=0.0)
    first = SimpleNamespace(settings=settings, how="first", placed=False)
    monkeypatch.setattr(start, "first_start", anew)
    monkeypatch.setattr(start, "regraded", lambda *_: SimpleNamespace(how="as before"))
    grade = ImuGrade("consumer", "by innovations")
    assert start.begun_as(None, ProcessConfig(), first, grade, 0.0).how == begun


@dataclass
class Choice:
    """Of a start what a choice between two of them looks at."""

    how: str
    grade: ImuGrade
    settings: SimpleNamespace
    by_the_fixes: str = ""
    lag: float = 0.0

    def __post_init__(self):
        self.by_the_fixes = self.how


@pytest.mark.parametrize(("costs", "used"), [((30.0, 20.0), "kept"), ((20.0, 30.0), "anew")])
def test_another_grade_keeps_a_latency_that_explains_the_fixes_better(monkeypatch, costs, used):
    """A tractor's antenna was 0.3 s late, and its heading off by 160 deg once it was a chip's."""
    cost = dict(zip(("anew", "kept"), costs, strict=True))
    mems, chip = ImuGrade("mems", "by its noise"), ImuGrade("consumer", "by innovations")

    def begun(how, grade):
        return Choice(how, grade, SimpleNamespace(imu=None))

    monkeypatch.setattr(start, "as_graded", lambda *_: begun("kept", chip))
    monkeypatch.setattr(start, "less_level", lambda other, *_: other)
    monkeypatch.setattr(start, "begun_as", lambda *_: begun("first", chip))
    monkeypatch.setattr(start, "timed", lambda *_: begun("anew", chip))
    monkeypatch.setattr(start, "fit", lambda _, __, ___, how: Fit(1.0, cost[how], 100))
    first, other = start.as_judged(
        None, ProcessConfig(), None, begun("before", mems), begun("before", mems), chip
    )
    assert other.how == used
    # It says as what it was aligned
    assert first.grade.aligned_as == ("mems" if used == "kept" else None)


@pytest.mark.parametrize(
    ("costs", "used"),
    [((30.0, 20.0), "regraded"), ((20.0, 30.0), "anew"), (None, "before")],
    ids=["fixes fit worse", "fixes fit better", "no start"],
)
def test_a_better_grade_by_drift_takes_no_start_that_fits_the_fixes_worse(monkeypatch, costs, used):
    """Nor does it end the run where its first attitude shows no start."""
    tactical = ImuGrade("tactical", "by its noise")

    def begun(how, grade=tactical):
        return Choice(how, grade, SimpleNamespace(imu=how, control=None))

    def regraded(_, __, ___, grade):
        if costs is None:
            raise AlignmentError("no start")
        return begun("first", grade)

    ordinary = NoiseFactors(1.0, 1.0)
    drift = SimpleNamespace(ratio=1.0, factors=lambda: ordinary)
    fits = SimpleNamespace(factors=ordinary)
    monkeypatch.setattr(start, "_as_quiet_as_in_motion", lambda *args: (args[-1], drift))
    monkeypatch.setattr(start, "GradeFits", lambda *_: fits)
    monkeypatch.setattr(
        start, "_calibrated", lambda *_: (begun("first"), begun("before"), drift, fits)
    )
    monkeypatch.setattr(start, "better_grade", lambda *_: "navigation")
    monkeypatch.setattr(start, "regraded", regraded)
    monkeypatch.setattr(start, "as_graded", lambda *args: begun("regraded", args[-1]))
    monkeypatch.setattr(start, "timed", lambda *args: begun("anew", args[-1].grade))
    cost = dict(zip(("anew", "regraded"), costs or (), strict=False))
    monkeypatch.setattr(start, "fit", lambda _, __, ___, how: Fit(1.0, cost[how], 100))
    made = start.drifting(None, ProcessConfig(), None, begun("first"), begun("before"))
    assert made.how == used
    assert made.grade.grade == ("tactical" if costs is None else "navigation")


@pytest.mark.slow
def test_sensors_of_consumers_are_known_as_well_as_they_say(tmp_path):
    """Tilts were 2.1 sigmas off (rms), as scale factors of 0.8 % and angles of 8 mrad were not in
    the grade."""
    off = []
    for seed in range(1, 7):
        truth = drive(seed, 260.0, 20.0)
        chips = sensor_errors(0.4, 1200.0, 0.12, 25000.0, 8000.0, 0.5)
        data = crossed(record(truth, chips, seed, gnss_rate=5.0, sigma=0.1), seed, 8e-3)
        log = write(tmp_path / f"{seed}.mcap", data)
        arm = ",".join(str(x) for x in LEVER)
        answer, status, _ = process(log, truth, ["--lever-arm", arm])
        assert status == 0
        off.append(np.mean(np.square(answer.error[:, 6:] / answer.sigma[:, 6:]), axis=0))
    square = np.mean(off, axis=0)
    tilt, heading = np.sqrt(square[:2].mean()), np.sqrt(square[2])
    assert 0.6 < tilt < 1.3 and 0.5 < heading < 1.5


@pytest.mark.slow
def test_misaligned_accelerometers_are_in_the_first_tilt(tmp_path):
    """With their bias of 50 ug alone it was 3 mdeg where it was 21 off, seven sigmas."""
    off = []
    for seed in range(1, 5):
        truth = drive(seed, 200.0, 60.0)
        data = crossed(record(truth, GRADES["tactical"], seed, sigma=0.05), seed, 3e-4)
        log = write(tmp_path / f"{seed}.mcap", data)
        answer, *_ = process(log, truth, ["--sigma-misalignment", "0.3"])
        off.append(np.square(answer.error[0, 6:8] / answer.sigma[0, 6:8]))
    assert 0.3 < np.sqrt(np.mean(off)) < 1.6


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 6, 7])
def test_a_configured_grade_with_which_the_fixes_are_far_less_likely_is_reported(tmp_path, seed):
    """Two minutes have too few stretches without fixes for a drift: status 0 before with seed 6."""
    truth = drive(seed, 130.0, 20.0)
    data = record(truth, GRADES["industrial"], seed, gnss_rate=2.0, sigma=0.1)
    log = write(tmp_path / "log.mcap", crossed(data, seed, 5e-3))
    found = {}
    for grade in ("tactical", "mems"):
        begun = start_of(
            log,
            input={"gyro_kind": "mean-rate"},
            gnss={"lever_arm": tuple(LEVER.tolist())},
            navigation={"imu_grade": grade},
        )
        found[grade] = contradictions(begun, ())
    assert found["mems"] == []
    (said,) = found["tactical"]
    assert "far likelier" in said.text and said.severity == Severity.LOST


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bias_deg_h", "options", "denied"),
    [(0.0, {}, False), (40.0, {}, True), (40.0, {"sigma_bg": 30.0}, False)],
)
@pytest.mark.parametrize("axis", range(3))
def test_a_configured_grade_that_a_rest_denies_is_reported(
    tmp_path, axis, bias_deg_h, options, denied
):
    """Status 0 before, with tilts 19 sigmas off where fixes are noisy."""
    data = record(drive(3, 120.0, 30.0), GRADES["tactical"], 3, sigma=5.0)
    step = float(np.median(np.diff(data.seconds)))
    turn = bias_deg_h * DEGREE_PER_HOUR * step * np.eye(3)[axis]
    log = write(tmp_path / "log.mcap", replace(data, gyro=data.gyro + turn))
    begun = start_of(
        log,
        input={"gyro_kind": "mean-rate"},
        navigation={"imu_grade": "tactical"},
        in_flight=options,
    )
    texts = [finding.text for finding in contradictions(begun, ())]
    assert any(text.startswith("at rest, the bias") for text in texts) == denied, texts


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_drift_makes_no_better_imu_that_innovations_deny(tmp_path, seed):
    """A chip was taken for industrial by its drift: the mount was 6 sigmas off."""
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "600", "--still", "30", "--grade", "consumer",
        "--rate", "50", "--seed", str(seed), "--idle", "0.3,0.01", "--gnss-model", "coloured",
    )  # fmt: skip
    assert start_of(log, gnss={"gnss_latency": 0.0}).grade.grade in ("consumer", "mems")


@pytest.mark.slow
def test_a_configured_grade_that_the_drift_contradicts_is_reported(tmp_path):
    """Status 0 before, with headings 5 sigmas off."""
    truth = drive(9, 260.0, 20.0)
    data = record(truth, GRADES["industrial"], 32, gnss_rate=10.0, sigma=0.5)
    log = write(tmp_path / "log.mcap", data)
    assert process(log, truth, ["--imu-grade", "tactical"])[1] == 3
    assert process(log, truth, ["--imu-grade", "industrial"])[1] == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_scale_factors_that_little_noise_hides_do_not_refute_sigmas(tmp_path, seed):
    """A quarter as noisy as the grade has them, and half a per cent wrong in every turn."""
    errors = sensor_errors(0.4, 150.0, 0.15, 1500.0, 5000.0, 3000.0)
    truth = drive(seed, 420.0, 5.0)
    data = record(truth, errors, seed, gnss_rate=5.0, sigma=0.5, sigma_v=0.05)
    log = write(tmp_path / "log.mcap", without_fixes(data, [(150.0, 190.0), (300.0, 340.0)]))
    answer, status, _ = process(log, truth, ["--vehicle", "none"])
    late = answer.seconds > 60.0
    ratio = np.sqrt(np.mean(np.square(answer.error[late] / answer.sigma[late]), axis=0))
    assert status == 0
    assert ratio.max() < 1.6, ratio


@pytest.mark.parametrize(
    ("part", "grade", "named"),
    [
        ({"end": "20"}, "auto", False),
        ({"start": "18"}, "auto", True),
        ({"start": "18"}, "mems", False),
        # where seven seconds of driving are too few for any grade, none is asked for
        ({"start": "25"}, "auto", False),
    ],
)
def test_a_grade_is_asked_for_where_no_rest_shows_it_and_nothing_starts(
    tmp_path, monkeypatch, part, grade, named
):
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "32", "--still", "15", "--grade", "mems",
        "--rate", "50", "--baro-rate", "0",
    )  # fmt: skip
    if part == {"start": "18"}:

        def uncertain(*_):
            text = "the first attitude is unknown: its sigma is 58 deg"
            raise AlignmentError(text, "wait", uncertain=True)

        monkeypatch.setattr(initial_state, "in_flight", uncertain)
    with pytest.raises(AlignmentError) as refused:
        start_of(log, input=part, navigation={"imu_grade": grade})
    assert ("--imu-grade" in refused.value.hint) == named


@pytest.mark.parametrize(
    ("grade", "option", "expected"),
    [
        ("mems", "auto", True),
        ("tactical", "auto", False),
        ("tactical", "on", True),
        ("mems", "off", False),
    ],
)
def test_fictitious_noise_is_added_for_mems_or_as_asked_for(tmp_path, grade, option, expected):
    log = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "60", "--still", "10", "--grade", grade,
        "--rate", "50", "--baro-rate", "0",
    )  # fmt: skip
    start = start_of(
        log,
        navigation={"imu_grade": grade},
        filter={"virtual_noise": option},
        gnss={"gnss_latency": 0.0},
        align={"align": "fixed", "initial_attitude": (0.0, 0.0, 0.0)},
    )
    assert start.settings.control.virtual_noise == expected


@pytest.mark.slow
@pytest.mark.parametrize(("options", "has"), [({}, True), ({"filter": "network-26"}, False)])
def test_misalignments_are_found_and_reported(tmp_path, options, has):
    """Of a flight that rolls and pitches as it turns; truth: the simulation's own matrix."""
    log = simulated(
        tmp_path / "log.mcap", "manoeuvring-flight", "--duration", "900", "--grade", "tactical",
        "--rate", "50", "--seed", "4", "--no-scale-errors", "--no-bias-drift",
    )  # fmt: skip
    chosen, _ = run(log, filter=options, navigation={"imu_grade": "tactical"})
    used = chosen["filter"]
    for name in ("gyro", "accel"):
        found = used[f"{name}_misalignment"]
        if not has:
            assert found is None
            continue
        with log.open("rb") as stream:
            (written,) = make_reader(stream).iter_metadata()
        text = written.metadata[f"{name}_matrix_ppm"]
        flip = np.diag([1.0, -1.0, -1.0])
        truth = flip @ np.array([float(x) for x in text.split(",")]).reshape(3, 3) @ flip * 1e-6
        error = np.array(found) - truth[~np.eye(3, dtype=bool)]
        # A log shows some of the six, the grade's 0.2 mrad is known of the others
        assert np.abs(error).max() < 3.5 * 2e-4
        if name == "gyro":
            assert np.sort(np.abs(error))[2] < 0.5 * 2e-4


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_filter_without_states_for_it_does_not_make_a_chip_calibrated(tmp_path, seed):
    """Its scale factors and angles were noise, and less likely than none: tilts 4 sigmas off."""
    truth = drive(seed, 260.0, 5.0)
    data = crossed(record(truth, PHONE, seed, gnss_rate=5.0, sigma=0.03), seed, 5e-3)
    log = write(tmp_path / "log.mcap", data)
    options = {"input": {"gyro_kind": "mean-rate"}, "gnss": {"lever_arm": tuple(LEVER.tolist())}}
    assert start_of(log, filter={"filter": "plain-15"}, **options).grade.grade == "consumer"
