from itertools import pairwise

import numpy as np
import pytest

from sinstool.methods.hse.encoder import TableAngle, table_angle
from sinstool.methods.hse.rig import EncoderModel
from sinstool.methods.hse.segments import (
    BLOCK_S,
    SegmentRules,
    find_segments,
    relative_noise,
)
from sinstool.simulation.turntable import TableProfile

ARCSEC = np.pi / 648000.0
DT = 0.005
WALK = [(0, 30), (20, 120), (40, 300), (60, 300), (-40, 300), (-20, 120), (0, 30)]


def plateaus(walk):
    return [(float(np.radians(rate)), float(duration)) for rate, duration in walk]


def measured(walk, lost=(), seed=1):
    """Table angles as an encoder gives them: ripple, steps of 0.18 arcsec, wrapped."""
    profile = TableProfile(plateaus(walk))
    at = np.arange(0.0, profile.duration, DT)
    angle = profile.angle(at)[0]
    angle = angle + 1e-4 * np.sin(angle)
    reading = np.mod(0.18 * ARCSEC * np.round(angle / (0.18 * ARCSEC)), 2 * np.pi)
    stamps = 1_700_000_000_000_000_000 + np.round(at * 1e9).astype(np.int64)
    rows = np.delete(np.arange(1, len(at)), lost) if len(lost) else np.arange(1, len(at))
    return profile, table_angle(stamps[rows], stamps, reading, EncoderModel())


def test_noise_of_the_rate_of_blocks_is_that_of_differences_of_their_means():
    means = np.random.default_rng(3).normal(0.0, 1e-3, 20_000)
    noise = 0.5 * (means[2:] - means[:-2])
    found = relative_noise(0.7 + noise)
    assert found == pytest.approx(noise.std() / 0.7, rel=0.03)
    # an even change of the rate is no noise; nor is a table at rest
    assert relative_noise(np.linspace(0.5, 0.9, len(noise)) + noise) == pytest.approx(
        found, rel=0.1
    )
    assert relative_noise(noise[:100]) == 0.0


def spans(walk, acceleration=5.0):
    """When each plateau truly begins and ends."""
    t, before, out = 0.0, walk[0][0], []
    for rate, duration in walk:
        t += abs(rate - before) / acceleration
        out.append((t, t + duration))
        t, before = t + duration, rate
    return out


def test_plateaus_of_a_walk_through_the_rates():
    _, pieces = measured(WALK)
    assert len(pieces) == 1
    result = find_segments(pieces)
    assert [round(np.degrees(s.rate), 3) for s in result.used] == [40.0, 60.0, -40.0]
    for segment, (begin, end) in zip(result.used, spans(WALK)[2:5], strict=True):
        start = segment.start_s + DT  # the first gyro sample is stamped one interval late
        assert begin + 2.0 <= start <= begin + 2.0 + 2 * BLOCK_S
        assert end - 2.0 - 2 * BLOCK_S <= start + segment.duration_s <= end - 2.0 + 1e-9
    reasons = [s.reason for s in result.rejected]
    assert reasons[0].startswith("the table turns at 0.00 deg/s")
    assert reasons[2] == reasons[-3] == "6.4 turns: 10 whole ones needed"
    assert sum(reason == "the rate changes" for reason in reasons) == 6
    assert len(result.block_rate) == len(result.block_time_s) == int(1240 / BLOCK_S) - 1
    at = np.argmin(np.abs(result.block_time_s - 300.0))
    assert np.degrees(result.block_rate[at]) == pytest.approx(40.0, abs=0.01)


def test_lost_samples_split_a_plateau():
    lost = np.array([40000, 40001, 40002])  # 200 s, in the plateau of 40 deg/s
    _, pieces = measured(WALK, lost)
    result = find_segments(pieces)
    assert [round(np.degrees(s.rate), 3) for s in result.used] == [40.0, 60.0, -40.0]
    assert result.used[0].piece == 1
    assert result.used[0].start_s == pytest.approx(200.015 + 2.0, abs=0.02)
    assert any(s.reason.startswith("lasts 37.") for s in result.rejected)


@pytest.mark.parametrize("rate", [20.0, 100.0])
@pytest.mark.parametrize("seed", range(3))
def test_an_encoder_stamped_by_receipt_has_plateaus_too(seed, rate):
    """0.5 ms of jitter at 100 deg/s is a third of a degree per second from block to block."""
    random = np.random.default_rng(seed)
    profile = TableProfile(plateaus([(0, 20), (45, 90), (90, 90), (180, 90), (-180, 90)]))
    gyro_at = np.arange(0.0, profile.duration, 0.01)
    at = np.arange(0.0, profile.duration, 1.0 / rate)
    reading = np.mod(profile.angle(at)[0], 2 * np.pi)
    received = np.sort(at + 5e-4 * random.standard_normal(len(at)))
    epoch = 1_700_000_000_000_000_000
    stamps, readings = (epoch + np.round(t * 1e9).astype(np.int64) for t in (gyro_at[1:], received))
    result = find_segments(table_angle(stamps, readings, reading, EncoderModel()))
    found = [np.degrees(s.rate) for s in result.used]
    assert found == pytest.approx([45.0, 90.0, 180.0, -180.0], abs=0.01)
    assert min(s.duration_s for s in result.used) > 84.0


