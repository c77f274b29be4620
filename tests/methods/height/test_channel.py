"""The vertical channel in flight: responses, climbs, gaps, and barometers that misbehave."""

import numpy as np
import pytest
from scipy.signal import lfilter

from sinstool.core.rotation import from_euler
from sinstool.methods.height import layout
from sinstool.methods.height.channel import baro_sample, feedback, propagate
from sinstool.methods.height.vertical import upward_specific_force
from tests.helpers.height_network import NetworkTheory
from tests.helpers.quick import mostly_slow
from tests.methods.height.flights import CLIMBS, START, W2, Flight, accelerometer, markov, ns

RESPONSES = [(50.0, 0.03), (10.0, 0.05)]


def network(tau, k4=0.0):
    return NetworkTheory(tau, k4, W2)


def noisy(grade, seed, duration=700.0, climbs=CLIMBS, baro_rate=50.0):
    """A flight with sensors of a grade."""
    rng = np.random.default_rng(seed)
    flight = Flight(duration, climbs, baro_rate=baro_rate)
    flight.f_up = flight.f_up + accelerometer(rng, flight.t, grade)
    n = len(flight.t_baro)
    if grade == "navigation":
        flight.h_baro = flight.h_baro + markov(rng, n, 1 / baro_rate, 10.0, 500.0)
    else:
        flight.h_baro = flight.h_baro + markov(rng, n, 1 / baro_rate, 3.0, 300.0)
        flight.h_baro += 0.2 * rng.standard_normal(n)
    flight.rng = rng
    return flight


def kinds(channel):
    return [event.kind for event in channel.events]


# --- linear behaviour ---------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "bound"), RESPONSES)
@pytest.mark.parametrize(("tau", "k4"), [(2.4, 0.0), (2.4, 0.5), (10.0, 0.0)])
def test_baro_step(rate, bound, tau, k4):
    # samples just after an IMU sample: outputs at the rate are those just before the next
    flight = Flight(60 + 10 * tau, baro_rate=rate, baro_shift=0.001)
    flight.h_baro = flight.h_baro + 1.0 * (flight.t_baro > 30.0)
    out, _ = flight.run(network(tau, k4), quick_start=False)
    at = slice(3000, None, round(100 / rate))
    exact = network(tau, k4).step_response("baro", flight.t[at] - 30.0)
    assert abs(out["height"][at] - START - exact[:, 0]).max() < bound
    assert abs(out["v_up"][at] - exact[:, 1]).max() < bound * exact[:, 1].max()
    assert abs(out["correction"][at] - exact[:, 2]).max() < bound * abs(exact[:, 2]).max() * 2.5


@pytest.mark.parametrize(("rate", "bound"), RESPONSES)
@pytest.mark.parametrize(("tau", "k4"), [(2.4, 0.0), (2.4, 0.5), (10.0, 0.0)])
def test_accelerometer_bias(rate, bound, tau, k4):
    flight = Flight(30 + 20 * tau, baro_rate=rate)
    flight.f_up = flight.f_up + 0.2 * (flight.t >= 30.0)
    out, _ = flight.run(network(tau, k4), quick_start=False)
    # Between samples the channel runs away, at samples it comes back: the mean of both.
    at = np.arange(3000, len(flight.t), round(100 / rate))
    h, v, a = (
        0.5 * (out[name][at] + out[name][at - 1]) for name in ("height", "v_up", "correction")
    )
    since = np.maximum(flight.t[at] - 0.005 - 30.0, 0.0)
    exact = 0.2 * network(tau, k4).step_response("acceleration", since)
    assert abs(h - START - exact[:, 0]).max() < bound * exact[:, 0].max()
    assert abs(v - exact[:, 1]).max() < bound * exact[:, 1].max()
    assert abs(a - exact[:, 2]).max() < bound * 0.2
    assert out["height"][-1] == pytest.approx(START, abs=1e-4 * tau)
    assert out["correction"][-1] == pytest.approx(0.2, abs=1e-5)


CLIMB = ((30.0, 0.02, 5.0),)


