"""What a filter forgets where it begins anew, and what it takes for lost."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.rotation import to_dcm
from sinstool.core.streams import take_rows
from sinstool.methods.ins_gnss import baro, instants
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import DivergenceControl
from sinstool.methods.ins_gnss.states import (
    ACCEL_BIAS,
    ACCEL_SCALE,
    ATTITUDE,
    AXES_PAIRS,
    CORRECTION,
    GNSS_POSITION,
    GYRO_BIAS,
    GYRO_SCALE,
    POSITION,
    VELOCITY,
)
from sinstool.methods.strapdown.velocity import Increments
from tests.methods.ins_gnss.flown import Flown


@pytest.fixture(scope="module")
def flown():
    return Flown(duration=60.0)


def begun(flown, since, **control):
    """A filter that has gone astray, begun anew so many seconds after the last time."""
    settings = flown.using(control=DivergenceControl(**control))
    run = InsGnssFilter(flown.start, settings, with_baro=True)
    m, n = run._memory, run.kind.size
    random = np.random.default_rng(1)
    m.p[:n, :n] = 1e3 * np.eye(n)
    m.x[:n] = random.standard_normal(n)
    m.ratio[:], m.latest[:], m.streak[:], m.far_share[:] = 7.0, 1.0, 5.0, 0.5
    m.now, m.restart_at, m.doubt = 100.0, 100.0 - since, 2.0
    before = m.x[:n].copy()
    instants.begin_anew(m, run._model)
    return run, before


@pytest.mark.parametrize("escalate", [True, False])
@pytest.mark.parametrize("since", [1.0, 1e6])
def test_beginning_anew(flown, since, escalate):
    run, before = begun(flown, since, escalate=escalate)
    m, n = run._memory, run.kind.size
    expected = InsGnssFilter(flown.start, run.settings, with_baro=True).covariance
    lately = since == 1.0 and escalate
    if lately:
        for block, sigma in (
            (VELOCITY, 20.0),
            (ATTITUDE, np.deg2rad(10.0)),
            (GYRO_BIAS, np.deg2rad(100.0) / 3600.0),
            (ACCEL_BIAS, 0.02 * 9.80665),
        ):
            rows = run.kind.first(block) + np.arange(3)
            expected[rows, rows] += sigma**2
    np.testing.assert_allclose(m.p[:n, :n], expected, rtol=1e-12)
    assert m.doubt == (8.0 if lately else 2.0)
    first = run.kind.first(GNSS_POSITION)
    before[first : first + 6] = 0.0
    np.testing.assert_array_equal(m.x[:n], before)
    assert np.all(m.ratio == 1.0) and np.isnan(m.latest).all()
    assert not m.streak.any() and not m.far_share.any()
    assert m.restarts == 1.0 and m.restart_at == 100.0


def test_doubt_has_an_end(flown):
    run, _ = begun(flown, 1.0)
    for _ in range(9):
        instants.begin_anew(run._memory, run._model)
    assert run._memory.doubt == 1024.0


@pytest.mark.parametrize("apart", [1.0, 1e6])
def test_jumps_of_a_barometer_after_each_other_leave_the_height_in_doubt(flown, apart):
    """By the gate, and by what a network of such a time constant makes of it."""
    settings = flown.using()
    tau = settings.network.tau
    run = InsGnssFilter(flown.start, settings, with_baro=True)
    m, model = run._memory, run._model
    m.now, m.jump_at, m.distrust = 1e7, 1e7 - apart, -np.inf
    before = run.covariance
    baro.after_jump(m, model)
    expected = before.copy()
    if apart == 1.0:
        gate = model.channel_gate
        for block, axis, sigma in (
            (POSITION, 2, gate), (VELOCITY, 2, gate / tau), (CORRECTION, 0, gate / tau**2)
        ):  # fmt: skip
            row = run.kind.first(block) + axis
            expected[row, row] += sigma**2
    np.testing.assert_allclose(run.covariance, expected, rtol=1e-12)
    assert m.jump_at == m.now
    assert np.isfinite(m.distrust) == (apart == 1.0)


def test_a_gap_adds_what_a_vehicle_can_have_done_in_it(flown):
    """Beside the same filter that is in no gap: forces and turns that last for a while."""
    settings = replace(
        flown.using("plain-15"), gap_acceleration=3.0, gap_tilt_rate=0.6, gap_rate=0.4
    )
    after = []
    for in_gap in (0.0, 1.0):
        run = InsGnssFilter(flown.start, settings, with_baro=False)
        m = run._memory
        instants.begin_substep(m)
        m.mean_c[:] = 0.1 * np.eye(3)
        m.now, m.in_gap = m.now + 0.1, in_gap
        instants.close_substep(m, run._model)
        after.append(run.covariance)
    more = np.zeros((15, 15))
    for block, density in ((VELOCITY, 3.0), (ATTITUDE, np.array([0.6, 0.6, 0.4]))):
        rows = block + np.arange(3)
        more[rows, rows] = density**2 * instants.GAP_TIME * 0.1
    np.testing.assert_allclose(after[1] - after[0], more, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("tilt", [0.05, 0.5])
def test_a_large_tilt_after_a_gap_makes_the_vertical_velocity_uncertain(flown, tilt):
    """By g (1 - cos tilt), which no linear filter knows; here by draws of the tilt itself."""
    run = InsGnssFilter(flown.start, flown.using("plain-15"), with_baro=False)
    m = run._memory
    instants.begin_substep(m)
    m.p[:] = 0.0
    m.p[ATTITUDE, ATTITUDE] = m.p[ATTITUDE + 1, ATTITUDE + 1] = tilt**2
    m.mean_c[:] = 0.1 * np.eye(3)
    m.now, m.leaning = m.now + 0.1, 1.0
    instants.close_substep(m, run._model)
    down = m.p[VELOCITY + 2, VELOCITY + 2]
    random = np.random.default_rng(2)
    lost = 9.80665 * 0.5 * np.sum((tilt * random.standard_normal((100_000, 2))) ** 2, axis=1)
    expected = np.mean(lost**2) * instants.GAP_TIME * 0.1
    assert down == pytest.approx(expected, rel=0.05) if tilt > 0.1 else down < 0.1 * expected


def test_sigmas_admit_how_far_off_fixes_in_a_row_are(flown):
    long = Flown(duration=130.0)
    gnss = long.gnss
    t = (gnss.time_ns - long.flight.time_ns[0]) * 1e-9
    jumps = (t > 80.0) & (t < 90.0)
    gnss = replace(
        gnss,
        latitude=gnss.latitude + jumps * 60.0 / 6.37e6,
        longitude=gnss.longitude - jumps * 90.0 / (6.37e6 * np.cos(gnss.latitude)),
        height=gnss.height - jumps * 70.0,
        velocity_n=gnss.velocity_n + jumps[:, None] * [4.0, -5.0, 6.0],
    )
    _, (block,) = long.run(gnss=gnss)
    rejected = np.flatnonzero(block.gnss.gated & jumps)
    assert len(rejected) == jumps.sum()
    updates = block.updates
    for row in rejected[1:]:  # a single one may be an outlier
        k = np.searchsorted(updates.time_ns, block.gnss.time_ns[row])
        off = np.abs(block.gnss.innovation[row])
        for covariance, size in (
            (updates.covariance_position_n[k], off[:3]),
            (updates.covariance_velocity_n[k], off[3:]),
        ):
            sigma = np.sqrt(np.diag(covariance))
            assert np.all(size < sigma) and np.all(sigma < 1.3 * size + 1.0)
        clear = updates.covariance_position_n[k]
        assert abs(clear[0, 1]) < 0.1 * np.sqrt(clear[0, 0] * clear[1, 1])


def test_scale_factors_of_gyros_and_accelerometers_are_found(flown):
    """Each where the summary says that it is."""
    gyro, accel = np.array([4e-3, -3e-3, 5e-3]), np.array([-3e-3, 4e-3, 5e-3])
    long = Flown(duration=200.0)
    stated = long.increments
    stated = replace(
        stated,
        rotation_vector=stated.rotation_vector * (1.0 + gyro),
        velocity_increment=stated.velocity_increment * (1.0 + accel),
    )
    imu = replace(long.settings.imu, gyro_scale=5e-3, accel_scale=5e-3)
    run, _ = long.run(long.using("markov-27", imu=imu), increments=stated)
    sigma = np.sqrt(np.diag(run.covariance))
    for name, found, true in (
        ("gyro", run.summary.gyro_scale, gyro),
        ("accel", run.summary.accel_scale, accel + long.scale),
    ):
        first = run.kind.first(GYRO_SCALE if name == "gyro" else ACCEL_SCALE)
        assert np.all(np.abs(found - true) < 3.5 * sigma[first : first + 3])
        # of each sensor two axes show in such a flight
        assert np.sort(sigma[first : first + 3])[1] < 2e-3


def test_sensor_errors_are_taken_off_as_they_came_in(flown):
    """All different, and biases and scales large: the way is that of the true increments."""
    gyro, accel = np.array([2e-3, -3e-3, 4e-3]), np.array([0.3, 0.5, -0.4])
    gyro_scale, accel_scale = np.array([0.05, -0.07, 0.09]), np.array([-0.11, 0.13, 0.16])
    true = take_rows(flown.increments, slice(0, 100))
    step = true.interval[:, None]
    stated = replace(
        true,
        rotation_vector=true.rotation_vector * (1.0 + gyro_scale) + gyro * step,
        velocity_increment=true.velocity_increment * (1.0 + accel_scale) + accel * step,
    )
    axes = 1e-4 * np.array([1.0, -2.0, 3.0, 1.5, -2.5, 0.5])
    turned, pushed = true.rotation_vector.copy(), true.velocity_increment.copy()
    for k, (axis, other) in enumerate(AXES_PAIRS):
        turned[:, axis] += axes[k] * true.rotation_vector[:, other]
        pushed[:, axis] -= axes[k] * true.velocity_increment[:, other]
    across = replace(true, rotation_vector=turned, velocity_increment=pushed)
    ways = []
    for increments, sensors in (
        (true, np.zeros(24)),
        (stated, np.concatenate([gyro, accel_scale, accel, gyro_scale, np.zeros(12)])),
        (across, np.concatenate([np.zeros(12), axes, -axes])),
    ):
        run = InsGnssFilter(flown.start, flown.using("markov-27"), with_baro=False, output=True)
        run._memory.sensors[:] = sensors
        updates = run.push(increments).updates
        ways.append([updates.velocity_n, updates.q_nb, updates.omega_ib_b,
                     updates.specific_force_b])  # fmt: skip
    # but for what the turn of an interval does to the force in it
    limits = (1e-2, 1e-6, 1e-9, 1e-2), (1e-5, 1e-6, 1e-6, 1e-5)
    for way, limited in zip(ways[1:], limits, strict=True):
        for one, other, limit in zip(ways[0], way, limited, strict=True):
            assert np.abs(one - other).max() < limit


def test_a_steady_turn_goes_on_through_a_gap(flown):
    """Turned by 1.5 rad within it: as if no sample had been missing."""
    count, step = 500, 0.02
    first = int(flown.flight.time_ns[0])
    stamps = first + np.round(np.arange(1, count + 1) * step * 1e9).astype(np.int64)
    turning = Increments(
        np.arange(count),
        stamps,
        np.full(count, step),
        np.tile([0.02 * step, -0.05 * step, 0.5 * step], (count, 1)),
        np.tile([1.0 * step, 8.0 * step, -9.8 * step], (count, 1)),
    )
    kept = np.r_[0:200, 350:count]
    ends = []
    for rows in (slice(None), kept):
        run = InsGnssFilter(flown.start, flown.using("markov-21"), with_baro=False)
        run.push(take_rows(turning, rows))
        ends.append(run.nav)
    away = ends[1] - ends[0]
    assert np.abs(away[:2]).max() * 6.4e6 < 0.1 and abs(away[2]) < 0.1
    assert np.abs(away[3:6]).max() < 0.02
    assert np.abs(away[6:]).max() < 1e-5


def test_lost_samples_make_attitude_and_velocity_less_certain(flown):
    """By the variances of their axes, in NED, from the update on; nothing else changes."""
    few = take_rows(flown.increments, slice(0, 400))
    lost = np.zeros((400, 6))
    lost[-1] = 1e-6 * np.array([1.0, 5.0, 20.0, 300.0, 50.0, 700.0])
    last = []
    for increments in (few, replace(few, lost=lost)):
        run = InsGnssFilter(flown.start, flown.using("markov-21"), with_baro=False, output=True)
        last.append(run.push(increments).updates)
    plain, doubted = (take_rows(updates, slice(-1, None)) for updates in last)
    np.testing.assert_array_equal(plain.q_nb, doubted.q_nb)
    c = to_dcm(last[0].q_nb[-2])  # at the start of the update
    for name, of in (
        ("covariance_attitude_n", slice(0, 3)),
        ("covariance_velocity_n", slice(3, 6)),
    ):
        more = getattr(doubted, name)[0] - getattr(plain, name)[0]
        np.testing.assert_allclose(more, c @ np.diag(lost[-1, of]) @ c.T, rtol=1e-6, atol=1e-12)
