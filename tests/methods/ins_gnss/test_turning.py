"""What axes of gyros that are misaligned leave of an attitude after turns."""

import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.velocity import Increments
from tests.helpers.filter_start import start
from tests.methods.ins_gnss.flown import for_grade

LATITUDE, RATE, SECONDS = 0.85, 100.0, 60.0
MISALIGNED, FIRST = 1e-3, 1e-5
NOTHING = GnssEpochs(*(np.zeros(0, np.int64),) * 2, *(np.zeros(0),) * 3, *(np.zeros((0, 3)),) * 3)


def turned(axis, degrees, matrix, filter="markov-27"):
    """Attitude at the end of a turn, and what a filter says of it; its gyros are off by `matrix`.

    Gravity is felt from what is the truth; `axis` is forward, right, down, and stays level or not.
    """
    n, step = round(SECONDS * RATE), 1.0 / RATE
    rate_b = np.asarray(axis) * np.radians(degrees) / SECONDS
    q = rotation.exp(rate_b * step * np.arange(n + 1)[:, None])
    c_bn = np.swapaxes(rotation.to_dcm(q), 1, 2)
    turn = rate_b + c_bn[:-1] @ earth.earth_rate_n(LATITUDE)
    gain = -c_bn[:-1] @ earth.gravity_n(LATITUDE, 100.0)
    k = np.arange(n)
    time_ns = np.round((k + 1) * 1e9 / RATE).astype(np.int64)
    motion = Increments(k, time_ns, np.full(n, step), (turn + turn @ matrix.T) * step, gain * step)
    control = DivergenceControl(virtual_noise=False)
    model = GnssModel((0.1,) * 3, (0.01,) * 3, 200.0, (0.05,) * 3, (5e-3,) * 3)
    settings = for_grade(
        "tactical", filter=filter, network=None, gnss=model, control=control,
        imu=SensorGrade(gyro_misalignment=MISALIGNED),
    )  # fmt: skip
    begin = start(LATITUDE, 0.0, 100.0, np.zeros(3), rotation.exp(np.zeros(3)), 0.1, 0.01, FIRST)
    last = InsGnssFilter(begin, settings, with_baro=False).push(motion, NOTHING).updates
    error = rotation.log(rotation.multiply(last.q_nb[-1], rotation.conjugate(q[-1])))
    return error, np.sqrt(np.diagonal(last.covariance_attitude_n[-1]))


@pytest.mark.parametrize(
    ("axis", "degrees"),
    [((0, 0, 1), 90), ((0, 0, -1), 1530), ((0, 1, 0), -90), ((0.6, 0, 0.8), 200)],
)
def test_attitude_gets_as_uncertain_as_gyros_that_are_misaligned_turn_it_wrong(axis, degrees):
    """Truth: strapdown navigation itself, by gyros whose axes are off by a draw of matrices."""
    random = np.random.default_rng(5)
    squares = []
    for _ in range(100):
        matrix = MISALIGNED * random.standard_normal((3, 3))
        np.fill_diagonal(matrix, 0.0)
        error, sigma = turned(axis, degrees, matrix)
        squares.append(np.square(error / sigma))
    ratio = np.mean(squares, axis=0)
    # About the axis of a turn there is but the sigma of the start, which was not off
    shown = sigma > 0.1 * MISALIGNED
    assert np.count_nonzero(shown) >= 2 and np.all(ratio[~shown] < 1.0)
    # 100 draws know the mean of a square to 14 %
    assert ratio[shown] == pytest.approx(np.ones(np.count_nonzero(shown)), abs=0.45)


@pytest.mark.parametrize("degrees", [90.0, -90.0, 270.0, 1530.0])
@pytest.mark.parametrize("down", [1, -1])
def test_a_filter_without_states_for_the_axes_keeps_the_heading_of_a_car_as_it_turns(degrees, down):
    """Truth: strapdown navigation itself, by gyros whose axes are off by a draw of matrices.

    It grew by the misalignment in each right angle, as if it were random: by four in 1530 deg.
    """
    random = np.random.default_rng(3)
    errors = []
    for _ in range(60):
        matrix = MISALIGNED * random.standard_normal((3, 3))
        np.fill_diagonal(matrix, 0.0)
        error, sigma = turned([0.0, 0.0, down], degrees, matrix, "plain-15")
        errors.append(error)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert spread[2] < 0.04 * MISALIGNED and sigma[2] < 0.1 * MISALIGNED
    # tilts do become uncertain, by no less than they get wrong
    assert np.all(sigma[:2] > 0.75 * spread[:2]) and np.all(spread[:2] > 0.5 * MISALIGNED)


def test_a_turn_about_another_axis_makes_heading_uncertain_without_states_for_the_axes():
    random = np.random.default_rng(4)
    errors = []
    for _ in range(60):
        matrix = MISALIGNED * random.standard_normal((3, 3))
        np.fill_diagonal(matrix, 0.0)
        error, sigma = turned([0.0, 1.0, 0.0], 90.0, matrix, "plain-15")
        errors.append(error)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert spread[2] > 0.5 * MISALIGNED and 0.75 < sigma[2] / spread[2] < 1.8
    assert sigma[1] < 0.1 * MISALIGNED and spread[1] < 0.05 * MISALIGNED


@pytest.mark.parametrize("step", [0.05, 0.4])
def test_the_antenna_does_not_swing_on_after_a_gap_that_is_too_long_to_bridge(step):
    """A fix of the first update after it was compared with the rate from before the gap."""
    n, gap, swing = round(10.0 / step), 8.0, 1.0
    k = np.arange(2 * n)
    seconds = step * (k + 1) + np.where(k < n, 0.0, gap)
    heading = swing * step * np.minimum(np.arange(2 * n + 1), n)
    q = rotation.exp(heading[:, None] * [0.0, 0.0, 1.0])
    c_bn = np.swapaxes(rotation.to_dcm(q), 1, 2)
    turn = np.diff(heading)[:, None] * [0.0, 0.0, 1.0]
    turn += step * c_bn[:-1] @ earth.earth_rate_n(LATITUDE)
    gain = -step * c_bn[:-1] @ earth.gravity_n(LATITUDE, 100.0)
    time_ns = np.rint(1e9 * seconds).astype(np.int64)
    motion = Increments(k, time_ns, np.full(2 * n, step), turn, gain)
    at = time_ns[[n]] - round(0.8e9 * step)
    unknown, still = np.full((1, 3), np.nan), np.zeros((1, 3))
    no_place = np.full(1, np.nan)
    fix = GnssEpochs(at, at, no_place, no_place, no_place, still, unknown, unknown)
    settings = for_grade("tactical", filter="plain-15", network=None, lever_arm_b=(2.0, 0.0, 0.0))
    begin = start(LATITUDE, 0.0, 100.0, np.zeros(3), rotation.exp(np.zeros(3)), 0.1, 0.01, FIRST)
    epoch = InsGnssFilter(begin, settings, with_baro=False).push(motion, fix).gnss
    np.testing.assert_allclose(epoch.innovation[0, 3:], 0.0, atol=0.01)