@pytest.mark.parametrize(("rate", "bound"), RESPONSES)
@pytest.mark.parametrize("k4", [0.5, 0.8])
def test_climb(rate, bound, k4):
    flight = Flight(90.0, CLIMB, baro_rate=rate)
    out, _ = flight.run(network(2.4, k4), quick_start=False)
    error = out["height"] - flight.h
    exact = network(2.4, k4).climb_error(np.maximum(flight.t - 30.0, 0.0), 5.0)[:, 0]
    at = slice(3000, None, round(100 / rate))
    assert abs(error[at] - exact[at]).max() < bound * abs(exact).max()
    assert error[-1] == pytest.approx(-k4 * 5.0, abs=0.1)
    assert out["v_up"][-1] == pytest.approx(5.0, abs=0.02)


def test_climbs_leave_no_error_without_k4():
    flight = Flight(700.0, CLIMBS)
    out, channel = flight.run(network(2.4))
    assert abs(out["height"] - flight.h).max() < 0.02
    assert abs(out["v_up"] - flight.v).max() < 0.01
    assert kinds(channel) == ["engaged"]


def lagged(flight, lag):
    """What a barometer with a first-order lag gives; the truth in steps of a millisecond."""
    fine = Flight(flight.t[-1], CLIMBS, imu_rate=10.0, baro_rate=1000.0)
    r = np.exp(-0.001 / lag)
    g = 1.0 - lag / 0.001 * (1.0 - r)  # exact for straight pieces
    slow = START + lfilter([g, 1.0 - r - g], [1.0, -r], fine.h_baro - START)
    return np.interp(flight.t_baro, fine.t_baro, slow)


def test_baro_lag_is_cancelled():
    flight = Flight(400.0, CLIMBS)
    flight.h_baro = lagged(flight, 1.0)
    steady = (flight.t > 130.0) & (flight.t < 195.0)  # 5 m/s
    plain, _ = flight.run(network(2.4))
    ours, _ = flight.run(network(2.4, -1.0), baro_lag=1.0)
    assert np.mean((plain["height"] - flight.h)[steady]) == pytest.approx(-5.0, abs=0.05)
    assert abs(ours["height"] - flight.h)[steady].max() < 0.05


def test_undamped_height_runs_away():
    flight = Flight(3600.0, imu_rate=20.0)
    out, _ = flight.run(network(5.0), height=START + 1.0, reason=np.ones(180001, np.int64))
    assert 277.0 < out["height"][-1] - START < 279.0
    assert not out["valid"].any()


def test_wrong_start_settles():
    # 30 m/s and 0.3 m/s^2 that nobody knows of, through a slow network
    flight = Flight(600.0)
    flight.f_up = flight.f_up + 0.3
    out, channel = flight.run(network(100.0), "navigation", height=0.0, v_up=-30.0)
    late = flight.t > 400.0
    assert abs(out["height"] - START)[late].max() < 0.5
    assert abs(out["v_up"])[late].max() < 0.01
    assert kinds(channel) == ["engaged"]


def test_upward_specific_force():
    q = from_euler([0.3, -0.2, 1.0])
    # along the vehicle's own down axis, tilted by 0.3 and 0.2
    f = upward_specific_force(q[None], [[0.0, 0.0, -9.8]])
    assert f == pytest.approx([9.8 * np.cos(0.3) * np.cos(0.2)])


def test_mean_samples():
    flight = Flight(100.0, CLIMBS)
    _, v, _ = flight.h, flight.v, flight.a
    mean = np.concatenate([[0.0], np.diff(v) * 100.0]) + flight.f_up - flight.a
    flight.f_up = mean
    out, _ = flight.run(network(30.0), point_samples=False)
    assert abs(out["v_up"] - flight.v).max() < 1e-3
    wrong, _ = flight.run(network(30.0), point_samples=True)
    assert abs(wrong["v_up"] - flight.v).max() > 5e-3


# --- block edges --------------------------------------------------------------------------


@pytest.mark.parametrize("blocks", [1, 7, 4096])
def test_blocks_do_not_matter(blocks):
    flight = noisy("mems", 4, 130.0)
    flight.h_baro[1500] += 100.0
    flight.h_baro[2000:2300] = np.nan
    flight.h_baro[4000:] += 40.0
    flight.t_baro[[900, 901]] = flight.t_baro[[901, 900]]
    arrival = flight.t_baro + 0.03 * flight.rng.random(len(flight.t_baro))
    whole, one = flight.run(network(5.0), arrival=arrival)
    parts, many = flight.run(network(5.0), blocks=blocks, arrival=arrival)
    for name, column in whole.items():
        assert np.array_equal(column, parts[name])
    assert one.events == many.events
    assert one.summary == many.summary
    assert kinds(one) == ["engaged", "coast", "re-engaged", "jump"]


