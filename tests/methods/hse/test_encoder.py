from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.errors import AlignmentError
from sinstool.methods.hse.encoder import SMOOTHING_S, table_angle
from sinstool.methods.hse.rig import EncoderModel

EPOCH = 1_700_000_000_123_456_789
RATE = 0.7
ARCSEC = np.pi / 648000.0


def ns(seconds):
    return EPOCH + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def wrapped(angle):
    return np.mod(angle, 2 * np.pi)


def steady(rate=RATE, imu=500.0, encoder=100.0, seconds=20.0, start=5.9, late=0.0137):
    """Gyro stamps, encoder stamps and readings; the encoder starts earlier and stops later."""
    gyro = late + np.arange(round(seconds * imu)) / imu
    at = np.arange(round((seconds + 0.1) * encoder)) / encoder
    return gyro, at, start + rate * at


def test_edges_are_those_of_the_interval_for_each_kind_of_stamp():
    gyro, at, angle = steady()
    for stamp, back in (("end", 1.0), ("mid", 0.5), ("start", 0.0)):
        (piece,) = table_angle(ns(gyro), ns(at), wrapped(angle), EncoderModel(), stamp)
        assert piece.first == 0
        assert len(piece) == len(gyro) == len(piece.alpha) - 1
        edges = gyro[0] - back * 0.002 + 0.002 * np.arange(len(gyro) + 1)
        want = 5.9 + RATE * edges
        assert np.abs(piece.alpha - want).max() < 1e-9 * RATE  # stamps are whole ns
        assert piece.start_s == pytest.approx(-back * 0.002, abs=2e-9)


def test_epoch_stamps_keep_every_nanosecond():
    # as float64 seconds stamps have a grain of 0.24 us: 0.2 urad at this rate
    gyro, at, angle = steady(rate=1.0)
    (late,) = table_angle(ns(gyro), ns(at), wrapped(angle), EncoderModel())
    (early,) = table_angle(ns(gyro) - EPOCH, ns(at) - EPOCH, wrapped(angle), EncoderModel())
    np.testing.assert_array_equal(late.alpha, early.alpha)
    assert late.start_s == early.start_s


def test_delay_sign_offset_unit_and_harmonics():
    gyro, at, angle = steady()
    (plain,) = table_angle(ns(gyro), ns(at), wrapped(angle), EncoderModel(), smoothing_s=0.0)
    want = plain.alpha
    # a reading stamped t shows the angle at t - delay
    stale = EncoderModel(delay=3e-3)
    (got,) = table_angle(ns(gyro), ns(at), wrapped(angle - RATE * 3e-3), stale, smoothing_s=0.0)
    np.testing.assert_allclose(got.alpha, want, atol=2e-9)
    model = EncoderModel(sign=-1, offset=0.4, unit="deg")
    readings = np.mod(np.degrees(-(angle - 0.4)), 360.0)
    (got,) = table_angle(ns(gyro), ns(at), readings, model, smoothing_s=0.0)
    turns = (got.alpha - want) / (2 * np.pi)
    np.testing.assert_allclose(turns, round(turns[0]), atol=1e-9)
    wrong = angle + 2e-5 * np.cos(angle) - 1e-5 * np.sin(2 * angle)
    model = EncoderModel(harmonics=((1, 2e-5, 0.0), (2, 0.0, -1e-5)))
    (bad,) = table_angle(ns(gyro), ns(at), wrapped(wrong), EncoderModel(), smoothing_s=0.0)
    (got,) = table_angle(ns(gyro), ns(at), wrapped(wrong), model, smoothing_s=0.0)
    assert np.abs(bad.alpha - want).max() > 2e-5
    np.testing.assert_allclose(got.alpha, want, atol=2e-9)


