"""The front end of alignment in motion: spans of time, fixes, biases, and the way back."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.earth import normal_gravity
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import conjugate, from_euler, log, multiply, rotate
from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment import in_motion
from sinstool.methods.alignment.in_motion import align_in_motion, first_motion, spans
from sinstool.methods.alignment.inflight_types import AlignmentSettings, GnssFixes
from sinstool.methods.alignment.level_bias import level_bias
from sinstool.methods.alignment.measurements import gnss_fixes, increments, with_vertical
from sinstool.methods.alignment.span_reader import SpanReader
from sinstool.methods.alignment.still import WindowStage, lead_in, still_spans
from sinstool.methods.sensor_errors import SIMULATED_GRADES, SensorGrade
from sinstool.simulation.drive import road_drive
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import GnssErrors, Receiver, gnss_samples
from sinstool.simulation.sensors import with_errors
from tests.helpers.gnss import epochs, straight

LEVER = (0.8, -0.4, -1.1)
SHARP = GnssErrors((0.5, 0.5, 0.8), (0.0,) * 3, 100.0, (0.05, 0.05, 0.08))
DEGREE = np.pi / 180.0
MEMS = SensorGrade(112.0 * DEGREE / 3600.0, 0.1, 3e-3, 3e-3, 3.0 * DEGREE / 60.0, 0.03)


def mounted(imu, mount=(1.0, 0.0, 0.0, 0.0)):
    """Mean rates of a sensor whose axes are turned by `mount` against the vehicle's."""
    gyro, accel = (rotate(mount, v) for v in (imu.gyro_mean_rate, imu.mean_specific_force))
    return Imu(imu.time_ns, imu.time_ns, gyro, accel)


def aligned(imu, gnss, lever=(0.0, 0.0, 0.0), samples=None):
    """As the pipelines do it: bias from a rest at first, spans from the first motion on."""
    first, last = int(imu.time_ns[0]), int(imu.time_ns[-1])
    fixes, _ = gnss_fixes(gnss, first, last)
    stage = WindowStage()
    stage.push(imu.time_ns, imu.gyro, imu.accel)
    rest = lead_in(still_spans(stage.finish()), first)
    grade = MEMS if rest is None else replace(MEMS, gyro_bias=45.0 * DEGREE / 3600.0)
    start = first_motion(fixes, first, first)
    settings = AlignmentSettings(
        gate="off", at="start", refine=True, start_ns=start, grade=grade, lever_arm_b=lever
    )
    return align_in_motion(
        samples or SpanReader([imu]),
        "mean-rate",
        0.01,
        fixes,
        settings,
        np.zeros(3) if rest is None else rest.gyro,
        spans("off", start, None, first, int(fixes.time_ns[-1])),
        0.5 * DEGREE if rest is None else None,
    )


def walker(speed):
    """Fixes at 1 Hz of somebody who goes north with such a speed, m/s."""
    n = len(speed)
    velocity = np.zeros((n, 3))
    velocity[:, 0] = speed
    return GnssFixes(np.arange(n) * SECOND, np.zeros(n), np.zeros(n), np.zeros(n), velocity)


def test_a_walker_begins_when_he_walks_and_not_when_he_runs_at_last():
    speed = np.full(300, 1.3)
    speed[:40] = 0.0
    speed[294:] = 2.5
    assert first_motion(walker(speed), 0, 0) == 35 * SECOND
    speed[150:155] = 2.5
    assert first_motion(walker(speed), 0, 0) == 145 * SECOND
    # who never is fast may be but noise
    assert first_motion(walker(np.full(300, 1.3)), 0, 0) is None