def test_push_refuses_nonsense():
    _, channel = Flight(1.0).run(network(5.0))
    with pytest.raises(ValueError, match="increase"):
        channel.push(ns([0.5]), [9.8])
    with pytest.raises(ValueError, match="finite"):
        channel.push(ns([2.0]), [np.nan])


# --- gaps ---------------------------------------------------------------------------------


def gap_errors(grade, tau, length, seeds):
    rows = []
    for seed in range(seeds):
        flight = noisy(grade, seed, 560.0, ())
        gap = (flight.t_baro > 400.0) & (flight.t_baro < 400.0 + length)
        flight.h_baro[gap] = np.nan
        out, channel = flight.run(network(tau), grade)
        h, v = out["height"] - flight.h, out["v_up"] - flight.v
        first, last = np.searchsorted(flight.t, [400.0, 399.99 + length])
        assert kinds(channel) == ["engaged", "coast", "re-engaged"]
        assert channel.summary.samples["not_finite"] == np.count_nonzero(gap)
        coast, back = channel.events[1:]
        assert coast.time == pytest.approx(402.0, abs=0.03)
        assert back.duration == pytest.approx(length - 2.0, abs=0.05)
        assert channel.summary.seconds["coast"] == pytest.approx(length - 2.0, abs=0.05)
        assert out["valid"][100:].all()
        assert abs(np.diff(out["height"][1000:])).max() < 0.2  # no step
        rows.append((h[last] - h[first], v[last], abs(v[last : last + 6000]).max()))
    rows = np.array(rows)
    return (*np.sqrt((rows[:, :2] ** 2).mean(axis=0)), rows[:, 2].mean())


@pytest.mark.parametrize(
    ("grade", "tau", "length", "bounds"),
    [
        ("navigation", 2.4, 60.0, (7.0, 0.11, 0.95)),
        ("navigation", 30.0, 60.0, (7.9, 0.14, 0.3)),
        ("navigation", 100.0, 60.0, (7.9, 0.14, 0.2)),
        ("mems", 2.4, 30.0, (10.0, 0.65, 1.0)),
        ("mems", 5.0, 40.0, (18.0, 0.85, 1.2)),
    ],
)
def test_gap(grade, tau, length, bounds):
    errors = gap_errors(grade, tau, length, 24)
    assert all(e < b for e, b in zip(errors, bounds, strict=True)), errors


def test_gap_in_a_climb_costs_nothing_with_perfect_sensors():
    flight = Flight(300.0, CLIMBS)
    flight.h_baro[(flight.t_baro > 190.0) & (flight.t_baro < 250.0)] = np.nan  # 5 to -8 m/s
    out, _ = flight.run(network(5.0))
    assert abs(out["height"] - flight.h).max() < 0.05


def test_coast_of_more_than_five_minutes_is_no_height():
    flight = Flight(700.0, baro_rate=10.0)
    flight.h_baro[(flight.t_baro > 50.0) & (flight.t_baro < 500.0)] = np.nan
    out, channel = flight.run(network(5.0))
    assert kinds(channel) == ["engaged", "coast", "invalid", "re-engaged"]
    invalid = flight.t[~out["valid"]]
    assert invalid[invalid > 1.0].min() == pytest.approx(352.0, abs=0.1)
    assert invalid.max() == pytest.approx(500.0, abs=0.3)


def test_re_engaging_wants_two_that_agree():
    flight = Flight(300.0)
    flight.h_baro[(flight.t_baro > 100.0) & (flight.t_baro < 150.0)] = np.nan
    flight.h_baro[np.searchsorted(flight.t_baro, 150.0)] += 300.0
    out, channel = flight.run(network(5.0))
    assert abs(out["height"] - START).max() < 0.05
    assert channel.summary.samples["waiting"] == 2  # at the start, and the spike


