import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.errors import AlignmentError
from sinstool.methods.hse.encoder import TableAngle
from sinstool.methods.hse.segments import Segment, turn_statistics

DT = 0.01


def made(rate, seconds, start=0.4, ripple=0.0, seed=0, first=0):
    """Angles, samples that are nothing special, and a segment of all of them."""
    n = round(seconds / DT)
    alpha = start + rate * DT * np.arange(n + 1)
    alpha = alpha + ripple * np.sin(alpha)
    samples = np.random.default_rng(seed).standard_normal((first + n, 6)) + 3.0
    piece = TableAngle(first, 1.5, DT, alpha)
    return piece, whole(piece), samples[:, :3], samples[:, 3:]


def whole(piece):
    n = len(piece)
    return Segment(0, 0, n, piece.start_s, n * DT, (piece.alpha[-1] - piece.alpha[0]) / (n * DT))


def reference(alpha, gyro, accel):
    """The same sums by cutting every sample at the ends of turns and summing the pieces."""
    s = np.sign(alpha[-1] - alpha[0])
    turns = int(abs(alpha[-1] - alpha[0]) // (2 * np.pi))
    ends = alpha[0] + s * 2 * np.pi * np.arange(turns + 1)
    cuts = np.unique(np.concatenate([s * alpha, s * ends]))
    cuts = cuts[cuts <= s * ends[-1]]
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    sample = np.searchsorted(s * alpha, middle) - 1
    share = np.diff(cuts) / (s * np.diff(alpha))[sample] * DT
    turn = np.searchsorted(s * ends, middle) - 1
    # mean of cos and sin over each piece
    cos = np.diff(np.sin(s * cuts)) / np.diff(s * cuts)
    sin = -np.diff(np.cos(s * cuts)) / np.diff(s * cuts)
    basis = np.stack([cos, sin, np.ones_like(middle)], axis=1)
    values = np.concatenate([gyro, accel], axis=1)[sample]
    S = np.zeros((turns, 3, 6))
    np.add.at(S, turn, share[:, None, None] * basis[:, :, None] * values[:, None, :])
    weights = np.zeros((turns, 3))
    np.add.at(weights, turn, share[:, None] * basis)
    return S, weights


@given(
    st.floats(0.3, 8.0),
    st.sampled_from([1, -1]),
    st.floats(-50.0, 50.0),
    st.floats(0.0, 0.1),
    st.integers(0, 1000),
)
def test_one_pass_against_numpy(rate, direction, start, ripple, seed):
    piece, segment, gyro, accel = made(direction * rate, 45.0, start, ripple, seed)
    S, weights = reference(piece.alpha, gyro, accel)
    if not len(S):
        return
    got = turn_statistics(piece, segment, gyro, accel)
    np.testing.assert_allclose(got.S, S, rtol=0, atol=1e-10)
    np.testing.assert_allclose(got.circle, weights[:, :2], rtol=0, atol=1e-10)
    np.testing.assert_allclose(got.duration, weights[:, 2], rtol=0, atol=1e-11)
    assert got.direction == direction


@pytest.mark.parametrize("rate", [0.7, -1.05])
def test_what_is_fixed_to_the_body_drops_out(rate):
    # turns end within samples: nothing is left of them but rounding
    piece, segment, gyro, _ = made(rate, 100.0)
    constant = np.full_like(gyro, 2.5)
    got = turn_statistics(piece, segment, constant, constant)
    assert abs(got.duration[0] / DT % 1.0 - 0.5) < 0.49
    assert np.abs(got.S[:, :2]).max() < 1e-12
    np.testing.assert_allclose(got.S[:, 2], 2.5 * got.duration[:, None] * np.ones(6), rtol=1e-13)
    assert got.rate == pytest.approx(rate, rel=1e-13)
    np.testing.assert_allclose(got.direction * 2.0 * np.pi / got.duration, rate, rtol=1e-11)


def test_turns_that_end_with_samples_are_counted():
    n = 1000
    alpha = 0.1 + 2 * np.pi * np.arange(3 * n + 1) / n
    piece = TableAngle(0, 0.0, DT, alpha)
    samples = np.ones((3 * n, 3))
    got = turn_statistics(piece, whole(piece), samples, samples)
    assert len(got) == 3
    np.testing.assert_allclose(got.duration, n * DT, rtol=1e-12)


def test_rows_of_the_log_are_those_of_the_piece():
    piece, segment, gyro, accel = made(0.7, 60.0, first=137)
    got = turn_statistics(piece, segment, gyro, accel)
    S, _ = reference(piece.alpha, gyro[137:], accel[137:])
    np.testing.assert_allclose(got.S, S, atol=1e-10)
    later = Segment(0, 500, 5500, 6.5, 50.0, 0.7)
    got = turn_statistics(piece, later, gyro, accel)
    S, _ = reference(piece.alpha[500:5501], gyro[637:5637], accel[637:5637])
    np.testing.assert_allclose(got.S, S, atol=1e-10)
    assert got.start_s == 6.5


def test_faults_are_told():
    piece, segment, gyro, accel = made(0.7, 60.0, first=10)
    with pytest.raises(AlignmentError, match="no whole turn"):
        turn_statistics(piece, Segment(0, 0, 800, 1.5, 8.0, 0.7), gyro, accel)
    alpha = piece.alpha.copy()
    alpha[1001] = alpha[1000]
    with pytest.raises(AlignmentError, match="does not advance steadily at sample 1010"):
        turn_statistics(TableAngle(10, 1.5, DT, alpha), segment, gyro, accel)
    alpha = piece.alpha.copy()
    alpha[1001:] += 3.3
    with pytest.raises(AlignmentError, match="at sample 1010"):
        turn_statistics(TableAngle(10, 1.5, DT, alpha), segment, gyro, accel)
    holed = gyro.copy()
    holed[2000, 1] = np.nan
    with pytest.raises(AlignmentError, match="not finite"):
        turn_statistics(piece, segment, holed, accel)
    with pytest.raises(ValueError, match="rows of three"):
        turn_statistics(piece, segment, gyro[:-5], accel)
