"""A fix against the navigation: innovations, their rows, and their noise."""

import numpy as np
import pytest

from sinstool.core.rotation import exp, from_euler, multiply, to_dcm
from sinstool.methods.ins_gnss import gnss, instants, layout, states
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import GnssModel
from sinstool.methods.strapdown.navigation import initial_state
from tests.helpers.optimal_filter import RATE, metres, moved, radii
from tests.methods.ins_gnss.flown import Flown

LEVER = np.array([1.8, -0.7, -2.4])
GNSS = GnssModel((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 210.0, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 50.0)
NAV = initial_state(0.8, np.pi - 1e-7, 300.0, [60.0, -40.0, 3.0], from_euler([0.3, -0.2, 2.0]))
OMEGA = np.array([0.2, -0.3, 0.5])  # in inertial axes, rad/s
ANGULAR, PULL = np.array([0.5, 0.4, -0.3]), np.array([3.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def flown():
    return Flown(duration=20.0)


def a_filter(flown, name="markov-27"):
    settings = flown.using(name, lever_arm_b=tuple(LEVER), gnss=GNSS)
    run = InsGnssFilter(flown.start, settings, with_baro=False)
    return run._memory, run._model


def turning(m, nav, rate=OMEGA):
    """Set a navigation that moves and turns ever faster."""
    m.nav[:] = nav
    rm, rn = radii(nav[0])
    m.moved[:3] = (
        nav[3] / (rm + nav[2]), nav[4] / ((rn + nav[2]) * np.cos(nav[0])), -nav[5],
    )  # fmt: skip
    m.moved[3:6], m.moved[6:9], m.rate[:] = PULL, ANGULAR, rate


def compared(m, model, fix, back, sigma=(np.nan,) * 6):
    diagnosis = np.zeros(layout.DIAGNOSTICS)
    rows = gnss.compare(m, model, np.concatenate([fix, sigma]), back, diagnosis)
    return m.h[:rows, : m.n].copy(), m.nu[:rows].copy(), m.r[:rows].copy()


def antenna(nav, back):
    """Place and velocity of the antenna so long ago, by the motion of `turning`."""
    place, v = nav[:3], nav[3:6]
    # position and velocity backward, attitude by the mean rate of the time between
    here = moved(*place, -(v - 0.5 * PULL * back) * back)
    before = v - PULL * back
    c_nb = to_dcm(multiply(nav[6:10], exp(-(OMEGA - 0.5 * ANGULAR * back) * back)))
    rate = c_nb @ (OMEGA - ANGULAR * back) - RATE * np.array(
        [np.cos(here[0]), 0.0, -np.sin(here[0])]
    )
    arm = c_nb @ LEVER
    return np.array([*moved(*here, arm), *(before + np.cross(rate, arm))])


@pytest.mark.parametrize("back", [0.0, 0.05])
def test_innovations_are_the_antennas_place_and_velocity_less_the_fix(flown, back):
    m, model = a_filter(flown)
    turning(m, NAV)
    off = np.array([3.0, -2.0, 1.5, 0.4, -0.3, 0.2])
    true = antenna(NAV, back)
    fix = np.array([*moved(*true[:3], -off[:3]), *(true[3:] - off[3:])])
    fix[1] = (fix[1] + np.pi) % (2.0 * np.pi) - np.pi  # over the date line
    _, nu, _ = compared(m, model, fix, back)
    # half of acceleration, and of the turn's square, times the time squared
    limit = 1e-4 + 0.5 * back**2 * np.array([5.0] * 3 + [2.0] * 3)
    assert np.all(np.abs(nu - off) < limit)


@pytest.mark.parametrize("back", [0.0, 0.2])
def test_rows_are_derivatives_of_the_innovations(flown, back):
    m, model = a_filter(flown)
    fix = antenna(NAV, back)
    turning(m, NAV)
    h, nu, _ = compared(m, model, fix, back)
    gyro, lasting = int(model.where[states.I_GYRO_BIAS]), int(model.where[states.I_GNSS_POSITION])
    step = 1e-5
    for state in range(m.n):
        ends = []
        for sign in (1.0, -1.0):
            error = sign * step * (np.arange(m.n) == state)
            nav, wrong = NAV.copy(), fix.copy()
            instants.corrected(NAV, -error, nav)
            turning(m, nav, OMEGA + error[gyro : gyro + 3])
            slow = error[lasting : lasting + 6]
            wrong[:3], wrong[3:] = moved(*fix[:3], slow[:3]), fix[3:] + slow[3:]
            ends.append(compared(m, model, wrong, back)[1])
        slope = (ends[0] - ends[1]) / (2.0 * step)
        # But for what turns with the Earth, and for what a rate's error does within the latency
        assert slope == pytest.approx(
            h[:, state], abs=3e-4 + 4.0 * back * (gyro <= state < gyro + 3)
        )
    # An estimate that is not fed back is taken off
    x = np.random.default_rng(1).standard_normal(m.n)
    turning(m, NAV)
    m.x[: m.n] = x
    np.testing.assert_allclose(compared(m, model, fix, back)[1], nu - h @ x, atol=1e-9)


@pytest.mark.parametrize("missing", [(), (2,), (0,), (3, 4), (0, 1, 2, 5), range(6)])
def test_rows_are_of_what_there_is(flown, missing):
    m, model = a_filter(flown)
    turning(m, NAV)
    fix = antenna(NAV, 0.0)
    h, nu, r = compared(m, model, fix + 1e-6, 0.0)
    fix[list(missing)] = np.nan
    some = compared(m, model, fix + 1e-6, 0.0)
    # without latitude there is no position
    there = np.setdiff1d(range(6), [*missing, *((0, 1, 2) if 0 in missing else ())]).astype(int)
    for whole, part in zip((h, nu, r), some, strict=True):
        np.testing.assert_array_equal(part, whole[there])


@pytest.mark.parametrize("name", ["markov-27", "plain-15"])
def test_a_receivers_own_sigma_holds_all_of_its_error(flown, name):
    """Where a filter estimates what lasts of it, the rest is white: of variances as given."""
    m, model = a_filter(flown, name)
    turning(m, NAV)
    fix = antenna(NAV, 0.0)
    white, slow = np.array([1, 2, 3, 0.1, 0.2, 0.3]), np.array([4, 5, 6, 0.4, 0.5, 0.6])
    whole = np.hypot(white, slow)
    splits = name == "markov-27"
    for sigma, expected in (
        (np.full(6, np.nan), white if splits else whole),
        (np.zeros(6), white if splits else whole),
        (whole, white if splits else whole),
        (2.0 * whole, np.sqrt(4.0 * whole**2 - slow**2) if splits else 2.0 * whole),
        (0.5 * whole, 0.5 * white if splits else 0.5 * whole),
    ):
        r = compared(m, model, fix, 0.0, sigma)[2]
        np.testing.assert_allclose(np.sqrt(r), expected, rtol=1e-12)


def test_metres_between_places_are_those_of_the_ellipsoid(flown):
    m, model = a_filter(flown)
    turning(m, NAV)
    fix = antenna(NAV, 0.0)
    fix[:2] += [2e-5, -3e-5]
    _, nu, _ = compared(m, model, fix, 0.0)
    np.testing.assert_allclose(nu[:3], metres(*antenna(NAV, 0.0)[:3], *fix[:3]), atol=1e-2)