def test_start_wants_two_that_agree():
    flight = Flight(60.0)
    flight.h_baro[0] += 300.0
    out, channel = flight.run(network(5.0), height=0.0)
    assert channel.events[0].time == pytest.approx(0.04)
    assert abs(out["height"] - START)[5:].max() < 1e-3


def test_imu_gaps():
    flight = Flight(200.0, ((20.0, 5.0, 3.0),))
    keep = ~((flight.t > 60.0) & (flight.t < 62.0)) & ~((flight.t > 120.0) & (flight.t < 130.0))
    for name in ("t", "h", "v", "a", "f_up"):
        setattr(flight, name, getattr(flight, name)[keep])
    out, channel = flight.run(network(5.0))
    assert kinds(channel) == ["engaged", "imu-gap", "imu-gap", "engaged"]
    assert [e.size for e in channel.events[1:3]] == pytest.approx([2.0, 10.0])
    assert abs(out["height"] - flight.h).max() < 0.1


# --- barometers that misbehave ------------------------------------------------------------


@pytest.mark.parametrize("rate", [50.0, 10.0, 1.0])
@pytest.mark.parametrize("tau", [2.4, 5.0, 30.0, 100.0])
def test_jump(rate, tau):
    flight = Flight(400.0, CLIMBS, baro_rate=rate)
    rng = np.random.default_rng(3)
    flight.h_baro = flight.h_baro + 0.2 * rng.standard_normal(len(flight.t_baro))
    flight.h_baro[flight.t_baro >= 300.3] += 40.0
    out, channel = flight.run(network(tau))
    assert kinds(channel) == ["engaged", "jump"]
    # at 1 Hz, four seconds pass without a sample to go by
    assert channel.events[1].size == pytest.approx(40.0, abs=0.3 if rate > 1 else 0.5)
    assert channel.summary.offset == -channel.events[1].size
    late = flight.t > 100.0
    assert abs(out["height"] - flight.h)[late].max() < (0.7 if rate > 1 else 1.5)
    assert abs(out["v_up"] - flight.v)[late].max() < 0.3


def test_jump_of_a_slow_and_late_barometer_is_no_coast():
    # the fifth sample that confirms it arrives after more than five intervals without a good one
    flight = Flight(400.0, CLIMBS, baro_rate=1.0)
    flight.h_baro = flight.h_baro + 0.2 * np.random.default_rng(3).standard_normal(401)
    flight.h_baro[flight.t_baro >= 300.3] += 40.0
    _, channel = flight.run(network(5.0), arrival=flight.t_baro + 0.3)
    assert kinds(channel) == ["engaged", "jump"]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("grade", ["mems", "tactical"])
def test_a_barometer_that_comes_back_takes_the_height_back_with_it(grade, seed):
    """It is silent, believed again far below, as height may have drifted, and back later."""
    away = np.random.default_rng(seed).uniform(40.0, 60.0)
    flight, undisturbed = noisy(grade, seed), noisy(grade, seed)
    flight.h_baro[(flight.t_baro >= 300.0) & (flight.t_baro < 332.0)] -= away
    flight.h_baro[(flight.t_baro >= 298.0) & (flight.t_baro < 310.0)] = np.nan
    out, channel = flight.run(network(5.0))
    clean, _ = undisturbed.run(network(5.0))
    assert kinds(channel) == ["engaged", "coast", "re-engaged", "returned"]
    assert channel.events[-1].size == pytest.approx(away, abs=3.0)
    late = flight.t > 420.0
    assert abs(out["height"] - clean["height"])[late].max() < 3.0
    assert channel.summary.offset == 0.0