def circling(rate, bias, wander=0.0):
    """A level vehicle that turns at such a rate, fast for 5 s of each minute; IMU and fixes."""
    seconds = np.arange(0, 130 * 50) / 50.0
    gyro = np.tile(np.array([0.0, 0.0, rate]) + bias, (len(seconds), 1))
    force = np.tile([0.0, 0.0, -9.81], (len(seconds), 1))
    time_ns = np.rint(seconds * SECOND).astype(np.int64)
    fixes = walker(np.where(np.arange(126) % 60 < 5, 4.0, 1.0))
    course = rate * np.arange(126) + wander * np.random.default_rng(4).standard_normal(126)
    turn = np.stack([np.cos(course), np.sin(course), np.zeros(126)], axis=-1)
    return Imu(time_ns, time_ns, gyro, force), replace(
        fixes, velocity_n=fixes.velocity_n[:, :1] * turn
    )


def test_a_level_bias_does_not_lose_whole_turns_while_the_vehicle_is_slow():
    bias = np.array([0.3, -0.2, 0.4]) * DEGREE
    imu, fixes = circling(6.0 * DEGREE, bias)
    found = level_bias(imu, fixes, 0)
    assert np.abs(found.bias - bias).max() < 0.01 * DEGREE
    assert found.sigma == pytest.approx(0.1 * DEGREE, rel=0.01)


def test_a_level_bias_is_as_uncertain_as_the_course_and_none_where_that_is_anything():
    imu, fixes = circling(6.0 * DEGREE, np.zeros(3), 0.3)
    found = level_bias(imu, fixes, 0)
    assert 0.1 * DEGREE < found.sigma < 0.3 * DEGREE
    assert np.abs(found.bias).max() < 3.0 * found.sigma
    assert level_bias(*circling(6.0 * DEGREE, np.zeros(3), 2.0), 0) is None


def test_a_level_bias_of_an_aircraft_that_circles_is_as_uncertain_as_its_bank():
    """In a turn it rotates about an axis that leans with it."""
    rate, speed = 5.0 * DEGREE, 60.0
    bank = np.arctan(speed * rate / 9.80665)
    seconds = np.arange(0, 130 * 50) / 50.0
    turn = np.array([0.0, rate * np.sin(bank), rate * np.cos(bank)])
    time_ns = np.rint(seconds * SECOND).astype(np.int64)
    force = np.tile([0.0, 0.0, -9.80665 / np.cos(bank)], (len(seconds), 1))
    imu = Imu(time_ns, time_ns, np.tile(turn, (len(seconds), 1)), force)
    fixes = walker(np.full(126, speed))
    course = rate * np.arange(126)
    ways = np.stack([np.cos(course), np.sin(course), np.zeros(126)], axis=-1)
    found = level_bias(imu, replace(fixes, velocity_n=speed * ways), 0)
    off = abs(found.bias @ found.up)
    assert 0.4 * DEGREE < off < 1.5 * found.sigma


@dataclass(frozen=True)
class Answer:
    """What an alignment says, without one."""

    errors: SimpleNamespace | None
    chi2: float
    status: str = "ok"
    sigma_worst: float = 0.01
    warnings: tuple[str, ...] = ()
    t_q_ns: int = 0
    t_stop_ns: int = 0


def test_a_gyro_bias_that_no_refinement_confirms_is_not_used(monkeypatch):
    """An answer that was not refined may be anything, however well it fits."""
    sigma = {"gyro_bias": np.full(3, DEGREE)}
    off = np.array([0.0, 0.0, 1.0]) * DEGREE
    bias = SimpleNamespace(gyro_bias=off, sigma=sigma, chi2=1.0)
    removed = []

    def answer(imu, fixes, span):
        first = np.allclose(imu.delta_theta[1:50].mean(axis=0), removed_from)
        removed.append(first)
        return Answer(bias, 2.0) if first else Answer(None, 0.1)

    imu, fixes = circling(6.0 * DEGREE, np.zeros(3))
    removed_from = increments(imu, "rate", 0.02, np.zeros(3)).delta_theta[1:50].mean(axis=0)
    monkeypatch.setattr(in_motion, "align_in_flight", answer)
    settings = AlignmentSettings(gate="off", at="start", refine=True, start_ns=0, grade=MEMS)
    found = align_in_motion(
        SpanReader([imu]), "rate", 0.02, fixes, settings, np.zeros(3), [None], 0.5 * DEGREE
    )
    assert removed.count(False)  # a bias was taken off and tried
    assert found.result.errors is bias and not found.bias_by_motion