@given(
    st.floats(-3.0, 3.0).filter(lambda r: abs(r) > 0.02),
    st.sampled_from(["turn", "half", "none"]),
    st.booleans(),
)
def test_wraps_of_every_kind_are_the_same_angle(rate, wrap, degrees):
    gyro, at, angle = steady(rate=rate, imu=100.0, encoder=25.0)
    reading = {
        "turn": np.mod(angle, 2 * np.pi),
        "half": np.mod(angle + np.pi, 2 * np.pi) - np.pi,
        "none": angle,
    }[wrap]
    model = EncoderModel(unit="deg" if degrees else "rad")
    (piece,) = table_angle(ns(gyro), ns(at), np.degrees(reading) if degrees else reading, model)
    np.testing.assert_allclose(np.diff(piece.alpha), rate / 100.0, atol=1e-8)
    turns = (piece.alpha[0] - (5.9 + rate * (gyro[0] - 0.01))) / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-7)


def test_smoothing_takes_stamp_jitter_and_keeps_the_angle_monotone():
    random = np.random.default_rng(3)
    gyro, at, angle = steady(encoder=500.0, seconds=60.0)
    jittered = np.sort(at + 3e-3 * random.standard_normal(len(at)))  # more than an interval
    rough = table_angle(ns(gyro), ns(jittered), wrapped(angle), EncoderModel(), smoothing_s=0.0)
    (smooth,) = table_angle(ns(gyro), ns(jittered), wrapped(angle), EncoderModel())
    # readings were sorted by stamp, so that their mean lateness is no longer 0 to each reading
    middle = slice(500, -500)
    errors = [
        p.alpha[middle] - (5.9 + RATE * (gyro[0] - 0.002 + p.first * 0.002))
        - RATE * 0.002 * np.arange(len(p.alpha))[middle]
        for p in (rough[0], smooth)
    ]  # fmt: skip
    assert np.std(errors[0]) > 5 * np.std(errors[1])
    assert (np.diff(smooth.alpha) > 0.0).all()


def test_smoothing_is_exact_at_constant_rate_whatever_the_stamps():
    random = np.random.default_rng(4)
    gyro, _, _ = steady(seconds=30.0)
    at = np.cumsum(random.uniform(1e-3, 9e-3, 8000))  # uneven, but true
    (piece,) = table_angle(ns(gyro), ns(at), wrapped(5.9 + RATE * at), EncoderModel())
    edges = gyro[0] - 0.002 + 0.002 * np.arange(piece.first, piece.first + len(piece.alpha))
    assert np.abs(piece.alpha - (5.9 + RATE * edges)).max() < 2e-9
    assert SMOOTHING_S > 0.0


def test_smoothing_adds_up_nothing_in_an_hour():
    gyro, at, angle = steady(rate=1.0471234, imu=1.0, encoder=500.0, seconds=3600.0)
    (piece,) = table_angle(ns(gyro), ns(at), angle, EncoderModel(), "start")
    away = piece.alpha - (5.9 + 1.0471234 * (piece.first + gyro[0] + np.arange(len(piece) + 1)))
    assert np.abs(away).max() < 1e-11  # plain sums: 9e-10


def test_gyro_jitter_is_taken_out_by_the_grid():
    random = np.random.default_rng(6)
    gyro, at, angle = steady(seconds=60.0)
    jittered = gyro + 1e-4 * random.standard_normal(len(gyro))
    (piece,) = table_angle(ns(jittered), ns(at), wrapped(angle), EncoderModel())
    edges = gyro[0] - 0.002 + 0.002 * np.arange(len(gyro) + 1)
    assert np.abs(piece.alpha - (5.9 + RATE * edges)).max() < RATE * 4e-6
    assert piece.jitter_s == pytest.approx(1e-4, rel=0.03)
    assert piece.wander_s < 3e-5


def test_lost_samples_split():
    gyro, at, angle = steady()
    mask = np.ones(len(gyro), bool)
    mask[[4000, 4001, 4002, 7000]] = False
    pieces = table_angle(ns(gyro[mask]), ns(at), wrapped(angle), EncoderModel())
    assert [(p.first, len(p)) for p in pieces] == [(0, 4000), (4000, 2997), (6997, 2999)]
    for piece, row in zip(pieces, (0, 4003, 7001), strict=True):
        edges = gyro[row] - 0.002 + 0.002 * np.arange(len(piece) + 1)
        assert np.abs(piece.alpha - (5.9 + RATE * edges)).max() < 2e-9


