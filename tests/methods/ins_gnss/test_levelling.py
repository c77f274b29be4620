"""A filter whose tilts are unknown, as after a gap: it levels before it believes in a heading."""

import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.methods.strapdown.velocity import Increments
from tests.helpers.filter_start import start
from tests.methods.ins_gnss.flown import for_grade

DEGREE = np.pi / 180.0
LATITUDE, RATE = 0.85, 100.0
SIGMA = np.array([15.0, 15.0, 100.0]) * DEGREE


def at_rest(seconds, noise, random):
    """Increments of an IMU at rest, forward axis to the north."""
    n = round(seconds * RATE)
    step = 1.0 / RATE
    white = np.sqrt(step) * random.standard_normal((2, n, 3))
    turn = earth.earth_rate_n(LATITUDE) * step + noise.angle_random_walk * white[0]
    gain = -earth.gravity_n(LATITUDE, 100.0) * step
    k = np.arange(n)
    time_ns = np.round((k + 1) * 1e9 / RATE).astype(np.int64)
    return Increments(
        k, time_ns, np.full(n, step), turn, gain + noise.velocity_random_walk * white[1]
    )


@pytest.mark.parametrize("seed", range(6))
def test_heading_is_not_learnt_from_gravity_that_tilts_turn(seed):
    """At rest nothing shows it: it was sure to 2 to 10 deg after a few seconds."""
    random = np.random.default_rng(seed)
    noise = IMU_GRADES["tactical"]
    control = DivergenceControl(virtual_noise=False, gate_probability=1.0)
    model = GnssModel((0.1,) * 3, (0.01,) * 3, 200.0, (0.05,) * 3, (5e-3,) * 3)
    settings = for_grade("tactical", filter="markov-27", network=None, gnss=model, control=control)
    psi = SIGMA * np.clip(random.standard_normal(3), -1.0, 1.0)
    begin = start(LATITUDE, 0.0, 100.0, np.zeros(3), rotation.exp(-psi), 0.5, 3.0, SIGMA)
    run = InsGnssFilter(begin, settings, with_baro=False)
    motion = at_rest(15.0, noise, random)
    seconds = np.arange(0.5, 15.0, 0.5)
    metres = 0.1 * random.standard_normal((len(seconds), 3))
    time_ns = np.round(seconds * 1e9).astype(np.int64)
    unknown = np.full((len(seconds), 3), np.nan)
    fixes = GnssEpochs(
        time_ns,
        time_ns,
        LATITUDE + metres[:, 0] / 6.37e6,
        metres[:, 1] / 4.2e6,
        100.0 - metres[:, 2],
        0.05 * random.standard_normal((len(seconds), 3)),
        unknown,
        unknown,
    )
    last = run.push(motion, fixes).updates
    error = rotation.log(rotation.conjugate(last.q_nb[-1]))
    sigma = np.sqrt(np.diagonal(last.covariance_attitude_n[-1]))
    assert np.all(sigma[:2] < 0.5 * DEGREE) and np.all(np.abs(error[:2]) < 4.0 * sigma[:2])
    assert sigma[2] > 0.3 * SIGMA[2] and abs(error[2]) < 4.0 * sigma[2]