@pytest.mark.parametrize("rate", [50.0, 10.0])
@pytest.mark.parametrize("rise", mostly_slow([0.5, 1.0, 1.5, 2.0, 3.0], 0.5, 3.0))
@pytest.mark.parametrize("grade", ["mems", "tactical"])
def test_a_jump_that_takes_seconds_is_no_drift_of_the_height(grade, rise, rate):
    """No height drifts by that in the seconds without a sample that agrees: not even for once."""
    for seed in range(4):
        random = np.random.default_rng(seed)
        away = random.choice([-1.0, 1.0]) * random.uniform(40.0, 90.0)
        flight, undisturbed = (noisy(grade, seed, baro_rate=rate) for _ in range(2))
        t = flight.t_baro
        there = np.clip((t - 300.0) / rise, 0.0, 1.0) - np.clip((t - 340.0) / rise, 0.0, 1.0)
        flight.h_baro = flight.h_baro + away * there
        out, channel = flight.run(network(5.0))
        clean, _ = undisturbed.run(network(5.0))
        off = abs(out["height"] - clean["height"])
        # while the sensor begins to move, a part of it is followed
        assert off.max() < 10.0, (seed, kinds(channel))
        assert off[flight.t > 420.0].max() < 5.0
        sizes = [event.size for event in channel.events if event.kind == "jump"]
        assert sizes[0] == pytest.approx(away, abs=10.0)
        assert channel.summary.offset == pytest.approx(0.0, abs=5.0)


@pytest.mark.parametrize(
    ("grade", "tau", "most"),
    [("mems", 5.0, 5.0), ("tactical", 30.0, 20.0), ("navigation", 100.0, 8.0)],
)
@pytest.mark.parametrize("rise", mostly_slow([1.0, 2.0, 3.0], 2.0))
def test_a_slow_channel_sees_the_barometer_come_back(grade, tau, most, rise):
    """What was left of a jump widened the gate, and what came back was followed in silence."""
    for seed in range(4):
        random = np.random.default_rng(seed)
        away = random.choice([-1.0, 1.0]) * random.uniform(40.0, 90.0)
        flight, undisturbed = (noisy(grade, seed, baro_rate=10.0) for _ in range(2))
        t = flight.t_baro
        there = np.clip((t - 300.0) / rise, 0.0, 1.0) - np.clip((t - 317.0) / rise, 0.0, 1.0)
        flight.h_baro = flight.h_baro + away * there
        out, channel = flight.run(network(tau))
        clean, _ = undisturbed.run(network(tau))
        off = abs(out["height"] - clean["height"])
        assert off[flight.t > 320.0].max() < most, (seed, kinds(channel))


def test_an_absorbed_jump_that_is_taken_back_during_a_coast_leaves_nothing():
    flight, undisturbed = noisy("mems", 2), noisy("mems", 2)
    flight.h_baro[(flight.t_baro >= 300.0) & (flight.t_baro < 330.0)] -= 60.0
    flight.h_baro[(flight.t_baro >= 325.0) & (flight.t_baro < 332.0)] = np.nan
    out, channel = flight.run(network(5.0))
    clean, _ = undisturbed.run(network(5.0))
    assert kinds(channel) == ["engaged", "jump", "coast", "re-engaged"]
    assert channel.summary.offset == pytest.approx(0.0, abs=1e-9)
    assert abs(out["height"] - clean["height"])[flight.t > 420.0].max() < 3.0


def test_jump_with_sensors_that_err():
    for seed in range(4):
        flight = noisy("mems", seed)
        flight.h_baro[flight.t_baro >= 300.3] += 40.0
        out, channel = flight.run(network(5.0))
        clean, _ = noisy("mems", seed).run(network(5.0))
        assert kinds(channel) == ["engaged", "jump"]
        assert channel.events[1].size == pytest.approx(40.0, abs=0.4)
        assert abs(out["v_up"] - clean["v_up"]).max() < 0.1


@pytest.mark.parametrize(("tau", "bound"), [(2.4, 0.64), (5.0, 0.64)])
def test_spikes_and_nan(tau, bound):
    flight = noisy("mems", 1)
    bad = flight.rng.choice(np.arange(1000, len(flight.h_baro)), 90, replace=False)
    spikes, nan, low = bad[:60], bad[60:75], bad[75:]
    sign = flight.rng.choice([-1.0, 1.0], 60)
    flight.h_baro[spikes] += sign * flight.rng.uniform(30.0, 300.0, 60)
    flight.h_baro[nan] = np.nan
    flight.h_baro[low] = np.nan  # zero or negative pressures have no height
    reason = np.zeros(len(flight.h_baro), np.int64)
    reason[low] = layout.OUT_OF_RANGE
    out, channel = flight.run(network(tau), reason=reason)
    samples = channel.summary.samples
    assert (samples["gate"], samples["not_finite"], samples["out_of_range"]) == (60, 15, 15)
    assert samples["accepted"] == len(flight.h_baro) - 91  # and one waited at the start
    assert kinds(channel) == ["engaged"]
    assert abs(out["v_up"] - flight.v)[2000:].max() < bound


