"""What a filter assumes of a receiver: its own sigmas, no better than stamps allow."""

import dataclasses

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss import fix_velocity
from sinstool.methods.ins_gnss.fix_velocity import (
    message_times,
    split_position_velocity,
    with_velocities,
)
from sinstool.pipelines.process.ins_gnss.receiver import (
    STAMP_S,
    gnss_model,
    inflate_sigmas,
    times_as_noisy,
    with_white_velocity,
)
from sinstool.pipelines.process.ins_gnss.timing import significant_lag
from tests.helpers.filter_logs import start_of
from tests.helpers.gnss import straight
from tests.helpers.unseen_drives import GRADES, LEVER, drive, record, within, write
from tests.helpers.unseen_errors import displaced

RADIUS = 6.37e6


def epochs(n=400, rate=5.0, sigma=0.01, sigma_v=0.05, lag=0.0, latitude=0.85, noise=0.0):
    """A vehicle that weaves north-eastward over the date line."""
    t = np.arange(n) / rate
    rng = np.random.default_rng(1)

    def place(t):
        return np.stack([8.0 * t + 20.0 * np.sin(0.4 * t), 6.0 * t, 0.5 * t], axis=1)

    def speed(t):
        return np.stack([8.0 + 8.0 * np.cos(0.4 * t), 6.0 + 0 * t, 0.5 + 0 * t], axis=1)

    p = place(t) + noise * rng.standard_normal((n, 3))
    lon = np.pi - 1e-5 + p[:, 1] / (RADIUS * np.cos(latitude))
    time_ns = 1_700_000_000_000_000_000 + np.round(t * 1e9).astype(np.int64)
    return GnssEpochs(
        time_ns,
        time_ns,
        latitude + p[:, 0] / RADIUS,
        np.pi - np.mod(np.pi - lon, 2.0 * np.pi),
        100.0 - p[:, 2],
        speed(t - lag),
        np.full((n, 3), sigma),
        np.full((n, 3), sigma_v),
    )


def test_a_centimetre_at_speed_is_inflated():
    gnss = epochs()
    inflated = inflate_sigmas(gnss, ProcessConfig())
    speed = np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1])
    assert np.allclose(inflated.sigma_position_n[:, 0], np.hypot(0.01, STAMP_S * speed))
    assert np.allclose(inflated.sigma_position_n[:, 2], np.hypot(0.01, STAMP_S * 0.5))
    assert np.allclose(inflated.sigma_velocity_n, 0.05)


def test_scale_is_on_all_that_the_receiver_says():
    gnss, config = epochs(sigma=3.0), ProcessConfig(filter={"gnss_noise_scale": 2.0})
    inflated = inflate_sigmas(gnss, config)
    assert np.allclose(inflated.sigma_position_n[:, 0], 6.0, rtol=1e-3)
    assert np.allclose(inflated.sigma_velocity_n, 0.1)
    model, how = gnss_model(gnss, config)
    whole = np.hypot(model.position_white[0], model.position_markov[0])
    assert whole == pytest.approx(6.0, rel=1e-2)
    assert "as the receiver states" in how


def test_what_a_receiver_does_not_give_is_not_said_to_be_assumed():
    gnss = epochs()
    none = np.full_like(gnss.velocity_n, np.nan)
    assert gnss_model(dataclasses.replace(gnss, velocity_n=none), ProcessConfig())[1].endswith(
        "; no velocity"
    )
    silent = dataclasses.replace(gnss, sigma_velocity_n=none)
    assert "velocity assumed, about" in gnss_model(silent, ProcessConfig())[1]


def test_silent_receivers_get_what_is_usual():
    gnss = epochs(sigma=np.nan, sigma_v=np.nan)
    model, how = gnss_model(gnss, ProcessConfig(filter={"gnss_sigma": 2.0}))
    whole = np.hypot(model.position_white, model.position_markov)
    assert whole == pytest.approx([2.0, 2.0, 3.2], rel=1e-2)
    assert how.count("assumed") == 2