def test_a_short_span_is_not_preferred_to_a_long_one_that_fits(monkeypatch):
    """Its residuals were smaller by a hair: a ship's heading was known to 3.9 deg, not to 1.3."""
    whole, ordinary = 125 * SECOND, MEMS.gyro_bias

    def answer(imu, fixes, span):
        long = span.end_ns == whole
        off = 0.5 * ordinary if long else 5.0 * ordinary
        sigma = {"gyro_bias": np.full(3, span.grade.gyro_bias)}
        errors = SimpleNamespace(gyro_bias=np.full(3, off), sigma=sigma, chi2=0.9 if long else 1.1)
        if long and np.abs(imu.delta_theta[1:50, 0].mean()) > 2.0 * ordinary * 0.02:
            return Answer(None, 2.5, "unobservable", 0.4)  # less the bias of a short span
        times = {"t_q_ns": 0, "t_stop_ns": span.end_ns}
        return Answer(errors, *((0.09, "degraded", 0.023) if long else (0.08, "ok", 0.07)), **times)

    imu, fixes = circling(6.0 * DEGREE, np.zeros(3))
    monkeypatch.setattr(in_motion, "align_in_flight", answer)
    settings = AlignmentSettings(gate="off", at="end", refine=True, start_ns=0, grade=MEMS)
    unknown = 0.5 * DEGREE, UNSEEN
    found = align_in_motion(
        SpanReader([imu]), "rate", 0.02, fixes, settings, np.zeros(3), [whole], *unknown
    )
    assert found.settings.end_ns == whole
    assert found.result.sigma_worst == 0.023


@pytest.mark.parametrize("aligns", [True, False])
def test_a_bias_that_turns_a_level_vehicle_off_its_course_gives_way(monkeypatch, aligns):
    """Two biases explain the turns; with one it turns by 1 deg/s while its course stays."""
    imu, fixes = circling(6.0 * DEGREE, np.array([0.0, 0.0, 1.0]) * DEGREE)
    sigma = {"gyro_bias": np.full(3, 0.03 * DEGREE)}

    def answer(samples, fixes, span):
        goes = samples.delta_theta[1:50, 2].mean() < 6.5 * DEGREE * 0.02
        off = np.array([0.0 if goes else 0.2, 0.0, 0.0]) * DEGREE
        errors = SimpleNamespace(gyro_bias=off, sigma=sigma, chi2=1.0)
        return Answer(errors, 1.5 if goes else 1.0, "ok" if aligns or not goes else "failed")

    monkeypatch.setattr(in_motion, "align_in_flight", answer)
    settings = AlignmentSettings(gate="off", at="start", refine=True, start_ns=0, grade=MEMS)
    found = align_in_motion(
        SpanReader([imu]), "rate", 0.02, fixes, settings, np.zeros(3), [None], 0.5 * DEGREE
    )
    assert found.gyro_bias[2] == pytest.approx(DEGREE if aligns else 0.0, abs=0.01 * DEGREE)


