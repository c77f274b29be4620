"""A filter whose heading gets known at once: biases of accelerometers tilt it in the body."""

import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.core.streams import GnssEpochs
from sinstool.core.units import MILLI_G
from sinstool.methods.ins_gnss import instants
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.ins_gnss.states import ATTITUDE
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.navigation import Q_W, Q_Z
from sinstool.methods.strapdown.velocity import Increments
from tests.helpers.filter_start import start
from tests.methods.ins_gnss.flown import for_grade

DEGREE = np.pi / 180.0
LATITUDE, RATE, REST, GAIN, END = 0.85, 50.0, 20.0, 2.0, 32.0
IMU = SensorGrade(
    angle_random_walk=0.3 * DEGREE / 60.0, velocity_random_walk=2e-3, accel_bias=30.0 * MILLI_G
)


def settings():
    control = DivergenceControl(virtual_noise=False, gate_probability=1.0)
    model = GnssModel((0.1,) * 3, (0.01,) * 3, 200.0, (0.02,) * 3, (1e-3,) * 3)
    return for_grade(
        "consumer", filter="markov-21", network=None, gnss=model, control=control, imu=IMU
    )


def driven_north(off, **options):
    """A filter over a rest and a pull-away to the north, whose heading is off at first, rad."""
    n = round(END * RATE)
    k, step = np.arange(n), 1.0 / RATE
    time_ns = np.round((k + 1) * 1e9 / RATE).astype(np.int64)
    gain = np.tile(-earth.gravity_n(LATITUDE, 100.0) * step, (n, 1))
    gain[k >= REST * RATE, 0] += GAIN * step
    turn = np.tile(earth.earth_rate_n(LATITUDE) * step, (n, 1))
    seconds = np.arange(0.5, END, 0.5)
    speed = GAIN * np.maximum(seconds - REST, 0.0)
    zero = np.zeros_like(speed)
    fix_ns = np.round(seconds * 1e9).astype(np.int64)
    unknown = np.full((len(seconds), 3), np.nan)
    fixes = GnssEpochs(
        fix_ns,
        fix_ns,
        LATITUDE + 0.5 * speed**2 / GAIN / 6.37e6,
        zero,
        zero + 100.0,
        np.stack([speed, zero, zero], axis=1),
        unknown,
        unknown,
    )
    sigma = np.array([3.0, 3.0, 30.0]) * DEGREE
    begin = start(LATITUDE, 0.0, 100.0, np.zeros(3), rotation.exp([0.0, 0.0, off]), 0.5, 0.1, sigma)
    run = InsGnssFilter(begin, settings(), with_baro=False, **options)
    return run, run.push(Increments(k, time_ns, np.full(n, step), turn, gain), fixes)


def roll(updates):
    """Sigma of the tilt about the direction of travel, rad."""
    return np.sqrt(updates.covariance_attitude_n[:, 0, 0])


@pytest.mark.parametrize("off", [-30.0, -20.0, 0.0, 10.0, 35.0])
def test_a_heading_that_gets_known_tells_no_tilt_from_a_bias(off):
    """Forces along a body that never turned: roll stays as uncertain as the bias across it."""
    run, block = driven_north(off * DEGREE)
    updates = block.updates
    at_rest = roll(updates)[round(REST * RATE) - 1]
    assert at_rest == pytest.approx((30e-3**-2 + (3.0 * DEGREE) ** -2) ** -0.5, rel=0.05)
    assert np.sqrt(run.covariance[ATTITUDE + 2, ATTITUDE + 2]) < 2.0 * DEGREE
    assert roll(updates)[-1] > 0.9 * at_rest


def test_errors_of_attitude_stay_in_the_body_and_covariances_symmetric():
    run, _ = driven_north(0.0)
    m, n = run._memory, run.kind.size
    before = run.covariance
    c = rotation.to_dcm(run.nav[Q_W : Q_Z + 1])
    m.x[ATTITUDE : ATTITUDE + 3] = 0.1, -0.2, 0.7
    m.keep = 0
    turned = rotation.to_dcm(rotation.exp(m.x[ATTITUDE : ATTITUDE + 3])) @ c
    instants.turn_errors(m, np.zeros((1, 1)))
    old, new = np.eye(n), np.eye(n)
    block = slice(ATTITUDE, ATTITUDE + 3)
    old[block, block], new[block, block] = c.T, turned.T
    after = run.covariance
    assert np.allclose(new @ after @ new.T, old @ before @ old.T, rtol=1e-9, atol=1e-15)
    assert np.array_equal(after, after.T)


@pytest.mark.parametrize("off", [-30.0, 25.0])
def test_a_smoother_takes_the_turn_of_errors_along(off):
    """Its sigma of a tilt that nothing shows is about that of the filter, from the begin on."""
    run, block = driven_north(off * DEGREE, store=True)
    with Smoother(run.kind) as smoother:
        smoother.push(block)
        (updates,) = smoother.blocks(smoother.epochs())
    error = rotation.log(updates.q_nb)
    sigma = np.sqrt(np.einsum("nii->ni", updates.covariance_attitude_n))
    settled = slice(round(RATE), None)
    assert np.all(np.abs(error[settled]) < 1.5 * sigma[settled])
    assert sigma[settled, 0].min() > 0.75 * roll(block.updates)[-1]
