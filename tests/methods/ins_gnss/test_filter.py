"""The INS/GNSS filter in flight: what it is told, what it makes of fixes and the barometer."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.core.errors import ConfigurationError
from sinstool.core.streams import take_rows
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel, Settings
from sinstool.methods.ins_gnss.states import FILTERS, GNSS_POSITION, GYRO_SCALE
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.navigation import LONGITUDE
from sinstool.methods.strapdown.velocity import Increments
from sinstool.simulation.gnss import GnssErrors, GnssFaults
from tests.methods.ins_gnss.flown import IMU, Flown, for_grade, joined

PRECISE = GnssErrors((0.01,) * 3, velocity_white=(0.003,) * 3)
PRECISE_MODEL = GnssModel((0.01,) * 3, (1e-3,) * 3, 100.0, (0.003,) * 3, (1e-4,) * 3)
NO_GATE = DivergenceControl(gate_probability=1.0)


@pytest.fixture(scope="module")
def flown():
    return Flown()


def nav_of(blocks):
    parts = [b.updates for b in blocks]
    names = ("latitude", "longitude", "height", "velocity_n", "q_nb", "omega_ib_b", "correction")
    names += ("specific_force_b", "covariance_attitude_n", "covariance_position_n")
    return {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}


# --- everyday -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_finds_its_way_and_knows_how_well(flown, name):
    settings = flown.using(name)
    if GYRO_SCALE in settings.kind.blocks:
        settings = replace(settings, imu=replace(settings.imu, gyro_scale=1e-4))
    run, blocks = flown.run(settings, store=True)
    rms = flown.rms(blocks)
    assert rms[:2].max() < 1.0
    assert rms[2] < 1.2
    assert rms[3:5].max() < 0.06
    assert rms[5] < 0.15
    assert rms[6:8].max() < 3e-4
    assert rms[8] < 2e-3
    last = blocks[-1].updates
    sigma = np.sqrt(
        [
            np.diagonal(c[-1])
            for c in (
                last.covariance_position_n,
                last.covariance_velocity_n,
                last.covariance_attitude_n,
            )
        ]
    ).ravel()
    assert np.all(abs(flown.errors(last, 199.9)[-1]) < 4.0 * sigma)
    assert run.covariance.shape == (run.kind.size,) * 2
    assert run.covariance == pytest.approx(run.covariance.T, abs=0.0)
    assert (
        np.linalg.eigvalsh(run.covariance / np.sqrt(np.outer(*[np.diag(run.covariance)] * 2)))[0]
        > -1e-9
    )
    assert run.summary.mean_nis == pytest.approx(1.0, abs=0.15)
    assert run.summary.gyro_bias == pytest.approx(flown.gyro_bias, abs=3.0 * IMU.gyro_bias)


@pytest.mark.parametrize("size, missing", [(1, 2), (7, 2), (4096, 90)])
def test_answers_do_not_depend_on_blocks(flown, size, missing):
    """Short holes only where blocks are short: what follows longer ones is looked at."""
    settings = flown.using(
        network=HeightNetwork(5.0, 0.5),
        lever_arm_b=(2.0, 1.0, -1.0),
        gnss_latency=0.04,
        control=DivergenceControl(adaptive="sage-husa", schmidt_epsilon=0.01),
    )
    short = replace_increments(flown.increments, slice(0, 2500))
    holes = np.delete(np.arange(2500), np.arange(1200, 1200 + missing))
    stated = replace_increments(short, holes)
    _, whole = flown.run(settings, increments=stated, store=True)
    _, parts = flown.run(settings, block=size, increments=stated, store=True)
    one, many = nav_of(whole), nav_of(parts)
    for name in one:
        assert np.array_equal(one[name], many[name]), name
    assert np.array_equal(joined(whole, "nis"), joined(parts, "nis"), equal_nan=True)
    for name in ("transition", "covariance_before", "covariance_after", "correction", "nav"):
        apart = np.concatenate([getattr(b.stored, name) for b in parts])
        assert np.array_equal(getattr(whole[0].stored, name), apart), name


def replace_increments(increments, rows):
    return take_rows(increments, rows)


@pytest.mark.slow
def test_parts_left_out_are_as_if_they_were_known(flown):
    exact = replace(IMU, accel_scale=0.0)
    _, a = flown.run(flown.using("markov-24", imu=exact))
    _, b = flown.run(flown.using("markov-21"))
    for name, column in nav_of(a).items():
        assert column == pytest.approx(nav_of(b)[name], rel=1e-9, abs=1e-9), name


def test_open_and_closed_loop_agree():
    # small errors: what is of second order in them does not matter
    quiet = SensorGrade(
        angle_random_walk=1e-6, velocity_random_walk=1e-4, gyro_bias=1e-7, accel_bias=1e-4
    )
    flown = Flown(noise=quiet, duration=150.0)
    _, closed = flown.run(flown.using(imu=quiet))
    run, opened = flown.run(flown.using(imu=quiet, feedback="none"))
    a, b = nav_of(closed), nav_of(opened)
    assert np.abs(a["latitude"] - b["latitude"]).max() * 6.4e6 < 0.2
    assert a["height"] == pytest.approx(b["height"], abs=0.2)
    assert a["velocity_n"] == pytest.approx(b["velocity_n"], abs=0.02)
    assert np.any(run.estimate[:6] != 0.0)
    assert flown.rms(opened)[:3].max() < 1.2


def test_without_feedback_a_far_navigation_is_told_of():
    flown = Flown(noise=replace(IMU, gyro_bias=0.02, accel_bias=0.5), duration=150.0)
    run, _ = flown.run(flown.using("markov-21", imu=replace(IMU, gyro_bias=0.02), feedback="none"))
    assert [e.kind for e in run.events].count("far-from-gnss") == 1


def test_without_a_barometer(flown):
    run, blocks = flown.run(flown.using("network-26a"), with_baro=False)
    assert run.fell_back and run.summary.fell_back
    assert run.kind.name == "markov-24"
    assert flown.rms(blocks)[2] < 1.5
    _, plain = flown.run(flown.using("markov-24"))
    assert np.array_equal(nav_of(blocks)["height"], nav_of(plain)["height"])


# --- fixes --------------------------------------------------------------------------------


def test_lever_arm_and_latency():
    arm, latency = (3.0, 1.5, -0.5), 0.113
    flown = Flown(errors=PRECISE, rate_hz=5.0, lever_arm_b=arm, latency_s=latency)
    chosen = {"gnss": PRECISE_MODEL, "control": NO_GATE}
    _, right = flown.run(flown.using("markov-24", lever_arm_b=arm, gnss_latency=latency, **chosen))
    assert flown.rms(right)[:3].max() < 0.03
    assert flown.rms(right)[3:6].max() < 0.02
    innovation = np.concatenate([b.gnss.innovation for b in right])[200:]
    assert np.sqrt(np.mean(innovation**2, axis=0))[3:].max() < 0.02
    nis = joined(right, "nis")[200:] / 6.0
    assert nis.mean() == pytest.approx(1.0, abs=0.25)
    for wrong in ({"gnss_latency": latency}, {"lever_arm_b": arm}):
        _, off = flown.run(flown.using("markov-24", **wrong, **chosen))
        assert flown.rms(off)[:3].max() > 0.3
        assert np.nanmean(joined(off, "nis")[200:]) / 6.0 > 5.0


def test_fixes_without_some_numbers():
    faults = GnssFaults(flat=((60.0, 90.0),), without_velocity=((80.0, 120.0),))
    flown = Flown(faults=faults)
    gnss = flown.gnss
    nowhere = (gnss.time_ns - flown.flight.time_ns[0] > 130e9) & (
        gnss.time_ns - flown.flight.time_ns[0] < 140e9
    )
    missing = {
        name: np.where(nowhere, np.nan, getattr(gnss, name))
        for name in ("latitude", "longitude", "height")
    }
    gnss = replace(gnss, **missing)
    run, blocks = flown.run(gnss=gnss)
    rows = joined(blocks, "rows")
    after = (joined(blocks, "time_ns") - flown.flight.time_ns[0]) * 1e-9
    expected = np.full(len(after), 6)
    expected[(after >= 60) & (after < 90)] = 4
    expected[(after >= 80) & (after < 120)] = 3
    expected[(after >= 80) & (after < 90)] = 2
    expected[(after > 130) & (after < 140)] = 3
    assert np.array_equal(rows, expected)
    innovation = joined(blocks, "innovation")
    assert np.array_equal(np.isfinite(innovation).sum(axis=1), rows)
    assert np.array_equal(
        np.isfinite(innovation[(after > 130) & (after < 140)][0]), [False] * 3 + [True] * 3
    )
    assert flown.rms(blocks)[:3].max() < 1.5
    assert run.summary.epochs_used == len(rows)


def test_empty_fix_is_no_measurement(flown):
    gnss = flown.gnss
    nothing = np.full(len(gnss), np.nan)
    gnss = replace(
        gnss,
        latitude=nothing,
        longitude=nothing,
        height=nothing,
        velocity_n=np.full((len(gnss), 3), np.nan),
    )
    run, blocks = flown.run(gnss=gnss)
    assert run.summary.epochs_used == 0
    assert not joined(blocks, "used").any()
    assert np.isnan(run.summary.mean_nis)


def test_what_the_receiver_says_of_itself_counts(flown):
    size = np.array([0.5, 2.0, 30.0])[np.arange(len(flown.gnss)) % 3]
    sigmas = np.repeat(size[:, None], 3, axis=1)
    gnss = replace(flown.gnss, sigma_position_n=sigmas, sigma_velocity_n=0.1 * sigmas)
    believing = DivergenceControl(gate_noise_epochs=0)
    _, blocks = flown.run(flown.using("plain-15", control=believing), gnss=gnss)
    assumed = joined(blocks, "measurement_sigma")
    assert assumed[:, :3] == pytest.approx(sigmas)
    assert assumed[:, 3:] == pytest.approx(0.1 * sigmas)
    # with states for the slow part, the white one is the rest, or its share
    model = GnssModel((1.0,) * 3, (2.0,) * 3, 100.0, (0.1,) * 3, (0.2,) * 3, 100.0)
    chosen = flown.using("markov-21", gnss=model, control=believing)
    _, blocks = flown.run(chosen, gnss=gnss)
    assumed = joined(blocks, "measurement_sigma")[:, 0]
    total = np.sqrt(5.0)
    rest = np.where(size > total, np.sqrt(np.maximum(size**2 - 4.0, 0)), size / total)
    assert assumed == pytest.approx(rest)


def test_withheld_fixes_are_scored_and_not_used(flown):
    after = (flown.gnss.time_ns - flown.flight.time_ns[0]) * 1e-9
    withheld = (after > 100.0) & (after < 130.0)
    run, blocks = flown.run(withheld=withheld)
    _, without = flown.run(gnss=flown.gnss.rows(~withheld))
    a, b = nav_of(blocks), nav_of(without)
    assert np.abs(a["latitude"] - b["latitude"]).max() * 6.4e6 < 1e-3
    assert a["height"] == pytest.approx(b["height"], abs=1e-3)
    assert np.array_equal(joined(blocks, "withheld"), withheld)
    assert not (joined(blocks, "used") & withheld).any()
    assert run.summary.epochs_used == (~withheld).sum()
    nis = joined(blocks, "nis")
    assert np.isfinite(nis[withheld]).all()
    # what is unknown grows in the gap, and the score with it only as much as it should
    sigma = joined(blocks, "innovation_sigma")[withheld][:, 0]
    assert sigma[-1] > 1.7 * sigma[0]
    assert np.mean(nis[withheld] / 6.0) < 4.0


# --- the barometer ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["network-26", "network-26a"])
def test_k4_is_told_to_the_filter(name):
    flown = Flown(baro=(1.0, 0.1))
    chosen = flown.using(name, network=HeightNetwork(2.4, 0.5))
    run, blocks = flown.run(chosen)
    assert flown.rms(blocks)[2] < 0.9
    assert run.summary.mean_nis < 1.25
    assert not [e for e in run.channel_events if e.kind == "jump"]
    assert run.summary.gains == pytest.approx((1.00766706, 0.48466588, 0.072337963), rel=1e-3)


def test_k4_without_a_network_is_refused():
    network = HeightNetwork(2.4, 0.5)
    flown = Flown(duration=20.0)
    with pytest.raises(ConfigurationError, match="K4"):
        flown.run(Settings(filter="baro-24", network=network))


def baro_with(flown, change, begin, end):
    after = (flown.baro_time - flown.flight.time_ns[0]) * 1e-9
    inside = (after >= begin) & (after < end)
    heights = flown.baro_height.copy()
    heights[inside] = change(heights[inside])
    return heights


@pytest.mark.parametrize("name", ["network-26", "network-26a", "baro-24"])
@pytest.mark.parametrize("what", ["silent", "jump", "frozen", "outliers"])
def test_barometers_that_misbehave(name, what):
    flown = Flown(baro=(1.0, 0.1))
    change, end = {
        "silent": (lambda h: h * np.nan, 130.0),
        "jump": (lambda h: h + 40.0, np.inf),
        "frozen": (lambda h: h * 0.0 + h[0], 150.0),
        "outliers": (lambda h: h + 100.0 * (np.arange(len(h)) % 7 == 3), np.inf),
    }[what]
    heights = baro_with(flown, change, 80.0, end)
    run, blocks = flown.run(flown.using(name), baro_height=heights)
    e = flown.errors(blocks[0].updates, 60.0)
    assert abs(e[:, 2]).max() < (3.0 if what != "frozen" else 6.0)
    # afterwards it is as if nothing had been
    late = flown.errors(blocks[0].updates, 185.0)
    assert np.sqrt(np.mean(late[:, 2] ** 2)) < 1.5
    assert run.summary.epochs_gated < 5
    kinds = [event.kind for event in run.events]
    if what == "jump":
        assert "baro-jump" in kinds
        assert run.summary.channel.offset == pytest.approx(-40.0, abs=2.0)
    if what == "silent" and name != "baro-24":
        assert "re-engaged" in [event.kind for event in run.channel_events]


def test_fast_barometer_acts_as_a_slow_one():
    # 50 Hz samples are gathered within a substep, 10 Hz ones act one by one
    flown = Flown(baro=(2.0, 0.0), duration=120.0)
    imu = flown.flight.imu.time_ns
    heights = (
        np.interp(
            imu[1:],
            flown.baro_time,
            flown.baro_height - np.interp(flown.baro_time, imu, flown.flight.height),
        )
        + flown.flight.height[1:]
    )
    settings = flown.using("network-26")
    fast, a = flown.run(settings, baro_time=imu[1:], baro_height=heights)
    slow, b = flown.run(settings, baro_time=imu[5::5], baro_height=heights[4::5])
    fine, c = flown.run(replace(settings, substep=0.02), baro_time=imu[1:], baro_height=heights)
    for blocks in (a, b):
        assert nav_of(blocks)["height"][50:] == pytest.approx(nav_of(c)["height"][50:], abs=0.1)
    for run in (fast, slow):
        sigma = np.sqrt(np.diag(run.covariance)) / np.sqrt(np.diag(fine.covariance))
        assert sigma == pytest.approx(np.ones(26), abs=0.05)


# --- faults -------------------------------------------------------------------------------


def test_gate_and_restart():
    flown = Flown()
    after = (flown.gnss.time_ns - flown.flight.time_ns[0]) * 1e-9
    moved = replace(flown.gnss, latitude=flown.gnss.latitude + (after > 100.0) * 100.0 / 6.37e6)
    control = DivergenceControl(restart_after=20)
    run, blocks = flown.run(flown.using(control=control), gnss=moved)
    gated, restarted = joined(blocks, "gated"), joined(blocks, "restarted")
    assert gated.sum() == 20
    assert restarted.sum() == run.summary.restarts == 1
    assert after[restarted][0] == pytest.approx(120.0, abs=1.0)
    assert [e.kind for e in run.events if e.kind in ("gated", "restart")] == ["gated"] * 20 + [
        "restart"
    ]
    # before, the fixes are not believed; after, they are
    assert abs(flown.errors(blocks[0].updates, 100.0, 119.0)[:, 0]).max() < 4.0
    assert flown.errors(blocks[0].updates, 140.0)[:, 0].mean() == pytest.approx(100.0, abs=2.0)
    locked, _ = flown.run(flown.using(control=DivergenceControl(restart_after=0)), gnss=moved)
    assert locked.summary.epochs_gated == (after > 100.0).sum()


@pytest.mark.parametrize("wrong", ["both", "position"])
def test_restart_where_positions_and_velocities_are_epochs_of_their_own(wrong):
    flown = Flown()
    fixes = flown.gnss
    seconds = (fixes.time_ns - flown.flight.time_ns[0]) * 1e-9
    nothing = np.full_like(fixes.latitude, np.nan)
    order = np.argsort(np.concatenate([fixes.time_ns, fixes.time_ns + 1_000_000]))

    def both(position, velocity):
        return np.concatenate([position, velocity])[order]

    stamps = both(fixes.time_ns, fixes.time_ns + 1_000_000)
    apart = replace(
        fixes,
        time_ns=stamps,
        log_time_ns=stamps,
        latitude=both(fixes.latitude, nothing),
        longitude=both(fixes.longitude, nothing),
        height=both(fixes.height, nothing),
        velocity_n=both(np.full((len(fixes), 3), np.nan), fixes.velocity_n),
        sigma_position_n=np.full((len(stamps), 3), np.nan),
        sigma_velocity_n=np.full((len(stamps), 3), np.nan),
    )
    # In an outage something happens that the noise of the IMU does not explain
    stated = flown.increments
    t = (stated.time_ns - flown.flight.time_ns[0]) * 1e-9
    kick = np.zeros((len(t), 3))
    kick[np.searchsorted(t, 100.0)] = (8.0, 0.0, 0.0)
    if wrong == "position":
        # and goes by again: positions are off alone
        kick[np.searchsorted(t, 109.0)] = (-8.0, 0.0, 0.0)
    run, blocks = flown.run(
        flown.using(control=DivergenceControl(restart_after=20)),
        gnss=apart,
        increments=replace(stated, velocity_increment=stated.velocity_increment + kick),
        withheld=both((seconds > 98.0) & (seconds < 110.0), (seconds > 98.0) & (seconds < 110.0)),
    )
    updates = blocks[0].updates
    assert np.abs(flown.errors(updates, 109.0, 109.9)[:, :2]).max() > 40.0
    assert run.summary.restarts == 1
    end = np.sqrt(np.mean(flown.errors(updates, 160.0) ** 2, axis=0))
    assert end[:3].max() < 2.0 and end[3:6].max() < 0.2


@pytest.mark.parametrize(("off", "used"), [(0.0, True), (500.0, False)])
def test_after_an_outage_fixes_are_believed_rather_than_the_imu(off, used):
    """But for fixes that no IMU of this grade can be so far off."""
    flown = Flown()
    seconds = (flown.gnss.time_ns - flown.flight.time_ns[0]) * 1e-9
    remaining = (seconds < 100.0) | (seconds > 115.0)
    gnss, seconds = flown.gnss.rows(remaining), seconds[remaining]
    first = np.searchsorted(seconds, 115.0)
    gnss.latitude[first] += off / 6.37e6
    stated = flown.increments
    t = (stated.time_ns - flown.flight.time_ns[0]) * 1e-9
    pull = np.zeros((len(t), 3))
    pull[(t > 100.0) & (t < 115.0), 0] = 0.1 * stated.interval[0]  # 0.1 m/s^2 that are not noise
    _, blocks = flown.run(
        gnss=gnss,
        increments=replace(stated, velocity_increment=stated.velocity_increment + pull),
    )
    assert joined(blocks, "used")[first : first + 15].tolist() == [used] + [True] * 14
    # those that agree are turned down by the usual gate elsewhere
    assert joined(blocks, "nis")[first + 1 : first + 9].max() > 2.0 * 27.86
    assert np.abs(flown.errors(blocks[0].updates, 125.0, 130.0)[:, :2]).max() < 4.0


def test_imu_gaps():
    flown = Flown()
    begin = 5000
    for length, kind in ((3.0, "imu-gap"), (8.0, "imu-gap-restart")):
        missing = np.arange(begin, begin + round(length * 50))
        stated = replace_increments(
            flown.increments, np.delete(np.arange(len(flown.increments.interval)), missing)
        )
        run, blocks = flown.run(increments=stated)
        event = next(e for e in run.events if e.kind.startswith("imu-gap"))
        assert event.kind == kind
        assert event.size == pytest.approx(length)
        u = blocks[0].updates
        before, just_after = u.covariance_attitude_n[begin - 1], u.covariance_attitude_n[begin + 20]
        assert np.trace(just_after) > 10.0 * np.trace(before)
        error = flown.errors(u)[begin + 20]
        sigma = np.sqrt(np.diagonal(u.covariance_attitude_n[begin + 20]))
        assert np.all(abs(error[6:]) < 4.0 * sigma)
        # the flight goes on, and attitude comes back with it
        end = flown.errors(u, 190.0)
        assert np.sqrt(np.mean(end[:, :3] ** 2)) < 2.0
        assert abs(end[:, 6:]).max() < (0.02 if length < 5 else 0.2)


@pytest.mark.parametrize("rate", [4.0, 20.0, 200.0])
@pytest.mark.parametrize("turned", [0.0, np.pi / 2, np.pi])
def test_turning_costs_certainty_as_scale_factors_do(rate, turned):
    """The same however many samples a substep of 0.25 s has; at rest nothing."""
    flown = Flown()
    n, step = round(4.0 * rate), 1.0 / rate
    first = int(flown.flight.time_ns[0])
    turning = Increments(
        np.arange(1, n + 1),
        first + np.round(np.arange(1, n + 1) * step * 1e9).astype(np.int64),
        np.full(n, step),
        np.tile([0.0, 0.0, turned / n], (n, 1)),
        np.tile([0.0, 0.0, -9.8 * step], (n, 1)),
    )
    none = flown.gnss.rows(np.zeros(len(flown.gnss), bool))
    variance = []
    for scale in (0.0, 1e-2):
        chosen = flown.using("markov-21", imu=replace(IMU, gyro_scale=scale))
        _, blocks = flown.run(chosen, increments=turning, gnss=none, with_baro=False)
        variance.append(np.diag(blocks[-1].updates.covariance_attitude_n[-1]))
    # a right angle's worth after a right angle, and then with the root of the angle
    expected = 1e-4 * (np.pi / 2) * turned
    assert variance[1] - variance[0] == pytest.approx(np.full(3, expected), rel=2e-3, abs=1e-15)


# --- for a smoother -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["network-26a", "baro-24", "plain-15"])
def test_stored_rows_fit_together(flown, name):
    run, blocks = flown.run(flown.using(name), store=True)
    s = blocks[0].stored
    u = blocks[0].updates
    assert np.array_equal(s.time_ns, u.time_ns[s.update])
    assert s.nav[:, 2] == pytest.approx(u.height[s.update], abs=1e-9)
    assert not s.restart[2:].any()
    n = run.kind.size
    scale = np.sqrt(np.diagonal(s.covariance_before[1:], axis1=1, axis2=2))
    added = s.covariance_before[1:] - s.transition[1:] @ s.covariance_after[:-1] @ np.swapaxes(
        s.transition[1:], 1, 2
    )
    added /= scale[:, :, None] * scale[:, None, :]
    assert np.linalg.eigvalsh(added).min() > -1e-8  # it is noise
    assert np.all(np.trace(added, axis1=1, axis2=2) > 0.0)
    lost = s.covariance_before - s.covariance_after
    first = s.covariance_before[:, range(n), range(n)]
    assert np.all(lost[:, range(n), range(n)] >= -1e-9 * first)
    # with feedback nothing is left but the errors of the fixes
    gnss = run.kind.first(GNSS_POSITION)
    fed = gnss if gnss >= 0 else n
    assert np.all(s.estimate[:, :fed] == 0.0)
    moved = s.correction[2:, 3:6]
    k = s.update[2:]
    jump = u.velocity_n[k] - 2 * u.velocity_n[k - 1] + u.velocity_n[k - 2]
    big = abs(moved) > 0.05
    assert np.corrcoef(jump[big], -moved[big])[0, 1] > 0.9 or not big.any()


def test_settings():
    for wrong in (
        {"filter": "network-27"},
        {"substep": 0.0},
        {"max_gap": -1.0},
        {"lever_arm_b": (np.nan, 0.0, 0.0)},
    ):
        with pytest.raises(ConfigurationError):
            Settings(**wrong)
    with pytest.raises(ConfigurationError):
        GnssModel(position_white=(0.0, 1.0, 1.0))
    with pytest.raises(ConfigurationError):
        SensorGrade(angle_random_walk=-1.0, velocity_random_walk=0.0, gyro_bias=0.0, accel_bias=0.0)
    sizes = {grade: for_grade(grade).imu.gyro_bias for grade in ("mems", "tactical", "navigation")}
    assert sizes["mems"] > sizes["tactical"] > sizes["navigation"]
    assert for_grade("mems", filter="plain-15").kind.size == 15


def test_specific_force_and_rate_are_those_of_the_middle_of_an_update():
    """The increment is in the axes that the update begins with; a turn of half of it is between."""
    quiet = SensorGrade(
        angle_random_walk=1e-7, velocity_random_walk=1e-6, gyro_bias=1e-8, accel_bias=1e-5
    )
    flown = Flown(noise=quiet)
    _, blocks = flown.run(flown.using(imu=quiet))
    made, imu = nav_of(blocks), flown.flight.imu
    rows = slice(1, 1 + len(made["specific_force_b"]))
    turning = np.linalg.norm(imu.gyro_mean_rate[rows], axis=1) > 0.1
    assert np.count_nonzero(turning) > 1000
    force = (made["specific_force_b"] - imu.mean_specific_force[rows])[turning]
    # The other way round it would be off by an update's turn times gravity, 0.02 m/s^2 and more
    assert np.sqrt(np.mean(force**2)) < 2e-3
    rate = (made["omega_ib_b"] - imu.gyro_mean_rate[rows])[turning]
    assert np.sqrt(np.mean(rate**2)) < 1e-4


def test_a_bridged_gap_has_a_row_on_either_side():
    """Between two rows a smoother's corrections are linear; across a gap they are not."""
    flown, begin, length = Flown(), 5003, 0.4
    missing = np.arange(begin, begin + round(length * 50))
    everything = np.arange(len(flown.increments.interval))
    stated = replace_increments(flown.increments, np.delete(everything, missing))
    _, (block, *_) = flown.run(flown.using("markov-21"), increments=stated, store=True)
    ends = flown.increments.time_ns[[begin - 1, missing[-1]]]
    rows = np.isin(block.stored.time_ns, ends)
    assert np.count_nonzero(rows) == 2
    # Both lie between the update before and the one after
    assert np.all(block.stored.update[rows] == begin)


