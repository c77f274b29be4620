"""Latency and lever arm by scores: what bad fixes and the prior do to the answer."""

import numpy as np
import pytest

from sinstool.methods.ins_gnss.receiver_offsets import _FAR, LATENCY_S, _robust, _Scores, _solved


def scores(nis, rows=6.0, latency=0.05, weight=400.0):
    """Epochs a second apart that each say `latency` with `weight`, 1/s^2."""
    n = len(nis)
    information = np.tile(np.diag([weight, 1e-3, 1e-3, 1e-3]), (n, 1, 1))
    score = np.tile([weight * latency, 0.0, 0.0, 0.0], (n, 1))
    many = np.full(n, rows)
    none = np.zeros(n, bool)
    seconds = np.arange(n, dtype=np.int64) * 10**9
    return _Scores(
        seconds, information, score, np.asarray(nis), many, np.zeros((n, 3, 4, 4)), ~none, none
    )


def test_no_epoch_weighs_more_than_usual_ones():
    """Huber's weight: 1 up to three times what is usual, then as one over the size."""
    nis = np.full(40, 24.0)  # twice as large as noise explains
    nis[7], nis[8] = 24.0 * 2.9**2, 24.0 * 300.0**2
    plain = scores(nis)
    robust = _robust(plain)
    weight = np.ones(40)
    weight[8] = _FAR / 300.0
    np.testing.assert_allclose(robust.nis, plain.nis * weight)
    np.testing.assert_allclose(robust.rows, plain.rows * weight)
    np.testing.assert_allclose(robust.score, plain.score * weight[:, None])
    np.testing.assert_allclose(robust.information, plain.information * weight[:, None, None])
    # Where the usual innovation is smaller than the filter expects, one of its sigmas is usual
    small = _robust(scores(np.where(np.arange(40) == 8, 6.0 * 2.9**2, 0.06)))
    np.testing.assert_array_equal(small.rows, 6.0)


def test_a_bad_fix_hardly_moves_the_latency():
    good = scores(np.full(400, 6.0))
    good.score[200, 0] += 400.0 * 30.0  # says 30 s
    good.nis[200] = 400.0 * 30.0**2
    usual = np.zeros(4)
    latency, covariance = _solved(good, usual, usual, 1.0)
    assert latency[0] == pytest.approx(0.05, abs=0.01)
    # The prior, 0.2 s, has no say beside 400 epochs of 0.05 s each
    assert np.sqrt(covariance[0, 0]) < 0.1 * LATENCY_S