def test_everything_is_accounted_for():
    _, pieces = measured(WALK)
    result = find_segments(pieces, SegmentRules(settle_s=0.0))
    parts = sorted([*result.used, *result.rejected], key=lambda s: s.first)
    assert parts[0].first == 0
    assert all(a.stop == b.first for a, b in pairwise(parts))
    assert len(pieces[0]) - parts[-1].stop < BLOCK_S / DT


def steady(rate, seconds, start_s=0.0):
    n = round(seconds / DT)
    return [TableAngle(0, start_s, DT, 0.4 + rate * DT * np.arange(n + 1))]


def test_long_plateaus_are_repeats():
    pieces = steady(0.7, 1454.0)
    result = find_segments(pieces)
    assert [s.duration_s for s in result.used] == pytest.approx([600.0, 600.0, 250.0])
    result = find_segments(steady(0.7, 1254.0))
    assert [s.duration_s for s in result.used] == pytest.approx([600.0, 600.0])
    (rest,) = result.rejected
    assert rest.duration_s == pytest.approx(50.0)
    assert rest.reason == "what is left after repeats of 600 s"
    result = find_segments(pieces, SegmentRules(align_duration_s=200.0))
    assert len(result.used) == 7


def test_warmup_is_left_out():
    result = find_segments(steady(0.7, 500.0), SegmentRules(skip_warmup_s=120.0))
    (segment,) = result.used
    assert segment.start_s == pytest.approx(120.0)
    assert segment.duration_s == pytest.approx(378.0)
    assert [s.reason for s in result.rejected] == ["within the first 120 s"]
    assert not find_segments(steady(0.7, 500.0), SegmentRules(skip_warmup_s=900.0)).used


def test_rules_hold():
    slow = np.radians(0.99)
    assert "0.99 deg/s" in find_segments(steady(slow, 600.0)).rejected[0].reason
    assert find_segments(steady(np.radians(7.0), 600.0)).used
    assert "59.8 s" in find_segments(steady(1.2, 63.9)).rejected[0].reason
    assert find_segments(steady(1.2, 64.1)).used
    few = SegmentRules(min_turns=20)
    assert "19.1 turns" in find_segments(steady(0.2, 604.0), few).rejected[0].reason
    short = find_segments(steady(0.7, 3.0)).rejected
    assert "lasts 0.0 s" in short[0].reason
    assert "too short" in find_segments(steady(0.7, 0.1)).rejected[0].reason
    assert not find_segments([]).used


def test_encoder_that_goes_back_is_refused():
    (piece,) = steady(0.7, 300.0)
    alpha = piece.alpha.copy()
    alpha[20010] = alpha[20011] + 1e-6  # within a block: its rate is as before
    result = find_segments([TableAngle(0, 0.0, DT, alpha)])
    assert not result.used
    assert result.rejected[0].reason == "the encoder goes backwards or stands still 1 time"


def test_slow_change_of_rate_is_not_one_plateau():
    at = DT * np.arange(round(900 / DT) + 1)
    alpha = 0.7 * at + 0.5 * 1e-5 * at**2  # 0.7 to 0.709 rad/s, beyond the tolerance
    result = find_segments([TableAngle(0, 0.0, DT, alpha)])
    for segment in result.used:
        change = 1e-5 * segment.duration_s
        assert change < 2.5e-3 * segment.rate
    assert len(result.used) + len(result.rejected) > 2


def test_what_lasts_just_as_long_as_the_rules_ask_will_do():
    piece = steady(1.2, 60.0)
    exactly = DT * round(60.0 / DT)
    assert find_segments(piece, SegmentRules(settle_s=0.0, min_duration_s=exactly)).used
    more = np.nextafter(exactly, 100.0)
    assert not find_segments(piece, SegmentRules(settle_s=0.0, min_duration_s=more)).used


@pytest.mark.parametrize("at", [1, -2])
def test_an_encoder_that_goes_back_at_either_end_of_a_segment_is_refused(at):
    (piece,) = steady(0.7, 300.0)
    alpha = piece.alpha.copy()
    # within the first and the last block: their rates are as before
    alpha[at] = alpha[0] - 1e-6 if at == 1 else alpha[-1] + 1e-6
    result = find_segments([TableAngle(0, 0.0, DT, alpha)], SegmentRules(settle_s=0.0))
    assert not result.used
    assert result.rejected[0].reason == "the encoder goes backwards or stands still 1 time"
