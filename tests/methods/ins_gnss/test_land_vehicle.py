"""Constraints of a land vehicle: rows against differences, and what a filter makes of them."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.ins_gnss import instants, land_vehicle, states
from sinstool.methods.ins_gnss.constraints import STEP_NS, Constraints, LandVehicle
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import GnssModel
from sinstool.methods.strapdown.navigation import initial_state
from tests.methods.ins_gnss.flown import Flown

MOUNT = rotation.to_dcm(rotation.from_euler(np.radians([4.0, -7.0, 35.0])))


def rolling_filter(speed=np.nan):
    """A filter of a vehicle that rolls through a turn, its state set."""
    flown = Flown(duration=20.0)
    vehicle = LandVehicle(MOUNT, 1.3, 0.1, 0.1, wheel_scale=0.02)
    flags = np.ones(300, bool)
    constraints = Constraints(0, ~flags, ~flags, flags, np.full(300, speed), vehicle)
    run = InsGnssFilter(
        flown.start, flown.using("markov-27"), with_baro=False, constraints=constraints
    )
    memory, model = run._memory, run._model
    memory.nav[:] = initial_state(
        0.8, 0.2, 300.0, [11.0, 7.0, -0.6], rotation.from_euler([0.02, -0.05, 0.3])
    )
    memory.vehicle[9:] = 1.3, 0.003, 0.004, 0.02
    memory.rolling[:] = 0.01, 0.02, 0.3, 1.5, 3.0, -9.7
    return memory, model


@pytest.mark.parametrize("speed", [np.nan, 12.8])
def test_rows_are_derivatives_of_the_innovations(speed):
    memory, model = rolling_filter(speed)
    rows, _, nods = land_vehicle.rolling_rows(memory, model, speed)
    assert rows == (3 if np.isfinite(speed) else 2)
    h, nu = memory.h[:rows, : memory.n].copy(), memory.nu[:rows].copy()
    nav, vehicle, rate = memory.nav.copy(), memory.vehicle.copy(), memory.rolling.copy()
    first = int(model.where[states.I_LAND_VEHICLE])
    gyro = int(model.where[states.I_GYRO_BIAS])
    step = 1e-6
    for state in range(h.shape[1]):
        moved = []
        for sign in (1.0, -1.0):
            error = np.zeros(h.shape[1])
            error[state] = sign * step
            memory.nav[:], memory.vehicle[:], memory.rolling[:] = nav, vehicle, rate
            instants.corrected(nav, -error, memory.nav)
            instants.feed_back_vehicle(memory.vehicle, -error, first)
            bias = memory.rolling[:3]
            bias += sign * step * (np.arange(3) == state - gyro)
            land_vehicle.rolling_rows(memory, model, speed)
            moved.append(memory.nu[:rows].copy())
        slope = (moved[0] - moved[1]) / (2.0 * step)
        if state == first + states.AXLE:  # of which the pitch rate tells nothing
            assert slope[1] == pytest.approx(-nods)
            slope[1] = 0.0
        # What the mount does to rate and acceleration is left out
        left_out = first <= state < first + states.AXLE
        assert slope == pytest.approx(h[:, state], abs=0.2 if left_out else 1e-6, rel=1e-5)
    assert nu[0] != 0.0


def test_a_slow_vehicle_is_not_held():
    memory, model = rolling_filter()
    memory.nav[3:6] = 0.5, 0.1, 0.0
    assert land_vehicle.rolling_rows(memory, model, np.nan)[0] == 0


def test_the_estimate_turns_the_mount():
    vehicle = np.concatenate([np.eye(3).ravel(), [0.0, 0.0, 0.0, 0.0]])
    x = np.zeros(6)
    x[:4] = 0.02, -0.05, 0.4, 1e-3
    instants.feed_back_vehicle(vehicle, x, 0)
    expected = rotation.to_dcm(rotation.exp([0.0, 0.02, -0.05]))
    assert vehicle[:9].reshape(3, 3) == pytest.approx(expected, abs=1e-12)
    assert vehicle[9:].tolist() == [0.4, 1e-3, 0.0, 0.0]
    assert not x.any()


def standing(rests, seconds=30.0, moving=0.0, bias=(0.0, 0.0, 0.0)):
    """A filter whose IMU stands on the turning Earth, or is told so while it moves."""
    flown = Flown(duration=seconds)
    n = round(seconds * 1e9 / STEP_NS) + 2
    flags = np.full(n, rests)
    start_ns = int(flown.increments.time_ns[0]) - STEP_NS
    constraints = Constraints(start_ns, flags, ~flags, ~flags, np.full(n, np.nan), None)
    still = replace(
        flown.increments,
        rotation_vector=np.outer(flown.increments.interval, bias),
        velocity_increment=np.tile(
            [0.0, 0.0, -9.81 * flown.increments.interval[0]], (len(flown.increments.interval), 1)
        ),
    )
    nav = flown.start.nav.copy()
    nav[3:6] = moving, 0.0, 0.0
    nav[6:10] = 1.0, 0.0, 0.0, 0.0
    start = replace(flown.start, nav=nav, gyro_bias_sigma=5e-3)
    run = InsGnssFilter(start, flown.using("markov-27"), with_baro=False, constraints=constraints)
    run.push(still)
    return run


def test_rest_holds_velocity_and_shows_the_gyro_bias():
    bias = np.array([4e-3, -3e-3, 6e-3])
    run = standing(True, bias=bias)
    assert run.summary.rests > 50
    assert np.linalg.norm(run.nav[3:6]) < 0.02
    # What the gyros measure is the bias and the Earth's rate
    earth = rotation.rotate(rotation.conjugate(run.nav[6:10]), _earth_rate(run.nav[0]))
    first = run.kind.first(states.GYRO_BIAS)
    sigma = np.sqrt(np.diagonal(run.covariance)[first : first + 3])
    assert np.all(np.abs(run.summary.gyro_bias + earth - bias) < 3.0 * sigma)
    assert sigma.max() < 3e-4
    assert np.linalg.norm(standing(False).nav[3:6]) > 0.1


def test_a_filter_that_moves_denies_a_rest():
    run = standing(True, seconds=10.0, moving=20.0)
    assert run.summary.rests == 0


def _earth_rate(latitude):
    return 7.292115e-5 * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])


@pytest.mark.parametrize("by_fixes", [True, False])
def test_a_position_from_a_fix_holds_its_slow_error(by_fixes):
    """At rest a lasting error of the fixes stays unknown, however many of them there are."""
    white, slow, seconds = 2.0, 5.0, 40
    flown = Flown(duration=float(seconds))
    interval = flown.increments.interval
    n = round(seconds * 1e9 / STEP_NS) + 2
    flags = np.ones(n, bool)
    start_ns = int(flown.increments.time_ns[0]) - STEP_NS
    constraints = Constraints(start_ns, flags, flags, ~flags, np.full(n, np.nan), None)
    nav = flown.start.nav.copy()
    nav[3:10] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    start = replace(
        flown.start,
        nav=nav,
        covariance_position_n=(white**2 + slow**2) * np.eye(3),
        by_fixes=by_fixes,
    )
    still = replace(
        flown.increments,
        rotation_vector=np.zeros((len(interval), 3)),
        velocity_increment=np.outer(interval, [0.0, 0.0, -9.81]),
    )
    model = GnssModel((white,) * 3, (slow,) * 3, 1e6, (1.0,) * 3, (1e-3,) * 3)
    at = flown.gnss.rows(flown.gnss.time_ns < still.time_ns[-1])
    ones = np.ones(len(at))
    fixes = replace(
        at,
        latitude=nav[0] * ones,
        longitude=nav[1] * ones,
        height=nav[2] * ones,
        velocity_n=np.full((len(at), 3), np.nan),
        sigma_position_n=np.full((len(at), 3), np.nan),
        sigma_velocity_n=np.full((len(at), 3), np.nan),
    )
    run = InsGnssFilter(
        start, flown.using("markov-27", gnss=model), with_baro=False, constraints=constraints
    )
    run.push(still, fixes)
    assert run.summary.epochs_used > 30
    # By all fixes, and that of the start: what their mean is off by
    known = np.sqrt(slow**2 + white**2 / (run.summary.epochs_used + 1.0))
    sigma = np.sqrt(np.diagonal(run.covariance)[:2])
    if by_fixes:
        assert sigma == pytest.approx(known, rel=0.01)
    else:  # a position known otherwise, which is one more measurement
        assert np.all(sigma < 0.8 * known)
