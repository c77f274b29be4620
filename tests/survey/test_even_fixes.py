"""Times of fixes that a receiver makes evenly, from stamps of their receipt."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.config import ProcessConfig
from sinstool.core.streams import Gnss, Velocity
from sinstool.io.readers import open_log
from sinstool.survey.even_fixes import at_even_times, even_times
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import GRADES, LEVER, T0, drive, record, with_outliers, write
from tests.helpers.unseen_errors import unsteady_stamps

TOPICS = ("/fix", "/velocity")
DELAYS = {
    "exponential": lambda random, n: np.minimum(random.exponential(1.0, n), 5.0),
    "even": lambda random, n: random.uniform(0.0, 2.0, n),
    "normal": lambda random, n: 0.7 * random.standard_normal(n),
    "stalls": lambda random, n: (
        random.exponential(1.0, n) + 20.0 * random.random(n) * (random.random(n) < 0.01)
    ),
}


def measured(seed, rate, n, lost=0.01):
    """Times of measurement, s, by a clock that is fast and wanders, with an outage."""
    random = np.random.default_rng(seed)
    seconds = np.arange(n) / rate * (1.0 + 1e-5 * random.standard_normal())
    seconds += 1e-3 * np.sin(seconds / 300.0)
    kept = random.random(n) > lost
    kept[n // 3 : n // 3 + n // 20] = False
    return seconds[kept]


def stamped(seconds, delays, size, seed):
    late = size * DELAYS[delays](np.random.default_rng([seed, 1]), len(seconds))
    stamps = np.maximum.accumulate(seconds + late)
    return T0 + np.round(1e9 * stamps).astype(np.int64) + np.arange(len(seconds))


def moving(seconds, noise=0.05, speed=10.0):
    """Places in bends, m, shape (n, 3)."""
    place = np.stack([20.0 * np.sin(seconds / 20.0), 13.0 * np.cos(seconds / 13.0), 0.0 * seconds])
    return speed * place.T + noise * np.random.default_rng(3).standard_normal((len(seconds), 3))


def fixes_at(time_ns, place):
    n = len(time_ns)
    latitude, longitude = 0.8 + place[:, 0] / 6.37e6, 0.1 + place[:, 1] / 6.37e6 / np.cos(0.8)
    ones = np.ones(n, np.int64)
    return Gnss(
        time_ns, time_ns, latitude, longitude, -place[:, 2], np.zeros((n, 3, 3)), ones, ones
    )


@pytest.mark.parametrize("delays", DELAYS)
@pytest.mark.parametrize("rate, size", [(1.0, 0.03), (1.0, 0.08), (2.0, 0.05), (5.0, 0.024)])
def test_delays_are_taken_off(delays, rate, size):
    """But for what the line beside them is uncertain by."""
    for seed in range(5):
        seconds = measured(seed, rate, round(400 * rate))
        stamps = stamped(seconds, delays, size, seed)
        even = even_times(stamps)
        assert even is not None
        assert even.interval_ns == pytest.approx(1e9 / rate, rel=2e-4)
        error = (even.time_ns - T0) * 1e-9 - seconds
        off = np.abs(error - np.median(error))
        assert np.quantile(off, 0.99) < 0.4 * size
        # From the promptest on, or where delays may be anything, from their middle
        assert np.median(error) / size == pytest.approx(float(delays == "even"), abs=0.2)
        assert even.are_of_receipt(moving(seconds))
        assert not even.are_of_receipt(moving((stamps - T0) * 1e-9))


@pytest.mark.parametrize(("rate", "step"), [(3.0, 0.1), (0.7, 0.5)])
def test_stamps_cut_to_a_step_are_late_by_what_was_cut(rate, step):
    for seed in range(5):
        seconds = measured(seed, rate, round(400 * rate))
        stamps = T0 + np.round(1e9 * step * np.floor(seconds / step)).astype(np.int64)
        even = even_times(stamps)
        assert even is not None
        error = (even.time_ns - T0) * 1e-9 - seconds
        # As the clock wanders, what is cut off is not the same part of a step everywhere
        assert np.std(error) < 0.2 * step and np.abs(error + 0.5 * step).max() < 0.5 * step
        assert even.are_of_receipt(moving(seconds))


@given(st.integers(0, 10_000), st.floats(0.002, 0.05))
@settings(max_examples=30, deadline=None)
def test_a_fused_position_is_one_of_its_stamp(seed, size):
    """However much it moves, and where it rests."""
    seconds = measured(seed, 4.0, 2000)
    stamps = stamped(seconds, "even", size, seed)
    at = (stamps - T0) * 1e-9
    for speed in (0.0, 0.03, 1.0):
        fixes = fixes_at(stamps, moving(at, speed=speed))
        same, _, findings = at_even_times(fixes, None, TOPICS, False)
        assert same is fixes and findings == []


def test_stamps_that_say_nothing_stay():
    """Few, even already, or as if each interval were another."""
    seconds = measured(1, 5.0, 2000)
    exact = T0 + np.round(1e9 * seconds).astype(np.int64)
    assert even_times(exact) is None
    assert even_times(exact + np.random.default_rng(0).integers(0, 10**6, len(exact))) is None
    assert even_times(stamped(seconds, "exponential", 0.02, 0)[:50]) is None
    random = np.random.default_rng(2)
    assert even_times(T0 + np.cumsum(random.integers(10**8, 4 * 10**8, 2000))) is None


def test_a_few_fixes_between_outages_are_as_late_as_the_others():
    seconds = np.concatenate([np.arange(0.0, 200.0, 0.2), 230.0 + np.arange(0.0, 2.0, 0.2)])
    even = even_times(stamped(seconds, "exponential", 0.02, 5))
    assert even is not None
    error = (even.time_ns - T0) * 1e-9 - seconds
    assert np.std(error[:1000]) < 0.003
    assert abs(np.mean(error[1000:]) - np.mean(error[:1000])) < 0.02
    assert np.std(error[1000:]) > 0.005


def test_velocities_go_with_their_fixes():
    """Those of the same messages by the same times, others by their own."""
    seconds = measured(4, 5.0, 2000)
    stamps = stamped(seconds, "exponential", 0.02, 4)
    fixes = fixes_at(stamps, moving(seconds))
    speed = np.gradient(moving(seconds, noise=0.0), seconds, axis=0)
    kept = np.arange(len(stamps)) % 7 > 0
    velocity = Velocity(stamps[kept], stamps[kept], speed[kept], np.zeros((kept.sum(), 3, 3)))
    moved, with_them, (finding,) = at_even_times(fixes, velocity, ("/fix", "/fix"), False)
    assert np.array_equal(with_them.time_ns, moved.time_ns[kept])
    assert finding.kind == "uneven-fixes" and finding.topic == "/fix"
    assert finding.numbers["jitter_s"] == pytest.approx(0.02, rel=0.2)
    _, own, findings = at_even_times(fixes, velocity, TOPICS, False)
    assert [one.topic for one in findings] == list(TOPICS)
    assert np.std((own.time_ns - T0) * 1e-9 - seconds[kept]) < 0.003


def test_velocities_alone_may_be_late():
    seconds = measured(5, 5.0, 4000)
    stamps = stamped(seconds, "exponential", 0.03, 5)
    right = T0 + np.round(1e9 * seconds).astype(np.int64)
    random = np.random.default_rng(6)
    # In town: it drives off and brakes all the time
    speed = np.stack([5.0 * np.sin(seconds / 2.0), 5.0 * np.cos(seconds / 3.0), 0.0 * seconds], 1)
    speed += 0.05 * random.standard_normal(speed.shape)
    none = np.zeros((len(stamps), 3, 3))
    velocity = Velocity(stamps, stamps, speed, none)
    fixes = fixes_at(right, moving(seconds))
    for beside in (None, fixes):
        same, moved, (finding,) = at_even_times(beside, velocity, TOPICS, False)
        assert same is beside and finding.topic == "/velocity"
        assert np.std((moved.time_ns - T0) * 1e-9 - seconds) < 0.004
    in_time = Velocity(right, right, speed, none)
    assert at_even_times(fixes, in_time, TOPICS, False) == (fixes, in_time, [])


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A drive whose fixes and velocities are stamped on receipt, and its truth."""
    truth = drive(2, 240.0, rest=20.0)
    data = record(truth, GRADES["industrial"], 2, gnss_rate=5.0, sigma=0.03, sigma_v=0.05)
    data = unsteady_stamps(with_outliers(data, 2), 2, 0.02)
    return write(tmp_path_factory.mktemp("drives") / "log.mcap", data), truth