def test_after_a_long_gap_hardly_anything_is_known():
    """Each variance grows by what the vehicle may have done, and by nothing more."""
    flown, begin, length = Flown(), 5000, 8.0
    missing = np.arange(begin, begin + round(length * 50))
    everything = np.arange(len(flown.increments.interval))
    stated = replace_increments(flown.increments, np.delete(everything, missing))
    # no fix after the gap, which would tell more at once
    early = flown.gnss.time_ns < flown.increments.time_ns[begin - 1]
    settings = replace(flown.using("markov-21"), gap_tilt_rate=0.2)
    _, blocks = flown.run(settings, increments=stated, gnss=flown.gnss.rows(early))
    u = blocks[0].updates
    before, after = begin - 1, begin
    velocity = np.diagonal(u.covariance_velocity_n[after] - u.covariance_velocity_n[before])
    speed2 = float(np.sum(u.velocity_n[before] ** 2))
    grown = speed2 + settings.gap_acceleration**2 * length
    assert velocity == pytest.approx(np.full(3, grown), rel=0.05)
    assert velocity - speed2 == pytest.approx(np.full(3, grown - speed2), rel=0.1)
    position = np.diagonal(u.covariance_position_n[after] - u.covariance_position_n[before])
    assert position == pytest.approx(np.full(3, grown * length**2), rel=0.05)
    attitude = np.diagonal(u.covariance_attitude_n[after] - u.covariance_attitude_n[before])
    tilted, turned = (rate**2 * length for rate in (settings.gap_tilt_rate, settings.gap_rate))
    kept_on = min((settings.gap_rate * length) ** 2, np.pi**2 / 3.0)
    assert attitude == pytest.approx([tilted, tilted, turned + kept_on], rel=0.05)