def test_no_false_rejects():
    for seed in range(8):
        _, channel = noisy("mems", seed).run(network(2.4))
        assert channel.summary.samples["gate"] == 0


def test_swapped_and_duplicate_stamps():
    flight = noisy("mems", 2, 200.0)
    clean, _ = flight.run(network(5.0))
    order = np.arange(len(flight.t_baro))
    for k in range(1000, 9000, 400):
        order[[k, k + 1]] = order[[k + 1, k]]
    flight.t_baro, flight.h_baro = flight.t_baro[order], flight.h_baro[order]
    copies = np.arange(1200, 9000, 300)
    flight.t_baro = np.insert(flight.t_baro, copies, flight.t_baro[copies - 1])
    flight.h_baro = np.insert(flight.h_baro, copies, flight.h_baro[copies - 1] + 50.0)
    out, channel = flight.run(network(5.0))
    assert channel.summary.samples["stamp"] == 20 + len(copies)
    assert abs(out["height"] - clean["height"]).max() < 0.05
    assert abs(out["v_up"] - clean["v_up"]).max() < 0.03


@pytest.mark.parametrize("k4", [0.0, 0.5])
def test_late_samples_are_used_at_their_stamps(k4):
    flight = Flight(300.0, CLIMBS)
    flight.t_baro = flight.t_baro + 0.0037  # between IMU samples
    flight.h_baro = Flight(300.0, CLIMBS, baro_shift=0.0037).h_baro
    on_time, _ = flight.run(network(2.4, k4))
    late, channel = flight.run(network(2.4, k4), arrival=flight.t_baro + 0.3)
    # what K4 does to an acceleration comes 0.3 s late
    bound = 0.03 if k4 == 0.0 else 0.4
    assert abs(late["height"] - on_time["height"])[200:].max() < bound
    assert channel.summary.samples["accepted"] > 14000
    # taken for new, they lag by 0.3 s
    flight.t_baro = flight.t_baro + 0.3
    wrong, _ = flight.run(network(2.4, k4))
    assert abs(wrong["height"] - on_time["height"]).max() > 2.0


def test_very_late_samples_still_hold_a_climb():
    flight = Flight(200.0, ((20.0, 5.0, 4.0),), baro_rate=2.0)
    out, _ = flight.run(network(30.0), arrival=flight.t_baro + 0.8)
    assert abs(out["height"] - flight.h)[10000:].max() < 0.1


@pytest.mark.parametrize("grade", ["mems", "navigation"])
@pytest.mark.parametrize("begin", [100.0, 180.0])  # in a climb; before it turns into a descent
@pytest.mark.parametrize("tau", [2.4, 5.0, 100.0])
def test_frozen_barometer(grade, begin, tau):
    flight = noisy(grade, 1, 300.0)
    stuck = (flight.t_baro >= begin) & (flight.t_baro < begin + 60.0)
    flight.h_baro[stuck] = flight.h_baro[stuck][0]
    out, channel = flight.run(network(tau), grade)
    listed = [e for e in channel.events if e.kind == "frozen"]
    assert len(listed) == 1
    assert listed[0].duration == pytest.approx(30.0, abs=0.05)
    assert kinds(channel)[-1] == "re-engaged"
    assert channel.summary.samples["frozen"] == pytest.approx(1500, abs=3)
    # What the frozen value did, some 100 m, is undone: as after a minute without a barometer.
    error = out["height"] - flight.h
    at = np.searchsorted(flight.t, begin)
    after = error[at + 3010 : at + 6000] - error[at]
    limit = {"navigation": 25.0, "mems": 35.0}[grade]
    if (grade, tau) != ("mems", 100.0):  # whose correction is not settled yet
        assert abs(after).max() < limit
        assert abs(error[at : at + 3000] - error[at]).max() > 2 * limit


