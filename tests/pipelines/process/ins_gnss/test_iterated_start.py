"""First attitudes that are far off: a filter is to be linear about the true one."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.rotation import conjugate, exp, from_dcm, log, multiply
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.pipelines.process.ins_gnss.iterated_start import iterated
from tests.helpers.filter_logs import first_start_of
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    DEG,
    LEVER,
    PHONE,
    RATE,
    band_noise,
    drive,
    flight,
    motion_of,
    multicopter,
    record,
    smoothed,
    write,
)

AS_LOGGED = {
    "input": {"gyro_kind": "mean-rate"},
    "gnss": {"lever_arm": tuple(LEVER.tolist())},
    "navigation": {"imu_grade": "consumer"},
}
TILT, HEADING = 2.0 * DEG, 20.0 * DEG


@pytest.fixture(scope="module", params=[(multicopter, 5), (flight, 6), (drive, 7)])
def begun(request, tmp_path_factory):
    """A first start, the motion after it, the true attitude there, and the truth."""
    kind, seed = request.param
    truth = kind(seed, 240.0)
    data = record(truth, PHONE, seed, gnss_rate=5.0, sigma=0.3, sigma_v=0.05)
    log_path = write(tmp_path_factory.mktemp("log") / "log.mcap", data)
    start, motion = first_start_of(log_path, **AS_LOGGED)
    at = int(np.searchsorted(truth.seconds, (start.time_ns - T0) * 1e-9))
    return start, motion, truth.c_nb[at], truth


def turned(start, c_nb, heading, tilt=(0.0, 0.0)):
    """The start with the true attitude turned, and sigmas that admit it."""
    q = multiply(exp([*tilt, heading]), from_dcm(c_nb))
    nav = np.concatenate([start.start.nav[:6], q])
    covariance = np.diag(np.square([TILT, TILT, HEADING]))
    return replace(start, start=replace(start.start, nav=nav, covariance_attitude_n=covariance))


def navigated(start, motion):
    run = InsGnssFilter(start.start, start.settings, with_baro=False)
    return run.push(motion, start.used).updates


def tilt_in_sigmas(start, motion, truth):
    """Tilt over its sigma, root mean square over the run after twenty seconds."""
    updates = navigated(start, motion)
    rows = slice(int(np.searchsorted(updates.time_ns, start.time_ns + 20 * 10**9)), None, 20)
    at = np.searchsorted(truth.seconds, (updates.time_ns[rows] - T0) * 1e-9 - 1e-6)
    off = log(multiply(from_dcm(truth.c_nb[at]), conjugate(updates.q_nb[rows])))[:, :2]
    square = np.diagonal(updates.covariance_attitude_n[rows], axis1=1, axis2=2)[:, :2]
    return float(np.sqrt(np.mean(off**2 / square)))


def lift(seed):
    """A skier who stands, is taken by a lift and sways in it: the only change of velocity shows the
    heading, and little else tells tilts from biases."""
    random = np.random.default_rng([seed, 77])
    t = np.arange(0.0, 130.0, 1.0 / RATE)
    speed = smoothed(np.where(t > 6.0, 4.0, 0.0), 3.0)
    moving = np.minimum(speed / 4.0, 1.0)[:, None]
    sway = moving * DEG * np.array([1.5, 3.0, 0.5]) * band_noise(random, t, 0.2, 1.0)
    angles = np.stack([0.0 * t, 0.1 * moving[:, 0], 0.9 + 0.0 * t], axis=1) + sway
    velocity = speed[:, None] * [np.cos(0.9), np.sin(0.9), -0.2]
    return motion_of(t, velocity, angles)


@pytest.mark.slow
def test_what_is_found_does_not_depend_on_where_it_began(tmp_path):
    apart = {"at once": [], "iterated": []}
    for seed in range(1, 6):
        truth = lift(seed)
        data = record(truth, PHONE, seed, gnss_rate=5.0, sigma=0.3, sigma_v=0.03)
        start, motion = first_start_of(write(tmp_path / f"{seed}.mcap", data), **AS_LOGGED)
        at = int(np.searchsorted(truth.seconds, (start.time_ns - T0) * 1e-9))
        begun = [
            turned(start, truth.c_nb[at], heading * DEG, (2.5 * DEG, -2.0 * DEG))
            for heading in (-20.0, 30.0)
        ]
        better = [replace(one, start=iterated(one, motion)) for one in begun]
        for name, pair in (("at once", begun), ("iterated", better)):
            one, other = (navigated(start, motion) for start in pair)
            off = log(multiply(one.q_nb[-1], conjugate(other.q_nb[-1])))
            apart[name].append(off / np.sqrt(np.diag(one.covariance_attitude_n[-1])))
    size = {name: np.sqrt(np.mean(np.square(off), axis=0)) for name, off in apart.items()}
    assert np.all(size["iterated"] < 0.2)
    assert np.all(size["at once"] > 2.0 * size["iterated"])


@pytest.mark.slow
@pytest.mark.parametrize("heading_deg", [-35.0, 25.0, 40.0])
def test_sigmas_hold_that_begin_far_off(begun, heading_deg):
    start, motion, c_nb, truth = begun
    made = turned(start, c_nb, heading_deg * DEG)
    found = replace(made, start=iterated(made, motion))
    left = log(multiply(from_dcm(c_nb), conjugate(found.start.nav[6:10])))
    assert abs(left[2]) < 6.0 * DEG
    assert np.array_equal(found.start.covariance_attitude_n, made.start.covariance_attitude_n)
    assert tilt_in_sigmas(found, motion, truth) < 2.0


def test_an_attitude_that_is_near_stays(begun):
    start, motion, c_nb, _ = begun
    made = turned(start, c_nb, 0.0)
    again = replace(made, start=iterated(made, motion))
    assert iterated(again, motion) is again.start
    assert iterated(made, None) is made.start