# --- what errors of the sensors do --------------------------------------------------------

SENSORS = (
    "gyro_bias", "accel_bias", "gyro_scale", "accel_scale", "gyro_misalignment",
    "accel_misalignment",
)  # fmt: skip
# Of whole substeps of 13 updates, the shortest that are .25 s: output has the covariance of the
# latest one
WHOLE_SUBSTEPS = 116 * 13


def with_error(stated, name, axis, size):
    """Increments of a sensor with one error more.

    Six of misalignment: by the first three a sensor feels what is along the next axis.
    """
    turned, pushed = stated.rotation_vector.copy(), stated.velocity_increment.copy()
    values = turned if name.startswith("gyro") else pushed
    if name.endswith("misalignment"):
        values[:, axis % 3] += size * values[:, (axis + 1 + axis // 3) % 3]
    else:
        values[:, axis] += size * (stated.interval if name.endswith("bias") else values[:, axis])
    return replace(stated, rotation_vector=turned, velocity_increment=pushed)


def flying(flown):
    """Increments of the flight's first 30 s."""
    return replace_increments(flown.increments, slice(0, WHOLE_SUBSTEPS))


def tumbling(flown):
    """Increments of a body that turns about no axis of its own, pushed along none of them."""
    stated = flying(flown)
    interval = stated.interval[:, None]
    return replace(
        stated,
        rotation_vector=interval * np.array([0.12, -0.1, 0.15]),
        velocity_increment=interval * np.array([6.0, -5.0, -7.0]),
    )


@pytest.mark.parametrize("motion", [flying, tumbling])
@pytest.mark.parametrize("name", SENSORS)
def test_each_error_of_a_sensor_spreads_as_the_navigation_with_it_does(name, motion):
    """Vary one sigma: the covariance against differences of whole navigations."""
    flown = Flown()
    stated = motion(flown)
    none = flown.gnss.rows(np.zeros(len(flown.gnss), bool))
    sizes = dict(zip(SENSORS, (1e-5, 1e-3, 1e-4, 1e-4, 1e-4, 1e-4), strict=True))
    quiet = {"angle_random_walk": 1e-12, "velocity_random_walk": 1e-12, "bias_time_s": 1e9}
    quiet |= {other: 1e-3 * sizes[other] for other in SENSORS}
    sharp = replace(
        flown.start,
        covariance_position_n=1e-12 * np.eye(3),
        covariance_velocity_n=1e-16 * np.eye(3),
        covariance_attitude_n=1e-20 * np.eye(3),
    )

    def navigated(increments, **noise):
        chosen = flown.using("markov-27", imu=SensorGrade(**{**quiet, **noise}))
        more = {"increments": increments, "gnss": none, "with_baro": False, "start": sharp}
        return flown.run(chosen, **more)[1][-1].updates

    made, least = navigated(stated, **{name: sizes[name]}), navigated(stated)
    meridian, transverse = earth.radii_of_curvature(made.latitude[-1])
    count = 6 if name.endswith("misalignment") else 3
    moved = np.empty((9, count))
    for axis in range(count):
        low, high = (navigated(with_error(stated, name, axis, s * sizes[name])) for s in (-1, 1))
        moved[:, axis] = 0.5 * np.concatenate(
            [
                [
                    (high.latitude - low.latitude)[-1] * (meridian + made.height[-1]),
                    (high.longitude - low.longitude)[-1]
                    * (transverse + made.height[-1])
                    * np.cos(made.latitude[-1]),
                    (low.height - high.height)[-1],
                ],
                (high.velocity_n - low.velocity_n)[-1],
                # psi: what turns the computed axes into the true ones
                rotation.log(rotation.multiply(low.q_nb[-1], rotation.conjugate(high.q_nb[-1]))),
            ]
        )
    expected = moved @ moved.T
    for part, rows in (
        ("position", slice(0, 3)),
        ("velocity", slice(3, 6)),
        ("attitude", slice(6, 9)),
    ):
        covariance, before = (getattr(m, f"covariance_{part}_n")[-1] for m in (made, least))
        covariance = covariance - before
        own = expected[rows, rows]
        scale = np.sqrt(np.outer(np.diag(own), np.diag(own)))
        np.testing.assert_allclose(covariance / scale, own / scale, atol=0.08, err_msg=part)


@pytest.mark.parametrize("east", [True, False])
def test_a_long_gap_across_the_antimeridian(east):
    """The Earth is round: the same flight elsewhere has the same longitudes, but for an offset."""
    flown, length = Flown(), 8.0
    speed = flown.flight.velocity_n[:, 1]
    begin = int(np.argmax(speed[1000:8000]) if east else np.argmin(speed[1000:8000])) + 1000
    missing = np.arange(begin, begin + round(length * 50))
    everything = np.arange(len(flown.increments.interval))
    stated = replace_increments(flown.increments, np.delete(everything, missing))
    none = flown.gnss.rows(np.zeros(len(flown.gnss), bool))

    def longitudes(offset):
        nav = flown.start.nav.copy()
        nav[LONGITUDE] = offset
        there = replace(flown.start, nav=nav)
        more = {"increments": stated, "gnss": none, "with_baro": False, "start": there}
        return flown.run(flown.using("markov-21"), **more)[1][0].updates.longitude

    here = longitudes(0.0)
    edge = np.pi if east else -np.pi
    there = longitudes(edge - 0.5 * (here[begin - 1] + here[begin]))
    assert (here[begin] > here[begin - 1]) == east
    assert np.all((there > -np.pi) & (there <= np.pi))
    assert np.sign(there[begin - 1]) == np.sign(edge) == -np.sign(there[begin])
    apart = there - here - (there - here)[0]
    np.testing.assert_allclose(
        apart - 2.0 * np.pi * np.round(apart / (2.0 * np.pi)), 0.0, atol=1e-12
    )
