"""Where gyros deny the angle of a turntable."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.earth import EARTH_RATE
from sinstool.methods.hse.agreement import stamped_angles
from sinstool.methods.hse.encoder import table_angle
from sinstool.methods.hse.rig import EncoderModel
from sinstool.methods.hse.segments import SegmentRules, find_segments

RATE = 100.0
LATITUDE = 0.7
RULES = SegmentRules(min_turns=4, min_duration_s=20.0)


def turning(rates, seed=0, hold=60.0, jitter=0.0, scale=0.0, bias=0.0, walk=0.0):
    """Pieces, those without smoothing, stretches, axial rates and true angles at the stamps."""
    random = np.random.default_rng(seed)
    knots, values = [0.0], [0.0]
    for rate in rates:
        for length in (5.0, hold):
            knots.append(knots[-1] + length)
            values.append(np.radians(rate))
    t = np.arange(int(knots[-1] * RATE) + 1) / RATE
    # A line's mean over an interval is the one in its middle
    means = np.interp(0.5 * (t[1:] + t[:-1]), knots, values)
    alpha = np.concatenate([[0.0], np.cumsum(means) / RATE])
    gyro = (1.0 + scale) * (means - EARTH_RATE * np.sin(LATITUDE)) + bias
    gyro += walk * np.sqrt(RATE) * random.standard_normal(len(gyro))
    stamps = np.round(t * 1e9).astype(np.int64)
    encoder_ns = np.sort(stamps + np.round(jitter * 1e9 * random.standard_normal(len(t)))).astype(
        np.int64
    )
    both = [
        table_angle(stamps[1:], encoder_ns, alpha % (2.0 * np.pi), EncoderModel(), "end", smooth)
        for smooth in (0.25, 0.0)
    ]
    return *both, find_segments(both[0], RULES).used, gyro, alpha[1:]


@pytest.mark.parametrize("seed", range(6))
def test_sound_encoders_are_not_denied(seed):
    """Whatever the errors of scale and bias, the noise, and the jitter of stamps."""
    random = np.random.default_rng(seed)
    rates = random.choice([30.0, -45.0, 90.0, -120.0, 180.0], 3, replace=False)
    smooth, read, stretches, gyro, alpha = turning(
        rates, seed,
        jitter=random.choice([0.0, 1e-4, 1e-3]), scale=random.choice([0.0, 1e-3, -0.02]),
        bias=np.radians(random.choice([0.0, 0.5]) / 3600.0),
        walk=np.radians(random.choice([0.001, 0.05]) / 60.0),
    )  # fmt: skip
    assert len(stretches) == 3
    (angle,) = stamped_angles(smooth, read, stretches, gyro, LATITUDE, "end")
    assert not angle.denied.any()
    steady = np.isin(np.arange(len(alpha)), [k for s in stretches for k in range(s.first, s.stop)])
    turned = (angle.alpha - alpha)[steady]
    assert np.ptp(turned) < 5e-3


@pytest.mark.parametrize("stamp", ["start", "mid", "end"])
def test_stamps_anywhere_in_their_intervals(stamp):
    smooth, read, stretches, gyro, alpha = turning([60.0, -60.0])
    # Of stamps at another edge the same intervals are other ones, by one sample
    (angle,) = stamped_angles(smooth, read, stretches, gyro, LATITUDE, stamp)
    back = {"start": 1.0, "mid": 0.5, "end": 0.0}[stamp]
    expected = alpha - back * np.diff(alpha, prepend=0.0)
    apart = angle.alpha - expected
    assert np.abs(apart - apart[0])[1000:-1000].max() < 1e-4
    assert not angle.denied.any()


def test_a_piece_that_no_stretch_lies_in():
    """Behind a gap of the encoder: denied against most of its samples."""
    smooth, read, stretches, gyro, _ = turning([60.0])
    first = len(read[0]) - 300
    cut = [
        [
            replace(piece, alpha=piece.alpha[: first + 1].copy()),
            replace(
                piece, first=first, alpha=piece.alpha[first:].copy(),
                start_s=piece.start_s + first * piece.interval_s,
            ),
        ]
        for piece in (smooth[0], read[0])
    ]  # fmt: skip
    stretches = [replace(s, stop=min(s.stop, first)) for s in stretches]
    for pieces in cut:
        pieces[1].alpha[100:103] += 0.2
    angles = stamped_angles(*cut, stretches, gyro, LATITUDE, "end")
    assert not angles[0].denied.any()
    np.testing.assert_array_equal(np.flatnonzero(angles[1].denied), [99, 100, 101])