@pytest.mark.parametrize("climbs", [(), ((30.0, 8.0, 5.0), (50.0, 8.0, 0.0))])
def test_steady_value_at_rest_is_no_frozen_barometer(climbs):
    flight = Flight(600.0, climbs)
    rng = np.random.default_rng(7)
    flight.f_up = flight.f_up + accelerometer(rng, flight.t, "mems")
    flight.h_baro = np.round(flight.h_baro * 4.0) / 4.0
    if not climbs:
        flight.f_up = flight.f_up + 0.3 * (flight.t > 100.0)
    _, channel = flight.run(network(5.0))
    assert kinds(channel) == ["engaged"]
    assert channel.summary.samples["frozen"] == 0


def test_a_sensor_that_often_keeps_its_value_is_frozen_later():
    flight = noisy("mems", 1, 300.0)
    for begin, duration in ((40.0, 10.0), (100.0, 60.0)):
        stuck = (flight.t_baro >= begin) & (flight.t_baro < begin + duration)
        flight.h_baro[stuck] = flight.h_baro[stuck][0]
    _, channel = flight.run(network(5.0))
    (frozen,) = (e for e in channel.events if e.kind == "frozen")
    assert frozen.duration == pytest.approx(50.0, abs=0.2)


# --- for a host ---------------------------------------------------------------------------


def test_feedback_moves_the_past_along():
    state, events = layout.new_state(), layout.new_events(10)
    parameters = layout.new_parameters(network(5.0), shadow=False)
    h, v = 100.0, 2.0
    for k in range(1, 101):
        h += 0.02
        dh, dv = propagate(state, parameters, events, 0.01 * k, 0.01, h, v, 0.0)
        h, v = h + dh, v + dv
        if k % 10 == 0:
            what, dh, dv = baro_sample(
                state, parameters, events, 0.01 * k, h, v, 0.01 * k, 98.0 + 0.02 * k, 0
            )
            h, v = h + dh, v + dv
    assert what == layout.CORRECTED
    feedback(state, 1.0, 3.0, 0.5, -0.1)
    assert state[layout.S_CORRECTION] == pytest.approx(-0.1)
    # a sample of 0.2 s ago that says just that
    then = 98.0 + 1.6 + 2.0 + 3.0 - 0.5 * 0.2
    h, v = h + 3.0, v + 0.5
    state[layout.S_LAST_STAMP] = state[layout.S_LAST_USED] = 0.7
    baro_sample(state, parameters, events, 1.0, h, v, 0.8, then - 2.0, 0)
    assert state[layout.S_INNOVATION] == pytest.approx(0.0, abs=1e-9)


def test_baro_bias_of_a_filter_is_taken_off():
    state, events = layout.new_state(), layout.new_events(3)
    parameters = layout.new_parameters(network(5.0), shadow=False)
    state[layout.S_BARO_BIAS] = 4.0
    for k in (1.0, 2.0):
        what, dh, _ = baro_sample(state, parameters, events, k, 50.0, 0.0, k, 57.0, 0)
    assert what == layout.RESET
    assert dh == pytest.approx(3.0)
    assert state[layout.S_L1 : layout.S_L3 + 1].tolist() == [1.0, 0.0, 0.0]


def test_late_samples_leave_the_loop_as_it_was():
    # A correction that is on its way already must not be made again by the samples before it.
    flight = Flight(70.0)
    flight.h_baro = flight.h_baro + 1.0 * (flight.t_baro > 30.0)
    on_time, _ = flight.run(network(2.4), quick_start=False)
    late, _ = flight.run(network(2.4), quick_start=False, arrival=flight.t_baro + 0.3)
    expected = on_time["height"][:-30] + 0.3 * on_time["v_up"][:-30]
    assert abs(late["height"][30:] - expected).max() < 0.02


def test_jump_that_a_frozen_barometer_feigned_is_taken_back():
    flight = noisy("mems", 1, 300.0, CLIMBS[:2])
    stuck = (flight.t_baro >= 215.0) & (flight.t_baro < 275.0)
    flight.h_baro[stuck] = flight.h_baro[stuck][0]
    out, channel = flight.run(network(5.0))
    assert kinds(channel) == ["engaged", "jump", "frozen", "re-engaged"]
    assert channel.summary.offset == 0.0
    assert abs(out["height"] - flight.h)[-100:].max() < 12.0
