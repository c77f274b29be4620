from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.core.errors import AlignmentError
from sinstool.methods.alignment.gyrocompass import Gyrocompass, gyrocompass
from sinstool.methods.alignment.inflight_types import ImuIncrements
from sinstool.methods.sensor_errors import SIMULATED_GRADES, SensorGrade
from sinstool.simulation import sensors
from sinstool.simulation.launch import launch
from sinstool.simulation.profile import Profile, Step, Wave, fly
from sinstool.simulation.truth import sample_times, static

DEGREE = np.pi / 180.0
PER_HOUR = DEGREE / 3600.0
EARTH_RATE = 7.292115e-5
# A fibre-optic unit: 0.05 deg/h, 0.005 deg/sqrt(h), 50 ug, 5 ug/sqrt(Hz)
FIBRE = SensorGrade(
    angle_random_walk=0.005 * DEGREE / 60,
    gyro_bias=0.05 * PER_HOUR,
    velocity_random_walk=5e-5,
    accel_bias=5e-4,
)
TACTICAL = SIMULATED_GRADES["tactical"]
RATE = 50.0


def grade_of(grade):
    return SensorGrade(grade.gyro_bias, grade.accel_bias, bias_time_s=float("inf"))


def increments(truth, grade=None, seed=0):
    felt = truth if grade is None else sensors.with_errors(truth, grade, seed)
    force = felt.mean_specific_force * felt.interval[:, None]
    return ImuIncrements(felt.time_ns, felt.gyro_increment, force)


def rest(seconds, latitude, euler_deg, rate=RATE):
    q_nb = rotation.from_euler(np.radians(euler_deg))
    return static(sample_times(rate, seconds), q_nb, latitude * DEGREE)


ALWAYS = (Step(-1e4, 1.0, 1.0),)


def shaken(seconds, latitude, scale=1.0, when=ALWAYS, rate=RATE):
    """A base that rocks and sways, 11 deg right wing down, pointing south-west."""
    turn = 2.0 * np.pi
    profile = Profile(
        speed=(Wave(0.05 * scale, turn * 0.3, 0.0, when),),
        climb=(),
        course=(),
        pitch=(Wave(2.0 * DEGREE * scale, turn * 0.21, 0.3, when),),
        yaw=(Wave(1.0 * DEGREE * scale, turn * 0.13, 1.0, when), Step(-1e4, 1.0, 3.6)),
        roll=(Wave(3.0 * DEGREE * scale, turn * 0.26, 0.7, when), Step(-1e4, 1.0, 0.2)),
    )
    site = (latitude * DEGREE, 0.3, 100.0)
    return fly(profile, sample_times(rate, seconds), 0, site, 0.4).imu


def psi(answer: Gyrocompass, truth):
    return rotation.log(rotation.multiply(answer.q_nb, rotation.conjugate(truth.q_nb[-1])))


def many(truth, grade, latitude, runs=30, height=0.0, settings=None):
    answers = [
        gyrocompass(
            increments(truth, grade, seed), latitude * DEGREE, height, settings or grade_of(grade)
        )
        for seed in range(runs)
    ]
    off = np.array([psi(a, truth) for a in answers])
    squares = [p @ np.linalg.solve(a.cov, p) / 3.0 for p, a in zip(off, answers, strict=True)]
    return answers, off, float(np.mean(squares))


ATTITUDES = [
    (0.0, (1.0, 2.0, 30.0)),
    (42.0, (-3.0, 5.0, 200.0)),
    (-33.0, (120.0, 40.0, -70.0)),
    (68.0, (10.0, -88.0, 100.0)),
    (-5.0, (180.0, 0.0, -179.0)),
]


@pytest.mark.parametrize(("latitude", "euler"), ATTITUDES)
def test_perfect_sensors_give_the_attitude(latitude, euler):
    truth = rest(30.0, latitude, euler)
    got = gyrocompass(increments(truth), latitude * DEGREE, 0.0, grade_of(FIBRE))
    np.testing.assert_allclose(psi(got, truth), 0.0, atol=1e-9)
    assert got.status == "ok" and got.q_nb[0] >= 0.0
    assert got.t_ns == truth.time_ns[-1] and got.still_s == pytest.approx(29.98 + 0.02, abs=0.03)
    np.testing.assert_allclose(got.gyro_bias, 0.0, atol=1e-12)


@pytest.mark.parametrize(("latitude", "euler"), ATTITUDES)
def test_errors_are_as_large_as_predicted(latitude, euler):
    truth = rest(120.0, latitude, euler)
    answers, off, squares = many(truth, FIBRE, latitude)
    # 90 squares of unit variance: mean within 0.6 to 1.5 in all but one of 1000 tries
    assert 0.55 < squares < 1.6
    walk = FIBRE.angle_random_walk / np.sqrt(120.0)
    level_rate = EARTH_RATE * np.cos(latitude * DEGREE)
    predicted = np.hypot(FIBRE.gyro_bias, walk) / level_rate
    for a in answers:
        # the largest of three Allan variances is a little more than the noise
        assert a.sigma_rad[2] == pytest.approx(predicted, rel=0.08)
        assert a.sigma_rad[0] == pytest.approx(FIBRE.accel_bias / 9.8, rel=0.05)
        assert a.angle_random_walk == pytest.approx(FIBRE.angle_random_walk, rel=0.3)
        assert a.velocity_random_walk == pytest.approx(FIBRE.velocity_random_walk, rel=0.05)
        assert a.chi2 < 5.0
    assert np.sqrt(np.mean(off[:, 2] ** 2)) == pytest.approx(predicted, rel=0.4)