def test_lag_of_velocities_is_found_and_taken_apart():
    gnss = epochs(lag=0.1, noise=0.01)
    lag = significant_lag(gnss)
    assert lag == pytest.approx(0.1, abs=0.005)
    apart = split_position_velocity(gnss, lag)
    assert len(apart) == 2 * len(gnss)
    assert np.all(np.diff(apart.time_ns) >= 0)
    places = apart.rows(apart.has_position)
    assert not places.has_velocity.any()
    # half the lag to either side of the stamps, so that the latency is that of their mean
    assert np.allclose(places.time_ns - gnss.time_ns, 0.5e9 * lag, atol=2)
    moving = apart.rows(apart.has_velocity)
    assert np.allclose(moving.time_ns - gnss.time_ns, -0.5e9 * lag, atol=2)
    stamps = message_times(apart, lag)
    assert np.abs(stamps[apart.has_velocity] - gnss.time_ns).max() <= 2
    assert np.abs(stamps[apart.has_position] - gnss.time_ns).max() <= 2


def test_no_lag_where_there_is_none():
    assert significant_lag(epochs(noise=0.3)) == 0.0
    gnss = epochs()
    assert split_position_velocity(gnss, 0.0) is gnss


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_velocities_from_positions(noise):
    gnss = epochs(noise=noise)
    made = with_velocities(gnss, max(noise, 1e-3))
    assert len(made) == len(gnss)
    inner = slice(20, -20)
    off = (made.velocity_n - gnss.velocity_n)[inner]
    # a parabola over 2 s misses the third derivative: 3/5 of T^2/6 of it; the Earth is no
    # sphere of RADIUS
    bend = 0.6 * 1.2**2 / 6.0 * 8.0 * 0.4**2
    assert np.abs(off[:, 0]).max() < bend + 0.005 * 16.0 + 2.5 * noise
    assert np.abs(off[:, 2]).max() < 2.5 * noise + 1e-3
    assert np.abs(off[:, 1]).max() < 0.005 * 6.0 + 2.5 * noise
    if not noise:  # what is left is the third derivative, which a parabola does not have
        north = off[:, 0] / made.sigma_velocity_n[inner, 0]
        assert 0.3 < np.sqrt(np.mean(north**2)) < 1.5
    if noise:
        ratio = off[:, 2] / made.sigma_velocity_n[inner, 2]
        assert 0.5 < np.sqrt(np.mean(ratio**2)) < 1.5