def test_gap_of_the_encoder_splits_too():
    gyro, at, angle = steady()
    mask = (at < 8.0) | (at > 9.0)
    pieces = table_angle(ns(gyro), ns(at[mask]), wrapped(angle[mask]), EncoderModel())
    assert len(pieces) == 2
    for piece in pieces:
        edges = gyro[piece.first] - 0.002 + 0.002 * np.arange(len(piece) + 1)
        turns = (piece.alpha - (5.9 + RATE * edges)) / (2 * np.pi)
        assert np.ptp(turns) < 1e-9
    assert pieces[0].start_s + len(pieces[0]) * 0.002 < 8.0
    assert pieces[1].start_s > 9.0 - 0.0137


def test_only_what_the_encoder_covers():
    gyro, at, angle = steady()
    inside = (at > 3.0) & (at < 11.0)
    (piece,) = table_angle(ns(gyro), ns(at[inside]), wrapped(angle[inside]), EncoderModel())
    edges = gyro[piece.first] - 0.002 + 0.002 * np.arange(len(piece) + 1)
    assert edges[0] >= at[inside][0] - 1e-9
    assert edges[-1] <= at[inside][-1] + 1e-9
    assert len(piece) >= (at[inside][-1] - at[inside][0]) * 500 - 2
    assert not table_angle(ns(gyro), ns(at - 1000.0), wrapped(angle), EncoderModel())


def test_faults_are_told():
    gyro, at, angle = steady(seconds=2.0)
    model = EncoderModel()
    swapped = ns(gyro)
    swapped[[7, 8]] = swapped[[8, 7]]
    with pytest.raises(AlignmentError, match=r"gyro stamps do not increase \(sample 8"):
        table_angle(swapped, ns(at), angle, model)
    back = ns(at)
    back[[5, 6]] = back[[6, 5]]
    with pytest.raises(AlignmentError, match="run backwards at reading 6"):
        table_angle(ns(gyro), back, angle, model)
    with pytest.raises(AlignmentError, match="1 encoder readings are not finite"):
        table_angle(ns(gyro), ns(at), np.where(np.arange(len(at)) == 3, np.nan, angle), model)
    with pytest.raises(AlignmentError, match="has 1 reading"):
        table_angle(ns(gyro), ns(at[:1]), angle[:1], model)
    with pytest.raises(AlignmentError, match="same stamp"):
        table_angle(ns(gyro), ns(at[[0, 0]]), angle[:2], model)
    with pytest.raises(ValueError, match="int64"):
        table_angle(gyro, ns(at), angle, model)


def test_repeated_readings_count_once():
    gyro, at, angle = steady()
    twice = np.repeat(np.arange(len(at)), 2)
    (piece,) = table_angle(ns(gyro), ns(at[twice]), angle[twice], EncoderModel())
    (plain,) = table_angle(ns(gyro), ns(at), angle, replace(EncoderModel(), joint="other"))
    np.testing.assert_array_equal(piece.alpha, plain.alpha)


@pytest.mark.parametrize(("stamp", "wanted"), [("end", 0.0), ("start", 1.0)])
def test_whole_turns_of_an_encoder_that_is_read_with_the_gyro_are_whole(stamp, wanted):
    # ten turns of 10 s and not a sample more; encoder and gyro have the same stamps
    at = np.arange(1, 10_001) * 0.01
    angle = 2.0 * np.pi / 10.0 * at
    (piece,) = table_angle(ns(at), ns(at), wrapped(angle), EncoderModel(), stamp)
    assert piece.first == 0 and len(piece) == len(at)
    turns = (piece.alpha - 2.0 * np.pi * 0.01 / 10.0 * wanted) / (2.0 * np.pi)
    assert turns[-1] - turns[0] == pytest.approx(10.0, abs=1e-9)
    assert turns[0] == pytest.approx(0.0, abs=1e-6)