def test_the_bias_of_the_east_gyro_is_what_turns_heading():
    """Groves eq. (5.106): the heading error is the east bias over the level Earth rate."""
    latitude, truth = -50.0, rest(60.0, -50.0, (0.0, 0.0, 0.0))
    biased = increments(truth)
    east = 0.05 * PER_HOUR
    turned = ImuIncrements(
        biased.time_ns,
        biased.delta_theta + truth.interval[:, None] * [0.0, east, 0.0],
        biased.delta_velocity,
    )
    got = gyrocompass(turned, latitude * DEGREE, 0.0, grade_of(FIBRE))
    expected = -east / (EARTH_RATE * np.cos(latitude * DEGREE))
    assert psi(got, truth)[2] == pytest.approx(expected, rel=1e-3)
    # it cannot be told from heading: none of it is taken for a bias
    assert abs(got.gyro_bias[1]) < 0.01 * east
    assert got.gyro_bias_sigma[1] == pytest.approx(FIBRE.gyro_bias, rel=0.01)
    # that of the others can, as the size and slope of the Earth's rate are known
    assert got.gyro_bias_sigma[0] < 0.8 * FIBRE.gyro_bias
    # no rest tells level accelerometer biases from tilt
    assert got.accel_bias_sigma.shape == (3,)
    assert got.accel_bias_sigma[:2] == pytest.approx([FIBRE.accel_bias] * 2, rel=0.05)


def test_gyros_too_poor_give_level_and_no_heading():
    truth = rest(60.0, 42.0, (7.0, -4.0, 133.0))
    for seed in range(5):
        got = gyrocompass(increments(truth, TACTICAL, seed), 42 * DEGREE, 0.0, grade_of(TACTICAL))
        assert got.status == "level-only"
        np.testing.assert_allclose(
            rotation.to_euler(got.q_nb), np.radians([7.0, -4.0, 0.0]), atol=4e-3
        )
        assert got.sigma_rad[2] == pytest.approx(np.pi / np.sqrt(3.0))
        assert got.cov[0, 2] == 0.0
        expected = np.hypot(TACTICAL.gyro_bias, TACTICAL.angle_random_walk / np.sqrt(60.0)) / (
            EARTH_RATE * np.cos(42 * DEGREE)
        )
        assert got.sigma_heading == pytest.approx(expected, rel=0.25)
        (text,) = got.warnings
        assert "heading is not observable" in text and "1 deg/h" in text and "60 s" in text


def test_near_a_pole_heading_goes():
    good, _, squares = many(rest(120.0, 86.0, (2.0, 3.0, 40.0)), FIBRE, 86.0, 20)
    shown = [a for a in good if a.status == "degraded"]
    assert len(shown) >= 15 and 0.4 < squares < 1.8
    for a in good:
        assert any("7.0 % of the Earth's rate" in w for w in a.warnings)
        assert a.status == "level-only" or a.sigma_heading < 5.0 * DEGREE
    at_pole = rest(60.0, 90.0, (2.0, 3.0, 40.0))
    got = gyrocompass(increments(at_pole, FIBRE), 90 * DEGREE, 0.0, grade_of(FIBRE))
    assert got.status == "level-only"
    np.testing.assert_allclose(rotation.to_euler(got.q_nb)[:2], np.radians([2, 3]), atol=3e-4)


def test_a_gyro_worse_than_its_grade_is_noticed():
    truth = rest(120.0, 42.0, (0.0, 1.0, 2.0))
    wrong = replace(FIBRE, gyro_bias=3.0 * PER_HOUR)
    got = gyrocompass(increments(truth, wrong, 2), 42 * DEGREE, 0.0, grade_of(FIBRE))
    assert any("shows gyro biases of" in w and "0.05 are expected" in w for w in got.warnings)
    # so is another latitude
    got = gyrocompass(increments(truth, FIBRE, 2), 32 * DEGREE, 0.0, grade_of(FIBRE))
    assert any("the latitude" in w for w in got.warnings)


def test_biases_that_show_are_as_large_about_east():
    """Ten times those of the grade: about east too, where they turn heading by degrees."""
    truth, poor = rest(120.0, 42.0, (3.0, 1.0, 50.0)), replace(FIBRE, gyro_bias=0.5 * PER_HOUR)
    answers = [
        gyrocompass(increments(truth, poor, seed), 42 * DEGREE, 0.0, grade_of(FIBRE))
        for seed in range(40)
    ]
    shown = [a for a in answers if a.status != "level-only"]
    over = np.abs([psi(a, truth)[2] / a.sigma_heading for a in shown])
    # Of a size that two components tell, errors over it have the tails of Student's t
    assert len(shown) > 30 and np.median(over) < 1.2 and np.mean(over > 4.0) <= 0.15
    assert np.median([a.sigma_heading for a in answers]) > 1.5 * DEGREE