@pytest.mark.parametrize("stamps", ["auto", "even", "kept"])
def test_the_choice_is_the_users(drives, stamps):
    log, _ = drives
    with open_log(log) as opened:
        source = prepare(
            opened,
            ProcessConfig(navigation={"mode": "ins-gnss"}, input={"gnss_stamps": stamps}),
        )
    steps = np.diff(source.aiding.gnss.time_ns)
    kinds = [finding.kind for finding in source.findings]
    assert ("uneven-fixes" in kinds) == (stamps != "kept")
    spread = np.quantile(steps, 0.9) - np.quantile(steps, 0.1)
    assert (spread < 1e6) == (stamps != "kept")


@pytest.mark.slow
def test_the_filter_gains_by_it(drives):
    """Along the track, where stamps that are late by 20 ms are off by 30 cm."""
    log, truth = drives
    rms = {}
    for stamps in ("auto", "kept"):
        _, solution = run(
            log,
            gnss={"lever_arm": tuple(LEVER.tolist())},
            input={"gnss_stamps": stamps, "gyro_kind": "mean-rate"},
            filter={"smooth": True},
        )
        rows = solution.rows((solution.time_ns - T0) * 1e-9 > 30.0)
        seconds = (rows.time_ns - T0) * 1e-9
        error = truth.errors_of(seconds, *rows.position.T, rows.velocity_n, np.eye(3)[None])
        rms[stamps] = float(np.sqrt(np.mean(error[:, :2] ** 2)))
    assert rms["auto"] < 0.06 and rms["auto"] < 0.6 * rms["kept"]