def corner(seed, bias):
    """Ten seconds at 10 m/s with a corner of 90 deg in them: IMU, fixes, and the first heading."""
    rng = np.random.default_rng(seed)
    when = np.arange(1000)
    time_ns = when * (SECOND // 100)
    rate = 15.0 * DEGREE * ((when >= 100) & (when < 700))
    heading = np.cumsum(rate) / 100.0 - 0.8
    zero = np.zeros(1000)
    # The Earth's rate is left out: it is a fiftieth of such a bias
    gyro = np.column_stack([zero, zero, rate]) + bias + 2e-3 * rng.standard_normal((1000, 3))
    accel = np.column_stack([zero, 10.0 * rate, zero - normal_gravity(0.5)])
    accel += 0.03 * rng.standard_normal(3) + 0.01 * rng.standard_normal((1000, 3))
    course = heading[9::10]
    velocity = 10.0 * np.column_stack([np.cos(course), np.sin(course), np.zeros(100)])
    velocity += 0.05 * rng.standard_normal((100, 3))
    place = np.full(100, 0.5)
    fixes = GnssFixes(time_ns[9::10], place, place, np.zeros(100), velocity, np.full(100, 0.05))
    return Imu(time_ns, time_ns, gyro, accel), fixes, heading[9]


UNSEEN = 0.2 * DEGREE


def test_a_bias_that_a_short_log_does_not_show_is_in_the_sigmas():
    """Ten seconds do not tell a bias of the gyros from a tilt and a bias of accelerometers."""
    squares, within = [], []
    for seed in range(8):
        bias = UNSEEN * np.random.default_rng(100 + seed).standard_normal(3)
        imu, fixes, heading = corner(seed, bias)
        at = int(fixes.time_ns[0])
        settings = AlignmentSettings(gate="off", at=at, refine=True, start_ns=0, grade=MEMS)
        unknown = 0.5 * DEGREE, UNSEEN
        found = align_in_motion(
            SpanReader([imu]), "rate", 0.01, fixes, settings, np.zeros(3), [None], *unknown
        )
        assert found.good
        error = psi(found.result.q_nb, from_euler([0.0, 0.0, heading]))
        squares.append(error @ np.linalg.solve(found.result.cov, error) / 3.0)
        off = np.abs(found.refined_bias - bias).max()
        within.append(off / np.max(found.result.errors.sigma["gyro_bias"]))
    assert np.mean(squares) < 2.0
    assert np.max(within) < 4.0


def carried_to_first_fix(moving, imu, gnss):
    """Row of the first fix's sample, attitude and covariance there."""
    row = int(np.searchsorted(imu.time_ns, gnss.time_ns[0]))
    end = int(np.searchsorted(imu.time_ns, moving.result.t_ns, "right"))
    part = increments(imu.rows(slice(row, end)), "mean-rate", 0.01, moving.refined_bias)
    return row, *moving.carried_back(part)


def psi(q_nb, q_true):
    return log(multiply(q_true, conjugate(q_nb)))


@pytest.mark.parametrize(
    ("mount", "seed"),
    [((0.0, 0.0, 0.0), 1), ((170.0, 60.0, -20.0), 2), ((-90.0, 5.0, 135.0), 3)],
)
def test_a_road_start_however_the_sensor_is_mounted(mount, seed):
    truth = road_drive(110.0, 100.0, heading=2.3, still_s=30.0, seed=seed)
    q_mount = from_euler(np.deg2rad(mount))
    # Half a degree per second of bias, as of a consumer's gyro
    sensors = with_errors(truth.imu, replace(SIMULATED_GRADES["mems"], gyro_bias=5e-3), seed)
    imu = mounted(sensors, q_mount)
    gnss = epochs(gnss_samples(truth, Receiver(4.0, 2.1, 0.0, errors=SHARP), seed), own_sigma=True)
    moving = aligned(imu, gnss)
    row, q_nb, covariance = carried_to_first_fix(moving, imu, gnss)
    error = psi(q_nb, multiply(truth.imu.q_nb[row], conjugate(q_mount)))
    assert np.rad2deg(np.sqrt(covariance[2, 2])) < 4.0
    assert error @ np.linalg.solve(covariance, error) < 14.2  # 99.7 % of three
    bias = rotate(q_mount, (sensors.gyro_increment - truth.imu.gyro_increment).mean(axis=0) * 100.0)
    sigma = np.max(moving.result.errors.sigma["gyro_bias"])
    assert np.abs(moving.refined_bias - bias).max() < 3.0 * sigma
    assert sigma < np.deg2rad(0.02)


@pytest.mark.parametrize("bias", [3e-4, 5e-3])
def test_without_rest_in_a_flight(bias):
    flight = manoeuvring_flight(120.0, 100.0, latitude=0.5, heading=-2.0, seed=4)
    grade = replace(SIMULATED_GRADES["mems"], gyro_bias=bias)
    imu = mounted(with_errors(flight.imu, grade, 5))
    gnss = epochs(
        gnss_samples(flight, Receiver(5.0, errors=SHARP, lever_arm_b=LEVER), 6), own_sigma=True
    )
    moving = aligned(imu, gnss, LEVER)
    assert moving.good
    row, q_nb, covariance = carried_to_first_fix(moving, imu, gnss)
    error = psi(q_nb, flight.imu.q_nb[row])
    assert error @ np.linalg.solve(covariance, error) < 14.2
    assert np.rad2deg(np.sqrt(covariance[2, 2])) < 5.0
    # A bias far beyond the grade is taken off before
    assert np.any(moving.gyro_bias) == (bias > 1e-3)


def test_where_nothing_shows_the_heading_there_is_none():
    standing = road_drive(60.0, 100.0, still_s=100.0)
    gnss = epochs(gnss_samples(standing, Receiver(4.0, errors=SHARP), 1), own_sigma=True)
    imu = mounted(with_errors(standing.imu, SIMULATED_GRADES["mems"], 1))
    assert not aligned(imu, gnss).good


def test_without_fixes_it_says_so():
    standing = road_drive(20.0, 100.0, still_s=100.0)
    gnss = epochs(gnss_samples(standing, Receiver(4.0, errors=SHARP), 1), own_sigma=True)
    first, last = int(gnss.time_ns[0]), int(gnss.time_ns[-1])
    for nothing in (None, replace(gnss, latitude=np.full(len(gnss), np.nan))):
        with pytest.raises(AlignmentError, match="needs GNSS fixes"):
            gnss_fixes(nothing, first, last)
    with pytest.raises(
        AlignmentError, match=r"span.*: the last is 3600\.0 s before the first"
    ) as e:
        gnss_fixes(gnss, last + 3600 * SECOND, last + 3700 * SECOND)
    assert "--gnss-clock-offset" in e.value.hint
    with pytest.raises(AlignmentError, match=r"span.*: the first is 100\.0 s after the first"):
        gnss_fixes(gnss, first - 100 * SECOND, first - 50 * SECOND)


def blocks_of(imu, size, read):
    """Blocks of samples, and the first sample of each that was read."""
    for begin in range(0, len(imu), size):
        read.append(begin)
        yield imu.rows(slice(begin, begin + size))


def test_no_more_is_read_than_a_span_needs():
    time_ns = 10**9 + 10_000_000 * np.arange(1000)
    values = np.random.default_rng(1).normal(size=(1000, 3))
    imu = Imu(time_ns, time_ns, values, -values)
    read = []
    samples = SpanReader(blocks_of(imu, 100, read))
    for end, count, blocks in ((150, 151, 2), (30, 31, 2), (199, 200, 3), (950, 951, 10)):
        part = samples.until(int(time_ns[end]))
        assert len(part) == count
        np.testing.assert_array_equal(part.accel, imu.accel[:count])
        assert len(read) == blocks
        assert not samples.cut_short(int(time_ns[end]))
    assert len(samples.until(None)) == 1000
    assert not samples.cut
    assert not samples.cut_short(None)


def test_where_there_are_too_many_samples_the_rest_is_left_and_said():
    time_ns = 10**9 + 10_000_000 * np.arange(1000)
    imu = Imu(time_ns, time_ns, np.zeros((1000, 3)), np.ones((1000, 3)))
    read = []
    samples = SpanReader(blocks_of(imu, 100, read), 250)
    assert len(samples.until(int(time_ns[200]))) == 201
    assert not samples.cut_short(int(time_ns[200]))
    for end in (int(time_ns[700]), None):
        assert samples.until(end).time_ns[-1] == time_ns[249]
        assert "first 250 samples (2 s)" in samples.cut_short(end)[0]
    assert len(read) == 3
    with pytest.raises(AlignmentError, match="no IMU samples"):
        SpanReader([]).until(None)


def test_a_good_first_span_leaves_the_rest_of_the_log_unread():
    truth = road_drive(400.0, 100.0, heading=2.3, still_s=30.0, seed=1)
    imu = mounted(with_errors(truth.imu, SIMULATED_GRADES["mems"], 1))
    gnss = epochs(gnss_samples(truth, Receiver(4.0, errors=SHARP), 1), own_sigma=True)
    whole = aligned(imu, gnss)
    assert whole.result.status == "ok"
    read = []
    again = aligned(imu, gnss, samples=SpanReader(blocks_of(imu, 1000, read)))
    np.testing.assert_array_equal(again.result.q_nb, whole.result.q_nb)
    np.testing.assert_array_equal(again.result.cov, whole.result.cov)
    assert 1000 * len(read) < 0.7 * len(imu)


def test_an_alignment_with_a_part_of_the_samples_says_so():
    standing = road_drive(60.0, 100.0, still_s=100.0)
    gnss = epochs(gnss_samples(standing, Receiver(4.0, errors=SHARP), 1), own_sigma=True)
    imu = mounted(with_errors(standing.imu, SIMULATED_GRADES["mems"], 1))
    result = aligned(imu, gnss, samples=SpanReader([imu], 3000)).result
    assert any("3000 samples" in text for text in result.warnings)
    assert result.t_ns <= imu.time_ns[3000]


def test_spans_grow_to_the_end_of_the_log():
    first = 7 * SECOND
    assert spans("off", None, first + 30 * SECOND, first, 10**12) == [first + 30 * SECOND]
    assert spans("paper", None, None, first, 10**12) == [None]
    long = spans("off", 100 * SECOND, None, first, 5000 * SECOND)
    assert long == [300 * SECOND, 700 * SECOND]
    assert spans("off", 100 * SECOND, None, first, 500 * SECOND) == [300 * SECOND, None]
    assert spans("off", None, None, first, 60 * SECOND) == [None]


def test_vertical_velocity_comes_from_height_where_there_is_none():
    seconds = np.arange(0.0, 60.0, 0.5)
    height = 300.0 + 4.0 * seconds
    whole = np.tile([20.0, -3.0, -4.0], (len(seconds), 1))
    flat = whole.copy()
    flat[:, 2] = np.nan
    filled, warnings = with_vertical(flat, seconds, seconds, height)
    np.testing.assert_allclose(filled[4:-4], whole[4:-4], atol=1e-9)
    assert "derived from height" in warnings[0]
    # few without are better left out than guessed
    few = whole.copy()
    few[10:20, 2] = np.nan
    unchanged, warnings = with_vertical(few, seconds, seconds, height)
    np.testing.assert_array_equal(unchanged, few)
    assert not warnings
    # no height either
    level, warnings = with_vertical(flat, seconds, np.empty(0), np.empty(0))
    assert not level[:, 2].any() and "level motion is assumed" in warnings[0]


def test_a_late_receiver_s_fix_counts_where_the_samples_of_its_time_are():
    gnss = straight(1_700_000_000 * SECOND + 200_000_000 * np.arange(20), 3.0)
    last = int(gnss.time_ns[-1])
    step = int(np.diff(gnss.time_ns)[0])
    span = int(gnss.time_ns[0]), last - step // 2
    prompt, _ = gnss_fixes(gnss, *span)
    late, _ = gnss_fixes(gnss, *span, latency_s=0.75 * step / SECOND)
    # Stamped after the last sample, but older; the first is older than the first sample
    assert prompt.time_ns[-1] == last - step and prompt.time_ns[0] == gnss.time_ns[0]
    assert late.time_ns[-1] == last and late.time_ns[0] == gnss.time_ns[1]