def test_knocks_do_little():
    knocks = (Step(60.0, 0.1, 1.0), Step(60.5, 0.3, -1.0), Step(90.0, 0.1, 1.0))
    truth = shaken(150.0, 45.0, 1.0, (*knocks, Step(91.5, 0.3, -1.0)))
    answers, _, squares = many(truth, FIBRE, 45.0, 12, 100.0)
    assert 0.4 < squares < 1.8
    for a in answers:
        assert a.status == "ok" and 144.0 < a.still_s < 148.0
    untouched = np.hypot(FIBRE.gyro_bias, FIBRE.angle_random_walk / np.sqrt(150.0))
    untouched /= EARTH_RATE * np.cos(45 * DEGREE)
    assert answers[0].sigma_rad[2] < 1.2 * untouched


def test_moved_while_it_aligns():
    """Turned by 20 deg within 3 s: rest before and after both count."""
    profile = Profile((), (), (), (), (Step(60.0, 3.0, 0.35),), (Step(-1e4, 1.0, 0.1),))
    site = (45 * DEGREE, 0.3, 100.0)
    truth = fly(profile, sample_times(RATE, 120.0), 0, site, 0.4).imu
    answers, off, squares = many(truth, FIBRE, 45.0, 12, 100.0)
    assert 0.4 < squares < 1.8 and answers[0].still_s > 110.0
    assert np.abs(off[:, 2]).max() < 1.2 * DEGREE


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.05])
def test_rocking_base(scale):
    """Without any rest, gravity seen in inertial axes shows heading; never better than said."""
    truth = shaken(240.0, 45.0, scale)
    answers, off, squares = many(truth, FIBRE, 45.0, 3, 100.0)
    assert squares < 2.0
    for a, p in zip(answers, off, strict=True):
        assert a.still_s < 1.0 and a.status in ("ok", "degraded")
        assert np.abs(p[2]) < 1.2 * DEGREE and np.abs(p[:2]).max() < 0.02 * DEGREE
        assert a.angle_random_walk == pytest.approx(FIBRE.angle_random_walk, rel=0.1)


def test_rocking_too_little_to_break_stillness():
    """A parked vehicle in the wind: taken for rest, its sway would be noise of the gyros."""
    truth = shaken(240.0, 45.0, 0.005)
    got = gyrocompass(increments(truth, FIBRE, 3), 45 * DEGREE, 100.0, grade_of(FIBRE))
    assert got.still_s < 1.0 and got.sigma_heading < 0.5 * DEGREE
    assert abs(psi(got, truth)[2]) < 3.0 * got.sigma_heading
    # perfect sensors: the Earth turns by 1.8e-5 rad in half of a window, which is accounted for
    got = gyrocompass(increments(truth), 45 * DEGREE, 100.0, grade_of(FIBRE))
    np.testing.assert_allclose(psi(got, truth)[:2], 0.0, atol=4e-6)


def test_driving_is_refused():
    truth = launch(RATE, 60.0).imu
    got = gyrocompass(increments(truth, FIBRE), 0.72, 1000.0, grade_of(FIBRE))
    assert got.status == "unobservable" and np.isnan(got.q_nb).all()
    assert "the vehicle moves" in got.warnings[-1]


def test_gaps_and_short_records():
    truth = rest(60.0, 45.0, (1.0, 2.0, 3.0))
    whole = increments(truth, FIBRE)
    part = np.r_[0:500, 700:3001]
    cut = ImuIncrements(whole.time_ns[part], whole.delta_theta[part], whole.delta_velocity[part])
    got = gyrocompass(cut, 45 * DEGREE, 0.0, grade_of(FIBRE))
    assert got.t_start_ns == 14_000_000_000 and "gap" in got.warnings[0]
    assert abs(psi(got, truth)[2]) < 4.0 * got.sigma_rad[2]
    for rows in (0, 1, 2, 200):
        short = ImuIncrements(
            whole.time_ns[:rows], whole.delta_theta[:rows], whole.delta_velocity[:rows]
        )
        with pytest.raises(AlignmentError, match="gyrocompassing needs"):
            gyrocompass(short, 45 * DEGREE)


@pytest.mark.parametrize(("begins_s", "drives"), [(24.0, True), (36.0, False)])
def test_who_moves_for_more_than_half_of_the_time_drives(begins_s, drives):
    truth = shaken(60.0, 42.0, scale=40.0, when=(Step(begins_s, 0.5, 1.0),))
    got = gyrocompass(increments(truth), 42.0 * DEGREE, 100.0, grade_of(FIBRE))
    assert got.still_s == pytest.approx(begins_s, abs=3.0)
    assert any("the vehicle moves" in text for text in got.warnings) == drives
    assert (got.status == "unobservable") == drives