@pytest.mark.parametrize(("rate", "noise"), [(1.0, 0.02), (1.0, 0.3), (5.0, 0.1)])
def test_the_first_and_last_fixes_have_velocities_where_they_are_wanted(rate, noise):
    """With errors that their sigmas admit: of noise, and of what no parabola follows."""
    fewer = 2 if rate == 1.0 else 0  # at each end
    exact = epochs(n=round(40 * rate), rate=rate)
    ratios = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        # another part of the weave each time
        begin = int(random.integers(len(exact) // 2))
        gnss = exact.rows(slice(begin, begin + len(exact) // 2))
        north, down = noise * random.standard_normal((2, len(gnss)))
        gnss = dataclasses.replace(
            gnss, latitude=gnss.latitude + north / RADIUS, height=gnss.height - down
        )
        usual = with_velocities(gnss, noise)
        made = with_velocities(gnss, noise, ends=True)
        assert len(usual) + 2 * fewer == len(made) == len(gnss)
        inner = slice(len(usual) // 3, 2 * len(usual) // 3)
        same = np.isin(made.time_ns, usual.time_ns[inner])
        np.testing.assert_array_equal(made.velocity_n[same], usual.velocity_n[inner])
        off = ((made.velocity_n - gnss.velocity_n) / made.sigma_velocity_n)[[0, -1]]
        ratios.append(off[:, [0, 2]])
    # in the noise of five fixes half of so strong a weave is hidden
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_fixes_without_height_show_how_fast_a_vehicle_goes_all_the_same():
    """A receiver in 2-D mode for a while: its fixes were thrown away, or leapt down to 0 m."""
    whole = epochs(noise=0.05)
    t = seconds_of(whole)
    climb = whole.height + 3.0 * np.sin(0.3 * t) + 800.0
    flat = (t > 30.0) & (t < 50.0)
    made = with_velocities(dataclasses.replace(whole, height=np.where(flat, np.nan, climb)), 0.05)
    assert len(made) == len(whole)
    off = (made.velocity_n - whole.velocity_n)[20:-20]
    assert np.abs(off[:, 1]).max() < 0.2 and np.abs(off[:, 0]).max() < 0.5
    down = made.velocity_n[:, 2] - whole.velocity_n[:, 2] + 0.9 * np.cos(0.3 * t)
    down /= made.sigma_velocity_n[:, 2]
    assert np.abs(down[20:-20]).max() < 4.0
    assert made.sigma_velocity_n[flat, 2].min() > 0.4 > made.sigma_velocity_n[t < 28.0, 2].max()
    assert not fix_velocity.outlying(
        dataclasses.replace(whole, height=np.where(flat, np.nan, climb))
    ).any()


def test_velocities_that_share_their_fixes_are_worth_less_together():
    gnss = epochs(noise=0.3)
    alone = with_velocities(gnss, 0.3).sigma_velocity_n[20:-20, 2]
    many = fix_velocity.half_width(seconds_of(gnss), 0.3) / np.median(np.diff(seconds_of(gnss)))
    together = with_velocities(gnss, 0.3, 0.0).sigma_velocity_n[20:-20, 2]
    assert np.median(together / alone) == pytest.approx(np.sqrt(many), rel=0.15)
    # What a slow error changes by in a second, over half a window, and lasts as long
    wandering = with_velocities(gnss, 0.3, 0.2).sigma_velocity_n[20:-20, 2]
    more = np.sqrt(np.median(wandering**2 - together**2))
    interval = np.median(np.diff(seconds_of(gnss)))
    assert more == pytest.approx(0.2 / np.sqrt(interval), rel=0.1)


def seconds_of(gnss):
    return (gnss.time_ns - gnss.time_ns[0]) * 1e-9


def test_too_few_fixes_make_no_velocity():
    assert len(with_velocities(epochs(n=4), 1.0)) == 0
    gnss = epochs(n=30)
    gaps = np.repeat(np.arange(3), 10) * 60_000_000_000  # 2 s of fixes each minute
    sparse = dataclasses.replace(gnss, time_ns=gnss.time_ns + gaps)
    made = with_velocities(sparse.rows(slice(None, None, 3)), 3.0)
    assert len(made) == 0


def test_velocities_of_positions_do_not_depend_on_how_many_are_made_at_a_time(monkeypatch):
    gnss = epochs(noise=0.02)
    gnss = gnss.rows(np.delete(np.arange(len(gnss)), np.r_[30:33, 150:190]))  # gaps
    at_once = with_velocities(gnss, 0.02)
    monkeypatch.setattr(fix_velocity, "BLOCK", 7)
    in_blocks = with_velocities(gnss, 0.02)
    assert len(at_once) > 300
    for name in ("time_ns", "velocity_n", "sigma_velocity_n"):
        np.testing.assert_array_equal(getattr(in_blocks, name), getattr(at_once, name))


@pytest.mark.parametrize("interval, noise", [(0.35, 0.01), (0.35, 0.3), (0.21, 0.05), (1.0, 1.0)])
def test_sigmas_of_velocities_from_positions_are_those_of_parabolas(interval, noise):
    """By polyfit, fix by fix: noise through the slope's weights, and what no parabola follows."""
    random = np.random.default_rng(6)
    t = interval * np.arange(60)
    down = 0.02 * t**3 - 3.0 * np.sin(t) + noise * random.standard_normal(len(t))
    gnss = straight(np.round(t * 1e9).astype(np.int64), speed=0.0)
    made = with_velocities(dataclasses.replace(gnss, height=-down), noise)
    half = fix_velocity.half_width(t, noise)
    for k in range(10, 50):
        near = np.abs(t - t[k]) <= half + 1e-9
        at = t[near] - t[k]
        slope, covariance = np.polyfit(at, down[near], 2, cov="unscaled")
        left = np.sum((down[near] - np.polyval(slope, at)) ** 2)
        bent = max(left - 2.0 * noise**2 * max(len(at) - 3, 1), 0.0)
        bend = 4.0 * np.sqrt(bent / len(at)) / np.abs(at).max()
        row = np.searchsorted(made.time_ns, gnss.time_ns[k])
        assert made.velocity_n[row, 2] == pytest.approx(slope[1], abs=1e-6)
        sigma = max(np.hypot(noise * np.sqrt(covariance[1, 1]), bend), fix_velocity.LEAST_SIGMA)
        assert made.sigma_velocity_n[row, 2] == pytest.approx(sigma, rel=1e-4)


@pytest.mark.parametrize(
    ("noisier", "words"),
    [
        ((2.0, 2.0, 3.0), "2 times (vertically 3 times)"),
        ((1.0, 1.0, 1.9), "vertically 1.9 times"),
        ((5.0, 1.0), "horizontally 5 times"),
    ],
)
def test_only_axes_that_are_noisier_are_named(noisier, words):
    """It said "1 times (vertically 1.9 times)"."""
    assert times_as_noisy(noisier) == words


@pytest.mark.slow
@pytest.mark.parametrize(
    ("claims", "options", "expected"),
    [
        (1.0, {}, 1.0),
        (0.2, {}, 5.0),
        (0.02, {}, 50.0),  # less than what stamps add to it at speed
        (5.0, {}, 1.0),
        (0.2, {"gnss_noise_scale": 2.0}, 1.0),
    ],
)
def test_fixes_are_as_noisy_as_they_show_and_no_less_than_the_receiver_says(
    tmp_path, claims, options, expected
):
    """A receiver that claimed a quarter of its noise left a smoother 0.5 m off at 8 sigmas."""
    noise = {"sigma": 0.4, "sigma_v": 0.05 if claims < 0.1 else None}
    data = record(drive(4, 120.0, 10.0), GRADES["tactical"], 4, gnss_rate=2.0, **noise)
    data = dataclasses.replace(
        data, fixes=dataclasses.replace(data.fixes, sigma=claims * data.fixes.sigma)
    )
    log = write(tmp_path / "log.mcap", data)
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss, filter=options)
    assert start.noisier == pytest.approx((expected, expected), rel=0.2)
    whole = np.hypot(start.settings.gnss.position_white, start.settings.gnss.position_markov)
    used = 0.4 * claims * options.get("gnss_noise_scale", 1.0) * expected
    assert whole == pytest.approx(3 * [used], rel=0.25)
    assert np.median(start.gnss.sigma_position_n[:, 0]) == pytest.approx(used, rel=0.25)
    said = any("as much as the receiver states" in text for text in start.warnings)
    assert said == (expected > 1.0) == ("times (vertically" in start.gnss_why)


@pytest.mark.parametrize(
    ("noise", "groups", "expected", "said"),
    [
        (0.4, {}, 0.4, True),
        (0.02, {}, 0.05, False),  # the usual white part
        (0.4, {"gnss": {"gnss_sigma_v": 0.4}}, 0.4, False),  # in all as the option says: 0.44
    ],
)
@pytest.mark.slow
def test_velocities_without_covariance_are_as_noisy_as_they_show(
    tmp_path, noise, groups, expected, said
):
    """Of 0.3 m/s in a receiver that says nothing, taken for 0.11, most fixes were rejected."""
    data = record(
        drive(4, 150.0, 10.0), GRADES["industrial"], 4, sigma=0.2, sigma_v=noise, latency=0.1
    )
    log = write(tmp_path / "log.mcap", data)
    gnss = {"lever_arm": tuple(LEVER.tolist()), **groups.get("gnss", {})}
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss)
    assert start.settings.gnss.velocity_white[:2] == pytest.approx(2 * [expected], rel=0.25)
    assert start.settings.gnss_latency == pytest.approx(0.1, abs=0.04)
    assert ("velocities vary by" in start.gnss_why) == said
    whole = np.hypot(start.settings.gnss.velocity_white, start.settings.gnss.velocity_markov)
    assert said or whole[:2] == pytest.approx(2 * [0.44 if groups else 0.11], rel=0.02)
    assert not any("velocities are" in text for text in start.warnings)
    # What a receiver claims is enlarged in the same way, and said
    stated = np.full((len(start.gnss), 3), 0.05)
    claims = dataclasses.replace(start.gnss, sigma_velocity_n=stated)
    calm = dataclasses.replace(start.settings, gnss=gnss_model(claims, ProcessConfig())[0])
    before = dataclasses.replace(start, settings=calm, gnss=claims)
    after = with_white_velocity(before, claims, ProcessConfig(), (noise, noise))
    assert after.noisier_velocity == pytest.approx(2 * [max(noise / 0.05, 1.0)], rel=0.1)
    assert after.gnss.sigma_velocity_n == pytest.approx(max(noise, 0.05), rel=0.1)
    # All of what it claims may be white, though no log shows that nothing lasts
    measured = ((0.05, 0.05), (0.06, 0.03), (0.01, np.nan))
    for shown, (level, down) in zip(
        measured, ((1.0, 1.0), (1.0, 0.6), (0.447, 0.447)), strict=True
    ):
        model = with_white_velocity(before, claims, ProcessConfig(), shown).settings.gnss
        expected = 0.05 * np.array([level, level, down])
        assert model.velocity_white == pytest.approx(expected, rel=0.02)
        assert np.hypot(model.velocity_white, model.velocity_markov) == pytest.approx(
            0.05, rel=1e-3
        )


def test_positions_without_covariance_are_as_noisy_as_they_show(tmp_path):
    data = record(drive(4, 150.0, 10.0), GRADES["industrial"], 4, gnss_rate=2.0, sigma=15.0)
    data = dataclasses.replace(data, fixes=dataclasses.replace(data.fixes, sigma=0.0))
    log = write(tmp_path / "log.mcap", data)
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss)
    assert start.settings.gnss.position_white == pytest.approx(3 * [15.0], rel=0.25)
    assert start.noisier == (1.0, 1.0)


def test_what_a_receiver_says_beyond_its_usual_error_lasts():
    """Of 4 m for half a minute, at 10 Hz, a filter made 0.6 m, and was 8 m off."""
    gnss = epochs(n=400, rate=10.0, sigma=0.1)
    sigma = gnss.sigma_position_n.copy()
    sigma[100:200] = 4.0
    sigma[300:310, 2] = 0.19
    worse = inflate_sigmas(
        dataclasses.replace(gnss, sigma_position_n=sigma), ProcessConfig(), stamp_s=0.0
    ).sigma_position_n
    # A hundred fixes in 10 s are as good as one of them
    assert worse[100:200] == pytest.approx(4.0 * np.sqrt(100.0), rel=1e-2)
    np.testing.assert_array_equal(
        np.delete(worse, np.s_[100:200], 0), np.delete(sigma, np.s_[100:200], 0)
    )
    slow = dataclasses.replace(gnss, time_ns=200 * gnss.time_ns, sigma_position_n=sigma)
    rare = inflate_sigmas(slow, ProcessConfig(), stamp_s=0.0).sigma_position_n
    np.testing.assert_array_equal(rare, sigma)  # a fix each 20 s: each is another


@pytest.mark.slow
def test_what_a_receiver_says_to_be_worse_is_no_noise_of_its_other_fixes(tmp_path):
    """Positions off by metres, as said, made all others count as 34 times as noisy as stated."""
    data = record(drive(4, 500.0, 10.0), GRADES["tactical"], 4, gnss_rate=2.0, sigma=0.05)
    worse = within(data.fixes.seconds, [(20.0, 245.0)])  # 56 % of what shows the noise
    random = np.random.default_rng(4)
    off = np.where(worse[:, None], 10.0 * random.standard_normal((len(worse), 3)), 0.0)
    data = displaced(data, off)
    sigma = np.where(worse, 10.0, data.fixes.sigma)
    data = dataclasses.replace(data, fixes=dataclasses.replace(data.fixes, sigma=sigma))
    gnss = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": 0.0}
    log = write(tmp_path / "log.mcap", data)
    start = start_of(log, input={"gyro_kind": "mean-rate"}, gnss=gnss)
    assert start.noisier == (1.0, 1.0)


def test_no_velocity_is_made_of_positions_that_are_said_to_be_worse():
    gnss = epochs(n=400, sigma=0.05)
    worse = np.zeros(400, bool)
    worse[150:300] = True
    off = np.cumsum(np.random.default_rng(2).standard_normal(400)) * worse
    spoilt = dataclasses.replace(
        gnss,
        latitude=gnss.latitude + off / RADIUS,
        sigma_position_n=np.where(worse[:, None], 20.0, gnss.sigma_position_n),
    )
    made = with_velocities(spoilt, 0.05)
    expected = with_velocities(gnss.rows(~worse), 0.05)
    np.testing.assert_array_equal(made.velocity_n, expected.velocity_n)
    np.testing.assert_array_equal(made.time_ns, expected.time_ns)
    assert 200 < len(made) <= 250
